"""The cost function, shared by planning, optimisation and comparison.

    weight_effort · Σ |u / max_step|²                                                    over all steps
      + Σ_i (weight_goal · (μ_i - target_i)² + weight_covariance · P_ii) / tolerance_i²  at the last knot
      + weight_goal · Σ P(a guard is missed, a boundary crossed)                           in the optimisation only
      + what constraints on the path ask to be paid (`path_constraints`)                 over all steps
      + weight_effort · pace²                                                              per step, between candidates

A path of D largest steps in N steps costs weight_effort · D²/N of effort: the longer, the less. So that no plan wins by
taking longer, each step has the price at which N = D / pace steps, the planned number, are the cheapest. A transition
costs one step more, as in the search.

Evaluated with numbers, arrays or CasADi expressions: only the entries of the goal's coordinates in means and variances
are used, so they may be arrays (n, ...), expressions (n, 1) or mappings.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.planning.limits import Limits
from micah_plan.planning.path_constraints import path_cost
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem

Value = Any
"""A float, an array or a CasADi expression."""

# Where effort costs hardly anything, search and feedback still count steps.
_SMALLEST_WEIGHT = 1e-3


def effort_cost(problem: Problem, squares: Value) -> Value:
    """Cost of inputs, from the sum of their squares relative to the largest step."""
    return problem.settings.weight_effort * squares


def time_cost(problem: Problem, is_transition: Booleans) -> float:
    """Cost of the steps (K-1,) between knots, which makes plans of different length comparable."""
    steps = len(is_transition) + int(is_transition.sum())
    return problem.settings.weight_effort * problem.settings.pace**2 * steps


def goal_cost(problem: Problem, mean: Value) -> Value:
    """Cost of the goal error of a last mean [rad or m]."""
    weight = problem.settings.weight_goal
    return sum(weight * ((mean[index] - value) / tolerance) ** 2 for index, value, tolerance in problem.goal.target)


def goal_weights(problem: Problem) -> Floats:
    """(n,) weights of `goal_cost` on the squared error of each coordinate; 0 where the goal is free."""
    weights = np.zeros(problem.automaton.n)
    for index, _, tolerance in problem.goal.target:
        weights[index] += problem.settings.weight_goal / tolerance**2
    return weights


def variance_cost(problem: Problem, variance: Value) -> Value:
    """Cost of the final variances [rad² or m²]."""
    weight = problem.settings.weight_covariance
    return sum(weight * variance[index] / tolerance**2 for index, _, tolerance in problem.goal.target)


def in_steps(problem: Problem, cost: Value) -> Value:
    """A cost in units of a step of the largest input, as used by search and feedback."""
    return cost / max(problem.settings.weight_effort, _SMALLEST_WEIGHT)


def cost_of(problem: Problem, limits: Limits, trajectory: Trajectory) -> float:
    """Cost of a trajectory without slack penalties."""
    effort = effort_cost(problem, np.square(trajectory.inputs / limits.max_step).sum())
    variance = np.square(trajectory.factors[-1]).sum(axis=-1)
    ending = goal_cost(problem, trajectory.means[-1]) + variance_cost(problem, variance)
    taken = time_cost(problem, trajectory.is_transition)
    return float(effort + ending) + path_cost(problem, trajectory) + taken
