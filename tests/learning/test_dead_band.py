"""Servos that rest some counts beside their goal are at no stop; what withstands more than moved them is one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.learning.dead_band import without_dead_band
from micah_plan.learning.learn import learn_graph
from micah_plan.recording.value import Recording

RADIUS, ROWS, FASTEST = 0.3, 240, 0.06


def servo(seed: int, bits: int = 12, counts: float = 2.0, end: float = np.inf) -> Recording:
    """A door on a servo that holds still within some counts of its goal; actions are the goal less the pose."""
    rng, count = np.random.default_rng(seed), 2.0 * np.pi / 2**bits
    goals = np.repeat(np.concatenate([[0.0], rng.uniform(0.1, 1.4, 4)]), ROWS // 5)
    goal, angle = np.zeros(ROWS), np.zeros(ROWS)
    for k in range(1, ROWS):
        goal[k] = goal[k - 1] + np.clip(goals[k] - goal[k - 1], -FASTEST, FASTEST)
        away = goal[k - 1] - angle[k - 1]
        angle[k] = min(angle[k - 1] + (0.5 * away if abs(away) > 1.01 * counts * count else 0.0), end)
    read = count * np.round(angle / count)
    action = _places(goal) - _places(read)
    action[-1] = np.nan
    quaternion = Rotation.from_rotvec(np.outer(read, [0.0, 0.0, 1.0])).as_quat()
    return Recording(np.arange(ROWS) / 30.0, _places(read), quaternion, action)


def _places(angle: np.ndarray) -> np.ndarray:
    return RADIUS * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)


def kinds(recording: Recording) -> list[str]:
    ((segments,),) = ([edge.segments] for edge in learn_graph(recording).edges)
    return [segment.joint.kind for segment in segments]


@pytest.mark.sweep
@pytest.mark.parametrize(("bits", "counts"), [(12, 2.0), (10, 1.0), (12, 3.0), (10, 2.0)])
@pytest.mark.parametrize("seed", [0, 2, 5])
def test_a_rest_next_to_the_goal_is_no_stop(bits: int, counts: float, seed: int) -> None:
    assert kinds(servo(seed, bits, counts)) == ["revolute"]


@pytest.mark.parametrize("seed", [1, 3])
def test_a_stop_that_withstands_more_is_one(seed: int) -> None:
    assert "rigid" in kinds(servo(seed, end=0.9))


def test_only_what_a_servo_is_too_coarse_for_is_left_out() -> None:
    recording = servo(0)
    action = np.nan_to_num(recording.action)
    kept = without_dead_band(recording.position, recording.quaternion, action)
    is_out = (kept != action).any(axis=1)
    rests = np.append((recording.position[1:] == recording.position[:-1]).all(axis=1), False)
    assert 0 < is_out.sum() <= rests.sum()
    assert np.linalg.norm(action[is_out], axis=1).max() < 3.0 * RADIUS * 2.0 * np.pi / 2**12
    np.testing.assert_array_equal(kept[~is_out], action[~is_out])


@pytest.mark.parametrize("case", ["noise", "gentle push", "no rests"])
def test_other_actions_are_left_as_they_are(case: str) -> None:
    rng, angle = np.random.default_rng(0), np.minimum(0.01 * np.arange(120), 0.9)
    action = RADIUS * 0.01 * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
    position = _places(angle)
    if case == "noise":
        position = position + 1e-3 * rng.standard_normal(position.shape)
    elif case == "gentle push":  # at the stop the hand asks for less than it did on the way
        action[90:] *= 0.3
    else:
        position, action = position[:90], action[:90]
    assert without_dead_band(position, None, action) is action
