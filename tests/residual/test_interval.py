"""Intervals hold what was planted, also where the likelihood is a staircase."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.tracks import tracks
from micah_plan.residual.candidates import candidates
from micah_plan.residual.coordinate_data import coordinate_data_of
from micah_plan.residual.held_out import HeldOut
from micah_plan.residual.likelihood import independent_share


def interval_of(door, plant, name, seed, goals=None):
    """(low, median, high) of the first parameter of the form that was planted, and the data."""
    moved = plants.runs_of(plant, 8, 40, seed, noise=0.003, goals=goals)
    (data,) = coordinate_data_of(door, tracks(door, plants.door_recording(moved)))
    held_out = HeldOut(data)
    (part,) = [one for one in candidates(data) if one.name == name]
    return held_out.intervals(held_out.competition.alone([part])[0])[0], data


def test_the_interval_of_a_threshold_is_as_wide_as_the_commands_around_it_are_apart(door) -> None:
    (low, median, high), data = interval_of(door, plants.sticky, "dead_zone", 0)
    assert low < median < high
    assert low < 0.02 < high
    sizes = np.sort(np.abs(data.u[data.counted_starts]))
    inside = int(np.sum((sizes > low) & (sizes < high)))
    assert inside <= 6


def test_correlated_rows_count_as_fewer() -> None:
    assert independent_share(0.0) == independent_share(-0.3) == 1.0
    assert independent_share(0.5) == pytest.approx(1 / 3)


@pytest.mark.evidence
@pytest.mark.parametrize(
    ("plant", "name", "truth", "goals"),
    [
        ("sticky", "dead_zone", 0.02, None),
        ("clinging", "guard_hysteresis", 0.03, (0.8, 1.2)),
        ("short_steps", "gain", 0.8, None),
        ("late", "delay", 2.0, None),
    ],
)
def test_intervals_hold_the_truth_as_often_as_they_say(door, plant, name, truth, goals) -> None:
    found = [interval_of(door, getattr(plants, plant), name, seed, goals)[0] for seed in range(16)]
    held = sum(low <= truth <= high for low, _, high in found)
    assert held >= 13  # of 16: fewer happen in 1 of 100 where 95 % is true
    widths = [high - low for low, _, high in found]
    assert np.median(widths) < 0.2 * truth
