"""Rows that are equal to the one before: rests that a coarse encoder reads anew, and readings that were lost."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.recording.repeats import repeated_readings

ROWS, LEVER = 160, 0.3


def servo(seed: int, share: float) -> np.ndarray:
    """Angles of a servo that goes a share of the way to its goal in each row, and rests until the next goal."""
    rng = np.random.default_rng(seed)
    angle, goal, angles = 0.0, 0.0, np.empty(ROWS)
    for row in range(ROWS):
        if row % 20 == 5:
            goal = rng.uniform(0.0, 1.5)
        angle += share * (goal - angle)
        angles[row] = angle
    return angles


def limited(seed: int, speed: float) -> np.ndarray:
    """Angles of a servo with a largest speed, which stops dead."""
    rng = np.random.default_rng(seed)
    angle, goal, angles = 0.0, 0.0, np.empty(ROWS)
    for row in range(ROWS):
        if row % 20 == 5:
            goal = rng.uniform(0.0, 1.5)
        angle += float(np.clip(goal - angle, -speed, speed))
        angles[row] = angle
    return angles


def poses(angle: np.ndarray, noise: float = 0.0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and quaternion of a lever at angles (n,), with noise [m]."""
    rng = np.random.default_rng(seed)
    position = np.stack([LEVER * np.cos(angle), LEVER * np.sin(angle), 0.2 + 0.0 * angle], axis=1)
    turn = Rotation.from_rotvec(np.outer(angle, [0.0, 0.0, 1.0]))
    if noise:
        position = position + noise * rng.standard_normal(position.shape)
        turn = Rotation.from_rotvec(2.0 * noise * rng.standard_normal(position.shape)) * turn
    return position, turn.as_quat()


@pytest.mark.sweep
@pytest.mark.parametrize("bits", [12, 8, 10, 16])
@pytest.mark.parametrize("motion", [servo, limited])
@pytest.mark.parametrize("with_orientation", [True, False])
def test_rests_that_an_encoder_reads_are_measurements(bits, motion, with_orientation) -> None:
    lost = 0
    for seed in range(4):
        count = 2.0 * np.pi / 2**bits
        position, quaternion = poses(count * np.round(motion(seed, 0.5 if motion is servo else 0.2) / count))
        assert (position[1:] == position[:-1]).all(axis=1).sum() > 20, "there are rests"
        lost += repeated_readings(position, quaternion if with_orientation else None).any()
    assert lost <= 1


@pytest.mark.sweep
@pytest.mark.parametrize("motion", [servo, limited])
@pytest.mark.parametrize("held", ["every third", "bursts"])
@pytest.mark.parametrize("with_orientation", [True, False])
def test_poses_that_a_tracker_writes_again_are_none(motion, held, with_orientation) -> None:
    """The same motion, seen by a tracker with noise that is slower than the log or loses the part now and then."""
    found = 0
    for seed in range(4):
        position, quaternion = poses(motion(seed, 0.2), noise=1e-3, seed=seed)
        again = np.arange(ROWS) % 3 > 0 if held == "every third" else np.arange(ROWS) % 40 > 32
        for row in np.flatnonzero(again):
            position[row], quaternion[row] = position[row - 1], quaternion[row - 1]
        repeats = repeated_readings(position, quaternion if with_orientation else None)
        assert not (repeats & ~again).any()
        found += repeats[again].all()
    assert found >= 3


def seen_now_and_then(angle: np.ndarray, period: float, first: float, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Poses that a tracker with a clock of its own reads, as a faster log keeps them, and rows with a new reading."""
    position, _ = poses(angle, noise=noise, seed=3)
    ticks = np.floor((np.arange(ROWS) - first) / period)
    new = np.append(True, np.diff(ticks) > 0)
    return position[np.maximum.accumulate(np.where(new, np.arange(ROWS), 0))], new


def pushed(step: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Actions that ask for steps (n,) [rad] of the lever at angles (n,)."""
    return LEVER * step[:, None] * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)


@pytest.mark.parametrize("period", [2, 3, 10 / 3, 5, 12])
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("with_actions", [True, False])
def test_a_tracker_that_is_slower_than_the_log_is_identified_by_its_clock(period, first, noise, with_actions) -> None:
    """Poses in steps of very different sizes, so that no speed tells what was lost."""
    step = 0.05 * np.random.default_rng(1).standard_normal(ROWS)
    angle = np.concatenate([[0.0], np.cumsum(step)[:-1]])
    position, new = seen_now_and_then(angle, period, first, noise)
    repeats = repeated_readings(position, None, pushed(step, angle) if with_actions else None)
    np.testing.assert_array_equal(repeats, ~new)


@pytest.mark.parametrize("every", [2, 3, 5])
@pytest.mark.parametrize("left_over", [0.0, 0.002])
def test_a_part_that_goes_at_every_third_row_rests(every, left_over) -> None:
    """The same poses, of an arm that is told to go now and then and is there at once (but for what is left over)."""
    step = np.where(np.arange(ROWS) % every == every - 1, 0.1 * np.cos(np.arange(ROWS)), left_over)
    angle = np.concatenate([[0.0], np.cumsum(np.where(step == left_over, 0.0, step))[:-1]])
    position, _ = poses(2e-3 * np.round(angle / 2e-3))
    assert (position[1:] == position[:-1]).all(axis=1).sum() > 70
    assert not repeated_readings(position, None, pushed(step, angle)).any()


@pytest.mark.parametrize("period", [3, 4])
def test_a_clock_may_miss_a_beat_and_the_part_may_rest(period) -> None:
    """An encoder that is read at every third row, of a part that rests in between, and ticks that come a row late."""
    rng = np.random.default_rng(2)
    step = np.where(np.arange(ROWS) % 60 < 40, 0.02 + 0.02 * rng.random(ROWS), 0.0)
    angle = np.concatenate([[0.0], np.cumsum(step)[:-1]])
    late = np.where(rng.random(ROWS) < 0.04, 1, 0)
    reads = np.isin(np.arange(ROWS) - late, np.arange(0, ROWS, period))
    kept = np.maximum.accumulate(np.where(reads, np.arange(ROWS), 0))
    position, _ = poses(2e-3 * np.round(angle / 2e-3))
    position = position[kept]
    repeats = repeated_readings(position, None, pushed(step, angle))
    np.testing.assert_array_equal(repeats, np.append(False, (position[1:] == position[:-1]).all(axis=1)))


def test_without_equal_rows_nothing_repeats() -> None:
    position, quaternion = poses(servo(0, 0.2), noise=1e-3)
    assert not repeated_readings(position, quaternion).any()
    assert not repeated_readings(position[:3], None).any()
