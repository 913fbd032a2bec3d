"""Servos that are told places and have a limit: of pull, of acceleration and speed; and delays that end within a row.

Each is simulated in a thousand instants of a row, with noise of the reading alone.
"""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.documents.model import model_text, usable_model
from micah_plan.recording.commands import with_commands
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.examined import examined
from micah_plan.residual.prediction import predict_recording, rmse

_INSTANTS, _NOISE = 100, 0.0005
_NEUTRAL = (("offset", 0.0), ("gain", 1.0), ("delay", 0.0), ("momentum", 0.0), ("width", 0.0))


def servo_run(rows, seed, law, delay=0.0, noise=_NOISE):
    """(z, u) of a run: `law`(way, speed) is by how much the speed, per row, changes in an instant."""
    rng = np.random.default_rng(seed)
    c = goal = float(rng.uniform(0.3, 0.9))
    goals, z, speed = [goal] * 40, np.zeros(rows), 0.0
    for k in range(rows):
        z[k] = c + noise * rng.standard_normal()
        if k > 1 and rng.random() < 0.04:
            goal = float(rng.uniform(0.1, 1.1))
        goals.append(goal)
        for instant in range(_INSTANTS):
            told = goals[len(goals) - 1 + int(np.floor((instant + 0.5) / _INSTANTS - delay))]
            speed += law(told - c, speed)
            c += speed / _INSTANTS
    return z, np.array(goals[40:]) - z


def told(law, delay, seeds):
    runs = [servo_run(200, seed, law, delay) for seed in seeds]
    return with_commands(plants.door_recording(runs), "position")


def at_once(most, share=200.0):
    """No inertia: as fast as the way is long, at most so fast."""
    return lambda way, speed: float(np.clip(share * way, -most, most)) - speed


def torque(most):
    """A spring of limited force and a damper."""
    return lambda way, speed: (float(np.clip(0.12 * way, -most, most)) - 0.4 * speed) / _INSTANTS


def rubbing(friction):
    """The same, limited by nothing, with friction: it brakes what moves, and holds what rests."""

    def law(way, speed):
        free = speed + (0.12 * way - 0.4 * speed) / _INSTANTS
        return float(np.sign(free) * max(abs(free) - friction / _INSTANTS, 0.0)) - speed

    return law


def profile(way, speed):
    """Speeds up and brakes with 0.0025 rad per row and row, at most 0.025 rad per row, to a stop at the goal."""
    wanted = np.sign(way) * min(np.sqrt(2.0 * 0.0025 * abs(way)), 0.025)
    return float(np.clip(wanted - speed, -0.0025 / _INSTANTS, 0.0025 / _INSTANTS))


@pytest.mark.parametrize(
    ("law", "delay", "expected"),
    [
        pytest.param(at_once(0.05), 1.8, {"delay": 1.8, "pull": 0.05}, id="speed and delay"),
        pytest.param(at_once(0.03), 6.4, {"delay": 6.4, "pull": 0.03}, id="long delay", marks=pytest.mark.slow),
        pytest.param(torque(0.01), 0.0, {"pull": 0.0082, "momentum": 0.67}, id="torque", marks=pytest.mark.slow),
        pytest.param(torque(1.0), 24.3, {"delay": 24.3, "momentum": 0.67}, id="delay over many rows"),
        pytest.param(rubbing(0.004), 0.0, {"friction": 0.0033, "momentum": 0.67}, id="friction"),
        pytest.param(profile, 0.0, {"acceleration": 0.0025, "speed": 0.025}, id="profile"),
    ],
)
def test_limits_of_servos_are_found_and_roll_outs_of_unseen_runs_are_short(door, law, delay, expected) -> None:
    found = calibrate(door, told(law, delay, range(4)))
    assert [effect.effect.name for effect in found.effects] == ["follow"]
    known = {name: value for name, value, *_ in found.effects[0].rows}
    for name, value in expected.items():
        assert known[name] == pytest.approx(value, rel=0.1), name
    fresh = told(law, delay, range(10, 13))
    before, after = (
        rmse([run.rollout.configuration for run in predict_recording(model, fresh)])
        for model in (with_effect(door, Effect("follow", "door", (("share", 1.0), *_NEUTRAL))), found.automaton)
    )
    assert after < 0.1 * before
    assert usable_model(model_text(found.automaton).encode(), "model") == found.automaton


def test_a_part_that_rests_in_digits_has_their_precision(door) -> None:
    """Most rows repeat the one before: a model that gives up all others would else be surer of these than a true one.

    Between rests it moves fast, so that hardly any two of its readings are one digit apart.
    """
    runs = [servo_run(150, seed, at_once(0.06), 1.8, noise=0.0) for seed in range(4)]
    places = [z + u for z, u in runs]
    read = [np.round(z / 0.0005) * 0.0005 for z, _ in runs]
    recording = plants.door_recording([(z, place - z) for z, place in zip(read, places, strict=True)])
    (model,) = examined(door, with_commands(recording, "position")).models
    of_a_digit = 0.0005 / np.sqrt(12.0)
    assert 0.49 * of_a_digit < model.data.resolution < 1.01 * of_a_digit
    assert np.exp(model.nominal.fit.noise[0]) >= 0.99 * model.data.resolution
    found = calibrate(door, with_commands(recording, "position"))
    assert [(effect.effect.name, effect.is_added) for effect in found.effects] == [("follow", True)]


def test_a_servo_without_limits_has_none_in_its_file(door) -> None:
    found = calibrate(door, told(lambda way, speed: (0.12 * way - 0.4 * speed) / _INSTANTS, 0.0, range(4)))
    (effect,) = found.effects
    assert effect.effect.name == "follow"
    assert {name for name, *_ in effect.rows} == {"share", *(name for name, _ in _NEUTRAL)}
    assert "pull" not in model_text(found.automaton)
    assert "inf" not in model_text(found.automaton)
