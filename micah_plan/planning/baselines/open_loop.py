"""A plan from open-loop inputs: what the baselines share, so that they are judged as POMDP-HD is.

A baseline finds inputs; what comes before and after is here. The means are those of the real transitions without noise,
the covariances those of the hybrid filter with the most likely measurements, and the feedback is the same belief-LQR.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.transition import step
from micah_plan.belief.filter import initial_belief, predict, update
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.findings import endpoint_findings, finding_of_reason
from micah_plan.planning.limits import Limits, limited_input, limits_of
from micah_plan.planning.search.polytope import mode_states
from micah_plan.task.clock import Clock
from micah_plan.task.deadline import Deadline, TimeLimitError
from micah_plan.task.plan import Level, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.start import start_mode

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Task:
    """What a baseline is to do.

    Attributes:
        limits: of the problem.
        mode: that the start is in.
        seed: of all that is random.
        deadline: when to end.
        clock: of its stages.
    """

    problem: Problem
    limits: Limits
    mode: str
    seed: int
    deadline: Deadline
    clock: Clock


class NoWayError(Exception):
    """A baseline found no inputs; `reason` says why and ends with the remedy."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


def plan_by(
    find: Callable[[Task], tuple[Floats, str]], level: Level, problem: Problem, seed: int, deadline: Deadline | None
) -> Plan:
    """The plan, still to be verified, along inputs that a baseline finds, or the reason why there are none.

    Args:
        find: gives inputs (T, m) and how they were found; raises NoWayError or TimeLimitError.
        level: where it fails if it does.
        deadline: None: as the settings say, from now on.
    """
    clock, deadline = Clock(), deadline or Deadline(problem.settings.solve_time_limit_s)
    mode, reason = start_mode(problem.automaton, problem.start)
    if mode is not None:
        limits = limits_of(problem)
        try:
            inputs, said = find(Task(problem, limits, mode, seed, deadline, clock))
            return _plan_along(problem, limits, mode, inputs, said, seed, clock.timings())
        except (NoWayError, TimeLimitError) as failed:
            reason = failed.reason
    findings = endpoint_findings(problem) or (finding_of_reason(level, reason),)
    return Plan("no_plan", reason, seed=seed, timings=clock.timings(), findings=findings)


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


def _plan_along(
    problem: Problem, limits: Limits, mode: str, inputs: Floats, said: str, seed: int, timings: dict[str, float]
) -> Plan:
    """The plan of inputs (T, m), still to be verified; `said` is how they were found."""
    trajectory = nominal_trajectory(problem, limits, mode, inputs)
    sequence = [q for i, q in enumerate(trajectory.modes) if i == 0 or q != trajectory.modes[i - 1]]
    return Plan(
        "solved",
        f"{' -> '.join(sequence)}: {said}",
        trajectory=trajectory,
        cost=cost_of(problem, limits, trajectory),
        goal_error=problem.goal.error(trajectory.means[-1]),
        goal_std=problem.goal.std(trajectory.factors[-1]),
        seed=seed,
        timings=timings,
    )


def _factor(problem: Problem, belief: HybridBelief, mode: str) -> Floats:
    """(n, n) of the belief's Gaussian in a mode."""
    return np.array(belief.factors[problem.automaton.mode_index(mode)])
