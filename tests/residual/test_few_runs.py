"""Few runs: rows of one run share what is particular to it, so each run must bear out what the others show."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.residual.calibrate import calibrate


def weak_but_in(run: int):
    def plant(c, u, k, memory):
        return (plants.honest if memory["run"] == run else plants.weak)(c, u, k, memory)

    return plant


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.evidence) for seed in (3, 4))])
def test_what_one_of_three_runs_contradicts_is_not_explained(door, seed) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(weak_but_in(1), 3, 40, seed)))
    assert found.verdict == "partly"
    assert found.traces[0].outcome.name == "contradicted"
    assert found.effects
    assert not any(one.is_added for one in found.effects)
    assert found.automaton == door


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.evidence)])
def test_what_each_of_three_runs_bears_out_is(door, seed) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.weak, 3, 40, seed)))
    assert found.verdict == "explained"
    assert all(one.is_added for one in found.effects)


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "verdict"), [(30, "partly"), (150, "explained")])
def test_one_run_explains_only_by_many_motions(door, rows, verdict) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.weak, 1, rows, 1)))
    assert found.verdict == verdict
    assert [one.is_added for one in found.effects] == [True]


def led_to_places(runs, rows=80, share=0.35):
    """A machine under position control: the part goes a share of the way to a place that is told in each row."""
    rng, found = np.random.default_rng(1), []
    for _ in range(runs):
        c = place = rng.uniform(0.2, 0.5)
        goal, z, u = rng.uniform(0.3, 0.9), np.zeros(rows), np.zeros(rows)
        for k in range(rows):
            z[k] = c + 0.003 * rng.standard_normal()
            goal = rng.uniform(0.3, 0.9) if abs(goal - place) < 0.03 else goal
            place += np.clip(goal - place, -0.03, 0.03)
            u[k] = place - z[k]
            c += share * (place - c)
        found.append((z, u))
    return found


@pytest.mark.evidence
@pytest.mark.parametrize("runs", [3, pytest.param(2, marks=pytest.mark.slow), pytest.param(6, marks=pytest.mark.slow)])
def test_few_runs_of_a_machine_that_is_led_to_places_bear_that_out(door, runs) -> None:
    found = calibrate(door, plants.door_recording(led_to_places(runs)))
    assert found.verdict == "explained"
    assert [(one.effect.name, one.is_added) for one in found.effects] == [("follow", True)]
