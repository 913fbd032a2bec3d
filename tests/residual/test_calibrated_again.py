"""The loop goes round: what a model took in is there when it is calibrated again, and is not found a second time."""

from __future__ import annotations

import planted_effects as plants
import pytest
from test_meaning import servo_run

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.message import codes_of
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.examined import examined
from micah_plan.view.calibration_page import calibration_page

PLANTS = [
    plants.short_steps,
    plants.late,
    plants.blocked,
    plants.sticky,
    plants.sprung,
    plants.loose,
    plants.slow,
    plants.weak,
    plants.magnetic,
    plants.stretched,
    plants.drifting,
    plants.heavy,
    plants.late_and_sticky,
]


# One of a joint; the others are evidence.
BLOCKING = (plants.stretched,)


def run_of(plant, seed):
    return plants.door_recording(plants.runs_of(plant, 8, 40, seed))


def test_a_model_with_the_effect_leaves_noise_and_one_without_does_not(door) -> None:
    recording = plants.door_recording(plants.runs_of(plants.short_steps, 6, 25, 4))
    weak = with_effect(door, Effect("gain", "door", (("gain", 0.8),)))
    assert examined(weak, recording).is_noise
    assert examined(door, recording).is_noise is False


@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(plant, marks=pytest.mark.slow if plant in BLOCKING else pytest.mark.evidence, id=plant.__name__)
        for plant in PLANTS
    ],
)
def test_what_the_model_has_already_is_not_found_again(door, plant) -> None:
    once = calibrate(door, run_of(plant, 3))
    again = calibrate(once.automaton, run_of(plant, 4))
    assert once.effects
    if again.verdict == "none":
        assert again.automaton == once.automaton
    else:  # the same, or what it was tied with, by numbers that the second recording tells better
        names = {name for one in once.effects for name in (one.effect.name, *one.tied)}
        assert {one.effect.name for one in again.effects} <= names
        assert len(again.automaton.effects) == len(once.automaton.effects)
        assert codes_of(again.notes)[0] == "earlier_effects_estimated_anew"
    # And "before" is what the model that was given leaves, not what it left before it learned of the effect.
    assert again.before.one_step < 1.3 * once.after.one_step


def test_a_delay_that_is_all_there_is_to_know_has_a_report(door) -> None:
    """Nothing is fitted then: no parameters, no correlations, and a page all the same."""
    late = with_effect(door, Effect("delay", "door", (("steps", 0.0),)))
    found = calibrate(late, plants.door_recording(plants.runs_of(plants.honest, 2, 13, 0)))
    assert found.effects == ()
    for trace in found.traces:
        names, matrix = trace.held_out.correlations_of(trace.chosen)
        assert names == ()
        assert matrix.shape == (0, 0)
    assert "Errors run by run" in calibration_page(found, title="door")


@pytest.mark.evidence
def test_a_servo_that_the_model_knows_is_not_put_behind_another(door) -> None:
    once, again = (plants.door_recording([servo_run(300, seed, share=0.3)]) for seed in (1, 2))
    known = calibrate(door, once).automaton
    found = calibrate(known, again)
    assert found.verdict == "none"
    assert [effect.name for effect in found.automaton.effects] == ["follow"]


@pytest.mark.slow
def test_an_onset_is_found_in_addition(door) -> None:
    """First the hand falls short; then its grip gets loose as well."""
    known = calibrate(door, run_of(plants.short_steps, 3)).automaton
    found = calibrate(known, run_of(plants.short_and_loose, 4))
    assert [one.effect.name for one in found.effects] == ["backlash"]
    assert [effect.name for effect in found.automaton.effects] == ["gain", "backlash"]
    assert found.effects[0].effect.values[0] == pytest.approx(0.06, abs=0.02)


@pytest.mark.evidence
def test_what_has_no_name_is_not_explained_by_a_second_recording(door) -> None:
    once = calibrate(door, run_of(plants.rippled, 3))
    assert once.verdict in ("partly", "unexplained")
    again = calibrate(once.automaton, run_of(plants.rippled, 4))
    assert again.verdict in ("partly", "unexplained")
    assert "residual_not_white" in codes_of(again.notes)
