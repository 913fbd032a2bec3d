"""Trajectories for other tools: poses of one part and run as TUM text, joint trajectories with velocities and times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from micah_plan import solve
from micah_plan.documents.plan import load_plan
from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert, joint_trajectory
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
