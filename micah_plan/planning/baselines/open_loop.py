"""A plan from open-loop inputs: what the baselines share, so that they are judged as POMDP-HD is.

A baseline finds inputs; the rest is here. The means are those of the real transitions without noise, the covariances
those of the hybrid filter with the most likely measurements, and the feedback is the same belief-LQR.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.transition import step
from micah_plan.belief.filter import initial_belief, predict, update
from micah_plan.planning.attempt import Attempt
from micah_plan.planning.cost import cost_of
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.limits import Limits, limited_input
from micah_plan.planning.search.polytope import nominal_start
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem


def plan_along(find: Callable[[Attempt], tuple[Floats, str]], attempt: Attempt) -> Plan:
    """The plan along inputs (T, m) that a baseline finds; it also says how it found them, or raises `NoWayError`."""
    inputs, said = find(attempt)
    trajectory = nominal_trajectory(attempt.problem, attempt.limits, attempt.mode, inputs)
    return attempt.solved(trajectory, cost_of(attempt.problem, attempt.limits, trajectory), f": {said}")


def nominal_trajectory(problem: Problem, limits: Limits, mode: str, inputs: Floats) -> Trajectory:
    """The trajectory of inputs (T, m) from the start's mean in a mode, with a knot more for every change of mode."""
    automaton = problem.automaton
    x = nominal_start(problem, limits, mode)
    belief = initial_belief(automaton, x, problem.start.std, mode)
    knots, steps = [(mode, x, belief)], list[tuple[Floats, bool]]()
    for u in inputs:
        cut = limited_input(automaton.mode(mode), x, u, limits.max_step)
        after = step(automaton, mode, x, cut)
        belief = update(automaton, predict(automaton, belief, cut), after.x)
        entered = [event.target for event in after.events if event.source != event.target]
        knots += [(name, after.x, belief) for name in (mode, *entered)]
        steps += [(cut, False), *[(np.zeros(automaton.m), True)] * len(entered)]
        mode, x = after.mode, after.x
    modes, means = tuple(name for name, _, _ in knots), np.array([x for _, x, _ in knots])
    factors = np.array([belief.factors[automaton.mode_index(name)] for name, _, belief in knots])
    applied = np.array([u for u, _ in steps]).reshape(-1, automaton.m)
    is_transition = np.array([is_it for _, is_it in steps], dtype=bool)
    gains = belief_lqr(problem, limits, modes, is_transition)
    return Trajectory(modes, means, factors, applied, gains, is_transition)
