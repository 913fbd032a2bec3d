"""`micah-plan convert`: files in the formats of others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from micah_plan.cli import tables
from micah_plan.cli.console import err, print_summary
from micah_plan.cli.options import JsonFlag
from micah_plan.outputs import Output, check_outputs


def convert(
    source: Annotated[Path, typer.Argument(help="Recording, plan, model (YAML) or URDF.")],
    target: Annotated[Path, typer.Argument(help="File to write; its ending says what.")],
    topic: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Topic or child frame of an MCAP file to read; default: all with poses."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Convert recordings (CSV, NPZ, TUM, MCAP), plans (to JointTrajectory) and models (to and from URDF)."""
    from micah_plan.exchange.convert import convert as converted
    from micah_plan.exchange.convert import targets

    check_outputs((source,), (Output("the target", target, targets(source)),))
    kind, notes = converted(source, target, topics=topic or ())
    for note in notes:
        err.print(f"warning: {note}", markup=False, style="yellow")
    summary = {"kind": kind, "notes": list(notes), "file": str(target), "bytes": target.stat().st_size}
    print_summary(as_json, summary, lambda: tables.print_files((target,)))
