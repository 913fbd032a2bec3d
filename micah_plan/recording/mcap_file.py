"""Recordings written as MCAP files with ROS 2 messages.

For every part there is ``geometry_msgs/PoseStamped`` on ``/PART/pose`` in the frame ``base``, and, where there are
any, actions and forces as ``Vector3Stamped`` on ``/PART/action`` and ``/PART/force``. Columns ``joint NAME`` become
``sensor_msgs/JointState`` on ``/joint_states``. Times are kept to the nanosecond.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from micah_plan.errors import InputError, located_in, shown
from micah_plan.files import replace_file
from micah_plan.recording.checks import checked, row_and_column
from micah_plan.recording.value import Recording
from micah_plan.ros.log import NANOSECONDS, Logged, MessageType, header_at, write_log

_POSE: MessageType = "geometry_msgs/msg/PoseStamped"
_VECTOR: MessageType = "geometry_msgs/msg/Vector3Stamped"
_LATEST_S = 2**31 - 1  # the seconds of a stamp are 32 bits
_JOINT = "joint "


def write_mcap(recording: Recording, path: str | Path) -> None:
    """Write what `mcap_bytes` makes, at once or not at all.

    Raises:
        InputError: also if the file cannot be written.
    """
    replace_file(path, mcap_bytes(recording, path))


def mcap_bytes(recording: Recording, path: str | Path) -> bytes:
    """The content of a recording as MCAP.

    Raises:
        InputError: if the recording has what the messages cannot hold: several runs,
            further columns, no orientation, or times before 0. Nothing is left out silently.
        MissingDependencyError: without the extra ``ros``.
    """
    with located_in(path):
        recording = checked(recording)
        _check_fits(recording)
    return write_log([message for row in range(len(recording)) for message in _messages(recording, row)])


def _check_fits(recording: Recording) -> None:
    remedy = "write a .csv or .npz file"
    if len(recording.runs) > 1:
        raise InputError(f"an MCAP file holds one run, found {len(recording.runs)}", remedy=remedy)
    others = [name for name in recording.extra if not name.startswith(_JOINT)]
    if others:
        raise InputError(f"an MCAP file cannot hold the columns {shown(','.join(others))}", remedy=remedy)
    if recording.quaternion is None:
        raise InputError("ROS poses have orientations, found none", remedy=remedy)
    if recording.time.min() < 0 or recording.time.max() > _LATEST_S:
        raise InputError(f"ROS times go from 0 to {_LATEST_S} s", where="column 't'", remedy="shift the times")


def _messages(recording: Recording, row: int) -> Iterable[Logged]:
    time, part = round(float(recording.time[row]) * NANOSECONDS), recording.part[row]
    header = header_at(time, "base")
    if recording.quaternion is not None:
        pose = {
            "position": dict(zip("xyz", recording.position[row].tolist(), strict=True)),
            "orientation": dict(zip("xyzw", recording.quaternion[row].tolist(), strict=True)),
        }
        yield Logged(f"/{part}/pose", _POSE, time, {"header": header, "pose": pose})
    for name, values in (("action", recording.action), ("force", recording.force)):
        if values is not None and not np.isnan(values[row]).any():
            vector = dict(zip("xyz", values[row].tolist(), strict=True))
            message = {"header": header, "vector": vector}
            yield Logged(f"/{part}/{name}", _VECTOR, time, message)
    joints = {name.removeprefix(_JOINT): column[row] for name, column in recording.extra.items() if column[row]}
    if joints:
        try:
            positions = [float(text) for text in joints.values()]
        except ValueError:
            where = row_and_column(row, f"{_JOINT}{next(iter(joints))}")
            raise InputError("expected joint positions [rad or m]", where=where, remedy="rename the column") from None
        state = {"header": header, "name": list(joints), "position": positions, "velocity": [], "effort": []}
        yield Logged("/joint_states", "sensor_msgs/msg/JointState", time, state)
