"""Densities with steps and kinks: thresholds and delays are found where they are; what noise decides does not count."""

from __future__ import annotations

import planted_effects as plants
import pytest
from unseen_plants import answered

from micah_plan.residual.calibrate import calibrate


@pytest.mark.parametrize("seed", [4, *(pytest.param(seed, marks=pytest.mark.evidence) for seed in (6, 7, 9))])
def test_a_delay_with_a_dead_zone_is_all_there_is(door, seed) -> None:
    """A threshold that is a little off leaves what a second effect, or noise, would explain."""
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.late_and_sticky, 8, 40, seed)))
    assert found.verdict == "explained"
    values = {one.effect.name: one.effect.values[0] for one in found.effects}
    assert values == {"delay": pytest.approx(2.0, abs=0.015), "dead_zone": pytest.approx(0.02, abs=3e-4)}
    assert found.after.one_step < 1.05 * found.noise_floor


@pytest.mark.slow
@pytest.mark.parametrize("seed", [700, pytest.param(810, marks=pytest.mark.evidence)])
def test_a_slide_that_becomes_an_arc_has_no_limit_besides_its_delay(seed) -> None:
    """Near the change a noisy row does not tell whether a command meant metres or radians."""
    answer = answered(("slide then arc: delay", seed))
    assert (answer.verdict, answer.said) == ("explained", "delay")


@pytest.mark.slow
def test_what_is_short_on_slide_and_arc_is_found_though_rows_are_left_out() -> None:
    assert answered(("slide then arc: gain", 500)).is_right
