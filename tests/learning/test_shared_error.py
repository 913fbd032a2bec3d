"""Errors that rows share: how wide they make a joint, against the joints of many wrong recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import micah_plan
from micah_plan.automaton.joint import Joint, axis_basis, prismatic, radius, radius_std, revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.errors import InputError
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.recording.shared_error import SharedError, shared_error_of, with_shared_errors
from micah_plan.recording.value import Recording

RNG = np.random.default_rng(5)
HINGE = revolute((0.2, 0.1, 1.0), (0.4, -0.3, 0.2), (0.7, 0.0, 0.1))
DRAWER = prismatic((1.0, 0.2, -0.1), (0.4, -0.3, 0.2))
FRAME = np.diag([1e-6, 4e-6, 9e-6, 1e-6, 9e-6, 4e-6])
NONE = np.zeros((6, 6))


def recording_of(joint: Joint, wrong: RigidTransform | None = None, scale: float = 1.0) -> Recording:
    rng = np.random.default_rng(1)
    poses = forward(joint, np.linspace(0.0, 0.8 if joint.turns else 0.3, 80))
    poses = poses if wrong is None else wrong * poses
    position = scale * poses.translation + rng.normal(0.0, 1e-4, (80, 3))
    turns = Rotation.from_rotvec(rng.normal(0.0, 3e-4, (80, 3))) * poses.rotation
    return Recording(0.05 * np.arange(80.0), position, turns.as_quat(canonical=True))


def moving_joint(recording: Recording) -> Joint:
    return next(s.joint for e in micah_plan.learn(recording).graph.edges for s in e.segments if s.joint.moves)


def stds(joint: Joint) -> dict[str, float]:
    assert joint.covariance is not None
    return dict(zip(joint.covariance.names, np.sqrt(np.diag(np.array(joint.covariance.matrix))), strict=True))


@pytest.mark.parametrize("truth", [HINGE, DRAWER])
def test_a_wrong_frame_moves_a_joint_as_far_as_its_covariance(truth: Joint) -> None:
    plain = recording_of(truth)
    said = stds(moving_joint(with_shared_errors(plain, {"part": SharedError(FRAME, NONE)})))
    bare = stds(moving_joint(plain))
    tilts = []
    for _ in range(40):
        shift, turn = np.split(RNG.multivariate_normal(np.zeros(6), FRAME), 2)
        wrong = RigidTransform.from_components(shift, Rotation.from_rotvec(turn))
        found = moving_joint(recording_of(truth, wrong))
        tilts.append(axis_basis(truth.axis) @ np.cross(truth.axis, found.axis))
    for k, spread in enumerate(np.sqrt(np.mean(np.square(tilts), axis=0)), start=1):
        expected = np.hypot(spread, bare[f"axis_{k}"])
        assert said[f"axis_{k}"] == pytest.approx(expected, rel=0.4)
        assert said[f"axis_{k}"] > 2.0 * bare[f"axis_{k}"]


def test_a_wrong_scale_is_a_wrong_radius() -> None:
    plain = recording_of(HINGE)
    joint = moving_joint(with_shared_errors(plain, {"part": SharedError(NONE, NONE, 0.05)}))
    assert radius_std(joint) == pytest.approx(0.05 * radius(HINGE), rel=0.05)
    assert radius_std(moving_joint(plain)) < 0.002
    assert radius(moving_joint(recording_of(HINGE, scale=1.05))) == pytest.approx(1.05 * radius(HINGE), rel=0.01)


def test_neighbours_that_are_wrong_alike_count_as_few_poses() -> None:
    pose = np.diag([4e-6] * 3 + [1e-5] * 3)
    plain = recording_of(DRAWER)
    said = stds(moving_joint(with_shared_errors(plain, {"part": SharedError(NONE, pose)})))
    # Three poses over 0.3 m: the slope of a line through them.
    assert said["axis_1"] == pytest.approx(2e-3 / (0.3 / np.sqrt(2.0)), rel=0.2)


def test_files_keep_it(tmp_path: Path) -> None:
    error = SharedError(FRAME + 1e-7, 2.0 * FRAME, 0.02)
    recording = with_shared_errors(recording_of(HINGE), {"part": error})
    for name in ("a.csv", "a.npz"):
        write_recording(recording, tmp_path / name)
        kept = shared_error_of(read_recording(tmp_path / name), "part")
        assert kept is not None
        assert np.allclose(kept.frame, error.frame, rtol=1e-3, atol=1e-10)
        assert np.allclose(kept.pose, error.pose, rtol=1e-3, atol=1e-10)
        assert kept.scale == 0.02


def test_independent_runs_know_better_than_one() -> None:
    plain = recording_of(HINGE)
    runs = [with_shared_errors(plain, {"part": SharedError(k * FRAME, NONE, 0.02)}) for k in (1.0, 1.001)]
    columns = {name: runs[0].extra[name] + runs[1].extra[name] for name in runs[0].extra}
    both = Recording(
        np.tile(plain.time, 2), np.tile(plain.position, (2, 1)), run=np.repeat([0, 1], 80), has_run=True, extra=columns
    )
    found = shared_error_of(both, "part")
    assert found is not None
    assert np.allclose(found.frame, 0.5 * FRAME, rtol=0.01)


def test_without_a_statement_nothing_is_added() -> None:
    plain = recording_of(HINGE)
    assert shared_error_of(plain, "part") is None
    assert stds(moving_joint(with_shared_errors(plain, {"part": SharedError(NONE, NONE)}))) == pytest.approx(
        stds(moving_joint(plain))
    )


@pytest.mark.parametrize("text", ["1 2 3", "nan", "a b", " ".join(["inf"] * 21)])
def test_another_text_is_one_line(text: str) -> None:
    plain = recording_of(HINGE)
    wrong = replace(plain, extra={"frame_covariance": (text, *[""] * (len(plain) - 1))})
    with pytest.raises(InputError, match="column 'frame_covariance': expected 21 numbers"):
        micah_plan.learn(wrong)
