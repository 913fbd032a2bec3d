"""Differences of models: nothing where they are the same, and every change at its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.documents.model import load_model
from micah_plan.documents.model_difference import differences

MODELS = Path(__file__).resolve().parents[2] / "models"


@pytest.fixture
def microwave():
    return load_model(MODELS / "microwave.yaml")


@pytest.mark.parametrize("name", ["microwave", "drawer"])
def test_a_model_does_not_differ_from_itself(name) -> None:
    assert differences(load_model(MODELS / f"{name}.yaml"), load_model(MODELS / f"{name}.yaml")) == ()


def test_an_effect_that_was_added_is_the_only_difference(microwave) -> None:
    (found,) = differences(microwave, with_effect(microwave, Effect("gain", "door", (("gain", 0.8),))))
    assert found.place == "effects"
    assert found.before is None
    assert str(found) == "+ effects: [name gain, coordinate door, parameters gain 0.8]"


def test_a_shifted_end_shows_in_guard_and_range_and_both_ways_round(microwave) -> None:
    shifted = with_effect(microwave, Effect("guard_shift", "door", (("shift", -0.05), ("side", 1.0))))
    found = {difference.place: difference for difference in differences(microwave, shifted)}
    assert "modes.rigid.pins.door.value" in found
    pin = found["modes.rigid.pins.door.value"]
    assert pin.after - pin.before == pytest.approx(-0.05)
    assert any(place.startswith("transitions") for place in found)
    back = {difference.place: difference for difference in differences(shifted, microwave)}
    assert set(back) == set(found)
    assert all((back[place].before, back[place].after) == (d.after, d.before) for place, d in found.items())


def test_two_effects_of_one_name_are_separated(microwave) -> None:
    one = with_effect(microwave, Effect("gain", "door", (("gain", 0.8),), modes=("revolute",)))
    two = with_effect(one, Effect("gain", "door", (("gain", 0.5),)))
    (found,) = differences(one, two)
    assert found.place == "effects.gain (2)"
    assert found.before is None
