"""What the controller believed against what was measured: its sensor's scale and offset, and who read what."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student_t

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.effects.add import is_possible, with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import prismatic
from micah_plan.automaton.tracks import tracks
from micah_plan.errors import InputError
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.likelihood import LEAST_EVIDENCE, student_t_log_density
from micah_plan.residual.prediction import estimate_errors, predict_recording
from micah_plan.residual.sensor_bias import _density, estimator_bias_findings


@pytest.fixture(scope="module")
def drawer():
    slide = prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    segment = Segment(slide, 0, 0, 9, -2.0, 2.0, (-2.0, 2.0), 0.001, 0.001, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "part", (segment,)),)))


def served(read, *, runs=6, rows=14, seed=0, by=None, noise=0.0005):
    """A drawer under visual servoing to drawn targets: commands lead from the belief, which is the reading.

    Args:
        read: configuration to reading of the controller's tracker.
        by: what is logged as the position, of configuration and reading; the configuration (a ruler) if None.
    """
    rng = np.random.default_rng(seed)
    lines = []
    for run in range(1, runs + 1):
        c, target = rng.uniform(-0.1, 0.4, 2)
        for k in range(rows):
            belief = read(c) + noise * rng.standard_normal()
            asked = float(np.clip(target - belief, -0.1, 0.1)) if k < rows - 1 else np.nan
            shown = c if by is None else by(c, belief)
            lines.append((run, 0.1 * k, shown + noise * rng.standard_normal() * (by is None), asked, belief))
            c += 0.0 if np.isnan(asked) else asked
    run, time, x, action, belief = np.array(lines).T
    place, zero = np.stack([x, 0 * x, 0 * x], axis=1), ("0",) * len(x)
    told = {"estimate_x": tuple(f"{value:.9g}" for value in belief), "estimate_y": zero, "estimate_z": zero}
    asked = np.stack([action, 0 * action, 0 * action], axis=1)
    return Recording(time=time, position=place, action=asked, run=run.astype(int), has_run=True, extra=told)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("read", "expected"),
    [
        (lambda c: 0.93 * c, {"sensor_scale": 0.93}),
        (lambda c: c + 0.02, {"sensor_offset": 0.02}),
        (lambda c: 1.1 * (c - 0.03), {"sensor_scale": 1.1, "sensor_offset": -0.03}),
    ],
)
def test_a_tracker_that_is_off_is_found_against_a_ruler(drawer, read, expected) -> None:
    found = calibrate(drawer, served(read))
    sensors = {one.effect.name: one.effect.values[0] for one in found.effects if one.effect.name.startswith("sensor")}
    assert sensors.keys() == expected.keys()
    for name, value in expected.items():
        assert sensors[name] == pytest.approx(value, abs=0.004)
    other = served(read, seed=1)
    before, after = (predict_recording(model, other) for model in (drawer, found.automaton))
    assert estimate_errors(after)[1] < 0.0012 < 0.2 * estimate_errors(before)[1]
    assert np.mean([abs(run.rollout.configuration[-1, 0]) for run in after]) < 0.0015


@pytest.mark.slow
def test_a_belief_that_agrees_is_no_evidence_on_the_sensor(drawer) -> None:
    for recording in (served(lambda c: c), served(lambda c: 0.93 * c, by=lambda _, belief: belief)):
        found = calibrate(drawer, recording)
        assert not [one for one in found.effects if one.effect.name.startswith("sensor")]


@pytest.mark.parametrize("share", [0.14, 0.0])
def test_a_part_that_hardly_moves_is_no_sensor_that_reads_a_multiple(drawer, share) -> None:
    """The controller believes that it moved; the scale that would explain it is beyond what a sensor may have."""
    stuck = served(lambda c: c, by=lambda _, belief: share * belief)
    found = estimator_bias_findings(drawer, tracks(drawer, stuck))
    assert all(is_possible(one.effect) for one in found)
    assert "sensor_scale" not in [one.effect.name for one in found]
    assert estimate_errors(predict_recording(drawer, stuck))[1] > 0.05


def test_a_model_with_the_sensor_reads_logs_of_its_own_tracker_and_those_of_a_ruler(drawer) -> None:
    """Its own: poses are readings, the belief is corrected. A ruler's: poses are true, the belief was not corrected."""
    model = with_effect(drawer, Effect("sensor_scale", "part", (("scale", 0.93),)))
    ruler = tracks(model, served(lambda c: 0.93 * c))
    own = tracks(model, served(lambda c: c, by=lambda c, _: 0.93 * c))
    assert [one.is_outside for one in (*ruler, *own)] == [True] * 6 + [False] * 6
    for one in (*ruler, *own):
        np.testing.assert_allclose(one.believed, one.x, atol=0.004)


def test_estimates_may_be_missing_in_places_but_must_be_numbers(drawer) -> None:
    recording = served(lambda c: c)
    texts = ("", *recording.extra["estimate_x"][1:])
    (first, *_) = predict_recording(
        drawer, recording.__class__(**{**vars_of(recording), "extra": with_x(recording, texts)})
    )
    assert np.isnan(first.believed[0, 0])
    assert np.isfinite(first.believed[1:]).all()
    wrong = recording.__class__(**{**vars_of(recording), "extra": with_x(recording, ("far", *texts[1:]))})
    with pytest.raises(InputError, match="estimate_x, row 1: expected a number"):
        predict_recording(drawer, wrong)


def vars_of(recording):
    names = ("time", "position", "quaternion", "action", "run", "has_run")
    return {name: getattr(recording, name) for name in names}


def with_x(recording, texts):
    return {**recording.extra, "estimate_x": texts}


def test_rests_of_a_noisy_measurement_that_agree_by_chance_show_no_sensor() -> None:
    """Five rests are few: the scatter within each says how far their agreement can be meant."""
    believed = np.array([-1.0, 0.2, 0.9, 1.6, 2.4])
    measured = 1.5 * believed + 0.3 + 0.01 * np.array([1.0, -1.0, 1.0, -1.0, 1.0])
    for scatter, is_told in ((0.01, True), (1.0, False)):
        rests = np.stack([measured, believed, 0.0 * believed, np.full(5, scatter**2)], axis=1)
        gain = _density(rests, ("sensor_scale", "sensor_offset")) - _density(rests, ())
        assert (gain > LEAST_EVIDENCE) is is_told


@pytest.mark.parametrize("freedom", [1, 2, 3.5, 30, 1e4])
def test_the_density_of_student_is_that_of_scipy(freedom: float) -> None:
    x = np.array([[-40.0, -1.0, 0.0], [1e-9, 2.5, 1e6]])
    np.testing.assert_allclose(student_t_log_density(x, freedom), student_t.logpdf(x, freedom), rtol=1e-9, atol=1e-9)
