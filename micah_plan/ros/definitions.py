"""The ROS 2 messages that are read and written, as their interface definitions say (geometry_msgs, sensor_msgs, ...).

Source: https://github.com/ros2/common_interfaces and https://github.com/ros2/rcl_interfaces; concatenated as MCAP's
``ros2msg`` encoding asks for.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

MessageType = Literal[
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/Vector3Stamped",
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/JointState",
    "trajectory_msgs/msg/JointTrajectory",
]

_PIECES: Mapping[str, str] = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start"
    ),
}
_HEADER = ("std_msgs/Header", "builtin_interfaces/Time")
_POSE = ("geometry_msgs/Point", "geometry_msgs/Quaternion")
_MESSAGES: Mapping[MessageType, tuple[str, tuple[str, ...]]] = {
    "geometry_msgs/msg/PoseStamped": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose",
        (*_HEADER, "geometry_msgs/Pose", *_POSE),
    ),
    "geometry_msgs/msg/Vector3Stamped": (
        "std_msgs/Header header\ngeometry_msgs/Vector3 vector",
        (*_HEADER, "geometry_msgs/Vector3"),
    ),
    "tf2_msgs/msg/TFMessage": (
        "geometry_msgs/TransformStamped[] transforms",
        (
            "geometry_msgs/TransformStamped",
            *_HEADER,
            "geometry_msgs/Transform",
            "geometry_msgs/Vector3",
            "geometry_msgs/Quaternion",
        ),
    ),
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
        _HEADER,
    ),
    "trajectory_msgs/msg/JointTrajectory": (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points",
        (*_HEADER, "trajectory_msgs/JointTrajectoryPoint", "builtin_interfaces/Duration"),
    ),
}
MESSAGE_TYPES: tuple[MessageType, ...] = tuple(_MESSAGES)


def definition(name: MessageType) -> str:
    """The definition of a message and of all that it is made of."""
    own, used = _MESSAGES[name]
    return "".join([f"{own}\n", *(f"{'=' * 80}\nMSG: {piece}\n{_PIECES[piece]}\n" for piece in used)])
