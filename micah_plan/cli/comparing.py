"""`micah-plan diff`: what differs between two models."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli import tables
from micah_plan.cli.console import print_summary
from micah_plan.cli.options import JsonFlag


def diff(
    before: Annotated[Path, typer.Argument(help="Model (YAML).")],
    after: Annotated[Path, typer.Argument(help="Model (YAML).")],
    as_json: JsonFlag = False,
) -> None:
    """Say what differs between two models: what calibration added, or what two recordings taught."""
    from micah_plan.documents.model_difference import differences
    from micah_plan.documents.model_file import load_model

    found = differences(load_model(before), load_model(after))
    summary = {"differences": [{"place": d.place, "before": d.before, "after": d.after} for d in found]}
    lines = tuple(str(difference) for difference in found) or ("the models are the same",)
    print_summary(as_json, summary, lambda: tables.print_lines(lines))
