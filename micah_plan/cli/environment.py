"""`micah-plan doctor`: what this installation can do."""

from __future__ import annotations

import typer

from micah_plan import summaries
from micah_plan.cli import tables
from micah_plan.cli.console import HONEST_NEGATIVE, print_summary, progress_bar
from micah_plan.cli.options import JsonFlag


def doctor(as_json: JsonFlag = False) -> None:
    """Try libraries, solvers and browser, and say what to install for what; exit code 1 if planning cannot work."""
    from micah_plan.environment import examine

    with progress_bar(as_json) as progress:
        found = examine(progress)
    print_summary(as_json, summaries.examined(found), lambda: tables.print_environment(found))
    if not found.complete:
        raise typer.Exit(HONEST_NEGATIVE)
