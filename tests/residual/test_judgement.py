"""The noise floor and the verdict of predictions, against what was planted."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.judgement import judge
from micah_plan.residual.prediction import predict_recording, rmse
from micah_plan.residual.residual_test import Circumstances, lagged_commands, whiteness_test

NOISE, MOVED = 0.004, 0.001


def judged(door, plant, *, runs=10, rows=50, seed=0, goals=None):
    moved = plants.runs_of(plant, runs, rows, seed, noise=NOISE, disturbance=MOVED, goals=goals)
    recording = plants.door_recording(moved, across=plants.RADIUS * NOISE, seed=seed)
    predicted = predict_recording(door, recording)
    return judge(door, recording, predicted), predicted


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("creeping", "sprung", "late")]


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["honest", "short_steps", "rippled", *SLOW])
def test_the_floor_is_the_noise_for_any_missing_effect(door, plant) -> None:
    found, predicted = judged(door, getattr(plants, plant))
    floor = np.sqrt(2 * NOISE**2 + MOVED**2)
    assert found.one_step.configuration == pytest.approx(floor, rel=0.12)
    # Across the hinge each pose is measured once, along it an error holds two measurements.
    across = plants.RADIUS * np.sqrt(floor**2 + 2 * NOISE**2)
    assert found.one_step.position == pytest.approx(across, rel=0.12)
    assert found.is_noise == (plant == "honest"), found.sentence
    if plant == "honest":
        assert rmse([run.one_step.position for run in predicted]) == pytest.approx(found.one_step.position, rel=0.05)
        assert rmse([run.rollout.configuration for run in predicted]) < 1.5 * found.rollout.configuration


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "what"),
    [
        ("late", "earlier commands"),
        pytest.param("short_steps", "the command", marks=pytest.mark.evidence),
        pytest.param("creeping", "a constant", marks=pytest.mark.evidence),
    ],
)
def test_words_name_what_errors_depend_on(door, plant, what) -> None:
    found, _ = judged(door, getattr(plants, plant))
    assert what in [group for _, group, _ in found.follows]
    assert what in found.sentence


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 8), marks=pytest.mark.evidence)], ids=len)
def test_honest_motion_is_rarely_called_more_than_noise(door, seeds) -> None:
    assert all(judged(door, plants.honest, runs=4, rows=40, seed=seed)[0].is_noise for seed in seeds)


def led_by_readings(rng, rows=18):
    """A controller that goes to where it reads the end: its commands follow the noise of what it read."""
    c, z, u = 0.3, [], []
    for _ in range(rows):
        z.append(c + 0.01 * rng.standard_normal())
        u.append(float(np.clip(plants.LENGTH - z[-1], -0.08, 0.08)))
        c = float(np.clip(c + u[-1] + 0.002 * rng.standard_normal(), 0.0, plants.LENGTH))
    return np.array(z), np.array(u)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(one, marks=pytest.mark.evidence) for one in (1, 2))])
def test_prediction_and_calibration_agree_on_what_is_noise_in_a_closed_loop(door, seed) -> None:
    rng = np.random.default_rng(seed)
    recording = plants.door_recording([led_by_readings(rng) for _ in range(20)])
    found = judge(door, recording, predict_recording(door, recording))
    assert found.is_noise, found.sentence
    assert calibrate(door, recording).verdict == "none"


def test_few_rows_give_no_floor(door) -> None:
    found, _ = judged(door, plants.short_steps, runs=2, rows=5)
    assert found.one_step is None
    assert found.is_noise is None
    assert "too few rows" in found.sentence


@pytest.mark.slow
def test_mode_changes_are_paired_and_timed(door) -> None:
    found, _ = judged(door, plants.honest, goals=(-1.0, 2.0))
    paired = [c for c in found.changes if c.measured is not None and c.predicted is not None]
    assert {c.mode for c in paired} == {"revolute", "rigid"}
    assert np.median([abs(c.measured - c.predicted) for c in paired]) <= 2 * plants.PERIOD


def test_a_regression_removes_what_depends_on_the_circumstances_alone() -> None:
    rng = np.random.default_rng(1)
    place, v = rng.uniform(0, 1, 600), rng.uniform(-0.05, 0.05, 600)
    under = Circumstances(place, lagged_commands(v), 0.1 * np.arange(600.0), np.linspace(0, 1, 600))
    noise = 0.002 * rng.standard_normal(600)
    pure = whiteness_test(noise[:, None], under)
    assert pure.probability > 1e-4
    assert pure.floor[0] == pytest.approx(0.002, rel=0.1)
    bent = whiteness_test((noise + 0.01 * np.sin(3 * place))[:, None], under)
    assert bent.floor[0] == pytest.approx(0.002, rel=0.1)
    assert bent.follows[0][0] in ("the configuration", "a constant")
    assert whiteness_test(noise[:5, None], under) is None
