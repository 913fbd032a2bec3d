"""Hinges that go further than half a turn: their runs are predicted and calibrated as those of any other."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import revolute
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import predict_recording, rmse

NOISE = 0.003


def turning(end):
    """Turns from 0 to `end` [rad] about a vertical hinge."""
    joint = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
    segment = Segment(joint, 0, 0, 9, 0.0, end, (0.0, end), 0.001, NOISE, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "lid", (segment,)),)))


def runs(end, gain, count=6, rows=60):
    """Runs from 0 to `end` and back, of which a command moves a share."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(count):
        step = end / 27 * rng.uniform(0.8, 1.2, rows)
        u = np.where(np.arange(rows) < rows // 2, step, -step)
        c, z = 0.02 * end, np.zeros(rows)
        for k in range(rows):
            z[k] = c + NOISE * rng.standard_normal()
            c = float(np.clip(c + gain * u[k], 0.0, end))
        found.append((z, u))
    return plants.door_recording(found)


@pytest.mark.parametrize("end", [3.6, 5.5, 15.0])
def test_a_true_model_leaves_noise(end) -> None:
    predicted = predict_recording(turning(end), runs(end, 1.0))
    assert rmse([run.one_step.configuration for run in predicted]) < 2.0 * NOISE
    assert max(np.ptp(run.x) for run in predicted) > 0.9 * end


@pytest.mark.slow
def test_an_effect_is_sized_beyond_half_a_turn() -> None:
    found = calibrate(turning(5.5), runs(5.5, 0.8))
    (effect,) = found.effects
    assert effect.effect.name == "gain"
    assert effect.effect.values[0] == pytest.approx(0.8, abs=0.01)
    assert found.after.rollout < 0.1 * found.before.rollout
