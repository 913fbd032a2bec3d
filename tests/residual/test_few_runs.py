"""Few runs: rows of one run share what is particular to it, so each run must bear out what the others show."""

from __future__ import annotations

import planted_effects as plants
import pytest

from micah_plan.residual.calibrate import calibrate


def weak_but_in(run: int):
    def plant(c, u, k, memory):
        return (plants.honest if memory["run"] == run else plants.weak)(c, u, k, memory)

    return plant


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (3, 4))])
def test_what_one_of_three_runs_contradicts_is_not_explained(door, seed) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(weak_but_in(1), 3, 40, seed)))
    assert found.verdict == "partly"
    assert found.traces[0].outcome.name == "contradicted"
    assert found.effects
    assert not any(one.is_added for one in found.effects)
    assert found.automaton == door


@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_what_each_of_three_runs_bears_out_is(door, seed) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.weak, 3, 40, seed)))
    assert found.verdict == "explained"
    assert all(one.is_added for one in found.effects)


@pytest.mark.parametrize(("rows", "verdict"), [(30, "partly"), (150, "explained")])
def test_one_run_explains_only_by_many_motions(door, rows, verdict) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.weak, 1, rows, 1)))
    assert found.verdict == verdict
    assert [one.is_added for one in found.effects] == [True]
