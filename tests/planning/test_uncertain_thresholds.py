"""Plans over thresholds that are known only so well hold for the object, wherever its threshold truly is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning_examples import DOOR_SHUT, door_automaton, door_problem, one_dimensional, with_settings
from scipy.stats import norm

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.verification import verify
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

STD = 0.04
TRIALS = 120


def blurred(automaton: HybridAutomaton, std: float) -> HybridAutomaton:
    edges = (edge if edge.is_self_transition else replace(edge, threshold_std=std) for edge in automaton.edges)
    return replace(automaton, edges=tuple(edges))


def latching(std: float) -> Problem:
    """Shut a door whose latch lies at 1.2 rad, give or take; the only goal is to be latched."""
    automaton = blurred(door_automaton(pin_std=max(0.005, std)), std)
    return door_problem(0.9, DOOR_SHUT, tolerance=0.2, goal_modes=("shut",), automaton=automaton)


def farthest(found: Plan) -> float:
    assert found.trajectory is not None
    return float(found.trajectory.means.max())


def share(problem: Problem, found: Plan) -> float:
    verified = verify(problem, found, trials=TRIALS, seed=1).success_probability
    assert verified is not None
    return verified


def test_the_guard_is_passed_by_k_sigma_of_what_is_not_known_of_it() -> None:
    # Further is worth it only where missing the goal costs something.
    certain, uncertain = (plan(with_settings(latching(std), weight_goal=0.0)) for std in (0.0, STD))
    k = norm.ppf(0.95)
    own = (farthest(certain) - DOOR_SHUT) / k
    assert farthest(uncertain) == pytest.approx(DOOR_SHUT + k * np.hypot(own, STD), abs=0.003)


def test_such_a_plan_latches_as_often_as_required_and_one_with_a_certain_threshold_does_not() -> None:
    truth = latching(STD)
    trusting = verify(truth, plan(latching(0.0)), trials=TRIALS, seed=1)
    assert trusting.outcome == "not_verified"
    assert trusting.success_probability is not None
    assert trusting.success_probability < 0.8
    assert share(truth, plan(truth)) >= 0.91  # 95 % less two standard errors


def staying(std: float) -> Problem:
    """Move up to just below a threshold without passing it."""
    automaton = blurred(one_dimensional(0.0, 0.2, 0.4), std)
    goal = Goal(((0, 0.18, 0.06),), ("first",))
    return Problem(automaton, Start((0.05,), (0.005,)), goal, PlannerSettings(samples_per_mode=40))


def test_a_threshold_that_is_not_to_be_passed_is_kept_away_from() -> None:
    truth = staying(0.02)
    certain, uncertain = plan(staying(0.0)), plan(truth)
    assert farthest(uncertain) <= 0.2 - norm.ppf(0.95) * 0.02
    assert farthest(uncertain) < farthest(certain) - 0.005
    assert share(truth, certain) < share(truth, uncertain)


def test_a_std_of_zero_changes_nothing() -> None:
    plain = replace(latching(0.0), automaton=door_automaton(pin_std=0.005))
    found, same = plan(plain), plan(latching(0.0))
    assert found.trajectory is not None
    assert same.trajectory is not None
    assert np.array_equal(found.trajectory.means, same.trajectory.means)
    assert share(plain, found) == share(latching(0.0), same)
