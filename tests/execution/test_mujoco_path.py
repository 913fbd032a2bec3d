"""Parts on a path in MuJoCo: a hinge that is written as a path moves, resists and latches as the hinge does."""

from dataclasses import replace

import numpy as np
import pytest
from execution_objects import SHUT, door
from extras import requires
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import Coordinate, HybridAutomaton, Link, Mode, Noise, Part, Primitive
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.path import path
from micah_plan.automaton.region import box, input_box
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.pose import command
from micah_plan.task.start import Start

pytestmark = requires("sim")

IDEAL = PhysicalParameters(damping=0.0, friction=0.0, position_noise=0.0, rotation_noise=0.0)


def knots_of(poses, c):
    return np.column_stack([c, poses.translation, poses.rotation.as_quat()])


def heavy_door(tilt=0.0):
    """A door whose inertia its shape says, whatever its joint is."""
    panel = Part("door", (Primitive("box", (0.3, 0.3, 0.02), (0.05, -0.1, 0.0)),), handle=(0.0, 0.0, 0.05))
    return replace(door(tilt), parts=(Part("base"), panel))


def on_a_path(automaton):
    """The door, its hinge written as a path whose configuration is the angle."""
    moving, pinned = automaton.modes
    c = np.linspace(-0.1, SHUT + 0.1, 40)
    same = path(knots_of(forward(moving.joints[0], c), c))
    return replace(automaton, modes=(replace(moving, joints=(same,)), pinned))


def garage(turned):
    """A door whose ends run along two walls; its angle goes through 1.5 rad while its middle follows an ellipse."""
    angle = np.linspace(0.0, 1.5, 20)
    position = np.column_stack([0.6 * np.sin(angle), 0 * angle, 0.4 * np.cos(angle)])
    quaternion = (turned * Rotation.from_rotvec(np.outer(-angle, [0.0, 1.0, 0.0]))).as_quat()
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1)))
    guided = path(np.column_stack([length, turned.apply(position) + np.array([0.3, -0.2, 0.5]), quaternion]))
    named = (Coordinate("lid", "m"),)
    end = float(length[-1])
    mode = Mode("moving", (guided,), ((1.0,),), box([0.0], [end], 1, ["lid"]), input_box([-0.1], [0.1], 1, ["lid"]))
    parts = (Part("base"), Part("lid", handle=(0.05, 0.0, 0.0)))
    return HybridAutomaton(named, named, (Link("base", "lid", 0),), parts, (mode,), (), Noise((0.001,), (0.003,)))


def trajectory(automaton, x, inputs, mode=None, **changes):
    """Configurations and forces after each of some commands, and the truth at the end."""
    plant = StandingPlant(automaton, Start((x,), (0.0,), mode), replace(IDEAL, **changes))
    plant.reset(np.random.default_rng(0))
    found = []
    for u in inputs:
        x = plant.truth().x
        measured = plant.apply(command(automaton, automaton.modes[0].name, x, np.array([u])))
        found.append((plant.truth().x[0], *measured.force[0]))
    return np.array(found), plant.truth()


@pytest.mark.sweep
@pytest.mark.parametrize("changes", [{}, {"damping": 30.0, "friction": 2.0}, {"gravity": 9.81}], ids=str)
@pytest.mark.parametrize("tilt", [0.0, 0.7])
def test_a_hinge_written_as_a_path_moves_as_the_hinge(tilt, changes):
    inputs = [0.08, 0.08, 0.03, -0.05, 0.0, 0.12]
    hinge, _ = trajectory(heavy_door(tilt), 0.2, inputs, **changes)
    guided, truth = trajectory(on_a_path(heavy_door(tilt)), 0.2, inputs, **changes)
    # Friction and ties are springs, so that a tenth of a millimetre at the handle is left, and a share of a newton.
    np.testing.assert_allclose(guided[:, 0], hinge[:, 0], atol=4e-4)
    np.testing.assert_allclose(guided[:, 1:], hinge[:, 1:], atol=0.3)
    pose = forward(door(tilt).modes[0].joints[0], truth.x)[0]
    np.testing.assert_allclose(truth.position[0], pose.translation, atol=5e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "released"), [(0.9, False), (1.1, True)])
def test_its_latch_catches_and_opens_at_its_force(share, released):
    automaton = on_a_path(heavy_door(0.4))
    _, caught = trajectory(automaton, 1.1, [0.096])
    assert caught.latched.all()
    assert caught.x[0] == pytest.approx(SHUT, abs=1e-4)
    pull = share * IDEAL.latch_force / IDEAL.stiffness / 0.35
    _, truth = trajectory(automaton, SHUT, [-pull], mode="shut")
    assert truth.latched.all() != released


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(3))
def test_a_garage_door_stays_on_its_path_and_follows_the_command(seed):
    automaton = garage(Rotation.random(rng=np.random.default_rng(seed)))
    inputs = [0.08] * 8 + [-0.1] * 4
    found, truth = trajectory(automaton, 0.05, inputs)
    np.testing.assert_allclose(found[:, 0], 0.05 + np.cumsum(inputs), atol=2e-3)
    pose = forward(automaton.modes[0].joints[0], truth.x)[0]
    np.testing.assert_allclose(truth.position[0], pose.translation, atol=2e-5)
    assert (pose.rotation.inv() * Rotation.from_quat(truth.quaternion[0])).magnitude() < 1e-4


def test_it_stops_at_the_end_of_its_range():
    automaton = garage(Rotation.identity())
    end = automaton.modes[0].interval(0)[1]
    found, _ = trajectory(automaton, 0.8 * end, [0.05] * 8)
    assert found[-1, 0] == pytest.approx(end, abs=2e-3)
    assert np.linalg.norm(found[-1, 1:]) > 1.0
