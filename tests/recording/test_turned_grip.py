"""A hand that turns on what it holds is told, and joints, screws, paths and noise are not taken for one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

import micah_plan
from micah_plan.automaton.joint import Joint, prismatic, radius, revolute, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.cli.application import app
from micah_plan.documents.conventions import load_conventions
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.suspicion import suspicions_of_recording, turned_grips
from micah_plan.recording.turned_grip import turned_grip
from micah_plan.recording.value import Recording

HINGE = revolute((0.1, 0.2, 1.0), (0.5, -0.2, 0.3), (0.75, -0.2, 0.3))
DRAWER = prismatic((1.0, 0.3, 0.1), (0.5, -0.2, 0.3))
ANGLE = 1.2


def recording_of(joint: Joint, slip: float, axis: np.ndarray | None = None, noise: float = 3e-4) -> Recording:
    """A tool on a part that turns against it by a share of its motion."""
    rng = np.random.default_rng(2)
    way = np.concatenate([np.linspace(0.0, 1.0, 120) ** 2 * (3 - 2 * np.linspace(0.0, 1.0, 120)), np.ones(20)])
    poses = forward(joint, way * (ANGLE if joint.turns else 0.3))
    turn = Rotation.from_rotvec(np.outer(slip * ANGLE * way, joint.axis if axis is None else axis))
    turns = Rotation.from_rotvec(rng.normal(0.0, 2.0 * noise, (140, 3))) * turn * poses.rotation
    position = poses.translation + rng.normal(0.0, noise, (140, 3))
    return Recording(0.05 * np.arange(140.0), position, turns.as_quat(canonical=True))


@pytest.mark.parametrize("slip", [-1.0, -0.4, -1.7, 0.5])
def test_a_hand_that_turns_on_a_handle_is_reported_and_leaving_orientations_out_helps(
    slip: float, tmp_path: Path
) -> None:
    recording = recording_of(HINGE, slip)
    (line,) = turned_grips(recording).values()
    assert "--positions-only" in line
    assert not any("--columns" in each for each in suspicions_of_recording(recording))
    assert line in micah_plan.learn(recording).warnings
    path, model = tmp_path / "tip.csv", tmp_path / "tip.yaml"
    write_recording(recording, path)
    result = CliRunner().invoke(app, ["learn", str(path), "--positions-only", "-o", str(model)])
    assert result.exit_code == 0
    (joint,) = (m.joints[0] for m in micah_plan.load(model).modes if m.joints[0].moves)
    assert radius(joint) == pytest.approx(radius(HINGE), rel=0.01)


def test_along_a_line_too() -> None:
    line = turned_grips(recording_of(DRAWER, 0.5, np.array([0.0, 0.0, 1.0])))["part"]
    assert "along a line" in line


@pytest.mark.parametrize(
    "joint",
    [HINGE, DRAWER, screw((0.0, 0.0, 1.0), (0.5, -0.2, 0.3), 0.05, (0.75, -0.2, 0.3))],
    ids=["hinge", "drawer", "screw"],
)
@pytest.mark.parametrize("noise", [0.0, 3e-4, 5e-3])
def test_true_joints_are_not_doubted(joint: Joint, noise: float) -> None:
    assert turned_grips(recording_of(joint, 0.0, noise=noise)) == {}


def test_a_bolt_that_turns_along_its_way_is_a_screw() -> None:
    assert turned_grips(recording_of(DRAWER, 0.6)) == {}


def test_noise_rest_and_few_rows_are_uninformative() -> None:
    rng = np.random.default_rng(1)
    resting = RigidTransform.identity(60)
    assert turned_grip(rng.normal(0.0, 1e-3, (60, 3)), resting.rotation) is None
    assert turned_grip(np.zeros((60, 3)), Rotation.random(60, rng=rng)) is None
    short = recording_of(HINGE, -1.0)
    assert turned_grip(short.position[:5], short.poses().rotation[:5]) is None
    assert turned_grips(replace(short, quaternion=None)) == {}


def test_a_file_next_to_a_log_states_it_as_well(tmp_path: Path) -> None:
    write_recording(recording_of(HINGE, -0.4), tmp_path / "tip.csv")
    beside = tmp_path / "tip.conventions.yaml"
    beside.write_text("format: micah-plan/conventions/1\npositions_only: true\n")
    assert load_conventions(beside).positions_only is True
    assert not micah_plan.load(tmp_path / "tip.csv").has_orientation
    assert read_recording(tmp_path / "tip.csv").has_orientation
