"""Conventions of foreign files: names of columns, units, rate, upward axis, quaternions.

A recording is in metres, radians and seconds, with z upwards and the scalar of a quaternion last. Logs of laboratories
often are not. `Conventions` define how to read them; nothing is guessed, except for formats that state it themselves.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.errors import InputError, shown
from micah_plan.quantities import count
from micah_plan.recording import messages
from micah_plan.recording.checks import KNOWN
from micah_plan.recording.commands import TARGETS, CommandKind, with_commands
from micah_plan.recording.value import Recording

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
ANGLES = {"rad": 1.0, "deg": float(np.pi / 180)}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
Order = Literal["xyzw", "wxyz"]
ROTATION_VECTOR, FIXED_ANGLES = ("rx", "ry", "rz"), ("roll", "pitch", "yaw")
OF_JOINTS = ("joint ", "target ")
NAMEABLE = (*KNOWN, *ROTATION_VECTOR, *FIXED_ANGLES, *TARGETS)
_NUMBER = r"\d[\d.]*(?:[eE][-+]?\d+)?"
# A column of the file as -NAME or 0.001*NAME, and with another zero, as NAME-2048 or 0.001*(NAME-2048).
_SCALED = re.compile(rf"(?:(?P<minus>-)|(?P<factor>[-+]?{_NUMBER})\s*\*)\s*(?P<name>.+)")
_SHIFTED = re.compile(rf"(?P<name>[^()]+?)\s*(?P<sign>[-+])\s*(?P<offset>{_NUMBER})")
# Rotations (n, 3) rows of a frame with that axis upwards into one with z upwards, by the smallest angle.
_UPRIGHT: Mapping[str, tuple[float, float, float]] = {
    "z": (0.0, 0.0, 0.0),
    "y": (np.pi / 2, 0.0, 0.0),
    "-y": (-np.pi / 2, 0.0, 0.0),
    "x": (0.0, -np.pi / 2, 0.0),
    "-x": (0.0, np.pi / 2, 0.0),
    "-z": (np.pi, 0.0, 0.0),
}


@dataclass(frozen=True)
class Conventions:
    """Conventions of a file; None: those of recordings, or of the file's format.

    Attributes:
        columns: the file's names of a recording's columns (`NAMEABLE`), by the name here, as in ``{"t": "Time"}``.
            Besides those of a recording: ``rx,ry,rz`` (a rotation vector) and ``roll,pitch,yaw`` (about the fixed axes
            x, y, z in that order), in place of a quaternion. ``-Y`` and ``0.001*dX`` are numbers of a column times a
            factor, ``0.0015*(pos-2048)`` those minus an offset. ``target x,target y,target z`` are commanded places, in
            place of actions. Of a robot's joints ``joint NAME`` and ``target NAME``.
        length, angle, time: units: ``LENGTHS``, ``ANGLES``, ``TIMES``.
        rate: rows per second [Hz]; then ``t`` counts frames, and rows are counted where there is none.
        up: the axis that points upwards.
        quaternion: the order in which ``qx,qy,qz,qw`` hold a quaternion.
        name: of the only part.
        topics: of a ROS log, topics with poses or child frames of transforms, one part each; none: all of them.
        frame: of a ROS log, in which the poses are wanted; None: that in which they are given.
        robot: a URDF or MJCF file, or the name of an installed robot, whose joints the file has; the poses are then
            those of its tool in the frame of its base.
        tool: the frame of the robot that moves with the part.
        joint_ranges: file of the calibrated ranges in percent of which the joints are logged: LeRobot's
            ``calibration.json``.
        commands: the meaning of ``ax,ay,az``: a displacement, the displacement to a commanded position, or a velocity
            [m/s].
        positions_only: ignore orientations, e.g. where a hand rotates on the object.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    length: str | None = None
    angle: str | None = None
    time: str | None = None
    rate: float | None = None
    up: Axis | None = None
    quaternion: Order | None = None
    name: str | None = None
    topics: tuple[str, ...] = ()
    frame: str | None = None
    robot: str | None = None
    tool: str | None = None
    joint_ranges: str | None = None
    commands: CommandKind | None = None
    positions_only: bool | None = None

    def __post_init__(self) -> None:
        choices = {
            "length": LENGTHS,
            "angle": ANGLES,
            "time": TIMES,
            "up": get_args(Axis),
            "quaternion": get_args(Order),
            "commands": get_args(CommandKind),
        }
        for key, allowed in choices.items():
            value = getattr(self, key)
            if value is not None and value not in allowed:
                raise InputError(f"{key}: expected one of {', '.join(allowed)}, found {shown(str(value))}")
        if self.rate is not None and not 0.0 < self.rate < 1e9:
            raise InputError(f"rate: expected rows per second, found {self.rate:g}", remedy="e.g. 120")
        for ours in self.columns:
            if ours not in NAMEABLE and not ours.startswith(OF_JOINTS):
                names = ", ".join(NAMEABLE)
                raise InputError(f"columns: a recording has no column {shown(ours)}", remedy=f"choose among {names}")
        if (self.robot is None) != (self.tool is None):
            problem = "a robot and its tool are given together"
            raise InputError(problem, remedy="e.g. --robot panda --tool panda_hand")
        if self.joint_ranges is not None and (self.robot is None or self.angle is not None):
            problem = "the ranges of joints are those of a robot, and joints in percent of them have no unit"
            raise InputError(problem, remedy="give --robot and --tool, and no unit of angles")
        for group in (ROTATION_VECTOR, FIXED_ANGLES, TARGETS):
            if 0 < len(self.columns.keys() & set(group)) < len(group):
                raise InputError(f"columns: expected all of {','.join(group)}", remedy="name the others as well")

    def stated(self) -> dict[str, str]:
        """The stated conventions as strings by name."""
        lists = {"columns": [f"{ours}={theirs}" for ours, theirs in self.columns.items()], "topics": self.topics}
        texts = {field.name: getattr(self, field.name) for field in fields(self)}
        texts |= {name: ",".join(each) or None for name, each in lists.items()}
        return {name: str(text) for name, text in texts.items() if text is not None}

    def refuse_stated(self, names: Sequence[str], problem: str) -> None:
        """Refuse conventions that do not apply to a format.

        Raises:
            InputError: with the problem, if they do.
        """
        if self.stated().keys() & set(names):
            raise InputError(problem, remedy=f"leave out {' and '.join(names)}")

    def completed_by(self, default: Conventions) -> Conventions:
        """These conventions, completed by the defaults of the file's format."""
        open_ones = {
            field.name: getattr(default, field.name) for field in fields(self) if getattr(self, field.name) is None
        }
        return replace(self, **open_ones)


@dataclass(frozen=True)
class ColumnSource:
    """A column of a file, whose numbers mean factor * (number + offset)."""

    name: str
    factor: float = 1.0
    offset: float = 0.0

    @property
    def is_plain(self) -> bool:
        """Whether the numbers need no conversion."""
        return self.factor == 1.0 and self.offset == 0.0

    def values(self, numbers: Any) -> Any:
        """Numbers of the column converted to the recording's unit."""
        return self.factor * (numbers + self.offset) if self.offset else self.factor * numbers


def source_of(text: str, header: Collection[str]) -> ColumnSource:
    """The source column of an expression with factor and offset; a name in the header takes precedence."""
    if text in header:
        return ColumnSource(text)
    scaled = _SCALED.fullmatch(text)
    factor = 1.0 if scaled is None else -1.0 if scaled["minus"] else float(scaled["factor"])
    rest = text if scaled is None else scaled["name"]
    if rest not in header:
        bare = rest[1:-1].strip() if rest.startswith("(") and rest.endswith(")") else rest
        shifted = _SHIFTED.fullmatch(bare)
        if shifted is not None and shifted["name"] in header:
            return ColumnSource(shifted["name"], factor, float(shifted["sign"] + shifted["offset"]))
    return ColumnSource(rest, factor)


def as_recorded(rows: Recording, conventions: Conventions) -> Recording:
    """The rows converted to the units, order and frame of a recording, including rows without a pose.

    Raises:
        InputError: if a name is given to several parts, or a meaning to commands that are not there.
    """
    from scipy.spatial.transform import Rotation

    length, time = LENGTHS[conventions.length or "m"], TIMES[conventions.time or "s"]
    upright = Rotation.from_rotvec(_UPRIGHT[conventions.up or "z"])

    # A turn by quarters: each axis becomes another one, exactly and where a number is missing, too.
    matrix = upright.as_matrix().round()
    axis = np.abs(matrix).argmax(axis=1)
    sign = matrix[np.arange(3), axis]

    def turned(vectors: Floats, scale: float) -> Floats:
        return np.asarray(scale * sign * vectors[:, axis])

    quaternion = rows.quaternion
    if quaternion is not None and conventions.quaternion == "wxyz":
        quaternion = quaternion[:, [1, 2, 3, 0]]
    if quaternion is not None and conventions.up not in (None, "z"):
        quaternion = _times(upright.as_quat(), quaternion)
    part, has_part = rows.part, rows.has_part
    if conventions.name is not None:
        if len(rows.parts) > 1:
            raise InputError(f"one name is given to {count(len(rows.parts), 'part')}", remedy="leave out the name")
        part, has_part = (conventions.name,) * len(rows), True
    read = replace(
        rows,
        time=rows.time * time if conventions.rate is None else rows.time / conventions.rate,
        position=turned(rows.position, length),
        quaternion=quaternion,
        action=None if rows.action is None else turned(rows.action, length),
        force=None if rows.force is None else turned(rows.force, 1.0),
        part=part,
        has_part=has_part,
        conventions=conventions.stated(),
    )
    return read if conventions.commands is None else with_commands(read, conventions.commands)


def without_gaps(rows: Recording) -> tuple[Recording, Ints]:
    """(rows with a pose and a note on the others, their indices (k,)).

    The command of a row without a pose is added to the displacement to the next row with one.

    Raises:
        InputError: if none has.
    """
    lost: Booleans = np.asarray(np.isnan(rows.position).all(axis=1))
    if rows.quaternion is not None:
        zero = (rows.quaternion == 0.0).all(axis=1)  # no orientation; some trackers mark lost rows so
        lost |= np.isnan(rows.quaternion).all(axis=1) | (zero & ~zero.all())
    every = np.arange(len(rows))
    if not lost.any():
        return rows, every
    if lost.all():
        raise InputError("no row has a pose", remedy="check the names of the columns")
    action = None if rows.action is None else rows.action.copy()
    if action is not None:
        last: dict[tuple[int, str], int] = {}
        for i, key in enumerate(zip(rows.run.tolist(), rows.part, strict=True)):
            if not lost[i]:
                last[key] = i
            elif key in last and not np.isnan(action[i]).any():
                action[last[key]] += action[i]
    kept = every[~lost]
    chosen = replace(rows, action=action).rows(kept)
    note = messages.rows_left_out(int(lost.sum()), len(rows), _longest(lost))
    return replace(chosen, notes=(*rows.notes, note)), kept


def turns_of(columns: Mapping[str, Floats], angle: str | None) -> Floats | None:
    """(n, 4) quaternions of a rotation vector or of fixed angles, NaN where these are; None without such columns."""
    from scipy.spatial.transform import Rotation

    names = next((names for names in (ROTATION_VECTOR, FIXED_ANGLES) if all(name in columns for name in names)), None)
    if names is None:
        return None
    values = ANGLES[angle or "rad"] * np.stack([columns[name] for name in names], axis=1)
    is_finite = np.isfinite(values).all(axis=1)
    quaternion = np.full((len(values), 4), np.nan)
    filled = values[is_finite]
    made = Rotation.from_rotvec(filled) if names == ROTATION_VECTOR else Rotation.from_euler("xyz", filled)
    quaternion[is_finite] = made.as_quat()
    return quaternion


def _times(first: Floats, right: Floats) -> Floats:
    """(n, 4) products of one quaternion with others, NaN where these are."""
    from scipy.spatial.transform import Rotation

    is_finite = np.isfinite(right).all(axis=1) & (np.linalg.norm(right, axis=1) > 0)
    result = right.copy()
    norm = np.linalg.norm(right[is_finite], axis=1, keepdims=True)
    result[is_finite] = norm * (Rotation.from_quat(first) * Rotation.from_quat(right[is_finite])).as_quat()
    return result


def _longest(lost: Booleans) -> int:
    """Length of the longest run of missing rows."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
    return int((ends[1::2] - ends[::2]).max())
