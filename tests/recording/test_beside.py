"""Commands by another clock: the planted offset, its std, what each row got, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.errors import InputError
from micah_plan.recording.beside import with_commands_beside
from micah_plan.recording.value import Recording

OFFSET = 41.37
TURNED = Rotation.from_euler("zyx", [0.7, -0.4, 0.2])


def law(t: np.ndarray) -> np.ndarray:
    """(n, 3) a drawer: pulled, held, pulled on, pushed back."""
    way = np.interp(t, [0.0, 1.0, 2.5, 4.0, 5.0, 6.0, 8.0, 10.0], [0.0, 0.0, 0.2, 0.2, 0.3, 0.3, 0.05, 0.05])
    return np.outer(way, [0.6, -0.8, 0.0])


def video(rng: np.random.Generator, noise: float = 5e-4, rate: float = 30.0, start: float = 0.0) -> Recording:
    time = np.arange(start, 10.0, 1.0 / rate)
    seen = np.delete(np.arange(len(time)), slice(70, 84))  # covered for half a second
    return Recording(time[seen] - start, (law(time) + rng.normal(0.0, noise, (len(time), 3)))[seen])


def robot(rate: float = 125.0, before: float = 3.0) -> Recording:
    """Its commands, by its clock and in its frame."""
    time = np.arange(-before, 12.0, 1.0 / rate)
    at = TURNED.apply(law(time))
    action = np.vstack([np.diff(at, axis=0), np.full((1, 3), np.nan)])
    return Recording(time + OFFSET, at, action=action)


@pytest.mark.parametrize("rate", [10.0, 30.0, 120.0])
def test_the_offset_is_found_from_the_motion(rate: float) -> None:
    rng, off = np.random.default_rng(3), []
    for _ in range(10):
        joined, clock = with_commands_beside(video(rng, rate=rate), robot())
        off.append(clock.seconds - OFFSET)
        assert clock.correlation > 0.9
        assert np.isfinite(joined.action[:-1]).all()
    assert np.abs(off).max() < max(0.02, 0.5 / rate)
    assert np.std(off) < 4.0 * clock.std + 0.002


def test_rows_have_what_was_commanded_until_the_next() -> None:
    recording = video(np.random.default_rng(1), noise=0.0)
    joined, clock = with_commands_beside(recording, robot(), offset=OFFSET)
    expected = TURNED.apply(np.diff(law(recording.time), axis=0))
    np.testing.assert_allclose(joined.action[:-1], expected, atol=1e-4)
    assert np.isnan(joined.action[-1]).all()
    assert (clock.seconds, clock.std, clock.correlation) == (OFFSET, 0.0, None)


def test_targets_are_what_is_commanded_too() -> None:
    plain = robot()
    late = plain.position - 0.3 * np.nan_to_num(plain.action)  # a machine that lags
    goal = np.nan_to_num(plain.position + np.nan_to_num(plain.action) - late)
    meant = replace(plain, position=late, action=goal, extra={"command_meaning": ("position",) * len(plain)})
    joined, clock = with_commands_beside(video(np.random.default_rng(1)), meant)
    assert clock.seconds == pytest.approx(OFFSET, abs=0.03)
    assert np.abs(np.nansum(joined.action, axis=0)).max() > 0.01


def test_of_several_parts_the_one_that_moves_is_acted_on() -> None:
    rng = np.random.default_rng(2)
    moving = video(rng)
    still = replace(moving, position=rng.normal(0.0, 5e-4, (len(moving), 3)))
    order = np.argsort(np.concatenate([moving.time, moving.time + 1e-6]), kind="stable")
    both = Recording(
        np.concatenate([moving.time, still.time])[order],
        np.concatenate([moving.position, still.position])[order],
        part=tuple(np.array(["drawer"] * len(moving) + ["lamp"] * len(still))[order].tolist()),
        has_part=True,
    )
    joined, clock = with_commands_beside(both, robot())
    assert clock.part == "drawer"
    lamp = joined.action[joined.index(part="lamp")]
    assert not lamp[:-1].any()


def test_what_cannot_be_joined_is_reported() -> None:
    rng = np.random.default_rng(4)
    recording = video(rng)
    with pytest.raises(InputError, match="expected commands, found none"):
        with_commands_beside(recording, recording)
    resting = replace(recording, position=rng.normal(0.0, 1e-3, recording.position.shape))
    with pytest.raises(InputError, match="at no offset between the clocks"):
        with_commands_beside(resting, robot())
    with pytest.raises(InputError, match="at this offset the commands are from"):
        with_commands_beside(recording, robot(), offset=-500.0)
    several = replace(recording, run=np.arange(len(recording)) % 2)
    with pytest.raises(InputError, match="expected one run"):
        with_commands_beside(several, robot())
