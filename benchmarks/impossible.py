"""Whether a placement is impossible, by means that no planner uses: places, and Gaussians, drawn at random.

- The object, put at thousands of places of the goal, meets a body at each; or the arm cannot hold it at any of them.
- What is free of the goal is narrower than anybody can be sure of: no filter knows a coordinate better than its Kalman
  filter does in the long run, or that many steps after a contact told it, as the way from there takes at least. Where
  the true state is free along w, a plan ends there with a probability of at most 2 Φ(w / 2σ) - 1, wherever it aims.
- What the inputs of a mode keep (how a hand holds a rod) is as it was when the mode was entered: a linear programme
  over a state in which that may be, and one in the mode that keeps the same, says how far a coordinate can be moved.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import linprog
from scipy.stats import norm

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Edge, Mode
from micah_plan.planning.limits import limits_of
from micah_plan.task.body import corners as body_corners
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem

# Places of the object, and of them those at which the arm is asked.
_PLACES, _ASKED = 4000, 60
# No object here is longer from the hand to where it touches [m].
_LONGEST = 0.15
# Postures that each of these is tried from.
_TRIES = 20


def free_places(problem: Problem, seed: int) -> Floats:
    """(k, n) states of the goal, in a mode that counts, in which neither the object nor the hand meets a body."""
    carried, rng, found = pre_release_problem(problem), np.random.default_rng(seed), list[Floats]()
    automaton, low, high = carried.automaton, *np.array([(-0.3, 1.0)] * 4).T
    for index, value, tolerance in carried.goal.target:
        low[index], high[index] = value - tolerance, value + tolerance
    for mode in automaton.modes:
        own = [mode.interval(i) for i in range(automaton.n)]
        ends = [(max(a, c), min(b, d)) for a, b, (c, d) in zip(low, high, own, strict=True)]
        if mode.name == "collided" or not carried.goal.admits(mode.name) or any(a > b for a, b in ends):
            continue
        states = rng.uniform(*np.array(ends).T, (_PLACES, automaton.n))
        free = np.ones(len(states), dtype=bool)
        for edge in automaton.edges_from(mode.name):
            if edge.target == "collided":
                free &= ~(edge.guard.margins(states, np.zeros((len(states), automaton.m))) > 0.0).all(axis=1)
        places = states[free]
        if problem.robot is not None:
            places = np.array([x for x in places[:_ASKED] if holds(problem, mode.name, x)]).reshape(-1, automaton.n)
        found.append(places)
    return np.concatenate(found) if found else np.empty((0, automaton.n))


def holds(problem: Problem, mode: str, x: Floats) -> bool:
    """Whether the arm can hold the object in a state, and lower it to let it go."""
    from micah_plan.robot.along_plan import problem_clearance, tool_path
    from micah_plan.robot.tool_path import ArmFailure, PathSettings, follow

    states = x[None]
    if problem.release is not None:
        from micah_plan.task.release import rest_of

        rest = rest_of(problem)
        states = np.tile(x, (3, 1))
        states[:, 2] = np.linspace(x[2], rest.top + rest.touching, 3)
    path = tool_path(problem, [mode] * len(states), states)
    if problem.release is not None and problem.hold is not None:
        grip = problem.hold.grip
        meet = frozenset((part.name, problem.release.support) for part in (grip.held, grip.moving))
        path = type(path)(path.tool, path.parts, [meet] * len(states))
    few = PathSettings(starts=_TRIES, followed=2, enough=1)
    return not isinstance(follow(problem_clearance(problem), path, 0, few), ArmFailure)


def least_std(problem: Problem, coordinate: int, steps: int = 0) -> float:
    """How well a true coordinate can be known when the last input arrives, that many steps after the start at least."""
    automaton = problem.automaton
    q, r = automaton.noise.process_std[coordinate] ** 2, automaton.noise.observation_std[coordinate] ** 2
    variances = [0.5 * (q + np.sqrt(q * q + 4.0 * q * r)), _later(problem.start.std[coordinate] ** 2, steps, q, r) + q]
    target = {index: (value, tolerance) for index, value, tolerance in pre_release_problem(problem).goal.target}
    for name, axis, sign in problem.hold.contacts if problem.hold is not None else ():
        if axis != coordinate:
            continue
        # What a contact tells is exact at best; the object is no longer than its arms from where the hand is then.
        body = next(body for body in problem.scene if body.name == name)
        ends = [body.pose.apply(body_corners(shape))[:, axis] for shape in body.shapes]
        face = max(map(np.max, ends)) if sign > 0 else min(map(np.min, ends))
        value, tolerance = target.get(axis, (face, 0.0))
        away = max(0.0, abs(value - face) - tolerance - _LONGEST)
        variances.append(_later(0.0, int(away / limits_of(problem).max_step[axis]), q, r) + q)
    return float(np.sqrt(min(variances)))


def is_out_of_reach(problem: Problem) -> bool:
    """Whether a target lies where no mode that moves its coordinate can take it, entered wherever it may be."""
    automaton = problem.automaton
    for index, value, tolerance in problem.goal.target:
        ranges = [
            own
            for mode in automaton.modes
            if mode.B[index].any()
            for taken in (None, *(edge for edge in automaton.edges if edge.target == mode.name))
            if (own := _moved_range(problem, mode, taken, index)) is not None
        ]
        if ranges and all(high < value - tolerance or low > value + tolerance for low, high in ranges):
            return True
    return False


def _moved_range(problem: Problem, mode: Mode, taken: Edge | None, index: int) -> tuple[float, float] | None:
    """Range of a coordinate in a mode that was entered by an edge; None: from the start. None if it cannot be."""
    automaton, n = problem.automaton, problem.automaton.n
    source = automaton.mode(taken.source) if taken is not None else mode
    rows = [(h, 0) for h in mode.invariant.half_spaces] + [(h, n) for h in source.invariant.half_spaces]
    rows += [(h, n) for h in taken.guard.half_spaces] if taken is not None else []
    rows = [(h, at) for h, at in rows if not h.on_input]
    A, b = np.zeros((len(rows), 2 * n)), np.array([-h.c for h, _ in rows])
    for k, (h, at) in enumerate(rows):
        A[k, at : at + n] = -np.array(h.a)
    kept = null_space(mode.B.T).T
    ends = [(None, None)] * n
    if taken is None:
        if mode.name != (problem.start.mode or automaton.modes[0].name):
            return None
        ends += [(m - 5.0 * s, m + 5.0 * s) for m, s in zip(problem.start.mean, problem.start.std, strict=True)]
    else:
        ends += [(None, None)] * n
    found = []
    for sign in (1.0, -1.0):
        cost = np.zeros(2 * n)
        cost[index] = sign
        answer = linprog(cost, A, b, np.hstack([kept, -kept]), np.zeros(len(kept)), ends)
        if answer.status == 2:
            return None
        found.append(answer.fun * sign if answer.status == 0 else -np.inf * sign)
    return found[0], found[1]


def _later(variance: float, steps: int, q: float, r: float) -> float:
    """A variance after steps with noise of variance q and measurements of variance r."""
    for _ in range(steps):
        variance = 1.0 / (1.0 / (variance + q) + 1.0 / r)
    return variance


def highest_share_entering(problem: Problem) -> float:
    """The probability of a true state within the modes of the goal as they are entered, at most.

    1 where something tells more than the sensor, or the start is in such a mode.
    """
    automaton, goal, start = problem.automaton, problem.goal, problem.start
    told = any(mode.pins or mode.ties or mode.observation_std for mode in automaton.modes) or automaton.noise.light
    if told or not goal.modes or goal.admits(start.mode or automaton.modes[0].name):
        return 1.0
    share, limits = 0.0, limits_of(problem)
    for mode in (mode for mode in automaton.modes if goal.admits(mode.name)):
        ends = np.array([mode.interval(i) for i in range(automaton.n)])
        nearest = np.clip(start.mean, ends[:, 0], ends[:, 1])
        away = np.maximum(0.0, np.abs(nearest - start.mean) - 3.0 * np.array(start.std))
        steps = int((away / limits.speed).max())
        stds = np.array([least_std(problem, i, steps) for i in range(automaton.n)])
        share += float(np.prod(2.0 * norm.cdf(0.5 * np.ptp(ends, axis=1) / stds) - 1.0))
    return min(1.0, share)


def highest_share(problem: Problem, places: Floats) -> float:
    """The probability with which any plan ends in what is free of a goal, at most."""
    share = 1.0
    if len(places) < 2:
        return 0.0
    for index in (i for i, _, _ in pre_release_problem(problem).goal.target if i < 3):
        width = float(np.ptp(places[:, index])) * (1.0 + 4.0 / len(places))
        std = least_std(problem, index)
        share *= 1.0 if std == 0.0 else float(2.0 * norm.cdf(0.5 * width / std) - 1.0)
    return share
