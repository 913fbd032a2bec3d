"""What actions say of a part at rest: locked, waiting for the hand, stopped, or left alone."""

from __future__ import annotations

import numpy as np
import pytest
from kinds_catalogue import simulated
from planted import JOINTS, TRAVEL, Noise, moving_then_held, recorded

from micah_plan.learning.learn import learn_graph
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


@pytest.mark.sweep
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_is_pushed_in_vain_and_then_released_was_locked(kind: str, noise: Noise) -> None:
    right = 0
    for seed in range(4):
        push = 1 + 0.2 * np.random.default_rng(seed).standard_normal(40)
        right += kinds(acted(kind, push, np.zeros(0), noise, seed)) == ["rigid", kind]
    assert right >= 3


@pytest.mark.sweep
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_was_not_pushed_yet_waits_for_the_hand(kind: str, noise: Noise) -> None:
    for rows in (10, 40):
        assert kinds(acted(kind, np.zeros(rows), np.zeros(0), noise)) == [kind]
    # A hand that takes up some slack before the part moves does not make it locked either.
    assert kinds(acted(kind, np.linspace(0, 1, 4), np.zeros(0), noise)) == [kind]


@pytest.mark.sweep
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_hand_that_first_goes_the_other_way_has_not_pushed_in_vain(kind: str, noise: Noise) -> None:
    away_and_back = np.concatenate([np.full(20, -1.0), np.full(20, 1.0)])
    assert kinds(acted(kind, away_and_back, np.zeros(0), noise)) == [kind]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("locked-first", marks=pytest.mark.slow),
        pytest.param("locked-first-then-a-stop", marks=pytest.mark.evidence),
        pytest.param("wander-locked-first", marks=pytest.mark.evidence),
    ],
)
def test_hands_whose_direction_wanders_do_not_wait_while_they_push(name: str) -> None:
    """Where actions predicted no steps, they excused any push in vain."""
    found = [simulated(name, seed) for seed in range(600, 618)]
    right = sum(kinds(one.recording) in [list(answer) for answer in one.edges["part"].answers] for one in found)
    assert right >= 16


@pytest.mark.sweep
@pytest.mark.parametrize("noise", [*NOISES, Noise(0.0, 0.0)])
@pytest.mark.parametrize("rows", [30, 120])
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_is_left_open_has_no_stop_however_long_it_rests(kind: str, rows: int, noise: Noise) -> None:
    assert kinds(acted(kind, np.zeros(0), np.zeros(rows), noise)) == [kind]


@pytest.mark.sweep
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_is_pushed_on_without_moving_is_stopped(kind: str, noise: Noise) -> None:
    assert kinds(acted(kind, np.zeros(0), np.ones(40), noise)) == [kind, "rigid"]


def pressed_on_the_way(kind: str, noise: Noise, seed: int, late: int) -> Recording:
    """A part that is moved to a stop, pressed on, and moved back, by a hand as uneven as hands are."""
    rng = np.random.default_rng(seed)
    step = TRAVEL[kind] / MOVING
    asked = step * np.concatenate([np.ones(MOVING), np.ones(25), -np.ones(50)]) * np.exp(0.3 * rng.normal(size=145))
    followed = asked.copy()
    followed[MOVING : MOVING + 25] = 0.0
    c = np.concatenate([[0.0], np.cumsum(followed)])
    commanded = np.concatenate([asked[late:], np.zeros(late + 1)])
    return recorded([(JOINTS[kind], c)], rng, noise, commanded=[commanded])


@pytest.mark.sweep
@pytest.mark.parametrize("late", [0, 4])
@pytest.mark.parametrize("kind", KINDS)
def test_a_part_that_is_pressed_at_a_stop_and_moved_back_was_held_there(kind: str, late: int) -> None:
    """A channel that is fitted to the rows of the press as well says so little that the stop is not seen."""
    found = [kinds(pressed_on_the_way(kind, Noise(0.001, 0.006), seed, late)) for seed in range(4)]
    assert found.count([kind, "rigid", kind]) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_less_a_hand_pushes_at_a_rest_the_less_certain_it_is(kind: str) -> None:
    """The joint may have the part there as well: that was no rival, and every rest was told with certainty."""
    means = []
    for push in (0.1, 1.0):
        pushed = [acted(kind, np.zeros(0), np.full(40, push), Noise(0.002, 0.01), seed) for seed in range(3)]
        ends = [learn_graph(one).edges[0].segments[-1] for one in pushed]
        means.append(np.mean([end.probability for end in ends if end.joint.kind == "rigid"]))
    hardly, firmly = means
    assert 0.5 < hardly < 0.9
    assert firmly > 0.97
