"""`micah-plan check`, `diff` and `doctor`: whether files and the installation can be used, and how models differ."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli.console import BAD_INPUT, NO_RESULT, JsonFlag, print_lines, print_summary, progress_bar

_LONGEST_LINE = 200


def check(
    files: Annotated[list[Path], typer.Argument(help="Models, parts, problems, sweeps, plans and recordings.")],
    as_json: JsonFlag = False,
) -> None:
    """List what is wrong with files, one line per fault, without solving; exit code 2 if one cannot be used."""
    from micah_plan.checking import check_file
    from micah_plan.cli.reports.checked import checked, print_checked

    with progress_bar(as_json) as progress:
        found = []
        for i, file in enumerate(files):
            progress(f"checking {file.name}", i / len(files))
            found.append(check_file(file))
    print_summary(as_json, checked(found), lambda: print_checked(found))
    if any(item.faults for item in found):
        raise typer.Exit(BAD_INPUT)


def diff(
    before: Annotated[Path, typer.Argument(help="Model (YAML).")],
    after: Annotated[Path, typer.Argument(help="Model (YAML).")],
    as_json: JsonFlag = False,
) -> None:
    """List what differs between two models, such as what calibration added or what two recordings led to."""
    from micah_plan.documents.model import load_model
    from micah_plan.documents.model_difference import differences

    found = differences(load_model(before), load_model(after))
    summary = {"differences": [{"place": d.place, "before": d.before, "after": d.after} for d in found]}
    lines = tuple(_short(str(difference)) for difference in found) or ("the models are the same",)
    print_summary(as_json, summary, lambda: print_lines(lines))


def _short(line: str) -> str:
    """A line as a terminal shows it; matrices are cut, --json has them whole."""
    return line if len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 4]} ..."


def doctor(as_json: JsonFlag = False) -> None:
    """Test libraries, solvers and browser, and say what to install for what; exit code 1 if planning cannot work."""
    from micah_plan.cli.reports.checked import examined, print_environment
    from micah_plan.environment import examine

    with progress_bar(as_json) as progress:
        found = examine(progress)
    print_summary(as_json, examined(found), lambda: print_environment(found))
    if not found.complete:
        raise typer.Exit(NO_RESULT)
