"""Recordings and plans as ROS 2 messages: round trips, what other tools read, other people's logs, refusals."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import module_requires
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.recording import ros_mcap as log
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.ros_mcap import Logged, header_at, log_topics, read_log, write_log
from micah_plan.recording.value import Recording

pytestmark = module_requires("ros")
from mcap import reader as mcap_reader
from mcap_ros2.decoder import DecoderFactory

ROOT = Path(__file__).resolve().parents[2]
POSE, TF, JOINTS = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/JointState"


def pose_message(time: int, x: float, frame: str = "map", topic: str = "/tracker/pose") -> Logged:
    orientation = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    pose = {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": orientation}
    return Logged(topic, POSE, time, {"header": header_at(time, frame), "pose": pose})


def transform(frame: str, child: str, time: int, x: float) -> dict[str, Any]:
    moved = {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return {"header": header_at(time, frame), "child_frame_id": child, "transform": moved}


def reader_of(path: Path) -> Any:
    """A reader of messages that is not the one of the package."""
    return mcap_reader.make_reader(io.BytesIO(path.read_bytes()), decoder_factories=[DecoderFactory()])


def written(path: Path, messages: Sequence[Logged]) -> Path:
    path.write_bytes(write_log(messages))
    return path


def same(first: Recording, second: Recording) -> None:
    np.testing.assert_allclose(second.time, first.time, atol=5.1e-10, rtol=1e-15)
    for name in ("position", "quaternion", "action", "force"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name), err_msg=name)
    assert second.part == first.part


@pytest.mark.parametrize("name", ["microwave", "drawer", "stapler"])
def test_demonstrations_survive_to_the_nanosecond(tmp_path: Path, name: str) -> None:
    recording = read_recording(ROOT / "examples" / "demonstrations" / f"{name}.csv")
    write_recording(recording, tmp_path / "r.mcap")
    same(recording, read_recording(tmp_path / "r.mcap"))
    again = tmp_path / "again.mcap"
    write_recording(recording, again)
    assert again.read_bytes() == (tmp_path / "r.mcap").read_bytes()


@settings(max_examples=30)
@given(
    values=arrays(np.float64, (6, 13), elements=st.floats(-1e3, 1e3)),
    parts=st.lists(st.sampled_from("ab"), min_size=6, max_size=6),
)
def test_any_recording_survives(tmp_path_factory: pytest.TempPathFactory, values: Any, parts: list[str]) -> None:
    quaternion = values[:, 3:7] + [0, 0, 0, 2e3]
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    recording = Recording(
        time=np.arange(6) * 0.1, position=values[:, :3], quaternion=quaternion, action=values[:, 7:10],
        force=values[:, 10:], part=tuple(parts), extra={"joint elbow": tuple(repr(v) for v in values[:, 0].tolist())},
    )  # fmt: skip
    path = tmp_path_factory.mktemp("any") / "r.mcap"
    write_recording(recording, path)
    found = read_recording(path)
    same(recording, found)
    assert found.extra == recording.extra


def rows_of(recording: Recording) -> list[tuple[Any, ...]]:
    """All rows with all that they have, in an order that says nothing of the file's; NaN as text."""
    quaternion = recording.quaternion if recording.quaternion is not None else np.zeros((len(recording), 0))
    vectors = [np.zeros((len(recording), 0)) if v is None else v for v in (recording.action, recording.force)]
    table = np.hstack([recording.position, quaternion, *vectors]).tolist()
    texts = [tuple(recording.extra[name][i] for name in sorted(recording.extra)) for i in range(len(recording))]
    keys = zip(recording.run.tolist(), recording.part, np.round(recording.time, 9).tolist(), strict=True)
    return sorted((*key, str(row), text) for key, row, text in zip(keys, table, texts, strict=True))


@pytest.mark.parametrize("oriented", [True, False])
def test_runs_with_columns_of_their_own_survive(tmp_path: Path, oriented: bool) -> None:
    """As `execute` writes them: several runs that all begin at 0, what was believed, modes, joints, empty fields."""
    rng = np.random.default_rng(0)
    n = 12
    quaternion = rng.normal(size=(n, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    recording = Recording(
        time=np.tile(0.1 * np.repeat(np.arange(3), 2), 2),
        position=rng.normal(size=(n, 3)),
        quaternion=quaternion if oriented else None,
        action=np.where(np.arange(n)[:, None] % 6 < 4, rng.normal(size=(n, 3)), np.nan),
        run=np.repeat([3, 5], 6),
        part=("door", "drawer") * 6,
        has_run=True,
        has_part=True,
        extra={
            "mode": ("free", "shut", "") * 4,
            "estimate_x": tuple(repr(value) for value in rng.normal(size=n).tolist()),
            "count": tuple(str(i) for i in range(n)),
            "padded": tuple(f"{i:03}" for i in range(n)),
            "rounded": ("0.10", "1e5") * 6,
            "joint elbow": tuple(repr(value) for value in np.repeat(rng.normal(size=6), 2).tolist()),
        },
    )
    write_recording(recording, tmp_path / "runs.mcap")
    found = read_recording(tmp_path / "runs.mcap")
    assert rows_of(found) == rows_of(recording)
    assert (found.runs, found.parts) == (recording.runs, recording.parts)
    kinds = {topic.name: topic.kind for topic in log_topics((tmp_path / "runs.mcap").read_bytes())}
    assert kinds["/run_3/door/estimate_x"] == "std_msgs/msg/Float64"
    assert kinds["/run_3/door/count"] == "std_msgs/msg/Int64"
    assert kinds["/run_5/drawer/padded"] == kinds["/run_5/drawer/rounded"] == "std_msgs/msg/String"
    one = recording.select(run=5)
    write_recording(one, tmp_path / "one.mcap")
    assert rows_of(read_recording(tmp_path / "one.mcap")) == rows_of(one)


def test_points_are_poses_without_orientation(tmp_path: Path) -> None:
    """A marker, seen by a camera that moves, is a point in every frame."""

    def point(k: int) -> Logged:
        message = {"header": header_at(k, "camera"), "point": {"x": 1.0, "y": 0.0, "z": 0.1 * k}}
        return Logged("/marker", "geometry_msgs/msg/PointStamped", k, message)

    moved = [Logged("/tf", TF, k, {"transforms": [transform("map", "camera", k, 2.0 * k)]}) for k in range(1, 5)]
    path = written(tmp_path / "r.mcap", [*map(point, range(1, 5)), *moved])
    found = read_recording(path, conventions=Conventions(topics=("/marker",), frame="map"))
    assert found.quaternion is None
    np.testing.assert_allclose(found.position, [[1 + 2 * k, 0, 0.1 * k] for k in range(1, 5)])
    with pytest.raises(InputError, match="some parts have orientations and others not; choose parts"):
        read_recording(path, conventions=Conventions(frame="map"))


def test_another_reader_finds_the_messages_with_its_own_definitions(tmp_path: Path) -> None:
    recording = read_recording(ROOT / "examples" / "demonstrations" / "microwave.csv")
    write_recording(recording, tmp_path / "r.mcap")
    reader = reader_of(tmp_path / "r.mcap")
    found = list(reader.iter_decoded_messages(topics=["/door/pose"]))
    assert len(found) == len(recording)
    schema, channel, message, decoded = found[3]
    assert (schema.name, schema.encoding, channel.message_encoding) == (POSE, "ros2msg", "cdr")
    assert decoded.header.frame_id == "base"
    assert decoded.pose.orientation.w == recording.quaternion[3, 3]
    assert message.log_time == round(recording.time[3] * 1e9)


def test_a_log_of_another_lab(tmp_path: Path) -> None:
    """Poses of a tracker, transforms, joint states at another rate, and topics that mean nothing here."""
    second = 10**9
    state = {"name": ["a", "b"], "velocity": [], "effort": []}
    messages = [pose_message(1_700_000_000 * second + k * second // 10, 0.01 * k) for k in range(4)]
    messages += [
        Logged(
            "/joint_states", JOINTS, 0, {"header": header_at(1_700_000_000 * second + at, ""), "position": p, **state}
        )
        for at, p in ((50_000_000, [1.0, 2.0]), (200_000_000, [3.0, 4.0]))
    ]
    found = read_recording(written(tmp_path / "r.mcap", messages))
    assert found.parts == ("tracker",)
    np.testing.assert_allclose(np.diff(found.time), 0.1, atol=1e-6)
    assert found.extra == {"joint a": ("", "1.0", "3.0", "3.0"), "joint b": ("", "2.0", "4.0", "4.0")}
    assert not found.has_actions


def test_transforms_are_chosen_by_their_child_frame(tmp_path: Path) -> None:
    tree = [
        Logged("/tf", TF, k, {"transforms": [transform("world", "door", k, 0.1 * k), transform("arm", "hand", k, 1.0)]})
        for k in range(1, 4)
    ]
    path = written(tmp_path / "tf.mcap", tree)
    with pytest.raises(
        InputError,
        match=r"poses in one frame, found 'arm, world'; choose one: --frame arm, and what moved:",
    ):
        read_recording(path)
    found = read_recording(path, conventions=Conventions(topics=("door",)))
    assert found.parts == ("door",)
    np.testing.assert_allclose(found.position[:, 0], [0.1, 0.2, 0.3])
    with pytest.raises(InputError, match=r"no topic or frame 'doors' with poses; did you mean 'door'\?"):
        read_recording(path, conventions=Conventions(topics=("doors",)))
    with pytest.raises(InputError, match=r"only ROS logs \(\.mcap, \.bag, \.db3\) have topics"):
        read_recording(ROOT / "examples" / "demonstrations" / "box.csv", conventions=Conventions(topics=("door",)))


def test_a_part_in_two_frames_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "r.mcap", [pose_message(1, 0.0, "map"), pose_message(2, 0.0, "odom")])
    with pytest.raises(InputError, match="in the frames 'map' and 'odom'"):
        read_recording(path)


def _simple(**columns: Any) -> Recording:
    given = {"time": np.arange(2.0), "position": np.zeros((2, 3)), "quaternion": np.tile([0, 0, 0, 1.0], (2, 1))}
    return Recording(**{**given, **columns})


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"extra": {"pose": ("1", "2")}}, "cannot hold a column 'pose'"),
        ({"extra": {"joint a": ("1", "x")}}, "row 1, column 'joint a': expected joint positions"),
        ({"time": np.array([-1.0, 0.0])}, "ROS times go from 0"),
    ],
)
def test_nothing_is_lost_unnoticed(tmp_path: Path, columns: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        write_recording(_simple(**columns), tmp_path / "r.mcap")
    assert not (tmp_path / "r.mcap").exists()


def test_without_the_extra_the_message_names_which(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mcap.writer", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'mcap\S+' 'rosbags"):
        write_recording(_simple(), tmp_path / "r.mcap")


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_chunks_are_unpacked_within_bounds(compression: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from mcap.writer import CompressionType, Writer

    kind = CompressionType.NONE if compression == "none" else CompressionType[compression.upper()]
    packed = io.BytesIO()
    writer = Writer(packed, compression=kind)
    writer.start()
    schema = writer.register_schema("x", "ros2msg", b"")
    channel = writer.register_channel("/x", "cdr", schema)
    writer.add_message(channel, 0, bytes(4_000_000), 0)
    writer.finish()
    assert list(read_log(packed.getvalue())) == []
    monkeypatch.setattr(log, "LARGEST_FILE_BYTES", 1024 * 1024)
    with pytest.raises(InputError, match="at most 1 MiB of messages, found more"):
        list(read_log(packed.getvalue()))


def test_damaged_files_are_one_line() -> None:
    good = write_log([pose_message(k, 0.0) for k in range(20)])
    rng = np.random.default_rng(0)
    for size in range(0, len(good), 37):
        _refused_or_read(good[:size])
    for _ in range(200):
        broken = bytearray(good)
        broken[rng.integers(len(good))] ^= 1 << rng.integers(8)
        _refused_or_read(bytes(broken))


def _refused_or_read(content: bytes) -> None:
    with contextlib.suppress(InputError):  # one line each; every other exception is the test's failure
        list(read_log(content))


def test_a_plan_becomes_a_trajectory_that_another_reader_reads(tmp_path: Path) -> None:
    from micah_plan.documents.plan import write_plan
    from micah_plan.documents.problem import load_problem
    from micah_plan.exchange.convert import convert
    from micah_plan.planning.solver import solve
    from micah_plan.templates.write import write_template

    for kind in ("problem", "robot"):
        write_template(kind, tmp_path / kind)  # type: ignore[arg-type]
        problem = load_problem(tmp_path / kind / "problem.yaml")
        plan = solve(problem)
        write_plan(plan, problem, tmp_path / "plan.json")
        assert convert(tmp_path / "plan.json", tmp_path / "t.mcap") == ("plan", ())
        convert(tmp_path / "plan.json", tmp_path / "t.json")
        told = json.loads((tmp_path / "t.json").read_text())
        reader = reader_of(tmp_path / "t.mcap")
        ((schema, _, _, message),) = reader.iter_decoded_messages()
        assert schema.name == "trajectory_msgs/msg/JointTrajectory"
        assert message.joint_names == told["joint_names"]
        points = [point["positions"] for point in told["points"]]
        np.testing.assert_array_equal([point.positions for point in message.points], points)
        times = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in told["points"]]
        np.testing.assert_allclose(times, 0.5 * np.arange(len(times)))
        assert plan.trajectory is not None
        assert len(points) == len(plan.trajectory.modes) - int(plan.trajectory.is_transition.sum())
        last = plan.trajectory.means if plan.arm is None else plan.arm.positions
        np.testing.assert_array_equal(points[-1], last[-1])
        assert told["joint_names"][0] == ("drawer" if plan.arm is None else "shoulder_pan")
