"""Consistency of solved plans: whether their numbers can be a solution of the problem.

A matching digest proves little, since any program may have written the file. Without simulation, this finds: a share of
successes below the confidence, a last state other than stated, a step that the model does not make.
"""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import EQUAL, Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.task.acceptance import least_share
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem


def disagreement(plan: Plan, problem: Problem) -> tuple[str, str] | None:
    """(key of the plan file, contradiction); None for a consistent plan, or one that is not solved."""
    if plan.outcome != "solved" or plan.trajectory is None:
        return None
    share, confidence = plan.success_probability, problem.settings.confidence
    if share is not None and share < (least := least_share(confidence, plan.verification_trials)):
        claim = f"outcome solved, but its share of successes {share:g} is less than the {least:.3g} that"
        return "success_probability", f"{claim} the confidence {confidence:g} requires"
    if (found := _belief_contradiction(plan.trajectory.factors)) is not None:
        return "trajectory.factors", found
    return _step_contradiction(plan.trajectory, problem) or _end_contradiction(plan, plan.trajectory, problem)


def _belief_contradiction(factors: Floats) -> str | None:
    """The first covariance (K, n, n) with an invalid factor."""
    for k, factor in enumerate(factors):
        if np.triu(factor, 1).any() or (np.diag(factor) < 0).any():
            return f"knot {k}: expected a lower triangular factor with a diagonal of at least 0"
    return None


def _end_contradiction(plan: Plan, trajectory: Trajectory, problem: Problem) -> tuple[str, str] | None:
    """A contradiction between last knot and goal; released objects come to rest elsewhere."""
    goal, last = problem.goal, trajectory.modes[-1]
    if problem.release is not None:
        return None
    error = goal.error(trajectory.means[-1])
    if plan.goal_error is not None and abs(error - plan.goal_error) > EQUAL:
        return (
            "goal_error",
            f"expected the distance {error:g} of the last knot from the goal, found {plan.goal_error:g}",
        )
    std = goal.std(trajectory.factors[-1])
    if plan.goal_std is not None and abs(std - plan.goal_std) > EQUAL:
        return "goal_std", f"expected the std {std:g} of the last knot, found {plan.goal_std:g}"
    if not goal.contains(last, trajectory.means[-1]):
        return "trajectory", f"outcome solved, but its last knot, in mode '{last}', is not in the goal"
    return None


def _step_contradiction(trajectory: Trajectory, problem: Problem) -> tuple[str, str] | None:
    """The first step that contradicts the model."""
    automaton, largest = problem.automaton, problem.settings.max_step
    for k, u in enumerate(trajectory.inputs):
        before, after = trajectory.modes[k : k + 2]
        if trajectory.is_transition[k]:
            if after not in _reached_in_one_instant(automaton, before):
                return (
                    "trajectory",
                    f"knot {k}: no transition of the model leads from '{before}' to '{after}'",
                )
            continue
        if before != after:
            return "trajectory", f"knot {k}: the mode changes from '{before}' to '{after}' without a transition"
        if largest is not None and (np.abs(u) > np.array(largest) + EQUAL).any():
            return "trajectory", f"knot {k}: an input of {np.abs(u).max():g} is more than the largest step"
        moved = trajectory.means[k + 1] - trajectory.means[k]
        # Effects and memories change what an input does; the verification's roll-outs have them, this has not.
        if not automaton.effects and not np.allclose(moved, automaton.mode(before).B @ u, rtol=0, atol=EQUAL):
            return "trajectory", f"knot {k}: the model's step in mode '{before}' does not lead to the next knot"
    return None


def _reached_in_one_instant(automaton: HybridAutomaton, source: str) -> set[str]:
    """The modes reachable from `source` by a transition and those that follow it at the same instant.

    A plan has one transition between two knots, also where the model takes several
    (`planning.zero_time_transitions`): the input fires the first of them, the state that each leads to fires the next.
    """
    reached = {edge.target for edge in automaton.edges_from(source)}
    new = set(reached)
    while new:
        following = (edge for mode in new for edge in automaton.edges_from(mode))
        new = {edge.target for edge in following if edge.guard.on_state and not edge.guard.on_input} - reached
        reached |= new
    return reached
