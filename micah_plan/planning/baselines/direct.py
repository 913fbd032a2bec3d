"""A baseline: direct planning in belief space over the soft mixture of all modes, without choosing a mode sequence."""

from __future__ import annotations

from functools import partial

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.planning.attempt import Attempt, NoWayError, Progress, attempted
from micah_plan.planning.baselines.mixture import MixtureProgramme, mixture_size
from micah_plan.planning.baselines.open_loop import nominal_start, plan_along
from micah_plan.planning.limits import Limits
from micah_plan.planning.nlp import Solution
from micah_plan.planning.search.motion import PACE
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

# The straight line and so many disturbed ones are tried.
_STARTS = 4
# Std of the disturbance, in largest steps.
_DISTURBANCE = 0.5
# Steps to spare on the straight line.
_SPARE_STEPS = 5
# Rotations per step from which building the programme would take minutes.
_LARGEST = 20_000


def plan(problem: Problem, seed: int = 0, progress: Progress | None = None, deadline: Deadline | None = None) -> Plan:
    """The cheapest local optimum of the mixture's programme over a few starts, or the reason why there is none."""
    return attempted(partial(plan_along, _optimised), "optimisation", problem, seed, progress, deadline)


def _optimised(attempt: Attempt) -> tuple[Floats, str]:
    """(T, m) inputs of the cheapest local optimum, and what it is."""
    problem, limits, deadline = attempt.problem, attempt.limits, attempt.deadline
    if mixture_size(problem.automaton) > _LARGEST:
        modes, edges = len(problem.automaton.modes), len(problem.automaton.edges)
        raise NoWayError(
            f"the mixture of {modes} modes and {edges} transitions in {problem.automaton.n} dimensions is too large "
            f"for direct planning; use the method pomdp-hd"
        )
    with attempt.clock.stage("build"):
        x = nominal_start(problem, limits, attempt.mode)
        straight = _straight(problem, limits, x)
        programme = MixtureProgramme(problem, limits, attempt.mode, x, len(straight))
    rng, found = np.random.default_rng(attempt.seed), list[tuple[Solution, Floats]]()
    for number in range(_STARTS):
        attempt.progress(f"optimising from start {number + 1}", number / _STARTS)
        if deadline.is_over():
            break
        noise = _DISTURBANCE * limits.max_step * rng.standard_normal(straight.shape) if number else 0.0
        start = np.clip(straight + noise, -limits.max_step, limits.max_step)
        with attempt.clock.stage("optimise"):
            found.append(programme.solve(start, min(deadline.left_s, problem.settings.time_limit_s)))
    usable = [(path.cost, number) for number, (path, _) in enumerate(found) if path.is_feasible]
    if not usable:
        said = ", ".join(sorted({path.said for path, _ in found})) or "none"
        deadline.check("optimisation", f"{len(found)} of {_STARTS} starts were tried ({said})")
        raise NoWayError(f"none of {len(found)} starts of the direct optimisation led to the goal ({said})")
    return found[min(usable)[1]][1], f"cheapest of {len(usable)} local optima of the soft mixture"


def _straight(problem: Problem, limits: Limits, x: Floats) -> Floats:
    """(T, m) equal inputs that would lead the mean straight to the target if all modes moved as the most mobile do."""
    automaton = problem.automaton
    target = x.copy()
    for index, value, _ in problem.goal.target:
        target[index] = value
    stacked = np.stack([mode.B for mode in automaton.modes])
    strongest = np.abs(stacked).argmax(axis=0)
    B = np.take_along_axis(stacked, strongest[None], axis=0)[0]
    total = np.linalg.pinv(B) @ (target - x)
    wanted = int(np.ceil(np.max(np.abs(total) / limits.max_step, initial=0.0) / PACE)) + _SPARE_STEPS
    steps = int(np.clip(wanted, 1, problem.settings.max_knots - 1))
    return np.repeat(total[None] / steps, steps, axis=0)
