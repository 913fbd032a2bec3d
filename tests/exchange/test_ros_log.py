"""ROS logs of other people: types of messages, chains of transforms, rates that differ, topics that are chosen."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import requires
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from micah_plan.cli.application import app
from micah_plan.errors import InputError
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.frames import displacements_between, interpolated
from micah_plan.recording.messages import frame_unknown, joint_topics, poses_left_out
from micah_plan.recording.read import read_columns, read_recording
from micah_plan.recording.ros_mcap import Logged, MessageType, header_at, write_log

pytestmark = requires("ros")

ROWS = 20
STEP = 50_000_000  # ns
TIMES = [1_700_000_000_000_000_000 + STEP * k for k in range(ROWS)]


def pose(
    position: Sequence[float], turn: Rotation | None = None, names: str = "position orientation"
) -> dict[str, Any]:
    place, orientation = names.split()
    quaternion = (turn or Rotation.identity()).as_quat().tolist()
    return {
        place: dict(zip("xyz", map(float, position), strict=True)),
        orientation: dict(zip("xyzw", quaternion, strict=True)),
    }


def transform(time: int, parent: str, child: str, position: Sequence[float], turn: Rotation | None = None) -> Any:
    moved = pose(position, turn, "translation rotation")
    return {"header": header_at(time, parent), "child_frame_id": child, "transform": moved}


def tf(topic: str, time: int, *transforms: Any) -> Logged:
    return Logged(topic, "tf2_msgs/msg/TFMessage", time, {"transforms": list(transforms)})


def vector(topic: str, time: int, value: Sequence[float], frame: str = "map") -> Logged:
    message = {"header": header_at(time, frame), "vector": dict(zip("xyz", map(float, value), strict=True))}
    return Logged(topic, "geometry_msgs/msg/Vector3Stamped", time, message)


def door(time: int, position: Sequence[float], frame: str = "map") -> Logged:
    message = {"header": header_at(time, frame), "pose": pose(position)}
    return Logged("/door/pose", "geometry_msgs/msg/PoseStamped", time, message)


def read(tmp_path: Path, messages: Sequence[Logged], **conventions: Any) -> Any:
    (tmp_path / "log.mcap").write_bytes(write_log(messages))
    return read_recording(tmp_path / "log.mcap", conventions=Conventions(**conventions))


COVARIANCE = [0.0] * 36
STILL = dict.fromkeys("xyz", 0.0)
TYPES: dict[MessageType, Any] = {
    "geometry_msgs/msg/PoseStamped": lambda header, at: {"header": header, "pose": at},
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda header, at: {
        "header": header, "pose": {"pose": at, "covariance": COVARIANCE}
    },
    "geometry_msgs/msg/PoseArray": lambda header, at: {"header": header, "poses": [at, at]},
    "geometry_msgs/msg/TransformStamped": lambda header, at: {
        "header": header,
        "child_frame_id": "/vicon/door/door",
        "transform": {"translation": at["position"], "rotation": at["orientation"]},
    },
    "nav_msgs/msg/Odometry": lambda header, at: {
        "header": header,
        "child_frame_id": "base_link",
        "pose": {"pose": at, "covariance": COVARIANCE},
        "twist": {"twist": {"linear": STILL, "angular": STILL}, "covariance": COVARIANCE},
    },
}  # fmt: skip
PARTS = {
    "geometry_msgs/msg/PoseArray": ("tracked/0", "tracked/1"),
    "geometry_msgs/msg/TransformStamped": ("vicon/door/door",),
    "nav_msgs/msg/Odometry": ("base_link",),
}


@pytest.mark.parametrize("kind", TYPES)
def test_every_type_of_poses(kind: MessageType, tmp_path: Path) -> None:
    turns = Rotation.from_rotvec(0.05 * np.arange(ROWS)[:, None] * [0.0, 0.6, 0.8])
    places = np.stack([0.1 * np.arange(ROWS), np.ones(ROWS), np.zeros(ROWS)], axis=1)
    messages = [
        Logged("/tracked", kind, time, TYPES[kind](header_at(time, "map"), pose(place, turn)))
        for time, place, turn in zip(TIMES, places, turns, strict=True)
    ]
    found = read(tmp_path, messages)
    assert found.parts == PARTS.get(kind, ("tracked",))
    rows = found.select(part=found.parts[-1])
    assert_allclose(rows.position, places)
    assert_allclose((Rotation.from_quat(rows.quaternion) * turns.inv()).magnitude(), 0.0, atol=1e-12)
    assert_allclose(np.diff(rows.time), STEP / 1e9, atol=1e-6)
    assert found.notes == ()


@requires("ros")
@pytest.mark.parametrize("kind", TYPES)
def test_every_type_of_poses_in_bags_of_ros_1(kind: MessageType, tmp_path: Path) -> None:
    from rosbags import rosbag1
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)

    def made(name: str, given: Any) -> Any:
        """The message of a type from plain values."""
        values = {}
        for field, (category, details) in store.fielddefs[name][1]:
            value = 0 if field == "seq" else given[field]
            if int(category) == 2:  # a name
                value = made(details, value)
            elif int(category) in (3, 4) and int(details[0][0]) == 2:
                value = [made(details[0][1], item) for item in value]
            elif int(category) in (3, 4):
                value = np.array(value, dtype=np.float64)
            values[field] = value
        return store.types[name](**values)

    with rosbag1.Writer(tmp_path / "log.bag") as writer:
        connection = writer.add_connection("/tracked", kind, typestore=store)
        for k, time in enumerate(TIMES):
            message = made(kind, TYPES[kind](header_at(time, "map"), pose([0.1 * k, 1.0, 0.0])))
            writer.write(connection, time, store.serialize_ros1(message, kind))
    found = read_recording(tmp_path / "log.bag")
    assert found.parts == PARTS.get(kind, ("tracked",))
    assert_allclose(found.select(part=found.parts[0]).position[:, 0], 0.1 * np.arange(ROWS))


def camera_in_the_hand() -> tuple[list[Logged], np.ndarray, Rotation]:
    """A hand that moves, a camera fixed to it, and a tag on a door that turns about z in the frame map."""
    k = np.arange(ROWS)
    turns = Rotation.from_rotvec(0.05 * k[:, None] * [0.0, 0.0, 1.0])
    places = np.array([1.0, 0.0, 0.5]) + turns.apply([0.4, 0.0, 0.0])
    hand_turn = Rotation.from_rotvec(0.02 * k[:, None] * [0.3, 1.0, 0.2])
    hand_place = np.stack([0.01 * k, -0.3 + 0 * k, 0.7 + 0.005 * k], axis=1)
    mount_turn, mount_place = Rotation.from_rotvec([0.1, 1.2, -0.4]), np.array([0.02, 0.0, 0.08])
    camera_turn = hand_turn * mount_turn
    camera_place = hand_place + hand_turn.apply(mount_place)
    seen_turn, seen_place = camera_turn.inv() * turns, camera_turn.inv().apply(places - camera_place)
    messages = [tf("/tf_static", TIMES[0], transform(TIMES[0], "hand", "camera", mount_place, mount_turn))] * 2
    for i, time in enumerate(TIMES):
        messages.append(tf("/tf", time, transform(time, "map", "hand", hand_place[i], hand_turn[i])))
        seen = transform(time, "camera", "tag_7", seen_place[i], seen_turn[i])
        messages += [tf("/tf", time, seen)] * 2  # repeated, as some trackers do
    return messages, places, turns


def test_a_camera_in_the_hand(tmp_path: Path) -> None:
    messages, places, turns = camera_in_the_hand()
    found = read(tmp_path, messages, topics=("tag_7",), frame="map")
    assert found.parts == ("tag_7",)
    assert len(found) == ROWS
    assert_allclose(found.position, places, atol=1e-12)
    assert_allclose((Rotation.from_quat(found.quaternion) * turns.inv()).magnitude(), 0.0, atol=1e-12)
    # In the camera's frame it is read too, and that the camera moves is told.
    seen = read(tmp_path, messages, topics=("tag_7",))
    assert seen.notes == ("the frame 'camera' of the poses moves itself; in 'map': --frame map",)
    assert read(tmp_path, messages, topics=("tag_7",), frame="camera").notes == ()
    with pytest.raises(InputError, match="found 'camera, map'; choose one: --frame map, and what moved: --topic"):
        read(tmp_path, messages)


def test_a_tag_in_the_frame_of_another(tmp_path: Path) -> None:
    """A door's tag and one on its cabinet, seen by one camera that moves: the door is read in the cabinet's frame."""
    messages, places, turns = camera_in_the_hand()
    fixed_turn, fixed_place = Rotation.from_rotvec([0.0, 0.3, 0.0]), np.array([1.0, 0.2, 0.4])
    tags = []
    for time in TIMES:
        (hand,) = [m for m in messages if m.time == time and m.message["transforms"][0]["child_frame_id"] == "hand"]
        given = hand.message["transforms"][0]["transform"]
        hand_place = np.array(list(given["translation"].values()))
        hand_turn = Rotation.from_quat(list(given["rotation"].values()))
        camera_turn = hand_turn * Rotation.from_rotvec([0.1, 1.2, -0.4])
        camera_place = hand_place + hand_turn.apply([0.02, 0.0, 0.08])
        place = camera_turn.inv().apply(fixed_place - camera_place)
        tags.append(tf("/tf", time, transform(time, "camera", "tag_1", place, camera_turn.inv() * fixed_turn)))
    found = read(tmp_path, [*messages, *tags], topics=("tag_7",), frame="tag_1")
    assert_allclose(found.position, fixed_turn.inv().apply(places - fixed_place), atol=1e-12)
    relative = fixed_turn.inv() * turns
    assert_allclose((Rotation.from_quat(found.quaternion) * relative.inv()).magnitude(), 0.0, atol=1e-12)


def test_a_chain_between_its_stamps_and_where_it_is_not_known(tmp_path: Path) -> None:
    """Transforms of 10 Hz under poses of 20 Hz: the even motion in between; poses before and after are left out."""
    messages = [
        tf("/tf", time, transform(time, "map", "camera", [0.1 * k, 0, 0]))
        for k, time in enumerate(TIMES)
        if k in (4, 6, 8)
    ]
    messages += [tf("/tf", time, transform(time, "camera", "door", [0, 1, 0])) for time in TIMES]
    found = read(tmp_path, messages, topics=("door",), frame="map")
    assert_allclose(found.position[:, 0], [0.4, 0.5, 0.6, 0.7, 0.8])
    assert found.notes == (f"{ROWS - 5} poses of 'door' are left out: it is not known then where 'camera' is in 'map'",)
    with pytest.raises(InputError, match="no transforms lead from 'door' to 'world'; 'door' is in 'map': --frame map"):
        read(
            tmp_path,
            [*messages, tf("/tf", 1, transform(1, "world", "robot", [0, 0, 0]))],
            topics=("door",),
            frame="world",
        )
    with pytest.raises(InputError, match=r"there is no frame 'mapp'; did you mean 'map'\?"):
        read(tmp_path, messages, topics=("door",), frame="mapp")


def test_poses_of_a_tracker_that_sees_nothing(tmp_path: Path) -> None:
    """Zeros and NaN while it sees nothing are left out and told; zeros throughout are orientations nobody measured."""

    def of(k: int, time: int, lost: Sequence[int]) -> Logged:
        at = pose([0.1 * k, 1, 0])
        if k in lost:
            at = {"position": dict.fromkeys("xyz", 0.0), "orientation": dict.fromkeys("xyzw", 0.0)}
        if k == 9 and lost:
            at["position"]["x"] = float("nan")
        return Logged(
            "/door/pose", "geometry_msgs/msg/PoseStamped", time, {"header": header_at(time, "map"), "pose": at}
        )

    commands = [vector("/door/action", time, [0.01, 0, 0]) for time in TIMES]
    found = read(tmp_path, [*(of(k, time, (3, 4)) for k, time in enumerate(TIMES)), *commands])
    assert_allclose(found.position[:, 0], np.delete(0.1 * np.arange(ROWS), [3, 4, 9]))
    assert found.notes[0] == poses_left_out(3, "door")
    # What was commanded meanwhile is not lost.
    assert_allclose(found.action[[2, 3, 6, 7], 0], [0.03, 0.01, 0.02, 0.01], atol=1e-9)
    points = [of(k, time, ()) for k, time in enumerate(TIMES)]
    for logged in points:
        logged.message["pose"]["orientation"] = dict.fromkeys("xyzw", 0.0)
    without = read(tmp_path, points)
    assert without.quaternion is None
    assert len(without) == ROWS
    knob = [tf("/tf", time, transform(time, "door", "knob", [1, 0, 0])) for time in TIMES]
    with pytest.raises(InputError, match="'/door/pose' gives no orientation of 'door', which others are placed by"):
        read(tmp_path, [*points, *knob], topics=("knob",), frame="map")
    for logged in points:
        logged.message["pose"]["position"]["y"] = float("nan")
    with pytest.raises(InputError, match="no message has a pose, only zeros or no numbers"):
        read(tmp_path, points)


@requires("ros")
def test_joints_of_bags_of_ros_1_are_numbers(tmp_path: Path) -> None:
    """Their arrays are NumPy's, whose numbers say what they are."""
    from rosbags import rosbag1
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = store.types
    with rosbag1.Writer(tmp_path / "log.bag") as writer:
        connections: dict[str, Any] = {}
        for k, time in enumerate(TIMES):
            stamp = kinds["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
            header = kinds["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="map")
            point = kinds["geometry_msgs/msg/Point"](x=0.1 * k, y=0.0, z=0.0)
            at, none = np.array([0.25 * k]), np.zeros(0)
            messages = {
                "sensor_msgs/msg/JointState": kinds["sensor_msgs/msg/JointState"](header, ["elbow"], at, none, none),
                "geometry_msgs/msg/PointStamped": kinds["geometry_msgs/msg/PointStamped"](header=header, point=point),
                "std_msgs/msg/Float64": kinds["std_msgs/msg/Float64"](data=0.5 * k),
            }
            topics = ("/joint_states", "/door", "/door/width")
            for topic, (kind, message) in zip(topics, messages.items(), strict=True):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(connections[topic], time, store.serialize_ros1(message, kind))
    found = read_recording(tmp_path / "log.bag")
    assert found.extra["joint elbow"][:3] == ("0.0", "0.25", "0.5")
    assert found.extra["width"][:3] == ("0.0", "0.5", "1.0")
    assert read_columns(tmp_path / "log.bag")[0]["joint elbow"].tolist() == (0.25 * np.arange(ROWS)).tolist()


def test_transforms_in_a_circle(tmp_path: Path) -> None:
    pairs = (("a", "b"), ("b", "c"), ("c", "a"))
    messages = [tf("/tf", time, *(transform(time, *pair, [0, 0, 0]) for pair in pairs)) for time in TIMES]
    with pytest.raises(InputError, match="go in a circle"):
        read(tmp_path, messages, topics=("a",), frame="b")


def test_two_publishers_of_one_transform(tmp_path: Path) -> None:
    once = [tf("/tf", time, transform(time, "map", "door", [0.1 * k, 0, 0])) for k, time in enumerate(TIMES)]
    assert len(read(tmp_path, [*once, *once])) == ROWS
    other = tf("/tf", TIMES[3], transform(TIMES[3], "map", "door", [0.5, 0, 0]))
    with pytest.raises(InputError, match=r"'/tf' has two poses of 'door' at 1700000000\.150 s; does another node"):
        read(tmp_path, [*once, other])
    both = [*once, *(door(time, [0, 0, 0]) for time in TIMES)]
    with pytest.raises(InputError, match="'door' is on the topics '/tf' and '/door/pose'; choose one: --topic /tf"):
        read(tmp_path, both)
    assert_allclose(read(tmp_path, both, topics=("/door/pose",)).position, 0.0)


def test_commands_at_half_the_rate_are_spread(tmp_path: Path) -> None:
    poses = [door(time, [0.01 * k, 0, 0]) for k, time in enumerate(TIMES)]
    commands = [vector("/door/action", TIMES[k] + 13_000_000, [0.02, 0, 0]) for k in range(0, ROWS, 2)]
    found = read(tmp_path, [*poses, *commands])
    assert_allclose(found.action[1:-1], np.tile([0.01, 0, 0], (ROWS - 2, 1)), atol=1e-9)
    assert np.isnan(found.action[-1]).all()
    (note,) = found.notes
    assert note.startswith("10 actions of 'door' at 10 Hz are joined to poses at 20 Hz (each spread until the next); ")
    assert note.endswith("the nearest stamps are 0.013 s apart")


def test_commands_at_the_stamps_of_the_poses_are_taken_as_they_are(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    given = rng.normal(size=(ROWS, 3))
    poses = [door(time, [0.01 * k, 0, 0]) for k, time in enumerate(TIMES)]
    commands = [vector("/door/action", time, value) for time, value in zip(TIMES, given, strict=True)]
    forces = [vector("/door/force", time, value) for time, value in zip(TIMES[:7], given[:7], strict=True)]
    found = read(tmp_path, [*poses, *commands, *forces])
    assert (found.action == given).all()
    assert (found.force[:7] == given[:7]).all()
    assert np.isnan(found.force[7:]).all()
    assert found.notes == ()


def test_forces_at_another_rate_are_interpolated(tmp_path: Path) -> None:
    poses = [door(time, [0.01 * k, 0, 0]) for k, time in enumerate(TIMES)]
    stamps = [TIMES[0] + 7_000_000 * k for k in range(60)]
    forces = [vector("/door/force", time, [(time - TIMES[0]) / 1e9, 0, 0]) for time in stamps]
    found = read(tmp_path, [*poses, *forces])
    assert_allclose(found.force[:9, 0], STEP / 1e9 * np.arange(9), atol=1e-9)
    assert np.isnan(found.force[9:]).all()  # where none was measured there is none
    assert found.action is None


def test_vectors_in_another_frame_are_turned(tmp_path: Path) -> None:
    turn = Rotation.from_euler("z", 90, degrees=True)
    messages = [tf("/tf_static", TIMES[0], transform(TIMES[0], "map", "tool", [1, 2, 3], turn))]
    messages += [door(time, [0.01 * k, 0, 0]) for k, time in enumerate(TIMES)]
    commands = [vector("/door/action", time, [0.01, 0, 0], "tool") for time in TIMES]
    found = read(tmp_path, [*messages, *commands])
    assert found.parts == ("door",)
    assert_allclose(found.action, np.tile([0, 0.01, 0], (ROWS, 1)), atol=1e-15)
    (note,) = read(tmp_path, [*messages[1:], *commands]).notes
    assert note == frame_unknown("tool", "door/action", "map")


@pytest.mark.parametrize("seed", range(20))
def test_what_is_commanded_is_conserved(seed: int) -> None:
    """Whatever the two rates: between two poses falls what was commanded between them, and in all what was in all."""
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.integers(1, 200, rng.integers(2, 60))).astype(np.int64)
    at = np.cumsum(rng.integers(1, 200, rng.integers(2, 60))).astype(np.int64)
    at = np.concatenate([[-1], at, [stamps[-1] + 400, max(at[-1], stamps[-1] + 400) + 1]])
    at = np.unique(at)
    vectors = rng.normal(size=(len(stamps), 3))
    found = displacements_between(stamps, vectors, at)
    assert_allclose(found[:-1].sum(axis=0), vectors.sum(axis=0), atol=1e-9)
    for row in np.flatnonzero((np.searchsorted(stamps, at[1:]) - np.searchsorted(stamps, at[:-1])) == 0):
        assert np.abs(found[row]).max() <= np.abs(vectors).max() + 1e-12  # no command begins here: a part of one


def test_values_between_samples_need_both() -> None:
    stamps = np.array([0, 10, 20, 60, 70], dtype=np.int64)
    found = interpolated(stamps, np.tile(stamps[:, None], (1, 3)).astype(float), np.array([-5, 0, 5, 20, 40, 65, 71]))[
        :, 0
    ]
    assert_allclose(found, [np.nan, 0, 5, 20, np.nan, 65, np.nan])


def test_a_log_without_poses_says_what_it_has(tmp_path: Path) -> None:
    messages = [vector("/wrench", time, [0, 0, 1]) for time in TIMES]
    with pytest.raises(InputError) as refused:
        read(tmp_path, messages)
    assert "found '/wrench' (geometry_msgs/Vector3Stamped); log poses of the part" in str(refused.value)


def test_learn_lists_topics(tmp_path: Path) -> None:
    messages = [door(time, [0, 0, 0]) for time in TIMES]
    messages += [vector("/door/action", time, [0, 0, 1]) for time in TIMES[:5]]
    (tmp_path / "log.mcap").write_bytes(write_log(messages))
    runner = CliRunner()
    listed = runner.invoke(app, ["learn", str(tmp_path / "log.mcap"), "--list-topics", "--json"])
    assert listed.exit_code == 0
    assert json.loads(listed.stdout)["topics"] == [
        {"name": "/door/action", "type": "geometry_msgs/msg/Vector3Stamped", "messages": 5},
        {"name": "/door/pose", "type": "geometry_msgs/msg/PoseStamped", "messages": ROWS},
    ]
    table = runner.invoke(app, ["learn", str(tmp_path / "log.mcap"), "--list-topics"])
    assert "/door/pose" in table.stdout
    assert "geometry_msgs/PoseStamped" in table.stdout


def test_folders_of_rosbag2(tmp_path: Path) -> None:
    """A recording in two pieces, of which the tenth comes after the second."""
    folder = tmp_path / "take"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    first, second = TIMES[:12], TIMES[12:]
    for number, times in ((2, first), (10, second)):
        content = write_log([door(time, [(time - TIMES[0]) / 1e9, 0, 0]) for time in times])
        (folder / f"take_{number}.mcap").write_bytes(content)
    found = read_recording(folder)
    assert len(found) == ROWS
    assert_allclose(found.position[:, 0], STEP / 1e9 * np.arange(ROWS))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="directory"):
        read_recording(tmp_path / "empty")


@requires("ros")
def test_the_topics_of_a_database(tmp_path: Path) -> None:
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    from micah_plan.recording.ros_bags import topics_of

    store = get_typestore(Stores.ROS2_HUMBLE)
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"](data="hello")
        writer.write(connection, 1, store.serialize_cdr(message, "std_msgs/msg/String"))
    (topic,) = topics_of(tmp_path / "bag")
    assert (topic.name, topic.kind, topic.messages) == ("/chatter", "std_msgs/msg/String", 1)
    with pytest.raises(InputError, match=r"found '/chatter' \(std_msgs/String\)"):
        read_recording(tmp_path / "bag")
    (tmp_path / "no.db3").write_bytes(b"no database at all")
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(tmp_path / "no.db3")


def joints(topic: str, first: int, angles: Sequence[float]) -> list[Logged]:
    """JointState messages of one joint, one each 50 ms."""
    messages = []
    for time, angle in zip(first + STEP * np.arange(len(angles)), angles, strict=True):
        content = {"header": header_at(int(time), ""), "name": ["elbow"], "position": [float(angle)]}
        content |= {"velocity": [], "effort": []}
        messages.append(Logged(topic, "sensor_msgs/msg/JointState", int(time), content))
    return messages


@pytest.mark.parametrize("commands", ["/joint_command", "/arm/cmd", "desired_joint_states"])
@pytest.mark.parametrize("early", [-1_000_000, 1_000_000])
def test_commanded_joints_are_targets_whichever_comes_first(tmp_path: Path, commands: str, early: int) -> None:
    states, goals = 0.1 * np.arange(ROWS), np.full(ROWS, 1.5)
    messages = [*joints("/joint_states", STEP, states), *joints(commands, STEP + early, goals)]
    (tmp_path / "log.mcap").write_bytes(write_log(sorted(messages, key=lambda message: message.time)))
    columns, notes = read_columns(tmp_path / "log.mcap")
    assert_allclose(columns["joint elbow"], states)
    assert_allclose(columns["target elbow"][1:], goals[1:])
    assert np.isnan(columns["target elbow"][0]) == (early > 0)
    assert notes == (joint_topics(("/joint_states",), (commands,)),)


def test_topics_that_are_chosen_are_the_measured_ones(tmp_path: Path) -> None:
    """Names that say nothing, and names that lie."""
    messages = [*joints("/leader", STEP, np.ones(ROWS)), *joints("/goal/real", STEP, np.zeros(ROWS))]
    (tmp_path / "log.mcap").write_bytes(write_log(messages))
    columns, _ = read_columns(tmp_path / "log.mcap", topics=["goal/real"])
    assert_allclose(columns["joint elbow"], 0.0)
    assert_allclose(columns["target elbow"], 1.0)
    with pytest.raises(InputError, match="no topic 'lost' has joint positions; choose one of /leader, /goal/real"):
        read_columns(tmp_path / "log.mcap", topics=["lost"])


def test_a_log_with_commands_alone_has_them_as_joints(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(write_log(joints("/joint_command", STEP, np.arange(ROWS))))
    columns, notes = read_columns(tmp_path / "log.mcap")
    assert set(columns) == {"t", "joint elbow"}
    assert notes == ()
