"""Options for the conventions of a recording: columns, units, rate, axes, quaternions, name, ROS topics and frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
Topics = Annotated[
    list[str] | None,
    typer.Option("--topic", metavar="NAME", help="Of a ROS log, a topic or child frame with poses; may be repeated."),
]
Frame = Annotated[str | None, typer.Option(metavar="NAME", help="Of a ROS log, the frame in which poses are wanted.")]
Robot = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Whose joints the file has: URDF, MJCF or a robot's name; poses are its tool's."),
]
Tool = Annotated[str | None, typer.Option(metavar="FRAME", help="Of the robot, the frame that moves with the part.")]
JointRanges = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="Of a log in percent of the joints' ranges: LeRobot's calibration.json."),
]
Commands = Annotated[
    Literal["displacement", "position", "velocity"] | None,
    typer.Option(help="What actions mean: a displacement, the way to a commanded position, or a velocity [m/s]."),
]
PositionsOnly = Annotated[
    bool, typer.Option("--positions-only", help="Leave orientations out: a hand turned on what it held.")
]
PartName = Annotated[str | None, typer.Option("--name", metavar="NAME", help="Name of the only part.")]


@dataclass(frozen=True)
class ConventionOptions:
    """Values of the options; None where omitted."""

    columns: str | None = None
    units: str | None = None
    rate: float | None = None
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    quaternion: Literal["xyzw", "wxyz"] | None = None
    name: str | None = None
    topics: Sequence[str] | None = None
    frame: str | None = None
    robot: str | None = None
    tool: str | None = None
    joint_ranges: str | None = None
    commands: Literal["displacement", "position", "velocity"] | None = None
    positions_only: bool = False

    def conventions(self) -> Conventions | None:
        """The options as conventions; None if all are omitted, so that a conventions file can apply.

        Raises:
            InputError: for a unit or a column that there is not.
        """
        if self == ConventionOptions():
            return None
        from micah_plan.recording.conventions import Conventions

        unit_of = _units(self.units)
        return Conventions(
            columns=_columns(self.columns),
            length=unit_of.get("length"),
            angle=unit_of.get("angle"),
            time=unit_of.get("time"),
            rate=self.rate,
            up=self.up,
            quaternion=self.quaternion,
            name=self.name,
            topics=tuple(self.topics or ()),
            frame=self.frame,
            robot=self.robot,
            tool=self.tool,
            joint_ranges=self.joint_ranges,
            commands=self.commands,
            positions_only=self.positions_only or None,
        )


def _columns(text: str | None) -> dict[str, str]:
    options: dict[str, str] = {}
    for pair in [] if text is None else text.split(","):
        ours, equals, theirs = (piece.strip() for piece in pair.partition("="))
        if not (ours and equals and theirs) or ours in options:
            problem = f"expected OURS=THEIRS, each once, found {shown(pair)}"
            raise InputError(problem, source="--columns", remedy="e.g. --columns t=Time,x=TX,y=TY,z=TZ")
        options[ours] = theirs
    return options


def _units(text: str | None) -> dict[str, str]:
    """Units by quantity."""
    from micah_plan.recording.conventions import ANGLES, LENGTHS, TIMES

    kinds = {"length": LENGTHS, "angle": ANGLES, "time": TIMES}
    options: dict[str, str] = {}
    for unit in [] if text is None else [piece.strip() for piece in text.split(",")]:
        kind = next((kind for kind, units in kinds.items() if unit in units), None)
        if kind is None or kind in options:
            problem = f"expected one unit each of length, angle and time, found {shown(text or '')}"
            raise InputError(problem, source="--units", remedy="e.g. --units mm,deg")
        options[kind] = unit
    return options
