"""An end at which the part clings though no mode of the model holds it there."""

from __future__ import annotations

import planted_effects as plants
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.transition import step
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.examined import examined

SWING = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
SLIDE = prismatic((0.0, 1.0, 0.0), (0.1, 0.0, 0.0))


def edge(name, joint, end):
    segment = Segment(joint, 0, 0, 9, 0.0, end, (0.0, end), 0.001, 0.003, 0.0, 1.0)
    return KinematicEdge(BASE, name, (segment,))


@pytest.fixture
def plain():
    """A door that no mode holds anywhere."""
    return build_automaton(KinematicGraph((edge("door", SWING, plants.LENGTH),)))


def clinging(c, u, _, memory):
    """Shut, it opens by a pull of more than 30 mrad only."""
    memory["held"] = (memory.get("held", False) or c <= 0.0) and u <= 0.03
    return 0.0 if memory["held"] else c + u


def test_a_held_end_is_left_by_a_larger_command_only_and_entered_as_before(plain):
    held = with_effect(plain, Effect("guard_hysteresis", "door", (("width", 0.03),)))
    check_automaton(held)
    shut = step(held, "revolute", [0.02], [-0.05])
    assert shut.x == pytest.approx([0.0], abs=1e-9)
    assert shut.mode != "revolute"
    stays = step(held, shut.mode, shut.x, [0.02])
    assert stays.x == pytest.approx([0.0], abs=1e-9)
    away = step(held, stays.mode, stays.x, [0.04])
    assert (away.mode, away.x[0]) == ("revolute", pytest.approx(0.04))
    # The other end of the same coordinate, too; in between nothing is changed.
    wide = step(held, "revolute", [plants.LENGTH - 0.01], [0.05])
    assert step(held, wide.mode, wide.x, [-0.02]).x == pytest.approx([plants.LENGTH])
    assert step(held, "revolute", [0.5], [0.02]).x == pytest.approx([0.52])


def test_another_coordinate_goes_on_while_one_is_held():
    both = build_automaton(KinematicGraph((edge("door", SWING, 1.0), edge("drawer", SLIDE, 0.3))))
    held = with_effect(both, Effect("guard_hysteresis", "door", (("width", 0.03),)))
    check_automaton(held)
    shut = step(held, both.mode_names[0], [0.02, 0.1], [-0.05, 0.05])
    assert shut.x == pytest.approx([0.0, 0.15])
    on = step(held, shut.mode, shut.x, [0.01, 0.3])
    assert on.x == pytest.approx([0.0, 0.3])
    assert step(held, on.mode, on.x, [0.2, -0.1]).x == pytest.approx([0.2, 0.2])


def recorded(plant):
    return plants.door_recording(plants.runs_of(plant, 6, 60, 4, noise=0.004, goals=(-0.3, 0.4)), across=0.001)


@pytest.mark.slow
def test_a_model_that_clings_leaves_noise_of_a_door_that_does(plain):
    held = with_effect(plain, Effect("guard_hysteresis", "door", (("width", 0.03),)))
    assert examined(held, recorded(clinging)).is_noise
    assert examined(plain, recorded(clinging)).is_noise is False


@pytest.mark.slow
def test_a_door_that_clings_when_shut_is_separated_from_one_that_does_not(plain):
    found = calibrate(plain, recorded(clinging))
    first = found.effects[0]
    assert found.verdict == "explained"
    assert first.effect.name == "guard_hysteresis"
    assert first.effect.values[0] == pytest.approx(0.03, abs=0.002)
    assert found.after.rollout < found.before.rollout
    assert calibrate(plain, recorded(plants.honest)).verdict == "none"
