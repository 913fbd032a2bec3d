"""The uncertain gain of a joint: against finite differences, displaced joints, and what objects then do."""

from __future__ import annotations

import numpy as np
import pytest
from reference.hybrid_step import step
from scipy.spatial.transform import Rotation
from uncertain_joints import LEVER, NAMES, POSE, known_to, swinging, unsure_door

from micah_plan.automaton.drawn_thresholds import with_boundaries
from micah_plan.automaton.joint import Joint, axis_basis, prismatic, revolute, rigid, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.step_noise import drawn_gains, gain_factors, gain_std, uncertain_gains, with_gains
from micah_plan.automaton.transition import TransitionBatch
from micah_plan.learning.joints.parametrization import JointChart, stepped

HANDLE = (0.05, -0.12, 0.2)


def random_joint(kind: str, seed: int) -> Joint:
    rng = np.random.default_rng(seed)
    axis, point, position = rng.normal(size=3), rng.uniform(-0.2, 0.2, 3), rng.uniform(0.3, 0.6, 3)
    quaternion = Rotation.random(rng=rng).as_quat()
    if kind == "revolute":
        return revolute(axis, point, position, quaternion)
    return screw(axis, point, 0.1, position, quaternion)


def moved(joint: Joint, numbers: np.ndarray) -> Joint:
    """The joint with its named parameters changed, as learning means them."""
    names = NAMES[joint.kind] + POSE
    steps = np.zeros((11, len(names)))
    after = stepped(joint, JointChart(names, np.eye(len(names)), steps, steps, axis_basis(joint.axis)), numbers)
    assert after is not None
    return after


def handle_at(joint: Joint, c: float) -> np.ndarray:
    return np.asarray(forward(joint, c)[0].apply(HANDLE))


def tangent(joint: Joint, c: float) -> np.ndarray:
    return (handle_at(joint, c + 1e-6) - handle_at(joint, c - 1e-6)) / 2e-6


@pytest.mark.parametrize("c", [0.0, 0.9, -2.0])
@pytest.mark.parametrize("kind", ["revolute", "screw"])
@pytest.mark.parametrize("seed", range(3))
def test_the_std_is_that_of_the_tangent_by_finite_differences_at_any_pose(kind: str, seed: int, c: float) -> None:
    joint = known_to(random_joint(kind, seed), 0.01, seed)
    assert joint.covariance is not None
    t, size = tangent(joint, c), len(joint.covariance.names)
    slopes = [
        t @ (tangent(moved(joint, h), c) - tangent(moved(joint, -h), c)) / 2e-4 / (t @ t) for h in 1e-4 * np.eye(size)
    ]
    expected = np.sqrt(slopes @ np.array(joint.covariance.matrix) @ slopes)
    assert gain_std(joint, HANDLE) == pytest.approx(expected, rel=1e-5)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["revolute", "screw"])
def test_a_hand_commanded_by_the_models_displacement_turns_the_true_joint_by_so_much(kind: str) -> None:
    """Joints drawn from the covariance, each displaced from where its own handle is."""
    joint, u, c = known_to(random_joint(kind, 5), 0.01, 5), 0.02, 0.4
    assert joint.covariance is not None
    rng, gains = np.random.default_rng(0), []
    told = handle_at(joint, c + u) - handle_at(joint, c)
    for numbers in rng.multivariate_normal(np.zeros(len(joint.covariance.names)), joint.covariance.matrix, 200):
        true = moved(joint, numbers)
        end, by = handle_at(true, c) + told, 0.0
        for _ in range(3):
            t = tangent(true, c + by)
            by += t @ (end - handle_at(true, c + by)) / (t @ t)
        gains.append(by / u)
    assert np.mean(gains) == pytest.approx(1.0, abs=0.01)
    assert np.std(gains) == pytest.approx(gain_std(joint, HANDLE), rel=0.12)


def test_a_lever_is_known_relative_to_its_length() -> None:
    assert gain_std(swinging(0.003)) == pytest.approx(0.003 / LEVER)
    assert gain_std(swinging(0.003), (LEVER, 0.0, 0.0)) == pytest.approx(0.003 / (2 * LEVER))


def test_what_does_not_turn_or_has_no_covariance_has_no_uncertain_gain() -> None:
    assert gain_std(known_to(prismatic((1, 2, 3), (0.1, 0.2, 0.3)), 0.1, 0)) == 0.0
    assert gain_std(known_to(rigid((0.1, 0.2, 0.3)), 0.1, 0)) == 0.0
    assert gain_std(swinging(None)) == 0.0
    assert gain_std(swinging(0.01), (-LEVER, 0.0, 0.0)) == 0.0  # the handle is on the axis


def test_objects_without_uncertain_gains_take_nothing_from_the_generator() -> None:
    automaton, rng = unsure_door(None), np.random.default_rng(3)
    assert drawn_gains(automaton, rng, 5).shape == (5, 0)
    assert rng.normal() == np.random.default_rng(3).normal()
    assert with_gains(automaton, np.zeros(0)) is automaton


def test_an_object_has_one_gain_in_all_its_steps() -> None:
    automaton = unsure_door(0.05)
    assert list(uncertain_gains(automaton).values()) == pytest.approx([0.05])
    errors = drawn_gains(automaton, np.random.default_rng(1), 4000)
    assert np.std(errors) == pytest.approx(0.05, rel=0.05)
    own = with_gains(automaton, errors[0])
    x = np.array([0.0])
    for _ in range(4):
        x = step(own, "swing", x, np.array([0.1])).x
    assert x[0] == pytest.approx(0.4 * (1 + errors[0, 0]))
    assert gain_factors(automaton, automaton.mode("shut"), errors[:2]).tolist() == [[1.0], [1.0]]


def test_many_objects_at_once_move_as_each_does_by_itself() -> None:
    automaton, rng = unsure_door(0.2), np.random.default_rng(2)
    count = 60
    shifts, gains = 0.01 * rng.normal(size=(count, 1)), drawn_gains(automaton, rng, count)
    objects = TransitionBatch(automaton, shifts, gains)
    x, u = rng.uniform(0.3, 0.6, (count, 1)), rng.uniform(-0.2, 0.3, (count, 1))
    modes, disturbance = rng.integers(0, 2, count), 0.01 * rng.normal(size=(count, 1))
    ends, states = objects.step(modes, x, u, disturbance)
    names = [mode.name for mode in automaton.modes]
    for i in range(count):
        own = with_boundaries(with_gains(automaton, gains[i]), shifts[i])
        after = step(own, names[modes[i]], x[i], u[i], disturbance[i])
        assert names[ends[i]] == after.mode
        assert states[i] == pytest.approx(after.x, abs=1e-12)
    assert set(ends) == {0, 1}
