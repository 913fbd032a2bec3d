"""Bags that the library of ROS users writes are read as the recording that is in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import module_requires

from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.read import read_recording

pytestmark = module_requires("ros")
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROWS = 12


def messages(store: Any, is_first: bool) -> list[tuple[str, str, int, Any]]:
    """Poses of a door that swings, with actions; `is_first`: ROS 1, whose headers count."""
    kinds = store.types
    found = []
    for k in range(ROWS):
        time, angle = 1_000_000_000 + 100_000_000 * k, 0.05 * k
        stamp = kinds["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
        number = {"seq": k} if is_first else {}
        header = kinds["std_msgs/msg/Header"](**number, stamp=stamp, frame_id="map")
        point = kinds["geometry_msgs/msg/Point"](x=float(np.cos(angle)), y=float(np.sin(angle)), z=0.5)
        turn = kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=np.sin(angle / 2), w=np.cos(angle / 2))
        pose = kinds["geometry_msgs/msg/Pose"](position=point, orientation=turn)
        vector = kinds["geometry_msgs/msg/Vector3"](x=0.01, y=0.0, z=0.0)
        of_pose = kinds["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)
        of_action = kinds["geometry_msgs/msg/Vector3Stamped"](header=header, vector=vector)
        found.append(("/door/pose", "geometry_msgs/msg/PoseStamped", time, of_pose))
        found.append(("/door/action", "geometry_msgs/msg/Vector3Stamped", time, of_action))
        found.append(("/chatter", "std_msgs/msg/String", time, kinds["std_msgs/msg/String"](data="hello")))
    return found


def written(writer: Any, store: Any, is_first: bool) -> None:
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, time, message in messages(store, is_first):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            serialize = store.serialize_ros1 if is_first else store.serialize_cdr
            writer.write(connections[topic], time, serialize(message, kind))


@pytest.fixture(params=["plain.bag", "bz2.bag", "lz4.bag", "rosbag2.db3"])
def bag(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param.endswith("db3"):
        written(rosbag2.Writer(tmp_path / "bag", version=9), get_typestore(Stores.ROS2_HUMBLE), False)
        return next((tmp_path / "bag").glob("*.db3"))
    path = tmp_path / request.param
    writer = rosbag1.Writer(path)
    if request.param[:3] in ("bz2", "lz4"):
        writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, request.param[:3].upper()))
    written(writer, get_typestore(Stores.ROS1_NOETIC), True)
    return path


def test_a_bag_is_the_recording_that_is_in_it(bag: Path, tmp_path: Path) -> None:
    recording = read_recording(bag, conventions=Conventions(topics=("/door/pose",)))
    assert recording.parts == ("door",)
    assert recording.time == pytest.approx(1.0 + 0.1 * np.arange(ROWS))
    assert recording.position[:, 1] == pytest.approx(np.sin(0.05 * np.arange(ROWS)))
    assert recording.action is not None
    assert recording.action[:, 0] == pytest.approx(0.01)
    kind, notes = convert(bag, tmp_path / "door.csv")
    assert (kind, notes) == ("recording", ())
    assert read_recording(tmp_path / "door.csv").digest() == read_recording(bag).digest()


def test_transforms_of_ros_1_are_poses(tmp_path: Path) -> None:
    """Most trackers of ROS 1 say where a part is on /tf, whose type its library does not bring."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "tf2_msgs/msg/TFMessage"
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    own = store.types
    with rosbag1.Writer(tmp_path / "tf.bag") as writer:
        connection = writer.add_connection("/tf", kind, typestore=store)
        for k in range(ROWS):
            time = 1_000_000_000 + 100_000_000 * k
            stamp = own["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
            header = own["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="world")
            place = own["geometry_msgs/msg/Vector3"](x=0.1 * k, y=0.0, z=0.5)
            turn = own["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
            moved = own["geometry_msgs/msg/Transform"](translation=place, rotation=turn)
            stamped = own["geometry_msgs/msg/TransformStamped"](header=header, child_frame_id="door", transform=moved)
            writer.write(connection, time, store.serialize_ros1(own[kind](transforms=[stamped]), kind))
    recording = read_recording(tmp_path / "tf.bag")
    assert recording.parts == ("door",)
    assert recording.position[:, 0] == pytest.approx(0.1 * np.arange(ROWS))


def test_a_damaged_bag_is_one_line(bag: Path) -> None:
    content = bag.read_bytes()
    for damaged in (b"", content[:100], content[: len(content) // 2], content.replace(b"door", b"\xff\0or")):
        bag.write_bytes(damaged)
        try:
            read_recording(bag)
        except InputError as error:
            assert str(error).startswith(str(bag))  # noqa: PT017
            assert len(str(error).splitlines()) == 1  # noqa: PT017
