"""Parquet files, as pandas and LeRobot write them, are read as the recording that is in them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from extras import module_requires

from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert
from micah_plan.recording.read import read_recording

pytestmark = module_requires("parquet")
import pyarrow as pa
from pyarrow import parquet as pq

ROOT = Path(__file__).resolve().parents[2]
ROWS = 15
TIME = np.arange(ROWS) / 30
POSITION = np.column_stack([0.3 * np.cos(TIME), 0.3 * np.sin(TIME), np.full(ROWS, 0.5)])
TURN = np.column_stack([0 * TIME, 0 * TIME, TIME])
TARGET = POSITION + np.array([0.01, 0.0, -0.02])


def data_set(folder: Path, state: list[str], action: list[str], values: np.ndarray, targets: np.ndarray) -> Path:
    """Two equal episodes in one file with the columns and the description of a LeRobot data set of version 3.0."""

    def vectors(rows: np.ndarray) -> object:
        flat = pa.array(np.tile(rows, (2, 1)).astype(np.float32).ravel())
        return pa.FixedSizeListArray.from_arrays(flat, rows.shape[1])

    columns = {
        "observation.state": vectors(values),
        "action": vectors(targets),
        "timestamp": pa.array(np.tile(TIME, 2).astype(np.float32)),
        "frame_index": pa.array(np.tile(np.arange(ROWS), 2)),
        "episode_index": pa.array(np.repeat([4, 5], ROWS)),
        "index": pa.array(np.arange(2 * ROWS)),
        "task_index": pa.array(np.zeros(2 * ROWS, dtype=np.int64)),
    }
    file = folder / "data" / "chunk-000" / "file-000.parquet"
    file.parent.mkdir(parents=True)
    pq.write_table(pa.table(columns), file)
    features = {
        "observation.state": {"dtype": "float32", "shape": [values.shape[1]], "names": state},
        "observation.images.top": {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]},
        "action": {"dtype": "float32", "shape": [targets.shape[1]], "names": action},
    }
    (folder / "meta").mkdir()
    info = {"codebase_version": "v3.0", "fps": 30, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return file


def test_a_hand_of_lerobot_is_a_part_and_its_targets_are_actions(tmp_path: Path) -> None:
    """The names are those that LeRobot's own arm writes: places and rotation vectors of the end effector."""
    state = [f"ee.{axis}" for axis in ("x", "y", "z", "wx", "wy", "wz", "gripper_pos")]
    action = [f"ee.{axis}" for axis in ("x", "y", "z")]
    file = data_set(tmp_path, state, action, np.column_stack([POSITION, TURN, TIME]), TARGET)
    found = read_recording(file)
    assert (found.runs, found.parts, len(found)) == ((4, 5), ("ee",), 2 * ROWS)
    first = found.select(run=4)
    np.testing.assert_allclose(first.position, POSITION, atol=1e-7)
    np.testing.assert_allclose(2 * np.arctan2(first.quaternion[:, 2], first.quaternion[:, 3]), TIME, atol=1e-6)
    np.testing.assert_allclose(first.action, TARGET - POSITION, atol=1e-7)
    np.testing.assert_allclose(np.array(first.extra["observation.state.ee.gripper_pos"], dtype=float), TIME, atol=1e-7)
    convert(file, tmp_path / "found.csv", run=4)
    assert len(read_recording(tmp_path / "found.csv")) == ROWS


def test_displacements_and_two_hands(tmp_path: Path) -> None:
    state = [f"{hand}.{axis}" for hand in ("left", "right") for axis in ("x", "y", "z")]
    action = [f"{hand}.delta_{axis}" for hand in ("left", "right") for axis in ("x", "y", "z")]
    moved = np.full((ROWS, 6), 0.01)
    file = data_set(tmp_path, state, action, np.column_stack([POSITION, POSITION + 1.0]), moved)
    found = read_recording(file)
    assert found.parts == ("left", "right")
    np.testing.assert_allclose(found.select(run=5, part="right").position, POSITION + 1.0, atol=1e-6)
    np.testing.assert_allclose(found.action, 0.01, atol=1e-7)


@pytest.mark.parametrize(
    ("state", "problem"),
    [(["shoulder.pos", "elbow.pos", "wrist.pos"], "x, y, z of an observation; found names"), ([], "no names")],
)
def test_joints_alone_are_no_pose(tmp_path: Path, state: list[str], problem: str) -> None:
    file = data_set(tmp_path, state, state, POSITION, TARGET)
    if not state:
        (tmp_path / "meta" / "info.json").unlink()
    with pytest.raises(InputError, match=problem):
        read_recording(file)


def test_a_table_with_the_columns_of_a_recording(tmp_path: Path) -> None:
    recording = read_recording(ROOT / "examples" / "demonstrations" / "cabinet.csv")
    x, y, z = recording.position.T
    columns = {"t": recording.time, "x": x, "y": y, "z": z, "part": list(recording.part), "run": recording.run}
    columns |= dict(zip(("qx", "qy", "qz", "qw"), recording.quaternion.T, strict=True))
    columns |= dict(zip(("ax", "ay", "az"), recording.action.T, strict=True))
    pq.write_table(pa.table(columns), tmp_path / "cabinet.parquet")
    found = read_recording(tmp_path / "cabinet.parquet")
    np.testing.assert_array_equal(found.position, recording.position)
    np.testing.assert_array_equal(found.action, recording.action)
    assert (found.part, found.has_run) == (recording.part, True)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + b"\0" * 60 + b"PAR1", b"t,x,y,z\n0,0,0,0\n"])
def test_what_is_no_parquet_file_is_reported(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "no.parquet").write_bytes(content)
    with pytest.raises(InputError, match="expected a Parquet file"):
        read_recording(tmp_path / "no.parquet")
