"""`micah-plan new`, `convert` and `schema`: template files, files in other formats, and the schemas of ours.

**`micah-plan demo`.** The whole road on one object that the project ships, in a folder of its own.

**`micah-plan check`, `diff` and `doctor`.** Whether files and the installation can be used, and how models differ.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from micah_plan.cli.console import (
    BAD_INPUT,
    NO_RESULT,
    JsonFlag,
    out,
    print_files,
    print_lines,
    print_summary,
    print_warnings,
    progress_bar,
    table,
)
from micah_plan.cli.conventions import (
    Columns,
    Commands,
    Frame,
    JointRanges,
    Order,
    PartName,
    PositionsOnly,
    Rate,
    Robot,
    Said,
    Tool,
    Topics,
    Units,
    Up,
)
from micah_plan.cli.user_code import Code, load_code
from micah_plan.errors import InputError, shown
from micah_plan.output_files import PLAN, Output, check_outputs
from micah_plan.quantities import count, duration

if TYPE_CHECKING:
    from micah_plan.checking import FileCheck
    from micah_plan.environment import Environment

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

_LONGEST_LINE = 200


def new(
    kind: Annotated[Literal["problem", "effect", "robot", "sweep", "tags"], typer.Argument(help="What to write.")],
    folder: Annotated[Path, typer.Argument(help="Folder for the files; created if it does not exist.")],
    model: Annotated[Path | None, typer.Option(help="Only for a problem: the model (YAML) of its object.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Write a commented problem, effect, sweep, problem with a robot, or tags to print; nothing is overwritten."""
    from micah_plan.templates.write import write_template

    written = write_template(kind, folder, model=model)
    print_summary(as_json, {"files": [str(path) for path in written]}, lambda: print_files(written))


def convert(
    source: Annotated[Path, typer.Argument(help="Recording, plan, model (YAML), URDF, SDF or MJCF.")],
    target: Annotated[Path, typer.Argument(help="File to write; its suffix chooses the format.")],
    topic: Topics = None,
    frame: Frame = None,
    robot: Robot = None,
    tool: Tool = None,
    joint_ranges: JointRanges = None,
    part: Annotated[str | None, typer.Option(help="Of a recording, the part to write; default: all.")] = None,
    run: Annotated[int | None, typer.Option(help="Of a recording, the run to write; default: all.")] = None,
    poses_only: Annotated[
        bool, typer.Option("--poses-only", help="Of a recording, leave out actions, forces and other columns.")
    ] = False,
    columns: Columns = None,
    units: Units = None,
    rate: Rate = None,
    up: Up = None,
    quaternion: Order = None,
    name: PartName = None,
    commands: Commands = None,
    positions_only: PositionsOnly = False,
    density: Annotated[
        float, typer.Option(min=1.0, max=30000.0, help="Of a model's shapes [kg/m^3], for the masses of bodies.")
    ] = 500.0,
    package: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=FOLDER", help="Of URDF and SDF, where a package of meshes lies; may be repeated."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Convert recordings (also ROS bags), plans (to JointTrajectory) and models (to and from URDF, SDF and MJCF)."""
    from micah_plan.exchange.convert import convert as converted
    from micah_plan.exchange.convert import targets

    check_outputs((source,), (Output("the target", target, targets(source)),))
    said = Said(columns, units, rate, up, quaternion, name, topic, frame, robot, tool, joint_ranges, commands)
    kind, notes = converted(
        source,
        target,
        part=part,
        run=run,
        poses_only=poses_only,
        density=density,
        packages=_packages(package or ()),
        conventions=replace(said, positions_only=positions_only).conventions(),
    )
    print_warnings(notes)
    summary = {"kind": kind, "notes": list(notes), "file": str(target), "bytes": target.stat().st_size}
    print_summary(as_json, summary, lambda: print_files((target,)))


def _packages(options: Sequence[str]) -> dict[str, str]:
    """Folder by package name, from NAME=FOLDER."""
    packages: dict[str, str] = {}
    for text in options:
        name, equals, folder = text.partition("=")
        if not (name and equals and Path(folder).is_dir()):
            problem = f"expected NAME=FOLDER with a folder that exists, found {shown(text)}"
            raise InputError(problem, source="--package", remedy="e.g. --package cupboard_description=../cupboard")
        packages[name] = str(Path(folder).resolve())
    return packages


def schema(
    kind: Annotated[
        Literal["problem", "model", "parts", "scene", "sweep", "experiment", "conventions", "tags", "plan"],
        typer.Argument(help="The kind of file."),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File to write (.json); default: stdout.")
    ] = None,
) -> None:
    """Print the JSON Schema of a file, with which editors complete, explain and check it."""
    from micah_plan.documents.kind import schema as described
    from micah_plan.files import replace_file

    check_outputs((), (Output("-o", output, PLAN),))
    text = json.dumps(described(kind), indent=2)
    if output is None:
        print(text)
        return
    replace_file(output, (text + "\n").encode())
    print_files((output,))


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
    """Run all steps in a folder that has the shipped files; each is a command that one can type oneself.

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


def check(
    files: Annotated[list[Path], typer.Argument(help="Models, parts, problems, sweeps, plans and recordings.")],
    code: Code = None,
    as_json: JsonFlag = False,
) -> None:
    """List what is wrong with files, one line per fault, without solving; exit code 2 if one cannot be used."""
    from micah_plan.checking import check_file

    load_code(code)
    with progress_bar(as_json) as progress:
        checks = []
        for i, file in enumerate(files):
            progress(f"checking {file.name}", i / len(files))
            checks.append(check_file(file))
    print_summary(as_json, check_keys(checks), lambda: _print_checked(checks))
    if any(item.faults for item in checks):
        raise typer.Exit(BAD_INPUT)


def check_keys(checks: Sequence[FileCheck]) -> dict[str, Any]:
    """Keys of `check`: the number of faults, and per file its kind, faults and warnings."""
    files = [
        {
            "file": str(item.file),
            "kind": item.kind,
            "faults": [error_keys(error) for error in item.faults],
            "warnings": list(item.warnings),
        }
        for item in checks
    ]
    return {"faults": sum(len(item.faults) for item in checks), "files": files}


def error_keys(error: InputError) -> dict[str, Any]:
    """An error in its pieces; line and column (from 1) are null where they are not known."""
    line, column = error.position or (None, None)
    place = {"source": error.source, "where": error.where, "line": line, "column": column}
    return {**place, "problem": error.problem, "remedy": error.remedy, "message": str(error)}


def _print_checked(checks: Sequence[FileCheck]) -> None:
    for item in checks:
        for fault in item.faults:
            out.print(f"error: {fault}", style="red")
        for warning in item.warnings:
            out.print(f"warning: {item.file}: {warning}", style="yellow")
        if not item.faults:
            article = {"experiment": "an ", "tags": ""}.get(item.kind or "", "a ")
            out.print(f"{item.file}: {article}{item.kind} that can be used")


def diff(
    before: Annotated[Path, typer.Argument(help="Model (YAML).")],
    after: Annotated[Path, typer.Argument(help="Model (YAML).")],
    as_json: JsonFlag = False,
) -> None:
    """List what differs between two models, such as what calibration added or what two recordings led to."""
    from micah_plan.documents.model import load_model
    from micah_plan.documents.model_difference import differences

    changes = differences(load_model(before), load_model(after))
    lines = [_short(str(difference)) for difference in changes] or ["the models are the same"]
    print_summary(as_json, {"differences": [asdict(change) for change in changes]}, lambda: print_lines(lines))


def _short(line: str) -> str:
    """A line as a terminal shows it; matrices are cut, --json has them whole."""
    return line if len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 4]} ..."


def doctor(as_json: JsonFlag = False) -> None:
    """Test libraries, solvers and browser, and say what to install; exit code 1 if planning cannot work."""
    from micah_plan.environment import examine

    with progress_bar(as_json) as progress:
        environment = examine(progress)
    libraries = [
        {**asdict(item.library), "state": item.state, "version": item.version, "message": item.message}
        for item in environment.libraries
    ]
    summary = {**asdict(environment), "complete": environment.complete, "libraries": libraries}
    print_summary(as_json, summary, lambda: _print_environment(environment))
    if not environment.complete:
        raise typer.Exit(NO_RESULT)


def _print_environment(environment: Environment) -> None:
    out.print(f"micah_plan {environment.micah_plan}, Python {environment.python}, {environment.system}")
    shown = table("library", "version", "state", "for", "extra")
    for item in environment.libraries:
        library = item.library
        shown.add_row(library.name, item.version or "-", item.state, library.purpose, library.extra)
    out.print(shown)
    out.print(f"IPOPT solves with: {', '.join(environment.linear_solvers) or 'nothing'}")
    out.print(f"browser: {environment.browser or 'none'}")
    for line in environment.advice:
        out.print(line, style="yellow")
