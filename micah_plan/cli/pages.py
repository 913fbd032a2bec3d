"""`micah-plan show`: a recording, a model or a plan as a page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli import tables
from micah_plan.cli.console import print_summary, progress_bar
from micah_plan.cli.options import JsonFlag, OutputPath
from micah_plan.errors import InputError
from micah_plan.outputs import PAGE, Output, check_outputs


def show(
    file: Annotated[Path, typer.Argument(help="A recording, a model or a plan.")],
    output: OutputPath,
    as_json: JsonFlag = False,
) -> None:
    """Write a self-contained page of a recording, a model or a plan."""
    from micah_plan.files import replace_file

    check_outputs((file,), (Output("-o", output, PAGE),))
    with progress_bar(as_json) as progress:
        kind, page = _page_of(file, progress)
    replace_file(output, page.encode())
    summary = {"kind": kind, "page": str(output), "bytes": len(page.encode())}
    print_summary(as_json, summary, lambda: tables.print_files((output,)))


def _page_of(file: Path, progress: Callable[[str, float], None]) -> tuple[str, str]:
    from micah_plan import workflow
    from micah_plan.view import page

    if file.suffix.lower() in (".yaml", ".yml"):
        from micah_plan.spec.model_file import load_model

        return "model", page.model_page(load_model(file), title=file.stem)
    if file.suffix.lower() == ".json":
        from micah_plan.spec.plan_file import load_plan

        stored = load_plan(file)
        return "plan", page.plan_page(stored.plan, stored.problem, title=file.stem)
    recording = workflow.read(file)
    if not workflow.is_long_enough(recording):  # the track alone is still worth seeing
        return "recording", page.recording_page(recording, None, title=file.stem)
    try:
        learned = workflow.learn(recording, progress=progress)
    except InputError as error:
        raise error.located(file) from None
    return "recording", page.recording_page(recording, learned.graph, title=file.stem)
