"""`micah-plan check`, `diff` and `doctor`: whether files and the installation can be used, and how models differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from micah_plan.cli.console import BAD_INPUT, NO_RESULT, JsonFlag, out, print_lines, print_summary, progress_bar, table
from micah_plan.errors import InputError

if TYPE_CHECKING:
    from micah_plan.checking import FileCheck
    from micah_plan.environment import Environment

_LONGEST_LINE = 200


def check(
    files: Annotated[list[Path], typer.Argument(help="Models, parts, problems, sweeps, plans and recordings.")],
    as_json: JsonFlag = False,
) -> None:
    """List what is wrong with files, one line per fault, without solving; exit code 2 if one cannot be used."""
    from micah_plan.checking import check_file

    with progress_bar(as_json) as progress:
        found = []
        for i, file in enumerate(files):
            progress(f"checking {file.name}", i / len(files))
            found.append(check_file(file))
    print_summary(as_json, checked(found), lambda: _print_checked(found))
    if any(item.faults for item in found):
        raise typer.Exit(BAD_INPUT)


def checked(found: Sequence[FileCheck]) -> dict[str, Any]:
    """Keys of `check`: the number of faults, and per file its kind, faults and warnings."""
    files = [
        {
            "file": str(item.file),
            "kind": item.kind,
            "faults": [fault(error) for error in item.faults],
            "warnings": list(item.warnings),
        }
        for item in found
    ]
    return {"faults": sum(len(item.faults) for item in found), "files": files}


def fault(error: InputError) -> dict[str, Any]:
    """An error in its pieces; line and column (from 1) are null where they are not known."""
    line, column = error.position or (None, None)
    place = {"source": error.source, "where": error.where, "line": line, "column": column}
    return {**place, "problem": error.problem, "remedy": error.remedy, "message": str(error)}


def _print_checked(found: Sequence[FileCheck]) -> None:
    for item in found:
        for fault in item.faults:
            out.print(f"error: {fault}", style="red")
        for warning in item.warnings:
            out.print(f"warning: {item.file}: {warning}", style="yellow")
        if not item.faults:
            article = "an" if item.kind == "experiment" else "a"
            out.print(f"{item.file}: {article} {item.kind} that can be used")


def diff(
    before: Annotated[Path, typer.Argument(help="Model (YAML).")],
    after: Annotated[Path, typer.Argument(help="Model (YAML).")],
    as_json: JsonFlag = False,
) -> None:
    """List what differs between two models, such as what calibration added or what two recordings led to."""
    from micah_plan.documents.model import load_model
    from micah_plan.documents.model_difference import differences

    found = differences(load_model(before), load_model(after))
    lines = [_short(str(difference)) for difference in found] or ["the models are the same"]
    print_summary(as_json, {"differences": [asdict(one) for one in found]}, lambda: print_lines(lines))


def _short(line: str) -> str:
    """A line as a terminal shows it; matrices are cut, --json has them whole."""
    return line if len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 4]} ..."


def doctor(as_json: JsonFlag = False) -> None:
    """Test libraries, solvers and browser, and say what to install; exit code 1 if planning cannot work."""
    from micah_plan.environment import examine

    with progress_bar(as_json) as progress:
        found = examine(progress)
    libraries = [
        {**asdict(item.library), "state": item.state, "version": item.version, "message": item.message}
        for item in found.libraries
    ]
    summary = {**asdict(found), "complete": found.complete, "libraries": libraries}
    print_summary(as_json, summary, lambda: _print_environment(found))
    if not found.complete:
        raise typer.Exit(NO_RESULT)


def _print_environment(found: Environment) -> None:
    out.print(f"micah_plan {found.micah_plan}, Python {found.python}, {found.system}")
    shown = table("library", "version", "state", "for", "extra")
    for item in found.libraries:
        library = item.library
        shown.add_row(library.name, item.version or "-", item.state, library.purpose, library.extra)
    out.print(shown)
    out.print(f"IPOPT solves with: {', '.join(found.linear_solvers) or 'nothing'}")
    out.print(f"browser: {found.browser or 'none'}")
    for line in found.advice:
        out.print(line, style="yellow")
