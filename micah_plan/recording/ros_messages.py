"""Messages of ROS as a log has them: their bytes (CDR) to values and back, by the definitions of the library `rosbags`.

Only messages of `MESSAGE_TYPES` are looked at, and they are read by the library's definitions, not by those that a file
brings along.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from micah_plan.errors import MissingDependencyError

NANOSECONDS = 1_000_000_000

MessageType = Literal[
    "geometry_msgs/msg/PointStamped",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/Vector3Stamped",
    "nav_msgs/msg/Odometry",
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Int64",
    "std_msgs/msg/String",
    "trajectory_msgs/msg/JointTrajectory",
]

MESSAGE_TYPES: tuple[MessageType, ...] = get_args(MessageType)


@dataclass(frozen=True)
class Logged:
    """A message in a log.

    Attributes:
        topic: its name, such as ``/door/pose``.
        kind: type of the message.
        time: at which it was logged [ns], at least 0.
        message: what it says: to write, a dict by field; as read, an object with the fields as attributes.
    """

    topic: str
    kind: MessageType
    time: int
    message: Any


@dataclass(frozen=True)
class Topic:
    """What a log has on a topic: its name, the type of its messages, and how many there are."""

    name: str
    kind: str
    messages: int


@lru_cache(maxsize=1)
def known_types() -> Any:
    """The messages of ROS 2 that the library knows.

    Raises:
        MissingDependencyError: without the extra ``ros``.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingDependencyError.of("ros", "ROS logs need libraries that are not installed") from None
    return get_typestore(Stores.ROS2_HUMBLE)


def definition(kind: str) -> str:
    """The definition of a message and of all that it is made of, each once."""
    return str(known_types().generate_msgdef(kind, ros_version=2)[0])


def decoded(data: bytes, kind: MessageType) -> Any:
    """What the bytes of a message say."""
    return known_types().deserialize_cdr(data, kind)


def encoded(message: dict[str, Any], kind: MessageType) -> bytes:
    """The bytes of a message, given by field."""
    return bytes(known_types().serialize_cdr(_made(message, kind), kind))


def _made(value: Any, kind: str) -> Any:
    """A message of the library from fields, those that are messages or lists of numbers included."""
    fields = {}
    for name, (_, what) in known_types().fielddefs[kind][1]:
        field = value[name]
        if isinstance(field, dict):
            fields[name] = _made(field, what)
        elif isinstance(field, list) and what[0][0].name == "NAME":
            fields[name] = [_made(item, what[0][1]) for item in field]
        elif isinstance(field, list) and what[0][1][0] != "string":
            fields[name] = np.array(field, dtype=what[0][1][0])
        else:
            fields[name] = field
    return known_types().types[kind](**fields)


def stamp_ns(header: Any, logged: int) -> int:
    """The time of a message [ns]: its stamp, or when it was logged if it has none."""
    stamp = int(header.stamp.sec) * NANOSECONDS + int(header.stamp.nanosec)
    return stamp if stamp else logged


def header_at(time: int, frame: str) -> dict[str, Any]:
    """A ``std_msgs/Header`` to write; `time` in ns."""
    return {"stamp": split_time(time), "frame_id": frame}


def split_time(time: int) -> dict[str, int]:
    """A time [ns] as messages write it."""
    return {"sec": time // NANOSECONDS, "nanosec": time % NANOSECONDS}
