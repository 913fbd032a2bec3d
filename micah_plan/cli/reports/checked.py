"""What `check` says of files, and `doctor` of the installation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from micah_plan.cli.console import out, table
from micah_plan.errors import InputError

if TYPE_CHECKING:
    from micah_plan.checking import FileCheck
    from micah_plan.environment import Environment


def checked(found: Sequence[FileCheck]) -> dict[str, Any]:
    """Keys of `check`: the number of faults, and per file its kind, faults and warnings."""
    files = [
        {
            "file": str(item.file),
            "kind": item.kind,
            "faults": [_fault(fault) for fault in item.faults],
            "warnings": list(item.warnings),
        }
        for item in found
    ]
    return {"faults": sum(len(item.faults) for item in found), "files": files}


def _fault(error: InputError) -> dict[str, Any]:
    """An error in its pieces; line and column (from 1) are null where they are not known."""
    line, column = error.position or (None, None)
    return {
        "source": error.source,
        "where": error.where,
        "line": line,
        "column": column,
        "problem": error.problem,
        "remedy": error.remedy,
        "message": str(error),
    }


def print_checked(found: Sequence[FileCheck]) -> None:
    """One line per fault and warning, or that there is none."""
    for item in found:
        for fault in item.faults:
            out.print(f"error: {fault}", markup=False, style="red")
        for warning in item.warnings:
            out.print(f"warning: {item.file}: {warning}", markup=False, style="yellow")
        if not item.faults:
            out.print(f"{item.file}: a {item.kind} that can be used", markup=False)


def examined(found: Environment) -> dict[str, Any]:
    """Keys of `doctor`: versions, libraries with their state, solvers, browser and advice."""
    libraries = [
        {**asdict(item.library), "state": item.state, "version": item.version, "message": item.message}
        for item in found.libraries
    ]
    return {
        "micah_plan": found.micah_plan,
        "python": found.python,
        "system": found.system,
        "complete": found.complete,
        "libraries": libraries,
        "linear_solvers": list(found.linear_solvers),
        "browser": found.browser,
        "advice": list(found.advice),
    }


def print_environment(found: Environment) -> None:
    """Table of the libraries, what else there is, and advice."""
    out.print(f"micah_plan {found.micah_plan}, Python {found.python}, {found.system}", markup=False)
    shown = table("library", "version", "state", "for", "extra")
    for item in found.libraries:
        library = item.library
        shown.add_row(library.name, item.version or "-", item.state, library.purpose, library.extra)
    out.print(shown)
    out.print(f"IPOPT solves with: {', '.join(found.linear_solvers) or 'nothing'}", markup=False)
    out.print(f"browser: {found.browser or 'none'}", markup=False)
    for line in found.advice:
        out.print(line, markup=False, style="yellow")
