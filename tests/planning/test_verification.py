"""Verification by roll-outs of the real hybrid system."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from many_doors import cabinet_problem
from planning_examples import DOOR_SHUT, door_automaton, door_problem, drawer_problem, planar_problem
from scipy.stats import binom, binomtest, norm

from micah_plan.automaton.hybrid import Noise
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.roll_outs import restricted_to_nearby_modes
from micah_plan.planning.verification import decision_points, sequential_decision, verify, wilson_interval
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem


@pytest.mark.parametrize(
    "problem", [door_problem(DOOR_SHUT, 0.7, mode="shut"), drawer_problem(0.0, 0.2), planar_problem()]
)
def test_good_plans_verify(problem) -> None:  # type: ignore[no-untyped-def]
    checked = verify(problem, plan(problem), trials=20, seed=1)
    assert checked.outcome == "solved"
    assert checked.success_probability is not None
    assert checked.success_probability >= 0.9
    assert checked.verification_trials == 20


def test_a_plan_that_does_not_move_is_not_verified_and_both_numbers_are_reported() -> None:
    problem = door_problem(0.2, 0.5)
    found = plan(problem)
    assert found.trajectory is not None
    still = replace(
        found.trajectory,
        inputs=np.zeros_like(found.trajectory.inputs),
        gains=np.zeros_like(found.trajectory.gains),
    )
    checked = verify(problem, replace(found, trajectory=still), trials=20)
    assert checked.outcome == "not_verified"
    assert checked.success_probability == 0.0
    assert "0 of 20 roll-outs (0 %)" in checked.reason
    assert "95 %" in checked.reason


def test_open_loop_success_probability_is_the_gaussians() -> None:
    """Without noise and feedback the true start alone decides: P(|N(0, 0.04)| <= 0.05) = 0.79."""
    automaton = replace(door_automaton(), noise=Noise((0.0,), (0.01,)))
    problem = door_problem(0.5, 0.55, start_std=0.04, automaton=automaton)
    trajectory = Trajectory(
        ("swings",) * 2, np.array([[0.5], [0.55]]), np.full((2, 1, 1), 0.04), np.array([[0.05]]), np.zeros((1, 1, 1)),
        np.array([False]),
    )  # fmt: skip
    trials = 300
    checked = verify(problem, Plan("solved", "", trajectory=trajectory), trials=trials, seed=3)
    expected = 1 - 2 * norm.sf(0.05 / 0.04)
    low, high = binom.interval(0.9999, trials, expected)
    assert checked.success_probability is not None
    assert low <= checked.success_probability * trials <= high


@pytest.mark.slow
def test_the_latch_is_reached_as_often_as_planned() -> None:
    """The only goal is to be latched, so the guard's confidence is the plan's: neither much less nor certain."""
    automaton = replace(door_automaton(), noise=Noise((0.005,), (0.01,)))
    problem = door_problem(0.2, DOOR_SHUT, automaton=automaton, goal_modes=("shut",))
    trials = 400
    share = verify(problem, plan(problem), trials=trials, seed=11).success_probability
    assert share is not None
    low, _ = binom.interval(0.999, trials, problem.settings.confidence)
    assert share * trials >= low
    assert share < 1.0


def test_feedback_helps() -> None:
    problem = door_problem(0.3, 0.6, start_std=0.06)
    found = plan(problem)
    assert found.trajectory is not None
    blind = replace(found, trajectory=replace(found.trajectory, gains=np.zeros_like(found.trajectory.gains)))
    closed, open_loop = (verify(problem, p, trials=60).success_probability for p in (found, blind))
    assert closed is not None
    assert open_loop is not None
    assert closed > open_loop + 0.1


def test_the_seed_decides() -> None:
    problem = door_problem(0.3, 0.5, start_std=0.1, tolerance=0.012)
    found = plan(problem)
    shares = [verify(problem, found, trials=40, seed=s).success_probability for s in (4, 4, 5, 6, 7)]
    assert shares[0] == shares[1]
    assert len(set(shares)) > 1


def test_a_plan_without_trajectory_stays_as_it_is() -> None:
    nothing = Plan("no_plan", "why")
    assert verify(door_problem(0.2, 0.5), nothing) is nothing


def test_the_goal_requires_tolerance_and_mode() -> None:
    goal = Goal(((1, 0.5, 0.1),), ("a",))
    assert goal.contains("a", np.array([9.0, 0.6]))
    assert not goal.contains("a", np.array([0.5, 0.61]))
    assert not goal.contains("b", np.array([0.5, 0.5]))
    assert Goal(((1, 0.5, 0.1),)).contains("b", np.array([0.5, 0.5]))


@pytest.mark.parametrize(("successes", "trials"), [(0, 20), (20, 20), (19, 20), (950, 1000), (1, 1)])
def test_the_interval_is_wilsons(successes: int, trials: int) -> None:
    expected = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_a_verified_plan_has_the_interval_of_its_success() -> None:
    problem = door_problem(0.2, 0.5)
    found = plan(problem)
    few, many = (verify(problem, found, trials=count).success_interval for count in (20, 400))
    assert few is not None
    assert many is not None
    assert few[0] < many[0] < many[1] <= few[1] == 1.0


@pytest.mark.parametrize("confidence", [0.8, 0.95, 0.99])
def test_what_is_plain_is_seldom_wrong(confidence: float) -> None:
    """Plans as good as asked are taken for ones that fail twice as often, and the other way round, in 1 % at most."""
    rng, looks = np.random.default_rng(0), decision_points(2000, confidence)
    for success, is_good in ((confidence, True), (1.0 - 2.0 * (1.0 - confidence), False)):
        wrong = 0
        for run in rng.random((4000, 2000)) < success:
            seen = [int(run[:n].sum()) for n in looks]
            answers = (sequential_decision(k, n, confidence) for k, n in zip(seen, looks, strict=True))
            wrong += next((answer for answer in answers if answer is not None), is_good) != is_good
        assert wrong <= 0.013 * 4000


def test_a_look_that_would_come_late_is_left_out() -> None:
    assert decision_points(1000, 0.95) == (130, 1000)
    assert decision_points(500, 0.98) == (500,)
    assert decision_points(1, 0.5) == (1,)


def test_in_turns_the_answer_is_the_same_with_fewer_roll_outs() -> None:
    problem = door_problem(0.9, 0.5)
    found, (first, _) = plan(problem), decision_points(1000, problem.settings.confidence)
    whole, turns = verify(problem, found), verify(problem, found, sequential=True)
    assert (turns.outcome, turns.verification_trials) == ("solved", first)
    assert whole.verification_trials == 1000
    again = verify(problem, found, sequential=True)
    assert (again.outcome, again.success_probability) == (turns.outcome, turns.success_probability)
    asked = replace(problem, goal=replace(problem.goal, target=((0, 0.5, 0.001),)))
    refused = verify(asked, found, sequential=True)
    assert (refused.outcome, refused.verification_trials) == ("not_verified", first)
    assert f"of {first} roll-outs" in refused.reason


@pytest.fixture(scope="module")
def many_doors() -> Problem:
    """Six doors that latch: 64 modes."""
    return cabinet_problem(6, 0, 1, 6)


@pytest.mark.slow
@pytest.mark.parametrize("near", [pytest.param(1, marks=pytest.mark.evidence), 2])
def test_of_many_modes_those_near_the_plan_are_rolled_out_and_the_answer_is_the_same(
    many_doors: Problem, near: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = plan(many_doors)
    assert found.trajectory is not None
    monkeypatch.setattr("micah_plan.planning.roll_outs._NEAR", near)
    part, outermost = restricted_to_nearby_modes(many_doors, found.trajectory)
    assert len(part.automaton.modes) < len(many_doors.automaton.modes)
    assert outermost.isdisjoint(found.trajectory.modes)
    quick = verify(many_doors, found, trials=200)
    monkeypatch.setattr("micah_plan.planning.roll_outs.FEW_MODES", 1000)
    assert restricted_to_nearby_modes(many_doors, found.trajectory) == (many_doors, frozenset())
    whole = verify(many_doors, found, trials=200)
    assert quick.success_probability == whole.success_probability
    assert quick.findings == whole.findings
