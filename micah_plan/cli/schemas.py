"""`micah-plan schema`: what the project's files may hold, for editors."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli import tables
from micah_plan.outputs import PLAN, Output, check_outputs


class SchemaKind(StrEnum):
    """The files that have a schema."""

    PROBLEM = "problem"
    MODEL = "model"
    PARTS = "parts"
    SWEEP = "sweep"
    PLAN = "plan"


def schema(
    kind: Annotated[SchemaKind, typer.Argument(help="The kind of file.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File to write (.json); default: stdout.")
    ] = None,
) -> None:
    """Print the JSON Schema of a file, with which editors complete, explain and check it."""
    from micah_plan.documents.schema import schema as described
    from micah_plan.files import replace_file

    check_outputs((), (Output("-o", output, PLAN),))
    text = json.dumps(described(kind.value), indent=2)
    if output is None:
        print(text)
        return
    replace_file(output, (text + "\n").encode())
    tables.print_files((output,))
