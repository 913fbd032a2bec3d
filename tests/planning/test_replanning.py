"""Planning while a plan is followed: from the belief of now, through what is left, past thresholds as learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning_examples import DOOR_SHUT, door_automaton, door_problem, planar_problem

from micah_plan.automaton.drawn_thresholds import boundary_stds, with_boundaries
from micah_plan.automaton.transition import simulate
from micah_plan.belief.filter import initial_belief, predict_belief, update
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.feedback import time_knots
from micah_plan.planning.limits import limits_of
from micah_plan.planning.plan_cost import cost_of
from micah_plan.planning.pomdp_hd import plan, trajectory_of
from micah_plan.planning.receding_horizon import RecedingHorizon, remainder_by_new_programme
from micah_plan.planning.replanning import believed_problem, replan, rest_of
from micah_plan.task.problem import Problem

STD = 0.04


def latching() -> Problem:
    """Shut a door whose latch lies at 1.2 rad, give or take."""
    automaton = door_automaton(pin_std=0.05)
    edges = tuple(e if e.is_self_transition else replace(e, threshold_std=STD) for e in automaton.edges)
    problem = door_problem(0.9, DOOR_SHUT, tolerance=0.2, goal_modes=("shut",))
    return replace(problem, automaton=replace(automaton, edges=edges))


def still_open(problem: Problem) -> HybridBelief:
    """Measured to be open at 1.23 rad, where the model has it shut."""
    belief = initial_belief(problem.automaton, [1.13], [0.01], "swings")
    for z in (1.18, 1.23):
        belief = update(problem.automaton, predict_belief(problem.automaton, belief, [0.05]), [z])
    return belief


def test_the_rest_of_a_trajectory_keeps_modes_steps_and_way() -> None:
    problem = latching()
    trajectory = plan(problem).trajectory
    assert trajectory is not None
    sequence, steps = rest_of(problem.automaton, trajectory, 2)
    assert sequence.modes == ("swings", "shut")
    assert problem.automaton.edges[sequence.edges[0]].name == "swings -> shut"
    assert sum(steps) == len(time_knots(trajectory)) - 2
    np.testing.assert_array_equal(np.concatenate(sequence.waypoints), trajectory.means[2:])
    last, none_left = rest_of(problem.automaton, trajectory, len(trajectory.modes) - 1)
    assert (last.modes, none_left) == (("shut",), [0])


def test_a_plan_continued_from_its_own_belief_stays_as_it_was() -> None:
    problem = latching()
    trajectory = plan(problem).trajectory
    assert trajectory is not None
    belief = initial_belief(problem.automaton, trajectory.means[3], trajectory.factors[3], "swings")
    horizon = RecedingHorizon(problem, trajectory)
    onward = horizon(belief, trajectory, 3)
    assert onward is not None
    assert onward.modes == trajectory.modes[3:]
    assert np.abs(onward.means[-1] - trajectory.means[-1]).max() < 1e-3
    assert np.abs(onward.means - trajectory.means[3:]).max() < 0.5 * 0.06
    assert horizon(initial_belief(problem.automaton, [1.2], [0.01], "shut"), trajectory, 3) is None


def test_too_few_steps_left_continue_nothing() -> None:
    problem = latching()
    trajectory = plan(problem).trajectory
    assert trajectory is not None
    behind = initial_belief(problem.automaton, [0.3], [0.01], "swings")
    horizon = RecedingHorizon(problem, trajectory)
    assert horizon(behind, trajectory, len(trajectory.modes) - 4) is None
    assert not horizon.built


@pytest.mark.sweep
@pytest.mark.parametrize(("problem", "knots"), [(latching(), (1, 5, 9)), (planar_problem(), (2, 12, 20))])
def test_the_programme_reused_answers_as_a_new_one(problem: Problem, knots: tuple[int, ...]) -> None:
    trajectory = plan(problem).trajectory
    assert trajectory is not None
    horizon, limits = RecedingHorizon(problem, trajectory), limits_of(problem)
    followed, at = trajectory, 0
    for knot in knots:
        mode, std = trajectory.modes[knot], np.linalg.norm(trajectory.factors[knot], axis=1)
        moves = problem.automaton.mode(mode).B.any(axis=1)
        belief = initial_belief(problem.automaton, trajectory.means[knot] + 0.5 * std * moves, std, mode)
        here = believed_problem(problem, belief)
        new = trajectory_of(here, limits, remainder_by_new_programme(here, followed, knot - at))
        followed, at = horizon(belief, followed, knot - at), knot
        assert followed is not None
        assert followed.modes == new.modes == trajectory.modes[knot:]
        np.testing.assert_allclose(followed.means[0], belief.means[belief.most_likely], atol=1e-7)
        costs = [cost_of(here, limits, found) for found in (followed, new)]
        # What missing a guard would cost, by the spreads that each plan knows, is traded against this.
        assert costs[0] == pytest.approx(costs[1], rel=0.03, abs=0.03)
        assert np.abs(followed.means - new.means).max() < 0.4 * limits.max_step.max()
        if not any(q.pins for q in problem.automaton.modes):  # else the belief's mean moves to the pin only in part
            inputs = followed.inputs[~followed.is_transition]
            driven = simulate(problem.automaton, mode, followed.means[0].tolist(), inputs)
            np.testing.assert_allclose(followed.means[[0, *(time_knots(followed) + 1)]], driven.states, atol=1e-6)
    assert (horizon.reused, horizon.built) == (len(knots), 0)


def test_a_threshold_learned_ahead_needs_a_new_programme_and_one_behind_does_not() -> None:
    problem = latching()
    trajectory = plan(problem).trajectory
    assert trajectory is not None
    horizon, latched = RecedingHorizon(problem, trajectory), trajectory.modes.index("shut")
    onward = horizon(still_open(problem), trajectory, latched - 2)
    assert (horizon.reused, horizon.built) == (0, int(onward is not None))
    shut = replace(still_open(problem), weights=np.array([0.0, 1.0]))
    assert shut.shifts is not None
    shut = replace(shut, means=np.full((2, 1), 1.24), shifts=np.full_like(shut.shifts, 0.04))
    assert horizon(shut, trajectory, latched) is not None
    assert horizon.reused == 1


def test_a_new_plan_goes_past_where_the_threshold_is_now_believed_to_be() -> None:
    problem = latching()
    belief = still_open(problem)
    assert belief.shifts[0, 0] > 0.03
    here = believed_problem(problem, belief)
    guard = here.automaton.edges[0].guard.half_spaces[0]
    assert guard.c == pytest.approx(DOOR_SHUT + belief.shifts[0, 0])
    assert here.automaton.edges[0].threshold_std == pytest.approx(belief.shift_stds[0, 0])
    assert here.start.mean[0] == pytest.approx(belief.means[0, 0])
    learned, first = replan(problem, belief), plan(problem).trajectory
    assert learned is not None
    assert first is not None
    assert learned.means.max() > guard.c
    assert learned.factors[-1, 0, 0] < first.factors[-1, 0, 0]


def test_known_boundaries_are_shifted_ones_with_their_stds() -> None:
    automaton = latching().automaton
    same = with_boundaries(automaton, np.zeros(1), np.array([STD]))
    assert (same.modes, same.edges) == (automaton.modes, automaton.edges)
    known = with_boundaries(automaton, np.array([0.1]), np.array([0.01]))
    moved = with_boundaries(automaton, np.array([0.1]))
    assert [edge.guard for edge in known.edges] == [edge.guard for edge in moved.edges]
    assert list(boundary_stds(known).values()) == pytest.approx([0.01])
    assert known.mode("shut").pins[0].value == pytest.approx(DOOR_SHUT + 0.1)
    # What else makes the pin uncertain stays: 0.05² - 0.04² = 0.03².
    assert known.mode("shut").pins[0].std == pytest.approx(np.hypot(0.03, 0.01))
