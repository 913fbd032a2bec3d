"""Recordings whose poses were smoothed: their steps are averages of commands, which no part knows beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.tracks import tracks
from micah_plan.recording.value import Recording
from micah_plan.residual.averaged_commands import Average, weights_of_steps, with_averages
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.compared_runs import read_tracks
from micah_plan.residual.coordinate_data import CoordinateData, coordinate_data_of

MEAN_OF_5 = np.full(5, 0.2)
# Savitzky and Golay, 1964: a parabola through nine points.
PARABOLA = np.array([-21, 14, 39, 54, 59, 54, 39, 14, -21]) / 231


def smoothed(plant, weights, seed, *, count=5, rows=70) -> Recording:
    """Runs whose readings were averaged over rows before and after, as a lab does when it cleans a recording."""
    reach = len(weights) // 2
    runs = plants.runs_of(plant, count, rows, seed, noise=0.003)
    return plants.door_recording([(np.convolve(np.pad(z, reach, mode="edge"), weights, "valid"), u) for z, u in runs])


def four_fifths(c, u, *_):
    return c + 0.8 * u


def data_of(door, recording) -> CoordinateData:
    (data,) = coordinate_data_of(door, tracks(door, recording))
    return data


@pytest.mark.slow
@pytest.mark.parametrize("weights", [MEAN_OF_5, PARABOLA])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.evidence)])
def test_smoothed_poses_are_nothing_that_a_model_lacks(door, weights, seed) -> None:
    found = calibrate(door, smoothed(plants.honest, weights, seed))
    assert found.verdict == "none"
    assert found.automaton == door
    assert found.traces[0].average.weights == pytest.approx(weights[len(weights) // 2 :], abs=0.03)
    assert found.before == found.after
    # What other commands than those that were written change is noise of the recording.
    assert found.before.one_step < 1.1 * found.noise_floor
    assert found.before.rollout < 1.5 * found.rollout_floor
    (note,) = (note for note in found.notes if note.code == "averaged_commands")
    assert note.values["reach"] == len(weights) // 2


@pytest.mark.slow
def test_an_effect_is_found_under_smoothed_poses(door) -> None:
    found = calibrate(door, smoothed(four_fifths, MEAN_OF_5, 0))
    assert found.verdict == "partly"
    assert found.traces[0].average is not None
    assert [(effect.effect.name, effect.is_added) for effect in found.effects] == [("gain", True)]
    assert found.effects[0].effect.values[0] == pytest.approx(0.8, abs=0.01)
    assert found.after.rollout < 0.4 * found.before.rollout


@pytest.mark.slow
@pytest.mark.parametrize("plant", [plants.slow, plants.late])
def test_what_remembers_commands_knows_none_to_come(door, plant) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plant, 5, 70, 3)))
    assert found.traces[0].average is None
    assert any(effect.is_added for effect in found.effects)


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_smoothed_poses_are_not_taken_for_commands_stored_late(door, rows) -> None:
    recording = smoothed(plants.honest, MEAN_OF_5, 2)
    late = np.array(recording.action)
    for run in recording.runs:
        own = np.flatnonzero(recording.run == run)
        late[own[rows:]] = recording.action[own[: len(own) - rows]]
        late[own[:rows]], late[own[-1]] = 0.0, np.nan
    assert read_tracks(door, replace(recording, action=late))[1] == rows


def test_averages_are_those_of_whole_runs(door) -> None:
    """A segment's first and last rows know what was commanded before and after it in the same run."""
    data = data_of(door, plants.door_recording(plants.runs_of(plants.honest, 2, 200, 0)))
    assert len(data.run) > 2
    changed = with_averages(data, Average(np.array([0.4, 0.2, 0.1])))
    runs = {number: data.whole.u[s] for s, number in enumerate(data.whole.run)}
    for s, number in enumerate(data.run):
        rows = np.flatnonzero(data.counted_starts[s])
        at = np.rint(data.time[s, rows] / data.period).astype(int)
        own = np.pad(runs[number], 2)
        expected = sum(
            weight * own[at + 2 + k] for k, weight in zip(range(-2, 3), (0.1, 0.2, 0.4, 0.2, 0.1), strict=True)
        )
        np.testing.assert_allclose(changed.u[s, rows], expected, atol=1e-12)
        np.testing.assert_allclose((changed.place - data.place)[s, rows], (changed.u - data.u)[s, rows], atol=1e-12)


def test_an_average_of_one_row_changes_nothing(door) -> None:
    data = data_of(door, plants.door_recording(plants.runs_of(plants.honest, 3, 50, 0)))
    same = with_averages(data, Average(np.array([1.0])))
    np.testing.assert_allclose(same.u, data.u, atol=1e-12)
    np.testing.assert_allclose(same.action, data.action, atol=1e-12)
    np.testing.assert_allclose(same.whole.u, data.whole.u, atol=1e-12)


def test_ends_move_by_no_command(door) -> None:
    """Where a part rests at its end for long, weights are those of the rest of the way."""
    runs = plants.runs_of(plants.honest, 3, 600, 0, noise=0.003)
    recording = plants.door_recording(
        [(np.convolve(np.pad(z, 2, mode="edge"), MEAN_OF_5, "valid"), u) for z, u in runs]
    )
    data = data_of(door, recording)
    at_an_end = np.mean((data.z[data.counted] < 0.05) | (data.z[data.counted] > plants.LENGTH - 0.05))
    assert at_an_end > 0.3
    assert weights_of_steps(data).weights == pytest.approx([0.2, 0.2, 0.2], abs=0.01)
