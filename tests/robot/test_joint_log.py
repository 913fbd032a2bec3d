"""Logs of joints: the shipped arm opens a door with its shoulder, logged in four formats, and is learned from each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import requires
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from micah_plan import InputError, Recording, learn, load
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.messages import rows_left_out
from micah_plan.recording.read import read_columns
from micah_plan.robot.joint_log import arm_of, tool_recording
from micah_plan.robot.joint_ranges import JointRange

ARM = Path(__file__).resolve().parents[2] / "models" / "robots" / "arm7.urdf"
ROBOT = {"robot": str(ARM), "tool": "tool"}
BENT = np.array([0.2, 0.6, 0.0, -1.6, 0.0, 1.0, 0.0])
MOVING, PUSHING = 70, 30
ROWS = MOVING + PUSHING


def opened(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(n, 7) joints of an arm that turns its shoulder by 1.2 rad and then pushes on, and (n, 7) their targets."""
    turned = np.concatenate([np.linspace(0.0, 1.2, MOVING), np.full(PUSHING, 1.2)])
    ahead = np.where(np.arange(ROWS) < MOVING - 1, 1.2 / (MOVING - 1), 0.05)
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, (ROWS, 7))
    q = BENT + np.outer(turned, np.eye(7)[0])
    return q + noise, q + np.outer(ahead, np.eye(7)[0])


@pytest.fixture(scope="module")
def arm() -> Any:
    return arm_of(str(ARM), "tool")


def table(arm: Any, prefix: str = "", factor: float = 1.0) -> dict[str, Any]:
    q, _ = opened()
    return {f"{prefix}{joint}": factor * q[:, i] for i, joint in enumerate(arm.joints)}


def csv(path: Path, columns: Mapping[str, Any]) -> Path:
    rows = zip(*(np.asarray(values, dtype=float).tolist() for values in columns.values()), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]) + "\n")
    return path


def is_the_door(recording: Any, arm: Any) -> None:
    """The tool goes round the shoulder's axis, at its distance from it."""
    assert isinstance(recording, Recording)
    x, y, z = arm.matrix(BENT)[:3, 3]
    assert_allclose(np.hypot(*recording.position[:, :2].T), np.hypot(x, y), atol=5e-3)
    assert_allclose(recording.position[:, 2], z, atol=5e-3)
    assert recording.quaternion is not None
    turned = Rotation.from_quat(recording.quaternion) * Rotation.from_matrix(arm.matrix(BENT)[:3, :3]).inv()
    assert_allclose(turned.as_rotvec()[-1], [0, 0, 1.2], atol=0.01)


@pytest.mark.parametrize("angle", ["rad", "deg"])
def test_a_table_of_joints(arm: Any, tmp_path: Path, angle: str) -> None:
    columns = {"t": 0.05 * np.arange(ROWS)} | table(arm, factor=1.0 if angle == "rad" else 180 / np.pi)
    found = load(csv(tmp_path / "log.csv", columns), angle=angle, name="door", **ROBOT)
    is_the_door(found, arm)
    assert isinstance(found, Recording)
    assert found.parts == ("door",)
    assert found.action is None
    assert found.notes == ()
    assert found.conventions["robot"] == str(ARM)


def test_degrees_that_are_read_as_radians_are_reported(arm: Any, tmp_path: Path) -> None:
    columns = {"t": 0.05 * np.arange(ROWS)} | table(arm, factor=180 / np.pi)
    found = load(csv(tmp_path / "log.csv", columns), **ROBOT)
    assert isinstance(found, Recording)
    (note,) = found.notes
    assert "go beyond their limits; are these degrees? Then add --units deg" in note


def test_names_of_joints_and_targets(arm: Any, tmp_path: Path) -> None:
    q, targets = opened()
    columns = {"stamp": 50 * np.arange(ROWS)}
    columns |= {f"q{i}": q[:, i] for i in range(7)} | {f"cmd{i}": -targets[:, i] for i in range(7)}
    names = {"t": "stamp"} | {f"joint {joint}": f"q{i}" for i, joint in enumerate(arm.joints)}
    names |= {f"target {joint}": f"-cmd{i}" for i, joint in enumerate(arm.joints)}
    found = load(csv(tmp_path / "log.csv", columns), columns=names, time="ms", **ROBOT)
    is_the_door(found, arm)
    assert isinstance(found, Recording)
    assert found.action is not None
    expected = [arm.matrix(there)[:3, 3] - arm.matrix(here)[:3, 3] for here, there in zip(q, targets, strict=True)]
    assert_allclose(found.action, expected, atol=1e-9)
    assert_allclose(np.diff(found.time), 0.05)


@requires("parquet")
def test_joints_of_lerobot_are_learned(arm: Any, tmp_path: Path) -> None:
    """Names as LeRobot's arms have them, in degrees; the pushing tells that the door is shut."""
    import pyarrow as pa
    from pyarrow import parquet

    q, targets = (np.rad2deg(each) for each in opened())
    names = [f"{joint}.pos" for joint in arm.joints]
    columns = {
        "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(q.ravel()), 7),
        "action": pa.FixedSizeListArray.from_arrays(pa.array(targets.ravel()), 7),
        "timestamp": pa.array(0.05 * np.arange(ROWS)),
        "episode_index": pa.array(np.full(ROWS, 3)),
    }
    file = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    file.parent.mkdir(parents=True)
    parquet.write_table(pa.table(columns), file)
    (tmp_path / "meta").mkdir()
    features = {key: {"dtype": "float32", "shape": [7], "names": names} for key in ("observation.state", "action")}
    (tmp_path / "meta" / "info.json").write_text(json.dumps({"features": features}))
    with pytest.raises(InputError, match="name the robot of these joints: --robot"):
        load(file)
    found = load(file, angle="deg", name="door", **ROBOT)
    is_the_door(found, arm)
    assert isinstance(found, Recording)
    assert found.runs == (3,)
    (edge,) = learn(found).graph.edges
    assert [segment.joint.kind for segment in edge.segments] == ["revolute", "rigid"]
    assert abs(edge.segments[1].start - MOVING) <= 3


@requires("ros")
def test_joint_states_of_ros(arm: Any, tmp_path: Path) -> None:
    from micah_plan.recording.ros_mcap import Logged, header_at, write_log

    q, _ = opened()
    messages = []
    for k in range(ROWS):
        time = 1_700_000_000_000_000_000 + 50_000_000 * k
        order = np.random.default_rng(k).permutation(7)
        state = {"name": [arm.joints[i] for i in order], "position": q[k, order].tolist(), "velocity": [], "effort": []}
        messages.append(
            Logged("/joint_states", "sensor_msgs/msg/JointState", time, {"header": header_at(time, ""), **state})
        )
        gripper = {"name": ["finger"], "position": [0.01], "velocity": [], "effort": []}
        messages.append(
            Logged("/gripper", "sensor_msgs/msg/JointState", time + 7, {"header": header_at(time + 7, ""), **gripper})
        )
    (tmp_path / "log.mcap").write_bytes(write_log(messages))
    found = load(tmp_path / "log.mcap", name="door", **ROBOT)
    is_the_door(found, arm)
    with pytest.raises(InputError, match=r"expected poses .*found '/gripper'.*name the robot of its joints: --robot"):
        load(tmp_path / "log.mcap")


@requires("ros")
@pytest.mark.parametrize(
    ("topic", "numbers", "is_read", "note"),
    [
        ("/forward_position_controller/commands", 7, True, "those of shoulder_pan, "),
        ("/forward_position_controller/commands", 6, True, "those of shoulder_pan, "),
        ("/forward_velocity_controller/commands", 7, False, "are not positions by its name"),
        ("/forward_position_controller/commands", 9, False, "9 numbers without names, 8 joints"),
        ("/diagnostics/values", 7, False, ""),
    ],
)
def test_commands_of_a_group_controller(
    arm: Any, tmp_path: Path, topic: str, numbers: int, is_read: bool, note: str
) -> None:
    """They have no names, and come in the controller's order, while joint states come in any."""
    from micah_plan.recording.ros_mcap import Logged, header_at, write_log

    q, messages = opened()[0], []
    for k in range(ROWS):
        time = 1_700_000_000_000_000_000 + 50_000_000 * k
        state = {"name": ["finger", *arm.joints[::-1]], "position": [0.01, *q[k, ::-1].tolist()]}
        state |= {"header": header_at(time, ""), "velocity": [], "effort": []}
        messages.append(Logged("/joint_states", "sensor_msgs/msg/JointState", time, state))
        command = [*q[min(k + 2, ROWS - 1)].tolist(), 0.01, 5.0][:numbers]
        array = {"layout": {"dim": [], "data_offset": 0}, "data": command}
        messages.append(Logged(topic, "std_msgs/msg/Float64MultiArray", time, array))
    (tmp_path / "log.mcap").write_bytes(write_log(messages))
    columns, notes = read_columns(tmp_path / "log.mcap")
    targets = {name.removeprefix("target "): values for name, values in columns.items() if name.startswith("target ")}
    assert note in " ".join(notes)
    assert set(targets) == set(arm.joints[:numbers] if is_read else ())
    for number, name in enumerate(arm.joints):
        if name in targets:
            assert_allclose(targets[name][:-2], q[2:, number])
    if is_read and numbers == 7:
        found = load(tmp_path / "log.mcap", name="door", **ROBOT)
        assert found.has_actions
        is_the_door(found, arm)


@requires("ros")
def test_groups_of_joints_have_commands_of_their_own(arm: Any, tmp_path: Path) -> None:
    """A gripper is no second command of an arm's joint, though it is as near to one."""
    from micah_plan.recording.ros_mcap import Logged, header_at, write_log

    q, messages = opened()[0], []
    for k in range(ROWS):
        time = 1_700_000_000_000_000_000 + 50_000_000 * k
        state = {"name": [*arm.joints, "finger"], "position": [*q[k].tolist(), float(q[k, 0])]}
        state |= {"header": header_at(time, ""), "velocity": [], "effort": []}
        messages.append(Logged("/joint_states", "sensor_msgs/msg/JointState", time, state))
        for topic, command in (("/arm/commands", q[k].tolist()), ("/gripper/commands", [float(q[k, 0])])):
            array = {"layout": {"dim": [], "data_offset": 0}, "data": command}
            messages.append(Logged(topic, "std_msgs/msg/Float64MultiArray", time, array))
    (tmp_path / "log.mcap").write_bytes(write_log(messages))
    columns, notes = read_columns(tmp_path / "log.mcap")
    assert {name for name in columns if name.startswith("target ")} == {
        f"target {name}" for name in (*arm.joints, "finger")
    }
    assert len(notes) == 2


def test_times_by_other_names_and_percent_of_a_range(arm: Any) -> None:
    columns = {"timestamp": 0.05 * np.arange(ROWS)} | table(arm)
    is_the_door(tool_recording(columns, arm, Conventions(**ROBOT)), arm)
    with pytest.raises(InputError, match="column 't' is missing"):
        tool_recording(columns | {"time": np.arange(ROWS)}, arm, Conventions(**ROBOT))  # which of the two?
    degrees = tool_recording({"t": 0.05 * np.arange(ROWS)} | table(arm, factor=90.0 / np.pi), arm, Conventions(**ROBOT))
    assert any("--units deg; or LeRobot's -100 to 100" in note for note in degrees.notes)
    far = tool_recording({"t": 0.05 * np.arange(ROWS)} | table(arm, factor=900.0), arm, Conventions(**ROBOT))
    assert not any("LeRobot" in note for note in far.notes)


def test_rows_in_which_a_joint_is_not_known_are_gaps(arm: Any) -> None:
    """As before the first message of a topic that begins later."""
    columns = {"t": 0.05 * np.arange(ROWS)} | table(arm)
    columns["elbow"][:3] = np.nan
    found = tool_recording(columns, arm, Conventions(**ROBOT))
    assert len(found) == ROWS - 3
    assert found.notes == (rows_left_out(3, ROWS, 3),)
    is_the_door(found, arm)
    columns["shoulder_pan"][3:] = np.nan
    with pytest.raises(InputError, match="no row has a pose"):
        tool_recording(columns, arm, Conventions(**ROBOT))


def test_a_file_beside_the_log_names_the_robot(arm: Any, tmp_path: Path) -> None:
    csv(tmp_path / "log.csv", {"t": 0.05 * np.arange(ROWS)} | table(arm))
    (tmp_path / "arm.urdf").write_text(ARM.read_text())
    beside = tmp_path / "log.conventions.yaml"
    beside.write_text("format: micah-plan/conventions/1\nrobot: arm.urdf\ntool: tool\nname: door\n")
    is_the_door(load(tmp_path / "log.csv"), arm)
    beside.write_text("format: micah-plan/conventions/1\nrobot: arm.urdf\n")
    with pytest.raises(InputError, match="a robot and its tool are given together"):
        load(tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("change", "conventions", "message"),
    [
        (
            {"elbow": None},
            {},
            "the joint 'elbow' has no column; name them, as in --columns \"joint shoulder_pan=NAME\"",
        ),
        ({"left.elbow": np.zeros(ROWS)}, {}, "the columns 'elbow, left.elbow' are all called like the joint 'elbow'"),
        ({"elbow": np.full(ROWS, np.nan)}, {}, "expected numbers in the column 'elbow'"),
        (
            {},
            {"columns": {"joint elbow": "elbw"}},
            "there is no column 'elbw' to read as joint elbow; did you mean 'elbow'?",
        ),
        ({"t": None}, {}, "column 't' is missing"),
    ],
)
def test_joints_that_cannot_be_used(arm: Any, change: dict[str, Any], conventions: Any, message: str) -> None:
    columns = {"t": 0.05 * np.arange(ROWS)} | table(arm)
    tool_recording(columns, arm, Conventions(**ROBOT))
    columns = {name: values for name, values in (columns | change).items() if values is not None}
    with pytest.raises(InputError) as refused:
        tool_recording(columns, arm, Conventions(**ROBOT, **conventions))
    assert message in str(refused.value)


def test_robots_that_there_are_not() -> None:
    with pytest.raises(InputError, match=r"no file 'arm8\.urdf'|arm8"):
        arm_of("arm8.urdf", "tool")
    with pytest.raises(InputError, match="no robot of that name"):
        arm_of("pandda", "panda_hand")
    with pytest.raises(InputError, match="tool"):
        arm_of(str(ARM), "no_such_frame")


# -- joints in percent of their calibrated ranges

LOW, HIGH = 700, 3300


def ranges(arm: Any, **changed: Any) -> dict[str, Any]:
    """As LeRobot writes them: the second motor is mounted the other way round."""
    found = {
        joint: {"id": i + 1, "drive_mode": int(i == 1), "homing_offset": -40, "range_min": LOW, "range_max": HIGH}
        for i, joint in enumerate(arm.joints)
    }
    return found | changed


def percent(arm: Any, prefix: str = "observation.state.") -> dict[str, Any]:
    per_radian = 200.0 * 4096 / (2 * np.pi * (HIGH - LOW))
    q, targets = opened()
    signs = np.where(np.arange(7) == 1, -1.0, 1.0)
    found = {f"{prefix}{joint}.pos": per_radian * signs[i] * q[:, i] for i, joint in enumerate(arm.joints)}
    return found | {f"action.{joint}.pos": per_radian * signs[i] * targets[:, i] for i, joint in enumerate(arm.joints)}


def calibrated(folder: Path, found: Any) -> dict[str, Any]:
    file = folder / "calibration.json"
    file.write_text(found if isinstance(found, str) else json.dumps(found))
    return ROBOT | {"joint_ranges": str(file)}


def test_percent_of_calibrated_ranges_are_angles(arm, tmp_path) -> None:
    log = csv(tmp_path / "log.csv", percent(arm))
    loaded = load(log, rate=50.0, **calibrated(tmp_path, ranges(arm)))
    is_the_door(loaded, arm)
    q, targets = opened()
    assert_allclose(loaded.position, arm.poses(q).translation, atol=1e-9)
    way = arm.poses(targets).translation - arm.poses(q).translation
    assert_allclose(loaded.action[:-1], way[:-1], atol=1e-9)
    assert not [note for note in loaded.notes if "limits" in note]


def test_the_file_beside_a_log_names_the_ranges_relative_to_itself(arm, tmp_path) -> None:
    calibrated(tmp_path, ranges(arm))
    log = csv(tmp_path / "log.csv", percent(arm))
    (tmp_path / "log.conventions.yaml").write_text(
        f"format: micah-plan/conventions/1\nrate: 50\nrobot: {ARM}\ntool: tool\njoint_ranges: calibration.json\n"
    )
    is_the_door(load(log), arm)


def test_a_formula_of_a_joint_goes_before_its_range(arm, tmp_path) -> None:
    table = percent(arm)
    name, others = f"observation.state.{arm.joints[0]}.pos", {f"action.{joint}.pos" for joint in arm.joints}
    table = {key: values for key, values in table.items() if key not in others}
    table[name] = 2.0 * opened()[0][:, 0] + 0.5
    columns = {f"joint {arm.joints[0]}": f"0.5*({name}-0.5)"}
    loaded = load(csv(tmp_path / "log.csv", table), rate=50.0, columns=columns, **calibrated(tmp_path, ranges(arm)))
    is_the_door(loaded, arm)


def test_a_gripper_is_logged_from_its_end() -> None:
    angles = JointRange(1000, 2024, is_one_sided=True).angles(np.array([0.0, 50.0, 100.0]))
    assert_allclose(angles, [0.0, np.pi / 4, np.pi / 2])
    turned = JointRange(1000, 2024, is_one_sided=True, is_reversed=True).angles(np.array([0.0, 100.0]))
    assert_allclose(turned, [np.pi / 2, 0.0])


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ("[1, 2", "expected JSON"),
        ([], "expected the ranges of motors by their names"),
        ({"arm": 3}, "key 'arm.range_min'"),
        ({"a1": {"range_min": 5, "range_max": 5}}, "expected a range_max above range_min 5, found 5"),
        ({"a1": {"range_min": 1.5, "range_max": 5}}, "expected a whole number, found '1.5'"),
        ({"a1": {"range_min": 0, "range_max": 4095}}, "has no range in the calibration"),
    ],
)
def test_what_is_no_calibration_is_refused(arm, tmp_path, found, expected) -> None:
    with pytest.raises(InputError, match=expected):
        load(csv(tmp_path / "log.csv", percent(arm)), rate=50.0, **calibrated(tmp_path, found))


def test_degrees_are_no_percent(arm, tmp_path) -> None:
    log = csv(tmp_path / "log.csv", table(arm, factor=180.0 / np.pi * 2.0))
    with pytest.raises(InputError, match="if these are degrees, give --units deg in place of --joint-ranges"):
        load(log, rate=50.0, **calibrated(tmp_path, ranges(arm)))
    with pytest.raises(InputError, match="no unit of angles"):
        load(log, rate=50.0, angle="deg", **calibrated(tmp_path, ranges(arm)))
