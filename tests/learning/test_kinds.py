"""The kinds of motion that learning is judged by do what their truth says."""

import numpy as np
import pytest
from kinds_catalogue import KINDS, simulated
from scipy.spatial.transform import Rotation

from micah_plan.automaton.kinematics import forward, inverse


@pytest.mark.slow
def test_a_seed_gives_the_same_recording_and_another_one_another():
    assert len(KINDS) >= 25
    for name in KINDS:
        first, again, other = (simulated(name, seed).recording.digest() for seed in (4, 4, 5))
        assert first == again != other


def test_recordings_are_as_long_as_the_kinds_say_and_the_truth_fits_them():
    for name in KINDS:
        one = simulated(name, 7)
        rows = len(one.recording) // len(one.recording.parts)
        assert 75 <= rows <= 301, name
        for truth in one.edges.values():
            assert len(truth.changepoints) == len(truth.tolerance) == len(truth.answers[0]) - 1
            assert list(truth.changepoints) == sorted(truth.changepoints)


@pytest.mark.parametrize("name", ["left-open-ideal", "locked-first-ideal"])
def test_ideal_poses_lie_on_the_joint_and_move_as_commanded(name):
    for seed in range(4):
        one = simulated(name, seed)
        recording, truth = one.recording, one.edges["part"]
        joint = truth.joints[-1]
        c = inverse(joint, recording.position, Rotation.from_quat(recording.quaternion))
        np.testing.assert_allclose(forward(joint, c).translation, recording.position, atol=1e-4)
        row = truth.changepoints[0] if truth.changepoints else 0
        assert np.ptp(c[: row + 1]) < 1e-3
        along = np.sum(np.diff(recording.position, axis=0) * recording.action[:-1], axis=1)
        moving = np.linalg.norm(np.diff(recording.position, axis=0), axis=1) > 1e-3
        assert (along[moving] > 0).all()
        assert not moving[:row].any()
        assert np.abs(recording.action[:row]).sum() > 0 or row == 0
