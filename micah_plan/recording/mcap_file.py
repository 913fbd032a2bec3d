"""Recordings as MCAP files with ROS 2 messages; bags of ROS 1 and rosbag2 are read, not written.

Written are, for every part, ``geometry_msgs/PoseStamped`` on ``/PART/pose`` in the frame ``base``, and, where there are
any, actions and forces as ``Vector3Stamped`` on ``/PART/action`` and ``/PART/force``. Columns ``joint NAME`` become
``sensor_msgs/JointState`` on ``/joint_states``. Times are kept to the nanosecond; rows come back in order of time.

Read are poses of ``PoseStamped``, one part per topic, and of ``TFMessage``, one part per child frame; actions and
forces as they are written; and ``JointState``, whose positions become further columns ``joint NAME``, each row with
the last message until its time. All poses must be in one frame.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, located_in, shown
from micah_plan.files import read_bytes, replace_file
from micah_plan.recording.checks import checked, row_and_column
from micah_plan.recording.value import DEFAULT_PART, Recording
from micah_plan.ros.bags import read_bag
from micah_plan.ros.log import NANOSECONDS, Logged, MessageType, header_at, read_log, stamp_ns, write_log

_POSE: MessageType = "geometry_msgs/msg/PoseStamped"
_VECTOR: MessageType = "geometry_msgs/msg/Vector3Stamped"
_LATEST_S = 2**31 - 1  # the seconds of a stamp are 32 bits
_SELECT = "convert it with --topic to name what is wanted"
_JOINT = "joint "
Sample = tuple[int, tuple[float, ...]]


def read_mcap(path: str | Path, *, minimum_rows: int = 1, topics: Collection[str] = ()) -> Recording:
    """`read_recording` of an MCAP file; `topics` are those of poses, or child frames of transforms.

    Raises:
        InputError: if it is no MCAP file, has no poses, or poses in several frames.
        MissingDependencyError: without the extra ``ros``.
    """
    with located_in(path):
        return checked(_recording(read_log(read_bytes(path)), topics), minimum_rows=minimum_rows)


def read_ros_bag(path: str | Path, *, minimum_rows: int = 1, topics: Collection[str] = ()) -> Recording:
    """`read_recording` of a bag of ROS 1 (.bag) or rosbag2 (.db3), with the same messages as in MCAP files.

    Raises:
        InputError: as `read_mcap` does.
        MissingDependencyError: without the extra ``ros``.
    """
    with located_in(path):
        return checked(_recording(read_bag(path), topics), minimum_rows=minimum_rows)


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


def _recording(messages: Iterable[Logged], topics: Collection[str]) -> Recording:
    poses: dict[str, list[Sample]] = {}
    frames: dict[str, str] = {}
    vectors: dict[str, dict[int, tuple[float, ...]]] = {}
    joints: dict[str, list[Sample]] = {}
    for logged in messages:
        if logged.kind == _VECTOR:
            time, vector = stamp_ns(logged.message.header, logged.time), logged.message.vector
            vectors.setdefault(logged.topic.strip("/"), {})[time] = (vector.x, vector.y, vector.z)
        elif logged.kind == "sensor_msgs/msg/JointState":
            time = stamp_ns(logged.message.header, logged.time)
            for name, position in zip(logged.message.name, logged.message.position, strict=False):
                joints.setdefault(name, []).append((time, (position,)))
        for topic, part, header, p, q in _poses(logged):
            if topics and topic not in topics and topic.strip("/") not in topics:
                continue
            if frames.setdefault(part, header.frame_id) != header.frame_id:
                problem = f"{shown(topic)} is given in the frames {shown(frames[part])} and {shown(header.frame_id)}"
                raise InputError(problem, remedy=_SELECT)
            poses.setdefault(part, []).append((stamp_ns(header, logged.time), (p.x, p.y, p.z, q.x, q.y, q.z, q.w)))
    if not poses:
        problem = "expected poses (geometry_msgs/PoseStamped or tf2_msgs/TFMessage), found none"
        raise InputError(problem, remedy="log poses of the part, or name other topics")
    if len(set(frames.values())) > 1:
        problem = f"expected poses in one frame, found {shown(', '.join(sorted(set(frames.values()))))}"
        raise InputError(problem, remedy=_SELECT)
    names = list(poses)
    rows = sorted((time, i, values) for i, part in enumerate(names) for time, values in poses[part])
    parts = tuple(names[i] for _, i, _ in rows)
    times = np.array([time for time, _, _ in rows], dtype=np.int64)
    table = np.array([values for _, _, values in rows])

    def of_parts(kind: str) -> Floats | None:
        given = {part: vectors.get(f"{part}/{kind}", {}) for part in names}
        if not any(given.values()):
            return None
        nothing = (np.nan,) * 3
        return np.array([given[part].get(time, nothing) for part, time in zip(parts, times.tolist(), strict=True)])

    return Recording(
        time=times / NANOSECONDS,
        position=table[:, :3],
        quaternion=table[:, 3:],
        action=of_parts("action"),
        force=of_parts("force"),
        part=parts,
        has_part=True,
        extra={f"{_JOINT}{name}": _held(samples, times) for name, samples in sorted(joints.items())},
    )


def _poses(logged: Logged) -> Iterator[tuple[str, str, Any, Any, Any]]:
    """The poses of a message: topic or child frame, part, header, position and orientation."""
    message = logged.message
    if logged.kind == _POSE:
        part = logged.topic.strip("/").removesuffix("/pose") or DEFAULT_PART
        yield logged.topic, part, message.header, message.pose.position, message.pose.orientation
    elif logged.kind == "tf2_msgs/msg/TFMessage":
        for item in message.transforms:
            frame, moved = item.child_frame_id, item.transform
            yield frame, frame.strip("/"), item.header, moved.translation, moved.rotation


def _held(samples: list[Sample], times: Any) -> tuple[str, ...]:
    """The last value until each time, as text; empty before the first."""
    samples = sorted(samples)
    last = np.searchsorted([time for time, _ in samples], times, side="right") - 1
    return tuple("" if i < 0 else repr(samples[i][1][0]) for i in last.tolist())
