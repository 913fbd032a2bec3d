"""A plan that fails too often is made anew with more room, a bounded number of times, and judged by fresh roll-outs."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planning_examples import DOOR_SHUT, door_automaton, door_problem, planar_problem, with_settings

from micah_plan.automaton.hybrid import Noise
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.solver import solve
from micah_plan.planning.tightening import tightened, verified_plan
from micah_plan.planning.verification import verify
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem


def two_chances_to_fail() -> Problem:
    """A door that may miss its latch or be latched too far from the target: at 95 % each, 93 % succeed.

    Missing the goal costs nothing, so nothing is done for more than these 95 %.
    """
    automaton = door_automaton(pin_std=0.01)
    edges = tuple(e if e.is_self_transition else replace(e, threshold_std=0.0075) for e in automaton.edges)
    automaton = replace(automaton, edges=edges, noise=Noise((0.005,), (0.01,)))
    problem = door_problem(0.9, DOOR_SHUT, tolerance=0.017, goal_modes=("shut",), automaton=automaton)
    return with_settings(problem, weight_goal=0.0)


def hopeless() -> Problem:
    """Process noise of two fifths of the tolerance in each step, in two coordinates."""
    problem = planar_problem()
    return replace(problem, automaton=replace(problem.automaton, noise=Noise((0.02, 0.02), (0.03, 0.03))))


class Counted:
    """The planner, with the confidences that it was asked for."""

    def __init__(self) -> None:
        self.asked: list[float] = []

    def __call__(self, problem: Problem, *, deadline: Deadline) -> Plan:
        self.asked.append(problem.settings.confidence)
        return plan(problem, deadline=deadline)


def test_more_room_makes_a_plan_that_holds() -> None:
    problem, planner = two_chances_to_fail(), Counted()
    first = verify(problem, plan(problem), seed=0)
    answer = verified_plan(problem, planner, seed=0)
    assert first.outcome == "not_verified"
    assert answer.outcome == "solved"
    assert answer.success_probability > first.success_probability + 0.01
    assert "planned again" in answer.reason
    assert planner.asked[0] == 0.95
    assert planner.asked[1] > 0.98
    # Not the roll-outs that chose it: with other seeds it holds as often.
    again = verify(problem, answer, trials=2000, seed=99).success_probability
    assert again == pytest.approx(answer.success_probability, abs=0.02)


@pytest.mark.slow
def test_rounds_are_bounded_and_the_best_is_reported() -> None:
    problem, planner = with_settings(hopeless(), verification_trials=200), Counted()
    answer = verified_plan(problem, planner, rounds=2)
    assert answer.outcome == "not_verified"
    assert 1 < len(planner.asked) <= 3
    assert planner.asked == sorted(planner.asked)
    assert answer.success_probability >= verify(problem, plan(problem), seed=0).success_probability
    assert any(finding.level == "verification" for finding in answer.findings)


@pytest.mark.slow
def test_no_rounds_and_no_time_leave_the_first_answer() -> None:
    problem = with_settings(hopeless(), verification_trials=100)
    once = verify(problem, plan(problem), seed=0)
    for changed in ({"tightening_rounds": 0}, {"solve_time_limit_s": 1e-3, "candidates": 1}):
        answer = solve(with_settings(problem, **changed))
        assert answer.outcome in ("not_verified", "no_plan")
        if answer.trajectory is not None:
            assert answer.success_probability == once.success_probability


def test_a_plan_that_holds_is_planned_once() -> None:
    planner = Counted()
    assert verified_plan(door_problem(0.9, DOOR_SHUT), planner).outcome == "solved"
    assert planner.asked == [0.95]


@pytest.mark.parametrize(("failing", "expected"), [(0.06, 0.985), (0.5, 0.995), (1.0, 0.9975), (0.0, 0.985)], ids=str)
def test_the_allowed_failures_shrink_as_there_were_too_many(failing: float, expected: float) -> None:
    assert tightened(0.95, 0.95, failing) == pytest.approx(expected)
    assert tightened(0.9999, 0.95, failing) == 0.9999
