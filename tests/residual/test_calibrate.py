"""Calibration on motion with something in it that nobody declared; the simulators share no code with the library."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.errors import InputError
from micah_plan.message import codes_of
from micah_plan.residual import calibration as calibration_module
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import predict_recording, rmse
from micah_plan.view.calibration_page import calibration_page
from micah_plan.view.prediction_page import calibration_scene


def found_in(door, plant, *, runs=6, rows=25, seed=3):
    recording = plants.door_recording(plants.runs_of(plant, runs, rows, seed))
    return calibrate(door, recording), recording


def test_nothing_is_found_where_the_model_is_right(door) -> None:
    found, _ = found_in(door, plants.honest)
    assert found.verdict == "none"
    assert found.effects == ()
    assert found.automaton == door
    assert found.after == found.before
    assert found.before.one_step == pytest.approx(found.noise_floor, rel=0.15)
    assert codes_of([found.experiment]) == ["larger_commands"]
    scene = calibration_scene(found, "door")
    assert scene is not None
    assert "rad before" in scene
    assert "rad after" not in scene, "there is one model"


def test_a_gain_is_named_sized_and_added(door) -> None:
    found, recording = found_in(door, plants.short_steps)
    assert found.verdict == "explained"
    (effect,) = found.effects
    assert effect.effect.name == "gain"
    (low, high), value = effect.interval[0], effect.effect.values[0]
    assert low < value < high
    assert value == pytest.approx(0.8, abs=0.02)
    assert found.after.one_step < 1.2 * found.noise_floor < 0.8 * found.before.one_step
    assert found.after.rollout < 0.25 * found.before.rollout
    before, after = (
        rmse([run.rollout.configuration for run in predict_recording(model, recording)])
        for model in (door, found.automaton)
    )
    assert after < 0.25 * before
    page, scene = re.subn(r"<iframe.*?</iframe>", "", calibration_page(found, "door"), flags=re.DOTALL)
    assert scene == 1
    assert "explained" in page
    assert page.count('<div class="chart"') == 14
    assert "gain (gain 0." in page  # opens with what was found, and what it is worth
    assert "Errors on rows that no fit saw: roll-outs from " in page
    named = ('http-equiv="Content-Security-Policy"', "https://github.com/leeoniya/uPlot (v1.6.32)")
    assert "http" not in page.replace(named[0], "").replace(named[1], "")


@pytest.mark.slow
def test_a_calibration_plays_the_runs_before_and_after_unless_the_new_model_refuses_them(
    door, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, recording = found_in(door, plants.short_steps)
    scene = calibration_scene(found, "door")
    assert scene is not None
    worst = max(predict_recording(door, recording), key=lambda run: float(np.mean(run.rollout.configuration**2))).run
    assert f"run {worst} after" in scene
    assert re.search(r"door = [\d.]+ rad measured, [\d.]+ rad before, [\d.]+ rad after", scene)
    monkeypatch.setattr(
        calibration_module, "refused", lambda model, _: "" if model is door else "a run starts elsewhere"
    )
    again = replace(found)
    assert calibration_scene(again, "door") is None
    assert again.pose_errors == ()
    assert "explained" in calibration_page(again, "door")


@pytest.mark.slow
def test_a_delay_is_reported_in_steps_and_seconds(door) -> None:
    found, recording = found_in(door, plants.late)
    assert [effect.effect.name for effect in found.effects] == ["delay"]
    assert found.effects[0].effect.values[0] == pytest.approx(2.0, abs=0.05)
    assert dict(found.effects[0].derived)["seconds"] == pytest.approx(0.2, abs=0.005)
    after = rmse([run.one_step.configuration for run in predict_recording(found.automaton, recording)])
    assert after < 1.2 * found.noise_floor


def test_another_object_or_no_actions_is_refused(door) -> None:
    recording = plants.door_recording(plants.runs_of(plants.honest, 2, 20, 0))
    without = type(recording)(time=recording.time, position=recording.position, run=recording.run, has_run=True)
    with pytest.raises(InputError, match="expected actions, found no columns ax, ay, az"):
        calibrate(door, without)
    elsewhere = type(recording)(
        time=recording.time,
        position=recording.position + np.array([0.5, 0.0, 0.0]),
        action=recording.action,
        run=recording.run,
        has_run=True,
    )
    with pytest.raises(InputError, match=r"do not fit the model: they are .* m+ off its joints"):
        calibrate(door, elsewhere)


@pytest.mark.slow
def test_ten_rows_give_no_confident_answer(door) -> None:
    found, _ = found_in(door, plants.honest, runs=1, rows=10)
    assert found.verdict == "none"
    assert "one_run" in codes_of(found.notes)
    assert "detection_limit" in codes_of(found.notes)


@pytest.mark.slow
def test_perfect_measurements_are_no_trouble(door) -> None:
    recording = plants.door_recording(plants.runs_of(plants.short_steps, 4, 15, 1, noise=0.0, disturbance=0.0))
    found = calibrate(door, recording)
    assert found.verdict == "explained"
    assert found.effects[0].effect.values[0] == pytest.approx(0.8, abs=1e-4)


@pytest.mark.slow
def test_the_same_recording_gives_the_same_answer(door) -> None:
    first, _ = found_in(door, plants.honest, runs=4, rows=25)
    second, _ = found_in(door, plants.honest, runs=4, rows=25)
    assert first.before == second.before
    assert first.traces[0].ranking == second.traces[0].ranking


LIBRARY = {
    "short_steps": ("gain",),
    "late": ("delay",),
    "sticky": ("dead_zone",),
    "sprung": ("spring", "gravity"),
    "loose": ("backlash",),
    "slow": ("lag",),
    "ramping": ("ramp",),
    "weak": ("saturation",),
    "creeping": ("bias",),
    "magnetic": ("latch",),
    "blocked": ("limit",),
    "stretched": ("sensor_scale",),
    "worn_half_way": ("gain",),
    "one_sided": ("direction_gain",),
}
# One of each layer of a model, and one that comes later; the others are evidence.
BLOCKING = ("late", "stretched", "worn_half_way")


@pytest.mark.parametrize(
    "plant",
    [pytest.param(p, marks=pytest.mark.slow if p in BLOCKING else pytest.mark.evidence) for p in LIBRARY],
)
def test_effects_of_the_library_are_named_first(door, plant) -> None:
    found, _ = found_in(door, getattr(plants, plant), runs=10, rows=50, seed=11)
    names = (found.effects[0].effect.name, *found.effects[0].tied) if found.effects else ()
    assert found.effects
    assert set(LIBRARY[plant]) & set(names[:1]), names
    assert found.verdict == "explained"
    assert found.after.one_step < 1.2 * found.noise_floor


@pytest.mark.parametrize(
    ("runs", "seed"),
    [
        pytest.param(10, 11, marks=pytest.mark.slow),
        pytest.param(10, 12, marks=pytest.mark.evidence),
        pytest.param(20, 11, marks=pytest.mark.evidence),
    ],
)
def test_a_threshold_that_few_rows_reach_gets_no_wrong_name(door, runs, seed) -> None:
    found, _ = found_in(door, plants.shifted, runs=runs, rows=50, seed=seed)
    if found.effects:
        assert found.verdict in ("explained", "partly")
        assert found.effects[0].effect.name in ("guard_shift", "limit")
    else:
        assert found.verdict in ("none", "partly", "unexplained")
        assert found.verdict == "unexplained" or found.automaton == door


@pytest.mark.evidence
def test_a_drift_away_from_the_ends_is_tied_with_a_bias(door) -> None:
    """Without a row at an end a reading that wanders off and a part that does look the same."""
    found, _ = found_in(door, plants.drifting, runs=10, rows=50, seed=11)
    (effect,) = found.effects
    names = (effect.effect.name, *effect.tied)
    assert {"bias", "drift"} <= set(names), names
    assert effect.experiment
    assert found.after.rollout < 0.5 * found.before.rollout


@pytest.mark.slow
def test_an_effect_outside_of_the_library_is_not_called_explained(door) -> None:
    found, _ = found_in(door, plants.rippled, runs=12, rows=50, seed=12)
    assert found.verdict in ("partly", "unexplained")
    assert found.unexplained_fraction > 0.05
    assert found.after.one_step <= found.before.one_step


@pytest.mark.slow
def test_controls_give_no_false_alarm(door) -> None:
    verdicts = [found_in(door, plants.honest, runs=5, rows=40, seed=seed)[0].verdict for seed in range(12)]
    assert verdicts == ["none"] * 12
