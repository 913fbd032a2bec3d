"""Joint logs as recordings: tool poses by forward kinematics, and commanded displacements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, choices, pip_install, shown
from micah_plan.quantities import count
from micah_plan.recording.checks import ACTION, POSITION, QUATERNION
from micah_plan.recording.columns import recording_of_columns
from micah_plan.recording.commands import with_commands
from micah_plan.recording.conventions import ANGLES, LENGTHS, Conventions, source_of
from micah_plan.recording.value import Recording
from micah_plan.robot.arm import Arm
from micah_plan.robot.joint_ranges import JointRange
from micah_plan.robot.load_arm import describe_robot, load_arm
from micah_plan.task.named_robots import is_name, named_robots

_MOST_LISTED = 12
_BEYOND = 0.1  # rad or m beyond a limit, which no calibration of an encoder explains
# Names of a column of times beside `t`, and the largest value of a joint in percent of its range.
_TIMES, _NORMALISED = ("timestamp", "time", "time_s"), 100.5


def arm_of(robot: str, tool: str) -> Arm:
    """The arm of a file, or of an installed robot of that name.

    Raises:
        InputError: if there is none, or it has no such tool.
    """
    if not is_name(robot) or Path(robot).exists():
        return load_arm(describe_robot(robot, tool))
    robots = named_robots()
    if robot not in robots:
        problem = f"there is no file {shown(robot)}, and no robot of that name"
        remedy = choices(robot, robots) if robots else f"robots by name need a package: {pip_install('robots')}"
        raise InputError(problem, remedy=remedy)
    return load_arm(describe_robot(robots[robot], tool))


def tool_recording(
    columns: Mapping[str, Any], arm: Arm, meant: Conventions, ranges: Mapping[str, JointRange] | None = None
) -> Recording:
    """The rows of a log of joints, as the poses of the arm's tool in the frame of its base.

    If the log has targets of all joints too, the action of a row is the displacement from the measured place of the
    tool to the commanded one.

    Args:
        columns: of the log, by its own names. Those of a joint are ``joint NAME`` in `meant.columns`, or those whose
            last word, without ``.pos``, is the joint's name; its targets ``target NAME``, or such a column that begins
            with ``action.``.
        arm: whose joints these are.
        meant: names of columns, units of angles and of joints that slide, times, rate, and the name of the part.
        ranges: by joint, in percent of which it is logged; None: joints are logged as angles and lengths.

    Raises:
        InputError: if a joint has no column, several, or values that it cannot have.
    """
    q = _positions("joint", columns, arm, meant, ranges or {})
    if q is None:
        raise InputError("no joint of the robot has a column", remedy=_named(arm, columns))
    poses = _poses(arm, q)
    table = dict(zip((*POSITION, *QUATERNION), poses.T, strict=True))
    targets = _positions("target", columns, arm, meant, ranges or {})
    uncommanded = 0
    if targets is not None:
        way = (_poses(arm, targets) - poses)[:, :3]
        uncommanded = int(np.argmax(np.isfinite(way).all(axis=1)))
        way[:uncommanded] = 0.0  # before the first target there is no command
        table |= dict(zip(ACTION, way.T, strict=True))
    others = {name: text for name, text in meant.columns.items() if name in ("t", "run", "part")}
    named_times = [name for name in columns if name.lower() in _TIMES]
    if "t" not in columns and "t" not in others and len(named_times) == 1 and meant.rate is None:
        others["t"] = named_times[0]
    sources = {source_of(text, columns).name for text in others.values()}
    table |= {name: values for name, values in columns.items() if name in ("t", "run", "part") or name in sources}
    # The poses are in metres and upright; of the log's conventions only times and names remain.
    conventions = Conventions(columns=others, time=meant.time, rate=meant.rate, name=meant.name or meant.tool)
    notes = _beyond_limits(arm, q)
    if uncommanded:
        notes = (
            *notes,
            f"the first {count(uncommanded, 'row')} come before the first target, so they have no command",
        )
    recording = recording_of_columns(table, conventions)
    if targets is not None:
        recording = with_commands(recording, "position")
    return replace(recording, conventions=meant.stated(), notes=(*notes, *recording.notes))


def _poses(arm: Arm, q: Floats) -> Floats:
    """(n, 7) positions and quaternions of the tool, NaN where a joint is not known, as before its first message."""
    found = np.full((len(q), 7), np.nan)
    is_finite = np.isfinite(q).all(axis=1)
    if is_finite.any():
        poses = arm.poses(q[is_finite])
        found[is_finite] = np.hstack([poses.translation, poses.rotation.as_quat()])
    return found


def _positions(
    kind: str, columns: Mapping[str, Any], arm: Arm, meant: Conventions, ranges: Mapping[str, JointRange]
) -> Floats | None:
    """(n, joints) positions or targets [rad or m], NaN where unknown; None if no joint has any.

    A joint whose column has a factor or an offset is read by these, independent of its range.

    Raises:
        InputError: if only some have, or a column has no numbers.
    """
    units = {"rad": ANGLES[meant.angle or "rad"], "m": LENGTHS[meant.length or "m"]}
    found: dict[str, Floats] = {}
    for joint, unit in zip(arm.joints, arm.units, strict=True):
        text = meant.columns.get(f"{kind} {joint}")
        named = _column(kind, joint, columns) if text is None else text
        if named is None:
            continue
        source = source_of(named, columns)
        name = source.name
        if name not in columns:
            problem = f"there is no column {shown(name)} to read as {kind} {joint}"
            raise InputError(problem, remedy=choices(name, columns))
        values = columns[name]
        if isinstance(values, tuple) or not np.isfinite(values).any():
            raise InputError(f"expected numbers in the column {shown(name)}", remedy="name another column")
        numbers = source.values(np.asarray(values, dtype=float))
        if ranges and source.is_plain:
            found[joint] = _in_range(joint, unit, numbers, ranges)
        else:
            found[joint] = units[unit] * numbers
    missing = [joint for joint in arm.joints if joint not in found]
    if found and missing and kind == "joint":
        raise InputError(f"the joint {shown(missing[0])} has no column", remedy=_named(arm, columns))
    return None if missing else np.stack([found[joint] for joint in arm.joints], axis=1)


def _in_range(joint: str, unit: str, percent: Floats, ranges: Mapping[str, JointRange]) -> Floats:
    """Angles [rad] of a joint that is logged in percent of its range."""
    if joint not in ranges:
        raise InputError(f"the joint {shown(joint)} has no range in the calibration", remedy=choices(joint, ranges))
    if unit != "rad":
        problem = f"the joint {shown(joint)} slides, and a range of counts is one of turns"
        raise InputError(problem, remedy=f'give its metres per percent: --columns "joint {joint}=0.001*NAME"')
    return ranges[joint].angles(percent)


def _column(kind: str, joint: str, columns: Mapping[str, Any]) -> str | None:
    """The column whose last word is the joint's name; of several that of measurements, or of targets.

    Raises:
        InputError: if several are.
    """
    named = [name for name in columns if _last_word(name) == joint]
    if kind == "target":
        named = [name for name in named if name.startswith(("action.", "target "))]
    else:
        named = [name for name in named if not name.startswith(("action.", "target "))]
    if len(named) > 1:
        problem = f"the columns {shown(', '.join(named))} are all called like the joint {shown(joint)}"
        raise InputError(problem, remedy=f'choose one: --columns "{kind} {joint}={named[0]}"')
    return named[0] if named else None


def _last_word(name: str) -> str:
    """The last dotted word of a name: ``arm.elbow`` of ``observation.state.arm.elbow.pos``."""
    return name.removesuffix(".pos").rpartition(".")[2].removeprefix("joint ").removeprefix("target ")


def _named(arm: Arm, columns: Mapping[str, Any]) -> str:
    listed = ", ".join(list(columns)[:_MOST_LISTED]) + (" ..." if len(columns) > _MOST_LISTED else "")
    return f'name them, as in --columns "joint {arm.joints[0]}=NAME"; it has {shown(listed)}'


def _beyond_limits(arm: Arm, q: Floats) -> Sequence[str]:
    """A note on joints beyond their limits, which suggests other units or another robot."""
    q = q[np.isfinite(q).all(axis=1)]
    if not len(q):
        return ()  # that no row has a pose is reported where gaps are left out
    beyond = np.maximum(q - arm.upper, arm.lower - q).max(axis=0)
    wrong = [joint for joint, by in zip(arm.joints, beyond, strict=True) if by > _BEYOND]
    if not wrong:
        return ()
    units, largest = "", float(np.abs(q).max())
    if largest > 2 * np.pi:
        units = "; are these degrees? Then add --units deg"
        if largest <= _NORMALISED:
            units += (
                "; or LeRobot's -100 to 100 of the calibrated range? Then give the arm's file of them: "
                "--joint-ranges calibration.json"
            )
    return (f"{count(len(wrong), 'joint')} of the robot, first {shown(wrong[0])}, go beyond their limits{units}",)
