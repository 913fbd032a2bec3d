"""What effects are worth beside two state-space models and their evidence (`tests/reference/model_comparison.py`)."""

from __future__ import annotations

import planted_effects as plants
import pytest
from reference.model_comparison import AS_TOLD, BIAS, GAIN, fitted

from micah_plan.residual.calibrate import calibrate

# Away from both ends: the reference knows none.
MIDDLE = (0.3, 0.7)


def weak(c, u, _row, _memory):
    return c + 0.8 * u


def pushed(c, u, _row, _memory):
    return c + u - 0.004


@pytest.mark.parametrize(
    ("plant", "name", "model"), [(weak, "gain", GAIN), (pushed, "bias", BIAS)], ids=["gain", "bias"]
)
def test_an_effect_and_its_evidence_are_those_of_two_kalman_filters(door, plant, name, model) -> None:
    runs = plants.runs_of(plant, 6, 40, 1, goals=MIDDLE)
    (effect,) = calibrate(door, plants.door_recording(runs)).effects
    theirs, nothing = fitted(model, runs, 0.003), fitted(AS_TOLD, runs, 0.003)
    assert effect.effect.name == name
    assert effect.effect.values[0] == pytest.approx(theirs.theta[0], abs=0.5 * theirs.std[0])
    # Priors differ, and noise that ours may have beside theirs.
    assert effect.evidence == pytest.approx(theirs.evidence - nothing.evidence, rel=0.15)


def test_nothing_is_worth_less_than_it_costs(door) -> None:
    runs = plants.runs_of(plants.honest, 6, 40, 1, goals=MIDDLE)
    assert calibrate(door, plants.door_recording(runs)).verdict == "none"
    worth = fitted(GAIN, runs, 0.003).evidence - fitted(AS_TOLD, runs, 0.003).evidence
    assert worth < 0.0
