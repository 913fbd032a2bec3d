"""Machines that are told how fast to go: valves and motors with a dead zone, a neutral that is off, a curve and a lag.

Each is simulated in a hundred instants of a row, with noise of the reading alone.
"""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest
from test_meaning import servo_run

from micah_plan.documents.model import model_text, usable_model
from micah_plan.recording.commands import with_commands
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import predict_recording, rmse

_INSTANTS, _NOISE = 100, 0.0003


def run_of(rows, seed, valve, lag, delay=0.0, friction=0.0):
    """(z, u) of a run: `valve`(command) is the speed that is told, per row; friction is a dead zone behind the lag."""
    rng = np.random.default_rng(seed)
    c, goal, speed = rng.uniform(0.2, 1.0), 0.6, 0.0
    most, z, u = 0.02, np.zeros(rows), np.zeros(rows)
    for k in range(rows):
        z[k] = c + _NOISE * rng.standard_normal()
        if rng.random() < 0.06:
            goal, most = rng.uniform(0.15, 1.05), rng.uniform(0.004, 0.03)
        u[k] = np.clip(0.3 * (goal - c), -most, most)
        for instant in range(_INSTANTS):
            sent = k + int(np.floor((instant + 0.5) / _INSTANTS - delay))
            told = valve(u[sent] if sent >= 0 else 0.0)
            speed = told if lag == 0.0 else speed + (told - speed) / lag / _INSTANTS
            moved = np.sign(speed) * max(abs(speed) - friction, 0.0)
            c = float(np.clip(c + moved / _INSTANTS, 0.0, plants.LENGTH))
    return z, u


def recorded(seeds, *machine):
    return with_commands(plants.door_recording([run_of(120, seed, *machine) for seed in seeds]), "displacement")


def valve(gain=1.0, neutral=0.0, width=0.0, backward=1.0, curve=0.0):
    def told(command):
        away = command - neutral
        beyond = max(abs(away) - width, 0.0)
        return np.sign(away) * gain * beyond * (1.0 + curve * beyond) * (1.0 if away > 0.0 else backward)

    return told


@pytest.mark.parametrize(
    ("given", "lag", "delay"),
    [
        pytest.param({"width": 0.003}, 2.0, 0.0, id="overlap"),
        pytest.param({"gain": 0.8, "width": 0.004, "neutral": 0.0015}, 1.5, 0.0, id="neutral", marks=pytest.mark.slow),
        pytest.param({"gain": 0.6, "width": 0.002, "curve": 60.0}, 2.0, 1.6, id="curve, late", marks=pytest.mark.slow),
        pytest.param({"width": 0.003, "backward": 0.7}, 3.0, 0.0, id="one way slower", marks=pytest.mark.slow),
        pytest.param({}, 4.0, 0.0, id="lag alone", marks=pytest.mark.slow),
    ],
)
def test_valves_and_motors_are_identified_with_their_options(door, given, lag, delay) -> None:
    found = calibrate(door, recorded(range(4), valve(**given), lag, delay))
    assert found.verdict == "explained"
    ((name, rows, is_added),) = [(one.effect.name, one.rows, one.is_added) for one in found.effects]
    assert (name, is_added) == ("drive", True)
    known = {parameter: value for parameter, value, *_ in rows}
    times = {
        f"{parameter}_seconds": known[parameter] * plants.PERIOD for parameter in ("lag", "delay") if parameter in known
    }
    assert dict(found.effects[0].derived) == pytest.approx(times)
    expected = {"gain": 1.0, "lag": lag, **given, **({"delay": delay} if delay else {})}
    assert known.keys() == expected.keys()
    for parameter, value in expected.items():
        assert known[parameter] == pytest.approx(value, rel=0.1), parameter
    fresh = recorded(range(10, 13), valve(**given), lag, delay)
    before, after = (
        rmse([run.rollout.configuration for run in predict_recording(model, fresh)])
        for model in (door, found.automaton)
    )
    assert after < 0.1 * before
    assert usable_model(model_text(found.automaton).encode(), "model") == found.automaton


@pytest.mark.parametrize(
    ("machine", "names"),
    [
        pytest.param((valve(0.8), 0.0), {"gain"}, id="gain"),
        pytest.param((valve(0.8), 0.0, 1.6), {"gain", "delay"}, id="gain and delay", marks=pytest.mark.slow),
        pytest.param((valve(width=0.004), 0.0), {"dead_zone"}, id="dead zone", marks=pytest.mark.slow),
    ],
)
def test_what_plainer_effects_do_is_no_drive(door, machine, names) -> None:
    found = calibrate(door, recorded(range(4), *machine))
    assert found.verdict == "explained"
    assert {one.effect.name for one in found.effects} == names


@pytest.mark.slow
def test_a_servo_with_unstated_commands_is_no_drive(door) -> None:
    """It moves as a drive that is told by how far it is from its place."""
    found = calibrate(door, plants.door_recording([servo_run(300, 1, share=0.1, momentum=0.7, short=0.02)]))
    assert [one.effect.name for one in found.effects] == ["follow"]
