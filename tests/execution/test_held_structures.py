"""Held objects of other structure than the stapler: what is the hand's and what the joint's follows from the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from extras import requires
from held_examples import TRAVEL, pivoting, reordered, stamp, tool

from micah_plan.automaton.joint import revolute, screw
from micah_plan.automaton.path import path
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.held import HeldPlant
from micah_plan.execution.plant import Command
from micah_plan.execution.pose import configuration

pytestmark = requires("sim")


def led(problem, inputs):
    """The plant's truths and measurements after each input."""
    plant = HeldPlant(problem)
    found = [(plant.reset(np.random.default_rng(0)), plant.truth())]
    links = len(problem.automaton.links)
    commands = [Command(np.array(u), np.zeros((links, 3)), np.zeros((links, 3))) for u in inputs]
    found += [(plant.apply(command), plant.truth()) for command in commands]
    plant.close()
    return found


def test_a_sliding_pin_is_pressed_in_by_the_table_as_the_model_says_and_latches():
    problem = stamp()
    automaton = problem.automaton
    tie = automaton.mode("line").ties[0]
    found = led(problem, [[0.0, 0.0, -0.01]] * 13 + [[0.0, 0.0, 0.02]] * 3)
    followed = [truth for _, truth in found if truth.mode == "free" and 0.002 < float(tie.value(truth.x)) < TRAVEL]
    assert len(followed) >= 2
    for truth in followed:
        # The pin stays where it was until it touches, and then follows the hand's height.
        assert truth.x[3] == pytest.approx(max(0.004, float(tie.value(truth.x))), abs=1.5e-3)
    last = found[-1][1]
    assert (last.mode, last.latched.tolist(), last.incident) == ("latched", [False, False, False, True], "")
    assert last.x[3] == pytest.approx(TRAVEL, abs=1e-3)
    assert last.x[2] > 0.1


def test_a_pin_that_is_not_pressed_home_stays_out():
    assert led(stamp(), [[0.0, 0.0, -0.01]] * 10 + [[0.0, 0.0, 0.02]] * 3)[-1][1].mode == "free"


def test_coordinates_may_come_in_any_order():
    inputs = [[0.01, -0.02, -0.01]] * 4 + [[0.0, 0.0, -0.01]] * 9
    order = (3, 2, 0, 1)
    expected = led(stamp(), inputs)
    for (measured, truth), (seen, same) in zip(led(reordered(stamp(), order), inputs), expected, strict=True):
        np.testing.assert_array_equal(truth.x, same.x[list(order)])
        np.testing.assert_array_equal(truth.latched, same.latched[list(order)])
        np.testing.assert_array_equal(truth.position, same.position)
        np.testing.assert_array_equal(measured.position, seen.position)
        assert truth.mode == same.mode


def test_a_rigid_tool_on_slanted_rails_goes_where_its_two_coordinates_say():
    problem = tool()
    found = led(problem, [[0.05, 0.02], [0.0, -0.04]])
    for (measured, truth), place in zip(found, ([0.0, 0.0], [0.05, 0.02], [0.05, -0.02]), strict=True):
        np.testing.assert_allclose(truth.x, place, atol=1e-4)
        np.testing.assert_allclose(truth.position[1], [0.6 * place[0], place[1], 0.2 + 0.8 * place[0]], atol=1e-4)
        # Parts follow the hand, and what the tracker shows is read as what is true.
        np.testing.assert_allclose(truth.position[2] - truth.position[1], [0.0, 0.0, -0.06], atol=1e-9)
        np.testing.assert_allclose(truth.position[3], truth.position[2], atol=1e-9)
        x = configuration(problem.automaton, "free", measured.position, measured.quaternion, truth.x)
        np.testing.assert_allclose(x, truth.x, atol=1e-4)
        assert not truth.latched.any()


def test_a_rigid_tool_hits_what_may_not_be_touched():
    truth = led(tool(), [[0.06, 0.0]] * 6)[-1][1]
    assert truth.mode == "collided"
    assert "it hit 'wall' at " in truth.incident


def test_the_turn_in_the_hand_may_be_a_coordinate():
    problem = pivoting()
    found = led(problem, [[0.0, 0.0, -0.02]] * 8)
    assert found[0][1].x[3] == pytest.approx(0.1, abs=1e-9)
    for measured, truth in found:
        x = configuration(problem.automaton, "free", measured.position, measured.quaternion, truth.x)
        np.testing.assert_allclose(x, truth.x, atol=1e-6)
    # In the air the weight of the pin, 3 cm beside the hand, turns it against its spring; the table turns it back.
    sag = 0.15 * 9.81 * 0.03 / 4.0
    assert found[4][1].x[3] == pytest.approx(-sag, rel=0.05)
    assert found[-1][1].x[3] > 0.03


def changed(problem, link, joint):
    """With another joint at a link, in all modes."""
    modes = [
        replace(mode, joints=(*mode.joints[:link], joint, *mode.joints[link + 1 :])) for mode in problem.automaton.modes
    ]
    return replace(problem, automaton=replace(problem.automaton, modes=tuple(modes)))


def test_what_cannot_be_built_is_refused_with_a_reason():
    problem = tool()
    turning = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    with pytest.raises(InputError, match="must move on slides that do not turn it"):
        HeldPlant(changed(problem, 0, turning))
    with pytest.raises(InputError, match="hinges and slides, and no screw joint"):
        HeldPlant(changed(problem, 3, screw((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.01, (0.0, 0.0, 0.0))))
    c = np.linspace(-0.1, 0.1, 5)
    curve = path(np.column_stack([c, c, c**2, 0.0 * c, np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))]))
    with pytest.raises(InputError, match="hinges and slides, and no path joint"):
        HeldPlant(changed(problem, 3, curve))
    with pytest.raises(InputError, match="turn in the hand about its point and the hinge's direction only"):
        HeldPlant(changed(pivoting(), 3, turning))
    grip = replace(problem.hold.grip, held=replace(problem.hold.grip.held, name="box"))
    with pytest.raises(InputError, match="no link of the model moves the part 'box'"):
        HeldPlant(replace(problem, hold=replace(problem.hold, grip=grip)))
    links = problem.automaton.links
    other = replace(problem.automaton, links=(*links[:3], replace(links[3], parent="hand")))
    with pytest.raises(InputError, match="physics wants links from the base to the hand"):
        HeldPlant(replace(problem, automaton=other))
    datum = replace(stamp().hold.grip, datum=None)
    free = replace(stamp().automaton, modes=stamp().automaton.modes[:1], edges=())
    with pytest.raises(InputError, match=r"give 'hold\.datum'"):
        HeldPlant(replace(stamp(), automaton=free, hold=replace(stamp().hold, grip=datum)))
