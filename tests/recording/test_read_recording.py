"""The reader that fits a file, and trajectory text and arrays as further formats."""

from __future__ import annotations

import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.value import Recording

TUM = "# timestamp tx ty tz qx qy qz qw\n\n 1.5 1 2 3  0 0 0 1\n# in between\n2.5\t4 5 6 0 0 1 0\n"


@pytest.mark.parametrize("name", ["r.tum", "r.txt", "R.TXT"])
def test_a_trajectory(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(TUM)
    r = read_recording(tmp_path / name)
    assert_array_equal(r.time, [1.5, 2.5])
    assert_array_equal(r.position, [[1, 2, 3], [4, 5, 6]])
    assert_array_equal(r.quaternion, [[0, 0, 0, 1], [0, 0, 1, 0]])
    assert not r.has_run
    assert not r.has_actions


@pytest.mark.parametrize("name", ["r.csv", "r.CSV", "r.txt"])
def test_a_table_with_commas(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("t,x,y,z\n0,1,2,3\n")
    assert_array_equal(read_recording(tmp_path / name).position, [[1, 2, 3]])


def test_arrays_that_numpy_saved(tmp_path: Path) -> None:
    path = tmp_path / "r.npz"
    np.savez(path, time=np.arange(2, dtype=np.float32), position=np.ones((2, 3), dtype=int), part=np.array(["a", "b"]))
    r = read_recording(path)
    assert_array_equal(r.time, [0, 1])
    assert r.position.dtype == np.float64
    assert r.parts == ("a", "b")
    assert r.has_part
    assert not r.has_run


def test_every_format_is_equivalent(tmp_path: Path) -> None:
    r = Recording(
        time=np.array([0.1, 0.3]),
        position=np.array([[1 / 3, 1e-300, -0.0]] * 2),
        quaternion=np.array([[0, 0.6, 0, 0.8]] * 2),
    )
    for suffix in (".csv", ".tum", ".txt", ".npz"):
        write_recording(r, tmp_path / f"r{suffix}")
        assert read_recording(tmp_path / f"r{suffix}").digest() == r.digest()


def test_archives_hold_no_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    r = Recording(time=np.zeros(1), position=np.zeros((1, 3)))
    write_recording(r, tmp_path / "1.npz")
    monkeypatch.setattr(time, "time", lambda: 2e9)
    write_recording(r, tmp_path / "2.npz")
    assert (tmp_path / "1.npz").read_bytes() == (tmp_path / "2.npz").read_bytes()
    with zipfile.ZipFile(tmp_path / "1.npz") as archive:
        assert {member.date_time[0] for member in archive.infolist()} == {1980}


def test_names_of_runs_and_parts_are_gathered_once():
    """Pages ask for them per row: gathered anew each time, 5,000 rows took minutes."""
    recording = Recording(time=np.arange(3.0), position=np.zeros((3, 3)), part=("lid", "box", "lid"))
    assert recording.parts == ("lid", "box")
    assert recording.parts is recording.parts
    assert recording.runs is recording.runs
