"""Recordings written as MCAP files with ROS 2 messages.

For every part there is ``geometry_msgs/PoseStamped`` on ``/PART/pose`` in the frame ``base``, or ``PointStamped`` where
no orientation was measured, and, where there are any, actions and forces as ``Vector3Stamped`` on ``/PART/action`` and
``/PART/force``. Columns ``joint NAME`` become ``sensor_msgs/JointState`` on ``/joint_states``, all others
``std_msgs/Float64``, ``Int64`` or ``String`` on ``/PART/COLUMN``. Several runs are ``/run_R/PART``. Times are kept to
the nanosecond.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from micah_plan.errors import InputError, located_in, shown
from micah_plan.recording.checks import checked_recording, row_and_column
from micah_plan.recording.ros_mcap import NANOSECONDS, Logged, MessageType, header_at, write_log
from micah_plan.recording.value import Recording

_POSE: MessageType = "geometry_msgs/msg/PoseStamped"
_VECTOR: MessageType = "geometry_msgs/msg/Vector3Stamped"
_LATEST_S = 2**31 - 1  # the seconds of a stamp are 32 bits
_JOINT = "joint "
_OWN = ("pose", "action", "force")  # what stands on the topics of a part
_INTEGER = re.compile(r"0|-?[1-9]\d{0,17}")


def mcap_bytes(recording: Recording, path: str | Path) -> bytes:
    """The content of a recording as MCAP.

    Raises:
        InputError: if the recording has data that the messages cannot represent: times before 0, columns called like
            the topics of a part. Nothing is left out silently.
        MissingDependencyError: without the extra ``ros``.
    """
    with located_in(path):
        recording = checked_recording(recording)
        _check_fits(recording)
    kinds = {name: _kind(column) for name, column in recording.extra.items() if not name.startswith(_JOINT)}
    return write_log([message for row in range(len(recording)) for message in _messages_of_row(recording, row, kinds)])


def _check_fits(recording: Recording) -> None:
    remedy = "write a .csv or .npz file"
    for name in recording.extra:
        if name in _OWN:
            raise InputError(f"an MCAP file cannot hold a column {shown(name)}", remedy=remedy)
    if recording.time.min() < 0 or recording.time.max() > _LATEST_S:
        raise InputError(f"ROS times go from 0 to {_LATEST_S} s", where="column 't'", remedy="shift the times")


def _kind(column: Sequence[str]) -> MessageType:
    """The message type that preserves a column's strings."""
    texts = [text for text in column if text]
    if texts and all(_INTEGER.fullmatch(text) for text in texts):
        return "std_msgs/msg/Int64"
    return "std_msgs/msg/Float64" if texts and all(map(_is_shortest, texts)) else "std_msgs/msg/String"


def _is_shortest(text: str) -> bool:
    """Whether a number is in Python's shortest notation."""
    try:
        return repr(float(text)) == text
    except ValueError:
        return False


def _messages_of_row(recording: Recording, row: int, kinds: Mapping[str, MessageType]) -> Iterable[Logged]:
    time, part = round(float(recording.time[row]) * NANOSECONDS), recording.part[row]
    run = f"run_{recording.run[row]}/" if len(recording.runs) > 1 or recording.run[row] else ""
    part = f"{run}{part}"
    header = header_at(time, "base")
    position = dict(zip("xyz", recording.position[row].tolist(), strict=True))
    if recording.quaternion is None:
        yield Logged(f"/{part}/pose", "geometry_msgs/msg/PointStamped", time, {"header": header, "point": position})
    else:
        pose = {"position": position, "orientation": dict(zip("xyzw", recording.quaternion[row].tolist(), strict=True))}
        yield Logged(f"/{part}/pose", _POSE, time, {"header": header, "pose": pose})
    for name, kind in kinds.items():
        text = recording.extra[name][row]
        if text:
            reads = {"std_msgs/msg/Float64": float, "std_msgs/msg/Int64": int}.get(kind, str)
            yield Logged(f"/{part}/{name}", kind, time, {"data": reads(text)})
    for name, values in (("action", recording.action), ("force", recording.force)):
        if values is not None and not np.isnan(values[row]).any():
            vector = dict(zip("xyz", values[row].tolist(), strict=True))
            message = {"header": header, "vector": vector}
            yield Logged(f"/{part}/{name}", _VECTOR, time, message)
    joints = {
        name.removeprefix(_JOINT): column[row]
        for name, column in recording.extra.items()
        if name.startswith(_JOINT) and column[row]
    }
    if joints:
        try:
            positions = [float(text) for text in joints.values()]
        except ValueError:
            where = row_and_column(row, f"{_JOINT}{next(iter(joints))}")
            raise InputError("expected joint positions [rad or m]", where=where, remedy="rename the column") from None
        state = {"header": header, "name": list(joints), "position": positions, "velocity": [], "effort": []}
        yield Logged(f"/{run}joint_states", "sensor_msgs/msg/JointState", time, state)
