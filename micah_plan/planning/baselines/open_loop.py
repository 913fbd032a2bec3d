"""A plan from open-loop inputs: what the baselines share, so that they are judged as POMDP-HD is.

A baseline finds inputs; what comes before and after is here. The means are those of the real transitions without noise,
the covariances those of the hybrid filter with the most likely measurements, and the feedback is the same belief-LQR.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.transition import step
from micah_plan.belief.filter import initial_belief, predict, update
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.attempt import Attempt
from micah_plan.planning.cost import cost_of
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.limits import Limits, limited_input
from micah_plan.planning.search.polytope import mode_states
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem


def plan_along(find: Callable[[Attempt], tuple[Floats, str]], attempt: Attempt) -> Plan:
    """The plan along inputs (T, m) that a baseline finds; it also says how it found them, or raises `NoWayError`."""
    inputs, said = find(attempt)
    trajectory = nominal_trajectory(attempt.problem, attempt.limits, attempt.mode, inputs)
    return attempt.solved(trajectory, cost_of(attempt.problem, attempt.limits, trajectory), f": {said}")


def nominal_start(problem: Problem, limits: Limits, mode: str) -> Floats:
    """(n,) the state of the start's mode next to the start's mean, which noise may have put outside of it."""
    states = mode_states(problem.automaton.mode(mode), limits)
    return states.nearest(np.array(problem.start.mean, dtype=float))


def nominal_trajectory(problem: Problem, limits: Limits, mode: str, inputs: Floats) -> Trajectory:
    """The trajectory of inputs (T, m) from the start's mean in a mode, with a knot more for every change of mode."""
    automaton = problem.automaton
    x = nominal_start(problem, limits, mode)
    belief = initial_belief(automaton, x, problem.start.std, mode)
    modes, means, factors = [mode], [x], [_factor(problem, belief, mode)]
    applied: list[Floats] = []
    is_transition: list[bool] = []
    for u in inputs:
        cut = limited_input(automaton.mode(mode), x, u, limits.max_step)
        after = step(automaton, mode, x, cut)
        belief = update(automaton, predict(automaton, belief, cut), after.x)
        entered = [event.target for event in after.events if event.source != event.target]
        for number, name in enumerate([mode, *entered]):
            modes.append(name)
            means.append(after.x)
            factors.append(_factor(problem, belief, name))
            applied.append(cut if number == 0 else np.zeros(automaton.m))
            is_transition.append(number > 0)
        mode, x = after.mode, after.x
    flags = np.array(is_transition, dtype=bool)
    gains = belief_lqr(problem, limits, tuple(modes), flags)
    shaped = np.array(applied).reshape(-1, automaton.m)
    return Trajectory(tuple(modes), np.array(means), np.array(factors), shaped, gains, flags)


def _factor(problem: Problem, belief: HybridBelief, mode: str) -> Floats:
    """(n, n) of the belief's Gaussian in a mode."""
    return np.array(belief.factors[problem.automaton.mode_index(mode)])
