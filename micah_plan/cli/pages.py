"""`micah-plan show`: a recording, a model or a plan as a page."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli.console import JsonFlag, print_files, print_lines, print_summary, progress_bar, title_of
from micah_plan.errors import InputError, located_in
from micah_plan.outputs import PAGE, Output, check_outputs


def show(
    file: Annotated[Path, typer.Argument(help="A recording, a model or a plan.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="File to write.")] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Serve the page to this machine's browsers until Ctrl-C.")
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of --live; 0: any free one.")] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Write a self-contained page of a recording, model or plan; or serve it, and remake it when the file changes."""
    from micah_plan.files import replace_file
    from micah_plan.view.live import PageServer, remade_on_change

    if output is None and not live:
        raise InputError("no output is named", remedy="name a file with -o, or serve the page with --live")
    check_outputs((file,), (Output("-o", output, PAGE),))
    with progress_bar(as_json) as progress:
        current = remade_on_change(file, lambda: _page_of(file, progress))
        page = current().encode()
    if output is not None:
        replace_file(output, page)
    written = {} if output is None else {"page": str(output)}
    summary: dict[str, str | int] = {"kind": _kind_of(file), **written, "bytes": len(page)}
    if not live:
        print_summary(as_json, summary, lambda: print_files((output,)))
        return
    with PageServer(current, port) as server:
        summary["url"] = server.url
        print_summary(as_json, summary, lambda: print_files((output,)))
        if not as_json:
            leave = "for this machine only; reload it after a change, leave with Ctrl-C"
            print_lines((f"the page is at {server.url} {leave}",))
        sys.stdout.flush()  # a program that started this waits for the address
        with suppress(KeyboardInterrupt):  # the way to end it
            server.serve_forever()


def _kind_of(file: Path) -> str:
    return {".yaml": "model", ".yml": "model", ".json": "plan"}.get(file.suffix.lower(), "recording")


def _page_of(file: Path, progress: Callable[[str, float], None]) -> str:
    from micah_plan import workflow

    kind = _kind_of(file)
    if kind == "model":
        from micah_plan.documents.model import load_model
        from micah_plan.view.model_page import model_page

        return model_page(load_model(file), title=title_of(file))
    if kind == "plan":
        from micah_plan.documents.plan import load_plan
        from micah_plan.view.plan_page import plan_page

        stored = load_plan(file)
        return plan_page(stored.plan, stored.problem, title=title_of(file))
    from micah_plan.view.recording_page import recording_page

    recording = workflow.read(file)
    if not workflow.is_long_enough(recording):  # the track alone is still worth seeing
        return recording_page(recording, None, title=title_of(file))
    with located_in(file):
        graph = workflow.learn(recording, progress=progress).graph
    return recording_page(recording, graph, title=title_of(file))
