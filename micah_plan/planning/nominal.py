"""A plan from open-loop inputs: what the baselines share, so that they are judged as POMDP-HD is.

The means are those of the real transitions without noise, the covariances those of the hybrid filter with the most
likely measurements, and the feedback is the same belief-LQR.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.transition import step
from micah_plan.belief.filter import initial_belief, predict, update
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.limits import Limits, limited_input
from micah_plan.planning.plan import Plan, Trajectory
from micah_plan.planning.polytope import mode_states
from micah_plan.planning.problem import Problem

Floats = NDArray[np.float64]


def nominal_start(problem: Problem, limits: Limits, mode: str) -> Floats:
    """(n,) the state of the start's mode next to the start's mean, which noise may have put outside of it."""
    states = mode_states(problem.automaton.mode(mode), limits.lower, limits.upper, limits.max_step)
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


def cost_of(problem: Problem, limits: Limits, trajectory: Trajectory) -> float:
    """What the optimisation minimises, without slack: goal error, variance and effort of a trajectory."""
    settings = problem.settings
    cost = settings.weight_effort * float(np.square(trajectory.inputs / limits.max_step).sum())
    for index, value, tolerance in problem.goal.target:
        error = float(trajectory.means[-1, index]) - value
        cost += settings.weight_goal * (error / tolerance) ** 2
        cost += settings.weight_covariance * float(np.square(trajectory.factors[-1, index]).sum()) / tolerance**2
    return cost


def plan_along(
    problem: Problem, limits: Limits, mode: str, inputs: Floats, said: str, seed: int, timings: dict[str, float]
) -> Plan:
    """The plan of inputs (T, m), still to be verified; `said` is how they were found."""
    trajectory = nominal_trajectory(problem, limits, mode, inputs)
    errors = [abs(float(trajectory.means[-1, i]) - value) for i, value, _ in problem.goal.target]
    stds = [float(np.linalg.norm(trajectory.factors[-1, i])) for i, _, _ in problem.goal.target]
    sequence = [q for i, q in enumerate(trajectory.modes) if i == 0 or q != trajectory.modes[i - 1]]
    return Plan(
        "solved",
        f"{' -> '.join(sequence)}: {said}",
        trajectory=trajectory,
        cost=cost_of(problem, limits, trajectory),
        goal_error=max(errors, default=0.0),
        goal_std=max(stds, default=0.0),
        seed=seed,
        timings=timings,
    )


def _factor(problem: Problem, belief: HybridBelief, mode: str) -> Floats:
    """(n, n) of the belief's Gaussian in a mode."""
    number = [q.name for q in problem.automaton.modes].index(mode)
    return np.array(belief.factors[number])
