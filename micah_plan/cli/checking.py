"""`micah-plan check`, `diff` and `doctor`: whether files and the installation can be used, and how models differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from micah_plan.cli.console import (
    BAD_INPUT,
    NO_RESULT,
    JsonFlag,
    out,
    print_lines,
    print_summary,
    progress_bar,
    table,
)
from micah_plan.cli.user_code import Code, load_code
from micah_plan.errors import InputError

if TYPE_CHECKING:
    from micah_plan.checking import FileCheck
    from micah_plan.environment import Environment

_LONGEST_LINE = 200


def check(
    files: Annotated[list[Path], typer.Argument(help="Models, parts, problems, sweeps, plans and recordings.")],
    code: Code = None,
    as_json: JsonFlag = False,
) -> None:
    """Check files without solving, one line per fault; exit code 2 if one cannot be used."""
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
    """An error as JSON; line and column (from 1) are null if unknown."""
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
    """List the differences between two models, such as those added by a calibration or between two recordings."""
    from micah_plan.documents.model import load_model
    from micah_plan.documents.model_difference import differences

    changes = differences(load_model(before), load_model(after))
    lines = [_short(str(difference)) for difference in changes] or ["the models are the same"]
    print_summary(as_json, {"differences": [asdict(change) for change in changes]}, lambda: print_lines(lines))


def _short(line: str) -> str:
    """A line shortened for a terminal; --json prints matrices in full."""
    return line if len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 4]} ..."


def doctor(as_json: JsonFlag = False) -> None:
    """Test libraries, solvers and browser, with advice on installation; exit code 1 if planning cannot work."""
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
