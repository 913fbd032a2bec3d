"""The model that a calibration writes: it takes the runs that it was calibrated on, and is as good as is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.message import codes_of
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import predict_recording, refused, rmse


@pytest.fixture(scope="module")
def honest():
    return plants.door_recording(plants.runs_of(plants.honest, 6, 50, 0))


@pytest.mark.slow
def test_the_error_of_the_new_model_is_what_predict_says(door) -> None:
    def dropping(c, u, _, memory):
        return c + (0.85 if memory["run"] >= 5 else 1.0) * u

    recording = plants.door_recording(plants.runs_of(dropping, 10, 50, 0))
    found = calibrate(door, recording)
    runs = predict_recording(found.automaton, recording)
    (written,) = found.written
    assert written.one_step == rmse([run.one_step.configuration for run in runs])
    assert written.rollout == rmse([run.rollout.configuration for run in runs])
    (effect,) = found.effects
    assert effect.effect.since is not None
    assert written.rollout == pytest.approx(found.after.rollout, rel=0.1)
    assert {"effect": "gain", "coordinate": "door", "onset": "with run 6"} in [
        dict(note.values) for note in found.notes
    ]


def test_a_model_that_refuses_runs_names_which(door, honest) -> None:
    assert refused(door, honest) == ""
    shifted = with_effect(door, Effect("guard_shift", "door", (("shift", -0.7), ("side", 1.0))))
    begun = plants.door_recording([(np.array([0.9, 0.4, 0.35, 0.3]), np.array([-0.5, -0.05, -0.05, 0.0]))])
    assert refused(door, begun) == ""
    assert "starts at" in refused(shifted, begun)  # the shut door is held at 0.5 rad


def test_a_run_may_start_where_no_demonstration_went_and_nothing_holds_the_part(door) -> None:
    shifted = with_effect(door, Effect("guard_shift", "door", (("shift", 0.7), ("side", -1.0))))
    begun = plants.door_recording([(np.array([0.2, 0.8, 0.85, 0.9]), np.array([0.6, 0.05, 0.05, 0.0]))])
    assert refused(shifted, begun) == ""


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        pytest.param(1000.0, "millimetres", marks=pytest.mark.slow),
        pytest.param(100.0, "centimetres", marks=pytest.mark.evidence),
    ],
)
def test_commands_in_other_units_are_named(door, honest, factor, unit) -> None:
    found = calibrate(door, replace(honest, action=factor * np.array(honest.action)))
    assert unit in [note.values["unit"] for note in found.notes if note.code == "gain_of_other_unit"]


@pytest.mark.evidence
def test_a_weak_motor_is_no_unit(door) -> None:
    found = calibrate(door, plants.door_recording(plants.runs_of(plants.weak, 6, 50, 0)))
    assert "gain_of_other_unit" not in codes_of(found.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("runs", "rows", "is_left_out"), [pytest.param(6, 50, True, marks=pytest.mark.evidence), (3, 80, False)]
)
def test_what_the_model_refused_before_is_not_laid_to_an_effect(door, runs, rows, is_left_out) -> None:
    begun = (np.array([1.5, 1.1, 1.06, 1.02, 1.0, 0.98]), np.array([-0.4, -0.05, -0.05, -0.05, -0.03, 0.0]))
    recording = plants.door_recording([*plants.runs_of(plants.short_steps, runs, rows, 0), begun])
    assert refused(door, recording)
    found = calibrate(door, recording)
    added = [effect.effect.name for effect in found.effects if effect.is_added]
    assert added == ["gain"]
    assert ("runs_refused" in codes_of(found.notes)) is not is_left_out
    assert (found.written == ()) is not is_left_out
    assert found.verdict != "explained"
