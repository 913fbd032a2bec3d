"""Recordings from ROS logs: MCAP files, bags of ROS 1 (.bag) and rosbag2 (.db3), and folders of rosbag2.

Poses are those of ``PoseStamped``, ``PoseWithCovarianceStamped``, ``PoseArray`` and ``PointStamped``, named after their
topic (with several runs, all as ``/run_3/door/pose``), and of ``TFMessage``, ``TransformStamped`` and ``Odometry``,
named after their child frame. For another frame, transforms are composed at the stamps of the part's own. Actions and
forces are ``Vector3Stamped`` on ``/PART/action`` and ``/PART/force``, at the stamps of the poses or joined to them.
Positions of ``JointState`` become columns ``joint NAME``, each row with the last message until its time; so do
``Float64``, ``Int64`` and ``String`` on ``/PART/COLUMN``.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from micah_plan.arrays import Floats, Ints
from micah_plan.errors import InputError, choices, located_in, shown
from micah_plan.quantities import count
from micah_plan.recording import messages
from micah_plan.recording.checks import checked_recording
from micah_plan.recording.conventions import OF_JOINTS, Conventions, as_recorded
from micah_plan.recording.frames import FrameEdge, Frames, displacements_between, interpolated, moves
from micah_plan.recording.ros_bags import messages_of, topics_of
from micah_plan.recording.ros_mcap import NANOSECONDS, Logged, stamp_ns
from micah_plan.recording.value import DEFAULT_PART, Recording

JOINT, TARGET = OF_JOINTS
_COLUMNS = ("std_msgs/msg/Float64", "std_msgs/msg/Int64", "std_msgs/msg/String")
# Names of topics with commands, as ros2_control and simulators have them; and of those that are no positions.
_COMMANDED = re.compile(r"command|cmd|target|goal|desired|reference|setpoint", re.IGNORECASE)
_OTHER_COMMANDS = re.compile(r"velocity|velocities|effort|torque|current|gripper_action", re.IGNORECASE)
# Rows that a joint may lag behind its commands; the finest resolution of encoders, and a large distance [rad or m].
_MOST_LATE, _FINEST, _FARTHEST = 12, 1e-6, 1e3
_RUN = re.compile(r"run_(-?\d{1,18})/(.+)")
READ = {
    "geometry_msgs/msg/PointStamped": "poses",
    "geometry_msgs/msg/PoseArray": "poses",
    "geometry_msgs/msg/PoseStamped": "poses",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "poses",
    "geometry_msgs/msg/TransformStamped": "poses",
    "nav_msgs/msg/Odometry": "poses",
    "tf2_msgs/msg/TFMessage": "poses",
    "geometry_msgs/msg/Vector3Stamped": "actions, forces",
    "sensor_msgs/msg/JointState": "joints",
    "std_msgs/msg/Float64MultiArray": "targets of joints, with --robot",
    **dict.fromkeys(_COLUMNS, "columns, on /PART/..."),
}
"""What a recording takes from the messages of a type."""
_MOST_LISTED = 12
Sample = tuple[int, tuple[float, ...]]


def read_ros_log(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """`read_recording` of a log of ROS messages.

    Raises:
        InputError: if it is none, has no poses, or poses in several frames of which none is chosen.
        MissingDependencyError: without the extra ``ros``.
    """
    meant = conventions or Conventions()
    with located_in(path):
        log = _Log()
        for logged in messages_of(path):
            log.add(logged)
        if not log.edges:
            kinds = ", ".join(kind.replace("/msg/", "/") for kind, content in READ.items() if content == "poses")
            remedy = "log poses of the part"
            if log.joints:
                remedy += ", or name the robot of its joints: --robot NAME --tool FRAME"
            raise InputError(f"expected poses ({kinds}), found {_listed(path)}", remedy=remedy)
        recording = as_recorded(log.recording(meant.topics, meant.frame), meant)
        return checked_recording(recording, minimum_rows=minimum_rows)


def joint_columns(path: str | Path, topics: Collection[str] = ()) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The positions of joints in a log, at the stamps of the topic that has most of them.

    A log may have measured and commanded joints, both as JointState. Commands are on the topics that are not chosen or,
    without a choice, on those named like commands (`/joint_command`). Commands of ros2_control's group controllers are
    Float64MultiArray, without names and stamps: they are targets at the times at which they were logged, of the joints
    that they are nearest to.

    Args:
        topics: with measured joints; none: all that are not named like commands.

    Returns:
        ``t`` [s], ``joint NAME`` and ``target NAME`` as they are in the log, each value held until the next one; and
        the used topics, where there are several.

    Raises:
        InputError: if it is no log, has none, or lacks a topic.
        MissingDependencyError: without the extra ``ros``.
    """
    joints: dict[str, dict[str, list[Sample]]] = {}
    arrays: dict[str, list[Sample]] = {}
    with located_in(path):
        for logged in messages_of(path):
            if logged.kind == "sensor_msgs/msg/JointState":
                time = stamp_ns(logged.message.header, logged.time)
                for name, position in zip(logged.message.name, logged.message.position, strict=False):
                    joints.setdefault(logged.topic, {}).setdefault(name, []).append((time, (float(position),)))
            elif logged.kind == "std_msgs/msg/Float64MultiArray" and _COMMANDED.search(logged.topic):
                values = tuple(float(value) for value in logged.message.data)
                arrays.setdefault(logged.topic, []).append((logged.time, values))
        if not joints:
            problem = f"expected joint positions (sensor_msgs/JointState), found {_listed(path)}"
            raise InputError(problem, remedy="log the joints of the robot")
        measured = _measured_topics(tuple(joints), topics)
    commanded = [topic for topic in joints if topic not in measured]
    most = max((joints[topic] for topic in measured), key=len)
    targets = {topic: joints[topic] for topic in commanded}
    notes = []
    for topic, samples in arrays.items():
        left = {name: places for name, places in most.items() if not any(name in of for of in targets.values())}
        named, note = _named_targets(topic, samples, left)
        targets |= {topic: named} if named else {}
        notes.append(note)
    stamps = np.unique([time for time, _ in max(most.values(), key=len)])
    columns: dict[str, Any] = {"t": stamps / NANOSECONDS}
    kinds = [*((JOINT, joints[topic]) for topic in measured), (JOINT, most), *((TARGET, of) for of in targets.values())]
    for kind, samples_of in kinds:
        for name, samples in samples_of.items():
            columns[f"{kind}{name}"] = np.array([float(text or "nan") for text in _latest_values(samples, stamps)])
    if len(joints) == 1:
        return columns, tuple(notes)
    return columns, (messages.joint_topics(tuple(measured), tuple(commanded)), *notes)


def _named_targets(
    topic: str, samples: Sequence[Sample], measured: Mapping[str, list[Sample]]
) -> tuple[dict[str, list[Sample]], str]:
    """(commanded positions without names by joint, note); empty if ambiguous.

    A controller keeps joints near its commands, so these are of the joints that they are nearest to, all together.
    """
    if _OTHER_COMMANDS.search(topic):
        return {}, messages.not_positions(topic)
    sizes = {len(values) for _, values in samples}
    if len(sizes) > 1 or max(sizes) > len(measured) or min(sizes) == 0:
        return {}, messages.unnamed_targets(topic, sorted(sizes), len(measured))
    times = np.array([time for time, _ in samples])
    commands, names = np.array([values for _, values in samples]), list(measured)
    places = np.array([[float(text or "nan") for text in _latest_values(measured[name], times)] for name in names])
    order = [names[k] for k in linear_sum_assignment(_log_distances(commands.T, places))[1]]
    named: dict[str, list[Sample]] = {joint: [] for joint in order}
    for time, values in samples:
        for joint, value in zip(order, values, strict=True):
            named[joint].append((time, (value,)))
    return named, messages.targets_by_position(topic, order)


def _log_distances(commands: Floats, places: Floats) -> Floats:
    """(m, k) log distance of positions (k, n) from commands (m, n) [rad or m] at the best delay."""
    found = np.full((len(commands), len(places)), np.inf)
    for late in range(min(_MOST_LATE, commands.shape[1])):
        apart = commands[:, None, : commands.shape[1] - late] - places[None, :, late:]
        is_known = np.isfinite(apart)
        squares = np.where(is_known, apart, 0.0) ** 2
        far = np.sqrt(squares.sum(axis=2) / np.maximum(is_known.sum(axis=2), 1))
        far = np.where(is_known.any(axis=2), far, _FARTHEST)  # measurements at other times are uninformative
        found = np.minimum(found, np.log(np.maximum(far, _FINEST)))
    return found


def _measured_topics(found: Sequence[str], chosen: Collection[str]) -> tuple[str, ...]:
    """The topics with measured joints."""
    wanted = {name.strip("/") for name in chosen}
    for name in wanted - {topic.strip("/") for topic in found}:
        raise InputError(f"no topic {shown(name)} has joint positions", remedy=choices(name, found))
    if wanted:
        return tuple(topic for topic in found if topic.strip("/") in wanted)
    return tuple(topic for topic in found if not _COMMANDED.search(topic)) or tuple(found)


def _listed(path: str | Path) -> str:
    topics = topics_of(path)
    texts = [f"{shown(topic.name)} ({topic.kind.replace('/msg/', '/')})" for topic in topics[:_MOST_LISTED]]
    more = f" and {len(topics) - _MOST_LISTED} more" if len(topics) > _MOST_LISTED else ""
    return ", ".join(texts) + more if texts else "no topics"


@dataclass
class _Log:
    """The decoded messages of a log by content.

    Attributes:
        edges: by topic and part or child frame.
        vectors: samples by topic without slashes at its ends, and the frame that they are in.
        joints: positions by run, as ``run_3/`` or empty where not stated, and joint.
        columns: texts by topic.
    """

    edges: dict[tuple[str, str], FrameEdge] = field(default_factory=dict)
    vectors: dict[str, tuple[str, dict[int, tuple[float, ...]]]] = field(default_factory=dict)
    joints: dict[tuple[str, str], list[Sample]] = field(default_factory=dict)
    columns: dict[str, dict[int, str]] = field(default_factory=dict)

    def add(self, logged: Logged) -> None:
        """Process a message.

        Raises:
            InputError: if a part was in another frame before.
        """
        message = logged.message
        if logged.kind == "geometry_msgs/msg/Vector3Stamped":
            samples = self.vectors.setdefault(logged.topic.strip("/"), (message.header.frame_id.strip("/"), {}))
            vector = message.vector
            samples[1][stamp_ns(message.header, logged.time)] = (vector.x, vector.y, vector.z)
        elif logged.kind == "sensor_msgs/msg/JointState":
            time = stamp_ns(message.header, logged.time)
            match = _RUN.fullmatch(logged.topic.strip("/"))
            run = f"run_{match[1]}/" if match else ""
            for name, position in zip(message.name, message.position, strict=False):
                self.joints.setdefault((run, name), []).append((time, (float(position),)))
        elif logged.kind in _COLUMNS:
            value = {"std_msgs/msg/Float64": float, "std_msgs/msg/Int64": int}.get(logged.kind, str)(message.data)
            text = value if isinstance(value, str) else repr(value)
            self.columns.setdefault(logged.topic.strip("/"), {})[logged.time] = text
        for child, header, p, q in _poses(logged):
            parent = header.frame_id.strip("/")
            edge = self.edges.get((logged.topic, child))
            if edge is None:
                static = logged.topic.strip("/").endswith("tf_static")
                edge = self.edges[logged.topic, child] = FrameEdge(logged.topic, child, parent, static)
            if edge.parent != parent:
                problem = f"{shown(child)} is given in the frames {shown(edge.parent)} and {shown(parent)}"
                raise InputError(problem, remedy="choose another topic: --topic NAME")
            turn = (np.nan,) * 4 if q is None else (q.x, q.y, q.z, q.w)
            edge.samples.append((stamp_ns(header, logged.time), (p.x, p.y, p.z, *turn)))

    def recording(self, topics: Sequence[str], frame: str | None) -> Recording:
        """The rows of the chosen parts in the chosen frame.

        Raises:
            InputError: if a topic or frame is not there, or one must be chosen.
        """
        notes = [note for edge in self.edges.values() if (note := edge.without_lost())]
        self.edges = {key: edge for key, edge in self.edges.items() if edge.samples}
        if not self.edges:
            raise InputError("no message has a pose, only zeros or no numbers", remedy="check the tracker")
        chosen = self._chosen(topics)
        frames = Frames.of(self.edges.values())
        target = self._target(chosen, frame, notes, frames)
        tracks = {edge.child: _track(edge, target, frames, notes) for edge in chosen}
        names = list(tracks)
        part = np.repeat(np.arange(len(names)), [len(stamps) for stamps, _ in tracks.values()])
        stamps = np.concatenate([stamps for stamps, _ in tracks.values()])
        poses = np.concatenate([poses for _, poses in tracks.values()])
        order = np.lexsort((part, stamps))
        vectors: dict[str, Floats | None] = {}
        for kind in ("action", "force"):
            values = self._vectors(kind, {name: track for name, (track, _) in tracks.items()}, target, frames, notes)
            vectors[kind] = None if values is None else values[order]
        times, quaternion = stamps[order], poses[order, 3:]
        if not np.isfinite(quaternion).all() and np.isfinite(quaternion).any():
            raise InputError("some parts have orientations and others not", remedy="choose parts: --topic NAME")
        runs = [_RUN.fullmatch(name) for name in names]
        called = [match[2] if match else name for match, name in zip(runs, names, strict=True)]
        has_run = all(runs)
        numbers = np.array([int(match[1]) if match and has_run else 0 for match in runs], dtype=np.int64)
        columns = self._columns(tracks)
        return Recording(
            time=times / NANOSECONDS,
            position=poses[order, :3],
            quaternion=quaternion if np.isfinite(quaternion).all() else None,
            action=vectors["action"],
            force=vectors["force"],
            run=numbers[part[order]],
            part=tuple((called if has_run else names)[i] for i in part[order].tolist()),
            has_run=has_run,
            has_part=True,
            extra=self._joints([names[i] for i in part[order].tolist()], times)
            | {name: tuple(texts[i] for i in order.tolist()) for name, texts in columns.items()},
            notes=tuple(notes),
        )

    def _joints(self, parts: Sequence[str], times: Ints) -> dict[str, tuple[str, ...]]:
        """Columns of joints at the rows of each run."""
        columns = {f"{JOINT}{name}": [""] * len(times) for name in sorted({name for _, name in self.joints})}
        for (run, name), samples in sorted(self.joints.items()):
            for i, text in enumerate(_latest_values(samples, times)):
                if parts[i].startswith(run):
                    columns[f"{JOINT}{name}"][i] = text
        return {name: tuple(texts) for name, texts in columns.items()}

    def _columns(self, tracks: Mapping[str, tuple[Ints, Floats]]) -> dict[str, list[str]]:
        """Further columns on topics of the parts, as strings: at the stamps of the poses, else the latest before."""
        names: dict[str, None] = {}
        for topic in self.columns:
            part, _, name = topic.rpartition("/")
            if part in tracks:
                names.setdefault(name)
        columns: dict[str, list[str]] = {name: [] for name in names}
        for part, (stamps, _) in tracks.items():
            for name, texts in columns.items():
                samples = self.columns.get(f"{part}/{name}", {})
                if set(samples) <= set(stamps.tolist()):
                    texts += [samples.get(stamp, "") for stamp in stamps.tolist()]
                    continue
                times = sorted(samples)
                last = np.searchsorted(times, stamps, side="right") - 1
                texts += ["" if i < 0 else samples[times[i]] for i in last.tolist()]
        return columns

    def _chosen(self, topics: Sequence[str]) -> list[FrameEdge]:
        """The chosen parts: those named by topic or frame, else all that are not static."""
        wanted = [name.strip("/") for name in topics]
        named = [(edge.topic.strip("/"), edge.child) for edge in self.edges.values()]
        for name, text in zip(wanted, topics, strict=True):
            if not any(name in names for names in named):
                there = sorted({child_name for names in named for child_name in names})
                raise InputError(f"there is no topic or frame {shown(text)} with poses", remedy=choices(name, there))
        pairs = zip(self.edges.values(), named, strict=True)
        chosen = [edge for edge, names in pairs if (set(names) & set(wanted) if wanted else not edge.static)]
        by_child: dict[str, FrameEdge] = {}
        for edge in chosen or list(self.edges.values()):
            earlier = by_child.setdefault(edge.child, edge)
            if earlier is not edge:
                problem = f"{shown(edge.child)} is on the topics {shown(earlier.topic)} and {shown(edge.topic)}"
                raise InputError(problem, remedy=f"choose one: --topic {earlier.topic}")
        return list(by_child.values())

    def _target(self, chosen: Sequence[FrameEdge], frame: str | None, notes: list[str], frames: Frames) -> str:
        """The frame of the poses."""
        if frame is not None:
            name = frame.strip("/")
            there = sorted({end for edge in self.edges.values() for end in (edge.parent, edge.child)})
            if name not in there:
                raise InputError(f"there is no frame {shown(frame)}", remedy=choices(name, there))
            return name
        parents = sorted({edge.parent for edge in chosen})
        if len(parents) > 1:
            roots = sorted({frames.root(parent) for parent in parents})
            places = {edge.parent for edge in self.edges.values()}
            leaf = next((edge.child for edge in chosen if edge.child not in places), "NAME")
            remedy = f"choose one: --frame {roots[0] or 'NAME'}, and what moved: --topic {leaf}"
            raise InputError(f"expected poses in one frame, found {shown(', '.join(parents))}", remedy=remedy)
        above = frames.upwards(parents[0])
        if moves(above):
            root = above[-1].parent
            notes.append(f"the frame {shown(parents[0])} of the poses moves itself; in {shown(root)}: --frame {root}")
        return parents[0]

    def _vectors(
        self, kind: str, stamps_of: dict[str, Ints], target: str, frames: Frames, notes: list[str]
    ) -> Floats | None:
        """(n, 3) actions or forces at the stamps of the parts, part by part; None if there are none."""
        if not any(self.vectors.get(f"{part}/{kind}", ("", {}))[1] for part in stamps_of):
            return None
        pieces = []
        for part, stamps in stamps_of.items():
            frame, samples = self.vectors.get(f"{part}/{kind}", ("", {}))
            if not samples:
                pieces.append(np.full((len(stamps), 3), np.nan))
                continue
            times = np.array(sorted(samples), dtype=np.int64)
            vectors = np.array([samples[time] for time in times.tolist()])
            if frame not in ("", target) and frame in frames.edges and frames.root(frame) == frames.root(target):
                vectors = frames.placed(frame, target, times)[1].apply(vectors)
            elif frame not in ("", target):
                notes.append(messages.frame_unknown(frame, f"{part}/{kind}", target))
            pieces.append(_at_pose_stamps(kind, part, (times, vectors), stamps, notes))
        return np.concatenate(pieces)


def _at_pose_stamps(kind: str, part: str, samples: tuple[Ints, Floats], stamps: Ints, notes: list[str]) -> Floats:
    """(n, 3) actions or forces at the stamps of poses; interpolated with a note where stamps differ."""
    times, vectors = samples
    aligned = np.isin(times, stamps).all()
    if aligned and (kind == "force" or np.isin(stamps[:-1], times).all()):
        at_stamps = np.full((len(stamps), 3), np.nan)
        at_stamps[np.isin(stamps, times)] = vectors
        return at_stamps
    apart = np.abs(times[:, None] - stamps[_neighbours(stamps, times)]).min() / NANOSECONDS
    rates = [NANOSECONDS / float(np.median(np.diff(each))) if len(each) > 1 else 0.0 for each in (times, stamps)]
    notes.append(messages.joined_at_poses(len(times), kind, part, (rates[0], rates[1]), float(apart)))
    return displacements_between(times, vectors, stamps) if kind == "action" else interpolated(times, vectors, stamps)


def _neighbours(stamps: Ints, times: Ints) -> Ints:
    """(k, 2) indices of the stamps around each time."""
    right = np.searchsorted(stamps, times)
    return np.stack([np.maximum(right - 1, 0), np.minimum(right, len(stamps) - 1)], axis=1)


def _track(edge: FrameEdge, target: str, frames: Frames, notes: list[str]) -> tuple[Ints, Floats]:
    """(n,) stamps [ns] and (n, 7) poses of a part in a frame."""
    stamps, poses = edge.once()
    if edge.parent == target:
        return stamps, poses
    is_point = np.isnan(poses[:, 3:])
    if is_point.any():  # where it is needs no orientation of its own
        upright = [(stamp, (*pose[:3], 0.0, 0.0, 0.0, 1.0)) for stamp, pose in edge.samples]
        edge = replace(edge, samples=upright)
    origin, turn, is_known = replace(frames, edges={**frames.edges, edge.child: edge}).placed(
        edge.child, target, stamps
    )
    if not is_known.any():
        problem = f"at no pose of {shown(edge.child)} it is known where {shown(edge.parent)} is in {shown(target)}"
        raise InputError(problem, remedy="record both at the same time")
    lost = int((~is_known).sum())
    if lost:
        of = f"where {shown(edge.parent)} is in {shown(target)}"
        notes.append(f"{count(lost, 'pose')} of {shown(edge.child)} are left out: it is not known then {of}")
    quaternion = np.where(is_point, np.nan, turn.as_quat())
    return stamps[is_known], np.concatenate([origin, quaternion], axis=1)[is_known]


def _poses(logged: Logged) -> Iterator[tuple[str, Any, Any, Any]]:
    """The poses of a message: part or child frame, header, position and orientation."""
    message, kind = logged.message, logged.kind
    named = logged.topic.strip("/").removesuffix("/pose") or DEFAULT_PART
    if kind == "geometry_msgs/msg/PoseStamped":
        yield named, message.header, message.pose.position, message.pose.orientation
    elif kind == "geometry_msgs/msg/PointStamped":
        yield named, message.header, message.point, None
    elif kind == "geometry_msgs/msg/PoseWithCovarianceStamped":
        yield named, message.header, message.pose.pose.position, message.pose.pose.orientation
    elif kind == "geometry_msgs/msg/PoseArray":
        for i, pose in enumerate(message.poses):
            yield f"{named}/{i}", message.header, pose.position, pose.orientation
    elif kind == "nav_msgs/msg/Odometry":
        child = message.child_frame_id.strip("/") or named
        yield child, message.header, message.pose.pose.position, message.pose.pose.orientation
    elif kind in ("tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"):
        for item in [message] if kind == "geometry_msgs/msg/TransformStamped" else message.transforms:
            yield item.child_frame_id.strip("/"), item.header, item.transform.translation, item.transform.rotation


def _latest_values(samples: list[Sample], times: Ints) -> tuple[str, ...]:
    """The latest value before each time as a string; empty before the first."""
    samples = sorted(samples)
    last = np.searchsorted([time for time, _ in samples], times, side="right") - 1
    return tuple("" if i < 0 else repr(samples[i][1][0]) for i in last.tolist())
