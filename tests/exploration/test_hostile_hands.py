"""Hands, force sensors and trackers that change on the way: nothing is claimed, and no more force is spent."""

from __future__ import annotations

import numpy as np
import pytest

from micah_plan.execution.handle import HandlePlant
from micah_plan.execution.plant import Command, Measurement
from micah_plan.exploration.run import Exploration, explore
from micah_plan.message import code_of
from micah_plan.task.exploration_scene import Scene

OUT = np.array([-0.48, 0.6, 0.64])


class Held:
    """A handle on a slide that the hand holds by a spring; `stiffness`, `sensor` and `tracker` change with the step."""

    def __init__(
        self, *, stiffness=1500.0, friction=4.0, later=None, at=9, is_measured=False, sensor=1.0, aside=1.0
    ) -> None:
        self.sensor, self.springs = sensor, np.diag([1.0, 1.0, aside])
        self.stiffness, self.friction, self.later, self.at = stiffness, friction, later, at
        self.is_measured, self.way, self.largest = is_measured, 0.0, 0.0

    def reset(self, rng: np.random.Generator) -> Measurement:
        self.rng, self.steps, self.force = rng, 0, np.zeros(3)
        return self.seen()

    def apply(self, command: Command) -> Measurement:
        self.steps += 1
        stiffness = self.stiffness * (0.45 if self.is_later("softer") else 4.0 if self.is_later("stiffer") else 1.0)
        counts_from = self.told if self.is_measured else self.way * OUT
        away = counts_from + command.handle[0] - self.way * OUT
        pull = stiffness * float(away @ OUT)
        if abs(pull) > self.friction:
            self.way = float(np.clip(self.way + (pull - np.sign(pull) * self.friction) / stiffness, 0.0, 0.4))
        self.force = stiffness * self.springs @ (counts_from + command.handle[0] - self.way * OUT)
        self.largest = max(self.largest, float(np.linalg.norm(self.force)))
        return self.seen()

    def is_later(self, what: str) -> bool:
        return self.later == what and self.steps >= self.at

    def seen(self) -> Measurement:
        noise = 0.001 * self.rng.standard_normal(3)
        self.told = (
            self.way * OUT
            + noise
            + (np.array([0.0, 0.8, 0.0]) if self.later == "leap" and self.steps == self.at else 0.0)
        )
        force = self.sensor * self.force * (0.45 if self.is_later("deaf") else 1.0)
        if self.later == "late":
            force, self.before = (force if self.steps == 0 else self.before), force
        return Measurement(0.5 * self.steps, self.told[None], np.array([[0.0, 0.0, 0.0, 1.0]]), force[None])

    def close(self) -> None:
        pass


def opened(hand: Held, force: float = 45.0, seed: int = 1, stiffness: float | None = None) -> Exploration:
    scene = Scene(largest_force=force, largest_stiffness=stiffness, opening=0.2)
    return explore(scene, HandlePlant(hand), np.random.default_rng(seed))


@pytest.mark.sweep
@pytest.mark.parametrize("later", ["softer", "deaf"])
@pytest.mark.parametrize("seed", range(2))
def test_motion_by_the_force_sensor_alone_is_no_opening(later, seed) -> None:
    hand = Held(friction=1e9, later=later)
    found = opened(hand, seed=seed)
    assert found.outcome != "opened"
    assert found.model is None
    assert hand.largest <= 45.0


@pytest.mark.sweep
@pytest.mark.parametrize("later", [None, "deaf"])
def test_what_the_tracker_sees_too_is_one(later) -> None:
    hand = Held(later=later, at=20)
    found = opened(hand)
    assert found.outcome == "opened"
    assert hand.way >= 0.17


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "force"), [(19_000.0, 10.0), pytest.param(19_000.0, 4.0, marks=pytest.mark.evidence), (1500.0, 10.0)]
)
def test_the_first_push_is_safe_for_the_stiffest_hand(stiffness, force) -> None:
    hand = Held(stiffness=stiffness, friction=1e9)
    assert opened(hand, force).outcome in ("held", "gave_up")
    assert hand.largest <= force


@pytest.mark.parametrize("stiffness", [1500.0, 350.0])  # so soft that pushes do not tell where commands count from
def test_no_command_follows_a_leap_that_it_would_count_from(stiffness) -> None:
    hand = Held(stiffness=stiffness, later="leap", at=12, is_measured=True)
    found = opened(hand)
    assert found.outcome == "gave_up"
    assert code_of(found.reason) == "rest_pulls"
    assert hand.largest <= 45.0
    assert found.steps == 12


def test_a_leap_that_nothing_counts_from_is_survived() -> None:
    assert opened(Held(later="leap", at=12)).outcome == "opened"


def test_a_sensor_that_reads_half_is_safe_with_a_given_stiffness() -> None:
    fooled, told = Held(friction=1e9, sensor=0.5), Held(friction=1e9, sensor=0.5)
    assert opened(fooled).outcome == "held"
    assert fooled.largest > 45.0  # nothing but the hand's own stiffness can tell
    assert opened(told, stiffness=1500.0).outcome in ("held", "gave_up")
    assert told.largest <= 45.0
    # What is told rightly costs nothing: a drawer opens as before.
    assert opened(Held(), stiffness=1500.0).outcome == "opened"


def test_a_hand_that_became_stiffer_is_stopped_at_once() -> None:
    hand = Held(friction=1e9, later="stiffer", at=14)
    found = opened(hand)
    assert found.outcome == "gave_up"
    assert "more than the 45 N that are allowed" in found.reason
    assert hand.largest > 45.0
    over = [moment for moment in found.moments if np.linalg.norm(moment.force) > 45.0]
    assert over == [found.moments[-1]]


@pytest.mark.parametrize(("aside", "outcome"), [(1.3, "opened"), (2.5, "gave_up")])
def test_a_hand_is_to_be_alike_in_all_directions(aside, outcome) -> None:
    hand = Held(aside=aside)
    found = opened(hand)
    assert found.outcome == outcome
    assert ("make it alike in all" in found.reason) == (outcome == "gave_up")
    assert hand.largest <= 45.0


def test_forces_of_the_command_before_are_named() -> None:
    hand = Held(later="late", friction=20.0)
    found = opened(hand)
    assert found.outcome == "gave_up"
    assert "of the command before" in found.reason
    assert hand.largest <= 45.0
