"""A laboratory's afternoon: from raw files of six kinds to executed plans, in three steps and without an editor."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import requires
from scipy.spatial.transform import Rotation

from micah_plan import Recording, execute, learn, load, solve

ROOT = Path(__file__).resolve().parents[1]
ROWS, OPENING = 90, 1.1


def door(seed: int = 0) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Times, places and turns of a door of 0.4 m that opens about z, as a tracker sees it."""
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(np.linspace(0.0, OPENING, ROWS)[:, None] * [0.0, 0.0, 1.0])
    places = np.array([0.6, 0.1, 0.5]) + turns.apply([0.4, 0.0, 0.0]) + rng.normal(0, 1e-3, (ROWS, 3))
    return 0.05 * np.arange(ROWS), places, Rotation.from_rotvec(rng.normal(0, 5e-3, (ROWS, 3))) * turns


def motive(folder: Path) -> Recording:
    """y upwards, millimetres, one row in nine lost."""
    time, places, turns = door()
    upright = Rotation.from_euler("x", -90, degrees=True)
    rows = np.hstack([(upright * turns).as_quat(), 1e3 * upright.apply(places)])
    lines = [
        "Format Version,1.23,Capture Frame Rate,20.0,Rotation Type,Quaternion,Length Units,Millimeters",
        "",
        ",Type" + ",Rigid Body" * 7,
        ",Name" + ",door" * 7,
        ",ID" + ",1" * 7,
        ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position",
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z",
    ]
    for k, row in enumerate(rows.tolist()):
        lines.append(",".join([str(k), repr(float(time[k])), *("" if k % 9 == 5 else repr(value) for value in row)]))
    (folder / "take.csv").write_text("\n".join(lines) + "\n")
    return loaded(folder / "take.csv")


def tum(folder: Path) -> Recording:
    time, places, turns = door()
    np.savetxt(folder / "door.tum", np.column_stack([time, places, turns.as_quat()]))
    return loaded(folder / "door.tum", name="door")


def data_frame(_: Path) -> Recording:
    import pandas

    time, places, turns = door()
    names = ["Time", "TX", "TY", "TZ", "RX", "RY", "RZ"]
    frame = pandas.DataFrame(np.column_stack([time, 1e3 * places, turns.as_rotvec(degrees=True)]), columns=names)
    columns = dict(zip(["t", "x", "y", "z", "rx", "ry", "rz"], names, strict=True))
    return loaded(frame, columns=columns, length="mm", angle="deg", name="door")


def vicon_bag(folder: Path) -> Recording:
    """TransformStamped, as the bridge of Vicon logs it."""
    from micah_plan.recording import ros_mcap as log

    messages = []
    for k, (place, turn) in enumerate(zip(*door()[1:], strict=True)):
        header = log.header_at(1_700_000_000_000_000_000 + 50_000_000 * k, "world")
        moved = {
            "translation": dict(zip("xyz", place.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", turn.as_quat().tolist(), strict=True)),
        }
        message = {"header": header, "child_frame_id": "vicon/door/door", "transform": moved}
        messages.append(log.Logged("/vicon/door/door", "geometry_msgs/msg/TransformStamped", 1 + k, message))
    (folder / "vicon.mcap").write_bytes(log.write_log(messages))
    return loaded(folder / "vicon.mcap", name="door")


def tag_seen_from_the_hand(folder: Path) -> Recording:
    """AprilTags on /tf, seen by a camera on a hand that moves."""
    from micah_plan.recording import ros_mcap as log

    _, places, turns = door()
    messages = []

    def transform(time: int, parent: str, child: str, place: np.ndarray, turn: Rotation) -> dict[str, Any]:
        moved = {
            "translation": dict(zip("xyz", place.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", turn.as_quat().tolist(), strict=True)),
        }
        return {"header": log.header_at(time, parent), "child_frame_id": child, "transform": moved}

    for k in range(ROWS):
        time = 1_700_000_000_000_000_000 + 50_000_000 * k
        hand_turn = Rotation.from_rotvec([0.3, 0.01 * k, 0.2])
        hand = np.array([0.1, -0.4 + 0.003 * k, 0.9])
        seen = transform(time, "camera", "tag_7", hand_turn.inv().apply(places[k] - hand), hand_turn.inv() * turns[k])
        transforms = [transform(time, "base_link", "camera", hand, hand_turn), seen]
        messages.append(log.Logged("/tf", "tf2_msgs/msg/TFMessage", time, {"transforms": transforms}))
    (folder / "tags.mcap").write_bytes(log.write_log(messages))
    return loaded(folder / "tags.mcap", topics=("tag_7",), frame="base_link", name="door")


def joints_of_lerobot(folder: Path) -> Recording:
    """An arm that opens the door with its shoulder, logged as joints in degrees."""
    import pyarrow as pa
    from pyarrow import parquet

    from micah_plan.robot.joint_log import arm_of

    robot = ROOT / "models" / "robots" / "arm7.urdf"
    q = np.tile([0.2, 0.6, 0.0, -1.6, 0.0, 1.0, 0.0], (ROWS, 1))
    q[:, 0] += np.linspace(0.0, OPENING, ROWS)
    q += np.random.default_rng(0).normal(0.0, 1e-3, q.shape)
    columns = {
        "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(np.rad2deg(q).ravel()), 7),
        "timestamp": pa.array(door()[0]),
        "episode_index": pa.array(np.zeros(ROWS, dtype=int)),
    }
    file = folder / "data" / "chunk-000" / "file-000.parquet"
    file.parent.mkdir(parents=True)
    parquet.write_table(pa.table(columns), file)
    (folder / "meta").mkdir()
    names = [f"{joint}.pos" for joint in arm_of(str(robot), "tool").joints]
    features = {"observation.state": {"dtype": "float32", "shape": [7], "names": names}}
    (folder / "meta" / "info.json").write_text(json.dumps({"features": features}))
    return loaded(file, robot=str(robot), tool="tool", angle="deg", name="door")


def loaded(source: Any, **conventions: Any) -> Recording:
    recording = load(source, **conventions)
    assert isinstance(recording, Recording)
    return recording


ROS_LOGS = [pytest.param(raw, marks=requires("ros")) for raw in (vicon_bag, tag_seen_from_the_hand)]
LEROBOT = pytest.param(joints_of_lerobot, marks=requires("parquet"))


@pytest.mark.sweep
@pytest.mark.parametrize("raw", [motive, tum, data_frame, *ROS_LOGS, LEROBOT])
def test_a_raw_file_becomes_an_executed_plan(raw: Callable[[Path], Recording], tmp_path: Path) -> None:
    recording = raw(tmp_path)
    assert recording.parts == ("door",)
    learned = learn(recording)
    (edge,) = learned.graph.edges
    assert [segment.joint.kind for segment in edge.segments] == ["revolute"]
    assert abs(edge.segments[0].joint.axis[2]) > 0.999
    plan = solve(learned)
    assert plan.outcome == "solved", plan.reason
    assert execute(plan, trials=5).successes == 5


def test_three_commands(tmp_path: Path) -> None:
    """From the shipped log of a laboratory."""
    commands = [
        ["learn", str(ROOT / "examples" / "logs" / "laboratory.csv"), "-o", "door.yaml"],
        ["solve", "door.yaml", "-o", "plan.json"],
        ["execute", "plan.json", "--trials", "3", "-o", "runs.csv"],
    ]
    said = []
    for command in commands:
        words = [sys.executable, "-m", "micah_plan", *command]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        said.append(done.stderr)
    assert "no problem is given, so the model is moved most of its way: door from " in said[1]
    assert len(loaded(tmp_path / "runs.csv").runs) == 3
