"""The arm in a plan: the shipped problem with a robot, from the file to the joint trajectory."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from robot_examples import ARM7

from micah_plan.automaton.kinematics import forward
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.planning import pomdp_hd
from micah_plan.planning.findings import explain
from micah_plan.planning.solver import solve
from micah_plan.planning.tightening import verified_plan
from micah_plan.robot.along_plan import arm_along, carried_parts, problem_clearance
from micah_plan.task.deadline import NEVER, Deadline, TimeLimitError
from micah_plan.task.plan import ArmTrajectory, Plan
from micah_plan.task.problem import Problem

PROBLEM = ARM7.parents[2] / "problems" / "microwave_close_by_arm.yaml"


@pytest.fixture(scope="module")
def problem() -> Problem:
    return load_problem(PROBLEM, {"planner.verification_trials": 100})


@pytest.fixture(scope="module")
def plan(problem: Problem) -> Plan:
    return solve(problem)


@pytest.mark.slow
def test_the_tool_holds_the_handle_all_along_the_plan(problem: Problem, plan: Plan) -> None:
    assert plan.outcome == "solved"
    assert plan.arm is not None
    assert plan.trajectory is not None
    assert plan.timings["arm"] > 0
    arm = problem_clearance(problem).arm
    handle = problem.automaton.part("door").handle
    for mode, x, q in zip(plan.trajectory.modes, plan.trajectory.means, plan.arm.positions, strict=True):
        door = forward(problem.automaton.mode(mode).joints[0], x[0])[0]
        tool = arm.matrix(q)
        np.testing.assert_allclose(tool[:3, 3], door.apply(handle), atol=1e-7)
        np.testing.assert_allclose(tool[:3, 2], -door.as_matrix()[:3, 1], atol=1e-7)  # it looks against the door
    assert np.abs(np.diff(plan.arm.positions, axis=0)).max() < 0.3
    assert plan.arm.least_clearance is not None
    assert 0.003 <= plan.arm.least_clearance < 0.1
    assert set(plan.arm.closest_pair) <= {name for pair in problem_clearance(problem).names for name in pair}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_arm(problem: Problem, plan: Plan) -> None:
    again = solve(problem)
    assert again.arm is not None
    assert plan.arm is not None
    assert np.array_equal(again.arm.positions, plan.arm.positions)
    assert again.arm.least_clearance == plan.arm.least_clearance


@pytest.mark.evidence
def test_an_arm_too_far_away_makes_no_plan_and_gives_the_reason(problem: Problem) -> None:
    assert problem.robot is not None
    far = replace(problem, robot=replace(problem.robot, position=(0.15, 1.4, -0.15)))
    found = solve(far)
    assert found.outcome == "not_verified"
    assert found.arm is None
    assert found.reason.startswith("the arm cannot follow the plan: the tool stays")
    told = explain(far, found)
    assert told.level == "arm"
    assert told.findings[0].knot is not None


@pytest.mark.slow
def test_a_time_limit_in_the_arm_is_named_and_what_was_found_is_kept(problem: Problem, plan: Plan) -> None:
    trajectory = plan.trajectory
    assert trajectory is not None

    def within(limit: int, ticks: Iterator[int]) -> object:
        return arm_along(problem, trajectory, deadline=Deadline(limit, lambda: next(ticks)))

    ticks = itertools.count()
    assert isinstance(within(10**9, ticks), ArmTrajectory)
    assert isinstance(within(next(ticks) - 3, itertools.count()), ArmTrajectory)  # of one start posture, not two
    for limit, state in ((10, "9 of 61 start postures were sought"), (65, r"\d+ of \d+ knots were reached")):
        with pytest.raises(TimeLimitError, match=f"was reached in the arm's motion: {state}"):
            within(limit, itertools.count())


def test_a_plan_whose_arm_had_no_time_is_not_verified(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    hasty = replace(problem, settings=replace(problem.settings, solve_time_limit_s=1e-9, tightening_rounds=0))
    unchecked_parts_warning = partial(verified_plan, verifier=lambda _problem, plan, *_, **__: plan)
    monkeypatch.setattr("micah_plan.planning.solver.verified_plan", unchecked_parts_warning)
    monkeypatch.setattr("micah_plan.planning.solver.pomdp_hd", whatever_time)
    found = solve(hasty)
    assert found.outcome == "not_verified"
    assert found.arm is None
    told = explain(hasty, found)
    assert told.level == "arm"
    assert "reached in the arm's motion" in told.findings[0].sentence
    assert told.findings[0].remedy == "raise solve_time_limit_s"


def whatever_time(problem: Problem, seed: int, **_: object) -> Plan:
    return pomdp_hd.plan(problem, seed, deadline=NEVER)


def test_parts_that_hang_on_the_held_one_are_carried(problem: Problem) -> None:
    cabinet = load_problem(PROBLEM.parent / "cabinet_open.yaml").automaton
    children = [link.child for link in cabinet.links]
    door = next(link.parent for link in cabinet.links if link.parent in children)
    assert set(carried_parts(cabinet, door)) == {door, *(link.child for link in cabinet.links if link.parent == door)}
    assert carried_parts(problem.automaton, "door") == ("door",)


def test_a_problem_without_a_robot_has_no_clearances(problem: Problem) -> None:
    with pytest.raises(InputError, match="no robot with a grasp"):
        problem_clearance(replace(problem, robot=None, grasp=None))
