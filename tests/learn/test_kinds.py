"""The kinds of motion that learning is judged by do what their truth says, and the changes are what they are called."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.automaton.kinematics import forward, inverse

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def scripts():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import kinds_catalogue
        import kinds_changed

        yield kinds_catalogue, kinds_changed
    finally:
        sys.path.remove(str(BENCHMARKS))


def test_a_seed_gives_the_same_recording_and_another_one_another(scripts):
    catalogue, _ = scripts
    assert len(catalogue.KINDS) >= 25
    for name in catalogue.KINDS:
        first, again, other = (catalogue.simulated(name, seed).recording.digest() for seed in (4, 4, 5))
        assert first == again != other


def test_recordings_are_as_long_as_the_kinds_say_and_the_truth_fits_them(scripts):
    catalogue, _ = scripts
    for name in catalogue.KINDS:
        one = catalogue.simulated(name, 7)
        rows = len(one.recording) // len(one.recording.parts)
        assert 75 <= rows <= 301, name
        for truth in one.edges.values():
            assert len(truth.changepoints) == len(truth.tolerance) == len(truth.answers[0]) - 1
            assert list(truth.changepoints) == sorted(truth.changepoints)


@pytest.mark.parametrize("name", ["left-open-ideal", "locked-first-ideal"])
def test_ideal_poses_lie_on_the_joint_and_move_as_commanded(scripts, name):
    catalogue, _ = scripts
    for seed in range(4):
        one = catalogue.simulated(name, seed)
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


def test_changes_are_undone_by_their_inverses(scripts):
    catalogue, changed = scripts
    for name in ("stop", "parts-actions", "stop-positions"):
        recording = catalogue.simulated(name, 1).recording
        back = changed.mirrored(changed.mirrored(recording))
        turn = Rotation.from_rotvec([0.3, -2.0, 1.0])
        same = changed.turned(changed.turned(recording, turn), turn.inv())
        for part in recording.parts:
            own, twice, turned = (one.select(part=part) for one in (recording, back, same))
            for other in (twice, turned):
                np.testing.assert_allclose(other.time, own.time, atol=1e-9)
                np.testing.assert_allclose(other.position, own.position, atol=1e-12)
                np.testing.assert_allclose(other.action, own.action, atol=1e-12)


def test_every_second_row_keeps_what_was_commanded(scripts):
    catalogue, changed = scripts
    recording = catalogue.simulated("slide", 2).recording
    fewer = changed.every_second(recording)
    assert len(fewer) == (len(recording) + 1) // 2
    last = np.searchsorted(recording.time, fewer.time[-1])
    np.testing.assert_allclose(np.nansum(fewer.action[:-1], axis=0), recording.action[:last].sum(axis=0), atol=1e-9)
