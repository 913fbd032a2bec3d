"""`micah-plan check`: whether files can be used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from micah_plan import summaries
from micah_plan.cli import tables
from micah_plan.cli.console import BAD_INPUT, print_summary, progress_bar
from micah_plan.cli.options import JsonFlag


def check(
    files: Annotated[list[Path], typer.Argument(help="Models, parts, problems, sweeps, plans and recordings.")],
    as_json: JsonFlag = False,
) -> None:
    """Say what is wrong with files, one line per fault, without solving; exit code 2 if one cannot be used."""
    from micah_plan.checking import check_file

    with progress_bar(as_json) as progress:
        found = []
        for i, file in enumerate(files):
            progress(f"checking {file.name}", i / len(files))
            found.append(check_file(file))
    print_summary(as_json, summaries.checked(found), lambda: tables.print_checked(found))
    if any(item.faults for item in found):
        raise typer.Exit(BAD_INPUT)
