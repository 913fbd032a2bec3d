"""`micah-plan demo`: the whole workflow on a shipped object, in a new folder."""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from micah_plan.cli.console import (
    JsonFlag,
    out,
    print_lines,
    print_summary,
)
from micah_plan.errors import InputError
from micah_plan.quantities import count, duration

if TYPE_CHECKING:
    pass

# A sentence about each step, and its command; {out} is where the files go. The last needs MuJoCo.
STEPS = (
    (
        "A recorded demonstration of a desk stapler becomes a hybrid automaton: a hinge that latches.",
        "learn examples/demonstrations/stapler.csv --parts models/parts/stapler.yaml -o {out}/stapler.yaml"
        " --figure {out}/segments.png --html {out}/recording.html",
    ),
    (
        "POMDP-HD finds how an arm gets it onto the books: pressed shut on the table first. Only the place is given.",
        "solve problems/stapler_on_books.yaml --model {out}/stapler.yaml -o {out}/plan.json --html {out}/plan.html"
        " --figure {out}/plan.png",
    ),
    (
        "The model itself executes the plan 3 times, with filter and feedback.",
        "execute {out}/plan.json --plant nominal --trials 3 -o {out}/nominal.csv --html {out}/nominal.html",
    ),
    (
        "Physics (MuJoCo) executes it 3 times: an arm under position control, contact, a latch, loose books.",
        "execute {out}/plan.json --plant mujoco --trials 3 -o {out}/runs.csv --figure {out}/belief.png"
        " --html {out}/runs.html",
    ),
)


def demo(
    folder: Annotated[Path, typer.Argument(help="New folder for the shipped files and for what is made of them.")],
    copy_only: Annotated[
        bool, typer.Option("--copy-only", help="Only copy the demonstrations, models and problems.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Learn, plan and execute a shipped demonstration in a new folder, which then has all shipped files."""
    from micah_plan.templates.shipped import copy_shipped

    files = copy_shipped(folder)
    if copy_only:
        summary = {"folder": str(folder), "files": len(files)}
        print_summary(as_json, summary, lambda: print_lines((f"{count(len(files), 'file')} in {folder}",)))
        return
    (folder / "output").mkdir()
    code = run_demo(folder, Path("output"), quiet=as_json)
    if code:
        raise typer.Exit(code)
    summary = {"folder": str(folder), "output": sorted(file.name for file in (folder / "output").iterdir())}
    print_summary(as_json, summary, lambda: None)


def run_demo(place: Path, output: Path, *, quiet: bool = False) -> int:
    """Run all steps in a folder with the shipped files; each is a command that users can type.

    Args:
        place: the folder.
        output: where files go, relative to it.
        quiet: print nothing but errors.

    Returns:
        The exit code of the step that failed, else 0.

    Raises:
        InputError: if the folder for the output is not there.
    """
    if not (place / output).is_dir():
        raise InputError("the folder for the output is not there", source=place / output, remedy="make it")
    steps = STEPS if find_spec("mujoco") is not None else STEPS[:-1]
    begin = time.monotonic()
    for number, (sentence, command) in enumerate(steps, start=1):
        arguments = command.format(out=output)
        if not quiet:
            out.print(f"\n[{number}/{len(steps)}] {sentence}\n$ micah-plan {arguments}")
        line = [sys.executable, "-m", "micah_plan", *shlex.split(arguments)]
        code = subprocess.run(line, cwd=place, check=False, stdout=subprocess.DEVNULL if quiet else None).returncode  # noqa: S603
        if code:
            print(f"this step ended with exit code {code}", file=sys.stderr)
            return code
    if not quiet:
        last = "runs.html" if steps is STEPS else "nominal.html"  # in physics, or in the model
        pages = " and ".join(str(place / output / name) for name in ("plan.html", last))
        print_lines((f"\nDone in {duration(time.monotonic() - begin)}. Open {pages} in a browser.",))
        if steps is not STEPS:
            print_lines(("With the extra 'sim' (MuJoCo) physics executes the plan, too.",))
    return 0
