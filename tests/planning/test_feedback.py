"""Feedback gains, the policy that uses them, and the limits of inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning_examples import door_automaton, door_problem, drawer_problem, planar_problem, with_settings
from scipy.linalg import solve_discrete_are

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.region import HalfSpace, Region, input_above
from micah_plan.planning.feedback import belief_lqr, feedback_input, time_knots
from micah_plan.planning.limits import limited_input, limits_of
from micah_plan.task.plan import Trajectory


def test_gains_far_from_the_end_are_those_of_the_infinite_horizon() -> None:
    problem = drawer_problem(0.0, 0.3)
    limits = limits_of(problem)
    gains = belief_lqr(problem, limits, ("slides",) * 101, np.zeros(100, dtype=bool))
    R = np.diag(1.0 / limits.max_step**2)
    Q = np.diag(0.3 / limits.speed**2)
    P = solve_discrete_are(np.eye(1), np.eye(1), Q, R)
    np.testing.assert_allclose(gains[0], -np.linalg.solve(R + P, P), rtol=1e-9)


def test_the_last_gain_weighs_the_goal_against_effort() -> None:
    """One step before the end: minimise w_e (v/s)² + (w_g/tol² + 0.3 w_e/s²) (x + v)² over v."""
    problem = drawer_problem(0.0, 0.3)
    limits, settings = limits_of(problem), problem.settings
    gains = belief_lqr(problem, limits, ("slides",) * 2, np.zeros(1, dtype=bool))
    step, tolerance = limits.max_step[0], problem.goal.target[0][2]
    value = settings.weight_goal / settings.weight_effort / tolerance**2 + 0.3 / step**2
    assert gains[0, 0, 0] == pytest.approx(-value / (value + 1 / step**2))


def test_no_feedback_on_pinned_coordinates_and_in_transitions() -> None:
    problem = door_problem(0.2, 1.2)
    modes = ("swings", "swings", "shut", "shut")
    gains = belief_lqr(problem, limits_of(problem), modes, np.array([False, True, False]))
    assert gains[0, 0, 0] < 0
    np.testing.assert_array_equal(gains[1:], 0.0)


def test_closed_loop_shrinks_errors_in_every_direction() -> None:
    problem = planar_problem()
    gains = belief_lqr(problem, limits_of(problem), ("left",) * 6, np.zeros(5, dtype=bool))
    for gain in gains:
        assert np.abs(np.linalg.eigvals(np.eye(2) + gain)).max() < 0.7


def test_policy_corrects_the_nominal_input() -> None:
    trajectory = Trajectory(
        ("q",) * 3, np.array([[0.0], [1.0], [1.0]]), np.zeros((3, 1, 1)), np.array([[1.0], [0.0]]),
        np.array([[[-0.5]], [[0.0]]]), np.array([False, True]),
    )  # fmt: skip
    assert feedback_input(trajectory, 0, np.array([0.4])) == pytest.approx(0.8)
    np.testing.assert_array_equal(time_knots(trajectory), [0])


def test_max_step_from_settings_then_inputs_then_range() -> None:
    door, drawer = door_problem(0.2, 0.6), drawer_problem(0.0, 0.3)
    assert limits_of(with_settings(door, max_step=(0.02,))).max_step == pytest.approx(0.02)
    assert limits_of(door).max_step == pytest.approx(0.06)
    assert limits_of(drawer).max_step == pytest.approx(0.35 / 20)


def test_a_step_beyond_a_saturation_is_not_used() -> None:
    drawer = drawer_problem(0.0, 0.3)
    held = with_effect(drawer.automaton, Effect("saturation", "drawer", (("largest", 0.01),)))
    assert limits_of(replace(drawer, automaton=held)).max_step == pytest.approx(0.01)


def test_limited_input_respects_step_and_admissible_inputs() -> None:
    mode = door_automaton().modes[0]
    assert limited_input(mode, np.zeros(1), np.array([0.5]), np.array([0.1])) == pytest.approx(0.06)
    assert limited_input(mode, np.zeros(1), np.array([-0.5]), np.array([0.01])) == pytest.approx(-0.01)
    towed = replace(mode, inputs=Region((HalfSpace((1.0,), (1.0,), 0.3), input_above(0, -1.0, 1, 1))))
    # x + u >= 0.3 at x = 0.28: at least 0.02.
    assert limited_input(towed, np.array([0.28]), np.array([0.0]), np.array([0.1])) == pytest.approx(0.02)
