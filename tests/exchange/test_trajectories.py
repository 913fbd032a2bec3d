"""Trajectories for other tools: poses of one part and run as TUM text, joint trajectories with velocities and times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan import solve
from micah_plan.documents.plan import load_plan
from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert
from micah_plan.exchange.joint_trajectory import joint_trajectory
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.read import read_recording

ROOT = Path(__file__).resolve().parents[2]
CABINET = ROOT / "examples" / "demonstrations" / "cabinet.csv"


def test_any_demonstration_becomes_a_trajectory(tmp_path: Path) -> None:
    kind, notes = convert(CABINET, tmp_path / "door.tum", part="door", run=0, poses_only=True)
    assert kind == "recording"
    assert notes == ("left out: action, force",) or notes == ("left out: action",)
    table = np.loadtxt(tmp_path / "door.tum")
    rows = read_recording(CABINET).select(run=0, part="door")
    np.testing.assert_array_equal(table[:, 0], rows.time)
    np.testing.assert_array_equal(table[:, 1:4], rows.position)
    np.testing.assert_allclose(table[:, 4:8], rows.quaternion, atol=1e-12)
    with pytest.raises(InputError, match="poses of one run and part only, found several parts, actions"):
        convert(CABINET, tmp_path / "all.tum")
    # What it is called is kept in a comment, which other programs skip.
    assert read_recording(tmp_path / "door.tum").parts == ("door",)
    with pytest.raises(InputError, match="no rows of run None and part lid"):
        convert(CABINET, tmp_path / "lid.tum", part="lid", poses_only=True)


def test_a_plan_has_times_and_velocities(tmp_path: Path) -> None:
    plan = solve(ROOT / "problems" / "drawer_open.yaml")
    plan.save(tmp_path / "plan.json")
    message = joint_trajectory(load_plan(tmp_path / "plan.json"))
    times = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in message["points"]]
    positions = np.array([point["positions"] for point in message["points"]])
    velocities = np.array([point["velocities"] for point in message["points"]])
    assert np.all(np.diff(times) > 0)
    assert velocities.shape == positions.shape
    assert np.all(velocities[[0, -1]] == 0.0)
    np.testing.assert_allclose(velocities[1:-1], (positions[2:] - positions[:-2]) / 1.0)  # two steps of half a second


def kitti(turn: Rotation, place: np.ndarray) -> str:
    return " ".join(f"{value:.9e}" for value in np.column_stack([turn.as_matrix(), place]).ravel())


def test_matrices_of_kitti_are_poses_at_a_rate(tmp_path: Path) -> None:
    turned = np.linspace(0.0, 1.2, 60)
    turns = Rotation.from_rotvec(np.outer(turned, [0.0, 0.0, 1.0]))
    places = np.stack([0.3 * np.cos(turned), 0.3 * np.sin(turned), np.zeros(60)], axis=1)
    file = tmp_path / "poses.txt"
    file.write_text("\n".join(kitti(turn, place) for turn, place in zip(turns, places, strict=True)) + "\n")
    with pytest.raises(InputError, match=r"line 1: 12 numbers per line are the matrices of KITTI.*--rate 10"):
        read_recording(file)
    found = read_recording(file, conventions=Conventions(rate=20.0))
    np.testing.assert_allclose(found.time, np.arange(60) / 20.0)
    np.testing.assert_allclose(found.position, places, atol=1e-9)
    assert found.quaternion is not None
    assert (Rotation.from_quat(found.quaternion) * turns.inv()).magnitude().max() < 1e-8
    shrunk = read_recording(file, conventions=Conventions(rate=20.0, length="mm"))
    np.testing.assert_allclose(shrunk.position, 1e-3 * places, atol=1e-12)
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:3], " ".join(["9.0", *lines[3].split()[1:]]), *lines[4:]]))
    with pytest.raises(InputError, match="line 4: expected a rotation in the first three columns"):
        read_recording(file, conventions=Conventions(rate=20.0))
    file.write_text("\n".join([*lines[:3], "1 2 x 4 5 6 7 8 9 10 11 12"]))
    with pytest.raises(InputError, match="line 4, number 3"):
        read_recording(file, conventions=Conventions(rate=20.0))
    file.write_text("\n".join([*lines[:3], "1 2 3"]))
    with pytest.raises(InputError, match="line 1: expected the 8 numbers"):
        read_recording(file, conventions=Conventions(rate=20.0))


def test_frames_of_a_trajectory_become_times(tmp_path: Path) -> None:
    file = tmp_path / "frames.tum"
    file.write_text("".join(f"{k} {0.01 * k} 0 0 0 0 0 1\n" for k in range(8)))
    found = read_recording(file, conventions=Conventions(rate=50.0))
    np.testing.assert_allclose(found.time, np.arange(8) / 50.0)
    np.savez(tmp_path / "a.npz", time=found.time, position=found.position)
    with pytest.raises(InputError, match=r"only tables .* and trajectories .* count rows"):
        read_recording(tmp_path / "a.npz", conventions=Conventions(rate=50.0))
