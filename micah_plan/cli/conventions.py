"""Options that say how somebody else's recording is meant: columns, units, rate, upward axis, quaternions, name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from micah_plan.errors import InputError, shown

if TYPE_CHECKING:
    from micah_plan.recording.conventions import Conventions

Columns = Annotated[
    str | None,
    typer.Option(metavar="OURS=THEIRS,...", help="What a CSV calls the columns of a recording: t=Time,x=TX,y=TY,z=TZ."),
]
Units = Annotated[
    str | None,
    typer.Option(metavar="UNIT,...", help="Units: m, cm, mm or in; rad or deg; s, ms, us or ns. Default: m,rad,s."),
]
Rate = Annotated[
    float | None, typer.Option(metavar="HZ", help="Rows per second: t counts frames, or rows where there is none.")
]
Up = Annotated[
    Literal["x", "y", "z", "-x", "-y", "-z"] | None, typer.Option(help="The axis that points upwards; default: z.")
]
Order = Annotated[
    Literal["xyzw", "wxyz"] | None, typer.Option(help="Order of the columns of a quaternion; default: scalar last.")
]
PartName = Annotated[str | None, typer.Option("--name", metavar="NAME", help="Name of the only part.")]


def conventions_of(
    columns: str | None,
    units: str | None,
    rate: float | None,
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None,
    quaternion: Literal["xyzw", "wxyz"] | None,
    name: str | None,
) -> Conventions | None:
    """What the options say; None where they say nothing, so that a file beside the recording may.

    Raises:
        InputError: for a unit or a column that there is not.
    """
    if (columns, units, rate, up, quaternion, name) == (None,) * 6:
        return None
    from micah_plan.recording.conventions import Conventions

    unit_of = _units(units)
    return Conventions(
        columns=_columns(columns),
        length=unit_of.get("length"),
        angle=unit_of.get("angle"),
        time=unit_of.get("time"),
        rate=rate,
        up=up,
        quaternion=quaternion,
        name=name,
    )


def _columns(text: str | None) -> dict[str, str]:
    found: dict[str, str] = {}
    for pair in [] if text is None else text.split(","):
        ours, equals, theirs = (piece.strip() for piece in pair.partition("="))
        if not (ours and equals and theirs) or ours in found:
            problem = f"expected OURS=THEIRS, each once, found {shown(pair)}"
            raise InputError(problem, source="--columns", remedy="e.g. --columns t=Time,x=TX,y=TY,z=TZ")
        found[ours] = theirs
    return found


def _units(text: str | None) -> dict[str, str]:
    """The units, by what they measure."""
    from micah_plan.recording.conventions import ANGLES, LENGTHS, TIMES

    kinds = {"length": LENGTHS, "angle": ANGLES, "time": TIMES}
    found: dict[str, str] = {}
    for unit in [] if text is None else [piece.strip() for piece in text.split(",")]:
        kind = next((kind for kind, units in kinds.items() if unit in units), None)
        if kind is None or kind in found:
            problem = f"expected one unit each of length, angle and time, found {shown(text or '')}"
            raise InputError(problem, source="--units", remedy="e.g. --units mm,deg")
        found[kind] = unit
    return found
