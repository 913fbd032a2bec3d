"""Runs that are unlike the others are named and set aside; what lasts, and what all runs show, is not."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.judgement import judge
from micah_plan.residual.prediction import predict_recording


def slipping_in(runs, plant=plants.honest):
    """The hand slips in the middle of some runs (from 0)."""

    def slipping(c, u, k, memory):
        return c + 0.2 * u if memory["run"] in runs and k > 10 else plant(c, u, k, memory)

    return slipping


def told(found):
    return [note for note in found.notes if note.code in ("faulty_run", "lasting_change")]


@pytest.mark.slow
@pytest.mark.parametrize(("runs", "plant", "count", "verdict"), [
    ((5,), plants.honest, 9, "none"),
    pytest.param((2, 6), plants.honest, 9, "none", marks=pytest.mark.evidence),
    pytest.param((5,), plants.weak, 14, "explained", marks=pytest.mark.evidence),
])  # fmt: skip
def test_a_faulty_run_is_named_and_left_out(door, runs, plant, count, verdict) -> None:
    recording = plants.door_recording(plants.runs_of(slipping_in(runs, plant), count, 35, 1))
    found = calibrate(door, recording)
    numbers = [recording.runs[run] for run in runs]
    assert found.verdict == verdict
    judged = judge(door, recording, predict_recording(door, recording)).sentence
    # Where every run misses by much, one that misses otherwise is no exception to `predict`.
    assert ("is unlike the others" in judged) == (plant is plants.honest)
    assert [f"run {number} is unlike" in note for note, number in zip(told(found), numbers, strict=True)] == [
        True
    ] * len(runs)
    assert set(recording.runs) - set(found.recording.runs) == set(numbers)
    clean = calibrate(door, recording.rows([run not in numbers for run in recording.run]))
    assert (found.after, found.noise_floor) == (clean.after, clean.noise_floor)


@pytest.mark.parametrize("plant", [plants.honest, pytest.param(plants.sprung, marks=pytest.mark.evidence)])
def test_what_all_runs_show_is_no_fault_of_any(door, plant) -> None:
    assert told(calibrate(door, plants.door_recording(plants.runs_of(plant, 9, 30, 1)))) == []


@pytest.mark.evidence
@pytest.mark.parametrize("last", [1, pytest.param(2, marks=pytest.mark.evidence)])
def test_what_lasts_to_the_end_may_be_a_change(door, last) -> None:
    recording = plants.door_recording(plants.runs_of(slipping_in(range(9 - last, 9)), 9, 30, 1))
    found = calibrate(door, recording)
    assert last > 1 or len(told(found)) == 1  # two runs may bear an effect out
    assert all("Something may have changed: record more runs" in note for note in told(found))
    assert found.verdict not in ("none", "explained")


@pytest.mark.evidence
def test_the_last_run_does_not_hide_what_the_others_show(door) -> None:
    def moves(c, u, _, memory):
        return c + 0.8 * u - (0.02 if memory["run"] == 7 else 0.0)

    recording = plants.door_recording(plants.runs_of(moves, 8, 50, 3))
    found = calibrate(door, recording)
    (effect,) = found.effects
    assert (found.verdict, effect.effect.name, effect.is_added) == ("partly", "gain", True)
    assert effect.effect.values[0] == pytest.approx(0.8, abs=0.02)
    assert [note.startswith("door: run 8 is unlike the others") for note in told(found)] == [True]
    assert found.recording.runs == recording.runs[:7]


@pytest.mark.slow
def test_what_began_within_one_of_the_last_runs_is_no_fault_of_these(door) -> None:
    def moves(c, u, k, memory):
        lost = 0.3 * plants.STEP if (memory["run"], k) >= (6, 35) else 0.0
        return c + np.sign(u) * max(0.8 * abs(u) - lost, 0.0)

    found = calibrate(door, plants.door_recording(plants.runs_of(moves, 8, 50, 3, noise=0.0015)))
    assert found.recording.runs == (1, 2, 3, 4, 5, 6, 7, 8)
    always, later = sorted((e.effect for e in found.effects), key=lambda effect: effect.since is not None)
    assert (found.verdict, always.name, later.name, later.since.run) == ("explained", "gain", "dead_zone", 7)
    assert later.since.time == pytest.approx(3.5, abs=0.4)


@pytest.mark.slow
def test_of_four_runs_none_is_the_exception(door) -> None:
    recording = plants.door_recording(plants.runs_of(slipping_in((1,)), 4, 40, 1))
    assert told(calibrate(door, recording)) == []
