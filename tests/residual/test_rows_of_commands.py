"""Commands stored in other rows than those that they move, and rows that are no measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.message import codes_of
from micah_plan.recording.commands import with_commands
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.compared_runs import read_tracks
from micah_plan.residual.judgement import judge
from micah_plan.residual.prediction import predict_recording, rmse


def stored_late(recording: Recording, rows: int) -> Recording:
    """Each action that many rows after the one that it moved."""
    action = np.array(recording.action)
    for run in recording.runs:
        own = np.flatnonzero(recording.run == run)
        action[own[rows:]] = recording.action[own[:-rows]]
        action[own[:rows]], action[own[-1]] = 0.0, np.nan
    return replace(recording, action=action)


def held(recording: Recording, each: int) -> Recording:
    """Poses that a slower tracker repeats until it has a new one."""
    first = np.arange(len(recording)) // each * each
    return replace(recording, position=recording.position[first], quaternion=recording.quaternion[first])


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, pytest.param(2, marks=pytest.mark.evidence)])
def test_a_true_model_is_true_whichever_row_its_commands_are_stored_in(door, rows) -> None:
    recording = stored_late(plants.door_recording(plants.runs_of(plants.honest, 8, 50, 3)), rows)
    found = calibrate(door, recording)
    assert found.verdict == "none"
    assert rows in [note.values["rows"] for note in found.notes if note.code == "actions_stored_late"]
    runs = predict_recording(door, recording)
    assert rmse([run.one_step.configuration for run in runs]) < 0.007
    told = judge(door, recording, runs)
    assert told.is_noise is not False
    assert "stored" in told.sentence


@pytest.mark.slow
def test_effects_are_found_in_commands_that_are_stored_late(door) -> None:
    found = calibrate(door, stored_late(plants.door_recording(plants.runs_of(plants.feeble, 10, 50, 0)), 1))
    scaled, pushed = sorted(found.effects, key=lambda effect: effect.effect.name == "bias")
    # Steps of a tenth are so small that a limit of them does as well: one of the two is written, and the other named.
    assert "gain" in (scaled.effect.name, *scaled.tied)
    assert pushed.effect.name == "bias"
    assert pushed.effect.values[0] == pytest.approx(0.004, abs=0.0003)


def loop(kind, seed, noise, count=5, rows=80):
    """Runs under a controller that sees noise: of displacements, of places, or of a wave without looking."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        c, v, goal, begun = rng.uniform(0.1, 0.5), 0.0, rng.uniform(0.3, 1.1), rng.uniform(0.0, 6.0)
        z, u = np.zeros(rows), np.zeros(rows)
        for k in range(rows):
            z[k] = c + noise * rng.standard_normal()
            goal = rng.uniform(0.1, 1.1) if k % 25 == 24 else goal
            if kind == "wave":
                u[k] = 0.04 * np.sin(0.2 * k + begun)
                v = u[k]
            elif kind == "servo":
                u[k], v = goal - z[k], 0.3 * (goal - c)
            else:
                u[k] = np.clip(0.6 * (goal - z[k]), -0.05, 0.05)
                v = 0.5 * v + 0.5 * u[k] if kind == "slow" else u[k]
            c = float(np.clip(c + v + 0.0005 * rng.standard_normal(), 0.0, 1.2))
        found.append((z, u))
    return plants.door_recording(found)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["displaced", "slow", "servo", "wave"])
@pytest.mark.parametrize("noise", [0.0003, 0.003, 0.01])
def test_commands_that_follow_what_was_measured_are_not_taken_for_late(door, kind, noise) -> None:
    assert [read_tracks(door, loop(kind, seed, noise))[1] for seed in range(3)] == [0, 0, 0]


@pytest.mark.parametrize("plant", [plants.late, plants.slow, plants.loose, plants.sticky, plants.worn_half_way])
def test_no_effect_is_taken_for_commands_stored_late(door, plant) -> None:
    for seed in range(2):
        assert read_tracks(door, plants.door_recording(plants.runs_of(plant, 6, 50, seed)))[1] == 0


@pytest.mark.parametrize("kind", ["displaced", "servo"])
def test_late_commands_of_a_closed_loop_are_noticed(door, kind) -> None:
    assert read_tracks(door, stored_late(loop(kind, 0, 0.003), 1))[1] == 1


def test_goals_that_lead_on_from_the_part_are_not_taken_for_late(door) -> None:
    """They are places, and foretell where the part is, since they were made of that."""
    recording = with_commands(loop("displaced", 1, 0.0003), "position")
    assert read_tracks(door, recording)[1] == 0


@pytest.mark.slow
def test_poses_that_are_held_for_three_rows_are_no_effect(door) -> None:
    recording = held(plants.door_recording(plants.runs_of(plants.honest, 8, 60, 3), across=0.001), 3)
    found = calibrate(door, recording)
    assert found.verdict == "none"
    assert "rows_without_measurement" in codes_of(found.notes)
    runs = predict_recording(door, recording)
    assert all(len(run.time) == 20 for run in runs)
    assert rmse([run.one_step.configuration for run in runs]) < 0.008


@pytest.mark.evidence
def test_effects_are_sized_between_held_poses(door) -> None:
    found = calibrate(door, held(plants.door_recording(plants.runs_of(plants.feeble, 10, 60, 0), across=0.001), 3))
    sizes = {effect.effect.name: effect.effect.values[0] for effect in found.effects}
    assert sizes == {"gain": pytest.approx(0.1, abs=0.01), "bias": pytest.approx(0.004, abs=0.0003)}


def test_rows_that_are_no_measurements_are_in_no_floor(door) -> None:
    """A median of five poses is one of them again and again."""
    runs = plants.runs_of(plants.honest, 5, 70, 0)
    windows = [np.lib.stride_tricks.sliding_window_view(np.pad(z, 2, mode="edge"), 5) for z, _ in runs]
    medians = [(np.median(around, axis=1), u) for around, (_, u) in zip(windows, runs, strict=True)]
    found = calibrate(door, plants.door_recording(medians))
    assert found.verdict == "none"
    assert "rows_without_measurement" in codes_of(found.notes)
    assert 0.5 * found.before.rollout < found.rollout_floor < 2.0 * found.before.rollout


@pytest.mark.parametrize("late", [0, 1, 2])
def test_goals_that_are_stored_late_stay_the_places_that_they_were(door, late) -> None:
    """Each leads from the pose beside which it was stored, whichever row it moves."""
    rng = np.random.default_rng(5)
    runs = []
    for _ in range(5):
        goal = np.repeat(rng.uniform(0.1, 1.1, 12), 8)
        z = np.zeros(len(goal))
        z[0] = goal[0]
        for k in range(len(z) - 1):
            z[k + 1] = z[k] + 0.35 * (goal[k] - z[k])
        stored = goal[np.maximum(np.arange(len(goal)) - late, 0)]
        seen = z + 0.0005 * rng.standard_normal(len(z))
        runs.append((seen, stored - seen))
    recording = plants.door_recording(runs)
    found = calibrate(door, recording)
    (effect,) = found.effects
    assert effect.effect.name == "follow"
    assert effect.effect.values[0] == pytest.approx(0.35, abs=0.01)
    errors = [run.rollout.configuration for run in predict_recording(found.automaton, recording)]
    assert rmse(errors) < 0.002


def test_rows_in_the_wrong_order_are_no_reason_to_fail(door) -> None:
    """Said to be places: what is left, after all effects are dropped, is that the part is there at once."""
    runs = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        goal, z = np.repeat(rng.uniform(0.1, 1.1, 10), 8), np.full(80, 0.5)
        for k in range(79):
            z[k + 1] = z[k] + 0.3 * (goal[k] - z[k])
        runs.append((z[::-1], (goal - z)[::-1]))
    found = calibrate(door, with_commands(plants.door_recording(runs), "position"))
    assert found.verdict != "none"
