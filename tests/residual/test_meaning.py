"""Commands that mean places are told from those that mean displacements; the servos are written here."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest
from extras import requires

from micah_plan.automaton.tracks import tracks
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.candidates import candidates
from micah_plan.residual.competition import Competition
from micah_plan.residual.coordinate_data import coordinate_data_of
from micah_plan.residual.prediction import predict_recording, rmse
from micah_plan.residual.responses import follows


def servo_run(rows, seed, *, share, momentum=0.0, late=0, short=0.0, noise=0.002):
    """(z, u) of an arm that is told places, held for a while each; u leads from the measured angle to the place."""
    rng = np.random.default_rng(seed)
    place = np.repeat(rng.uniform(0.3, 0.9, rows), rng.integers(8, 30, rows))[:rows]
    c, speed, z, u = 0.6, 0.0, np.zeros(rows), np.zeros(rows)
    for k in range(rows):
        z[k] = c + noise * rng.standard_normal()
        u[k] = place[k] - z[k]
        away = (place[k - late] if k >= late else z[0]) - c
        speed = momentum * speed + share * np.sign(away) * max(abs(away) - short, 0.0)
        c += speed
    return z, u


@pytest.mark.parametrize(
    "servo",
    [
        pytest.param({"share": 0.3}, marks=pytest.mark.slow),
        pytest.param({"share": 0.25, "momentum": 0.5, "late": 1}, marks=pytest.mark.evidence),
        pytest.param({"share": 0.05}, marks=pytest.mark.evidence),
        pytest.param({"share": 0.3, "late": 2}, marks=pytest.mark.evidence),
        pytest.param({"share": 0.3, "short": 0.06}, marks=pytest.mark.evidence),
    ],
    ids=str,
)
def test_a_servo_is_identified_by_its_places_and_predicts_another_run(door, servo) -> None:
    found = calibrate(door, plants.door_recording([servo_run(300, 1, **servo)]))
    assert found.effects[0].effect.name == "follow"
    known = dict(found.effects[0].effect.parameters)
    assert known["share"] == pytest.approx(servo["share"], rel=0.1)
    assert known["momentum"] == pytest.approx(servo.get("momentum", 0.0), abs=0.05)
    assert known["delay"] == pytest.approx(servo.get("late", 0), abs=0.15)
    # Without a momentum, friction does what a dead zone does.
    short = known["width"] + (0.0 if known["momentum"] else known.get("friction", 0.0) / known["share"])
    assert short == pytest.approx(servo.get("short", 0.0), abs=0.01)
    other = plants.door_recording([servo_run(300, 2, **servo)])
    before, after = (predict_recording(model, other)[0].rollout.configuration for model in (door, found.automaton))
    assert np.sqrt(np.mean(after**2)) < min(0.004, 0.2 * np.sqrt(np.mean(before**2)))


def test_places_predict_better_than_displacements(door) -> None:
    (data,) = coordinate_data_of(door, tracks(door, plants.door_recording([servo_run(300, 1, share=0.3)])))
    best, *others = Competition(data).alone([*candidates(data), *follows(data)])
    assert best.names == ("follow",)
    displaced = next(model for model in others if model.names != best.names)
    assert best.over(displaced)[0] > 10.0


@pytest.mark.parametrize(
    ("noise", "disturbance"),
    [
        pytest.param(0.001, 0.004, marks=pytest.mark.slow),
        pytest.param(0.003, 0.001, marks=pytest.mark.evidence),
    ],
)
def test_displacements_that_fall_short_are_no_places(door, noise, disturbance) -> None:
    """Also where what disturbs the part is larger than what blurs its measurement, and roll-outs of places peek."""
    runs = plants.runs_of(plants.short_steps, 8, 40, 3, noise=noise, disturbance=disturbance)
    found = calibrate(door, plants.door_recording(runs))
    assert [one.effect.name for one in found.effects] == ["gain"]


@requires("sim")
@pytest.mark.evidence
def test_places_are_seen_where_a_motor_swings_beyond_the_range() -> None:
    """Alone places then predict single steps worse than two effects on displacements, which roll out far worse."""
    from position_control import KINDS, model, recording_of, simulated

    rng = np.random.default_rng([1, sum(map(ord, "second order")), 5])
    runs = [simulated(KINDS["second order"], 5.0, rng) for _ in range(8)]
    found = calibrate(model(slides=False), recording_of(runs[:4], slides=False, rate=5.0))
    assert found.effects[0].effect.name == "follow"
    unseen = predict_recording(found.automaton, recording_of(runs[4:], slides=False, rate=5.0))
    assert rmse([run.rollout.configuration for run in unseen]) < 0.03


@pytest.mark.parametrize("push", [0.0, 0.02])
def test_commands_that_are_all_the_same_are_no_places(door, push) -> None:
    """A place is the measured one then, or as far beside it in every row: following it says nothing of commands."""
    moved = [(z, np.full_like(u, push)) for z, u in plants.runs_of(plants.honest, 6, 40, 0)]
    found = calibrate(door, plants.door_recording(moved))
    assert "follow" not in [one.effect.name for one in found.effects]


def test_a_locked_part_that_is_seen_without_noise_is_calibrated(door) -> None:
    held = [(np.full(20, 0.4), np.full(20, 0.02))] * 5
    found = calibrate(door, plants.door_recording(held))
    assert found.effects
    assert found.after.rollout < 0.01 * found.before.rollout
