"""What actions say of a part at rest: locked, waiting for the hand, stopped, or left alone."""

from __future__ import annotations

import numpy as np
import pytest
from planted import JOINTS, TRAVEL, Noise, moving_then_held, recorded

from micah_plan.learn.learn import learn_graph
from micah_plan.recording.value import Recording

MOVING = 70
NOISES = [Noise(0.001, 0.006), Noise(1e-5, 1e-4)]
KINDS = ["prismatic", "revolute"]


def acted(kind: str, before: np.ndarray, after: np.ndarray, noise: Noise, seed: int = 0) -> Recording:
    """A part at rest, moved, and at rest again, with what is commanded during both rests [shares of a typical step]."""
    rng = np.random.default_rng(seed)
    moved = moving_then_held(kind, MOVING, 0)
    typical = TRAVEL[kind] / MOVING
    c = np.concatenate([np.zeros(len(before)), moved, np.full(len(after), moved[-1])])
    commanded = np.concatenate([typical * before, np.diff(moved), [0.0], typical * after])
    return recorded([(JOINTS[kind], c)], rng, noise, commanded=[commanded])


def kinds(recording: Recording) -> list[str]:
    return [one.joint.kind for one in learn_graph(recording).edges[0].segments]


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_is_pushed_in_vain_and_then_released_was_locked(kind: str, noise: Noise) -> None:
    right = 0
    for seed in range(4):
        push = 1 + 0.2 * np.random.default_rng(seed).standard_normal(40)
        right += kinds(acted(kind, push, np.zeros(0), noise, seed)) == ["rigid", kind]
    assert right >= 3


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_nobody_pushed_yet_waits_for_the_hand(kind: str, noise: Noise) -> None:
    for rows in (10, 40):
        assert kinds(acted(kind, np.zeros(rows), np.zeros(0), noise)) == [kind]
    # A hand that takes up some slack before the part moves does not make it locked either.
    assert kinds(acted(kind, np.linspace(0, 1, 4), np.zeros(0), noise)) == [kind]


@pytest.mark.parametrize("noise", [*NOISES, Noise(0.0, 0.0)])
@pytest.mark.parametrize("rows", [30, 120])
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_is_left_open_has_no_stop_however_long_it_rests(kind: str, rows: int, noise: Noise) -> None:
    assert kinds(acted(kind, np.zeros(0), np.zeros(rows), noise)) == [kind]


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_is_pushed_on_without_moving_is_stopped(kind: str, noise: Noise) -> None:
    assert kinds(acted(kind, np.zeros(0), np.ones(40), noise)) == [kind, "rigid"]
