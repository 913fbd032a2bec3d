"""`micah-plan new`: files to start from."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli import tables
from micah_plan.cli.console import print_summary
from micah_plan.cli.options import JsonFlag


class Template(StrEnum):
    """What can be begun."""

    PROBLEM = "problem"
    EFFECT = "effect"
    ROBOT = "robot"
    SWEEP = "sweep"


def new(
    kind: Annotated[Template, typer.Argument(help="What to begin.")],
    folder: Annotated[Path, typer.Argument(help="Where to write the files; made if it is not there.")],
    model: Annotated[Path | None, typer.Option(help="Of a problem: the model (YAML) that it is about.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Write a commented problem, effect, sweep or problem with a robot that works as it is; nothing is overwritten."""
    from micah_plan.templates.write import write_template

    written = write_template(kind.value, folder, model=model)
    print_summary(as_json, {"files": [str(path) for path in written]}, lambda: tables.print_files(written))
