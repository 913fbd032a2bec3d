"""A baseline: direct planning in belief space over the soft mixture of all modes, without choosing a mode sequence.

The belief of a knot is a Gaussian (mean μ, lower Cholesky factor L) and a weight per mode. In a step every mode moves
the Gaussian with its own flow; the share that takes an edge is the smooth probability of its guard,

    p = Φ(t),  t = (a'μ + b'u - c) / sqrt(||L'a||² + s²),

multiplied over its half-spaces, with a softness s of part of a step so that there is a slope from afar; resets and pins
act on the shares, and moment matching makes them one Gaussian again, which the most likely measurement narrows.

Source: the direct baseline of Jain and Niekum, CoRL 2018; Blom and Bar-Shalom, 1988, for the moment matching.

A plan from open-loop inputs: what the baselines share, so that they are judged as POMDP-HD is.

A baseline finds inputs; the rest is here. The means are those of the real transitions without noise, the covariances
those of the hybrid filter with the most likely measurements, and the feedback is the same belief-LQR.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import casadi as ca
import numpy as np

from micah_plan.arrays import SMALLEST_STD, Floats
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.transition import step
from micah_plan.belief.filter import initial_belief, predict_belief, update
from micah_plan.planning.attempt import Attempt, attempt_plan
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.limits import Limits, limited_input
from micah_plan.planning.nlp import Programme, Solution, Solver
from micah_plan.planning.no_way import NoWayError
from micah_plan.planning.plan_cost import cost_of, effort_cost, goal_cost, variance_cost
from micah_plan.planning.search.polytope import nominal_start
from micah_plan.planning.transcription.packed_belief import pack, packed
from micah_plan.summaries import Progress
from micah_plan.symbolic.compiled import compiled_mode, sensing_std
from micah_plan.symbolic.square_root import lower_factor, observe, put_at
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Reason

Expression = TypeVar("Expression", ca.MX, ca.SX)

# Starts that are tried: the straight line and disturbed ones.
_STARTS = 4
# Std of the disturbance, in largest steps.
_DISTURBANCE = 0.5
# Steps to spare on the straight line.
_SPARE_STEPS = 5
# From this many elementary rotations in the moment matching of a step, building the programme would take minutes.
_LARGEST = 20_000
# Softness of a guard, in steps across it.
_SOFTNESS = 0.25
# Keeps the square roots of weights and the logarithm of the goal's weight differentiable.
_SMALLEST_WEIGHT = 1e-6
# Cost of a step's length outside of an invariant, squared, in a mode that is certain.
_INVARIANT_WEIGHT = 10.0
# Below it log Φ is computed from a continued fraction with that many levels: an error of 1e-12 at the seam.
_TAIL, _LEVELS = -5.0, 24


def plan(problem: Problem, seed: int = 0, progress: Progress | None = None, deadline: Deadline | None = None) -> Plan:
    """The cheapest local optimum of the mixture's programme over a few starts, or the reason why there is none."""
    return attempt_plan(partial(plan_along, _optimised), "optimisation", problem, seed, progress, deadline)


def _optimised(attempt: Attempt) -> tuple[Floats, str]:
    """(T, m) inputs of the cheapest local optimum, and what it is."""
    problem, limits, deadline = attempt.problem, attempt.limits, attempt.deadline
    modes, edges, n = len(problem.automaton.modes), len(problem.automaton.edges), problem.automaton.n
    if (modes + edges) * (n + 1) * n**2 > _LARGEST:
        mixture = f"the mixture of {modes} modes and {edges} transitions in {n} dimensions"
        sentence = f"{mixture} is too large for direct planning"
        raise NoWayError(Reason("search_limit_reached", sentence, ("use the method pomdp-hd",)))
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
    usable = [(path, inputs) for path, inputs in found if path.is_feasible]
    if not usable:
        said = ", ".join(sorted({path.status for path, _ in found})) or "none"
        deadline.check("optimisation", f"{len(found)} of {_STARTS} starts were tried ({said})")
        sentence = f"none of {len(found)} starts of the direct optimisation led to the goal ({said})"
        raise NoWayError(Reason("optimisation_failed", sentence, ("use the method pomdp-hd",)))
    inputs = min(usable, key=lambda pair: pair[0].cost)[1]
    return inputs, f"cheapest of {len(usable)} local optima of the soft mixture"


def _straight(problem: Problem, limits: Limits, x: Floats) -> Floats:
    """(T, m) equal inputs that would lead the mean straight to the target if all modes moved as the most mobile do."""
    stacked = np.stack([mode.B for mode in problem.automaton.modes])
    B = np.take_along_axis(stacked, np.abs(stacked).argmax(axis=0)[None], axis=0)[0]
    total = np.linalg.pinv(B) @ (problem.goal.reached_from(x) - x)
    shortest = float(np.max(np.abs(total) / limits.max_step, initial=0.0))
    wanted = int(np.ceil(shortest / problem.settings.pace)) + _SPARE_STEPS
    steps = int(np.clip(wanted, 1, problem.settings.max_knots - 1))
    return np.repeat(total[None] / steps, steps, axis=0)


class MixtureProgramme:
    """The nonlinear programme of T steps, built once and solved from several starts."""

    def __init__(self, problem: Problem, limits: Limits, mode: str, start: Floats, steps: int) -> None:
        """Args: the problem, its limits, the start's mode and mean (n,), and T."""
        automaton, n, m = problem.automaton, problem.automaton.n, problem.automaton.m
        self._step = mixture_step(automaton, limits)
        size, weights = self._step.size1_in(0), [float(name == mode) for name in automaton.mode_names]
        belief = pack(start[None], np.diag(problem.start.std)[None], ca.Sparsity.lower(n))
        self._start = np.append(belief, weights)
        states, inputs = ca.MX.sym("z", size, steps + 1), ca.MX.sym("u", m, steps)
        largest = np.repeat(limits.max_step[:, None], steps, axis=1)
        outside = _outside_function(automaton, limits).map(steps + 1)(states)
        cost = effort_cost(problem, ca.sumsqr(inputs / ca.DM(largest))) + _INVARIANT_WEIGHT * ca.sum2(outside)
        stepped = self._step.map(steps)(states[:, :-1], inputs)
        admissible = _admissible_function(automaton).map(steps)(states[:, :-1], inputs)
        goal = [states[i, -1] for i, _, _ in problem.goal.target]
        middle, tolerance = (np.array([target[i] for target in problem.goal.target]) for i in (1, 2))
        most, later = largest.ravel(order="F"), np.full(size * steps, np.inf)
        exact, open_ = np.zeros(size * steps), np.full(admissible.numel(), np.inf)
        self._programme = Programme(
            w=ca.vertcat(ca.vec(states), ca.vec(inputs)),
            cost=cost + _end_cost(problem, states[:, -1]),
            rows=ca.vertcat(ca.vec(states[:, 1:] - stepped), ca.vec(admissible), *goal),
            start=np.zeros(states.numel() + inputs.numel()),
            bounds=(np.concatenate([self._start, -later, -most]), np.concatenate([self._start, later, most])),
            row_bounds=(
                np.concatenate([exact, np.zeros_like(open_), middle - tolerance]),
                np.concatenate([exact, open_, middle + tolerance]),
            ),
        )

    def solve(self, inputs: Floats, time_limit_s: float) -> tuple[Solution, Floats]:
        """The local optimum next to inputs (T, m), whose belief is rolled out first, and its own inputs (T, m)."""
        rolled = [self._start]
        for u in inputs:
            rolled.append(np.array(self._step(rolled[-1], u), dtype=float).ravel())
        start = np.concatenate([np.array(rolled).ravel(), inputs.ravel()])
        # All modes in every step are too many scalar operations: they take longer to build than they save.
        found = Solver(self._programme, time_limit_s, expand=False).solve(start)
        return found, found.w[-inputs.size :].reshape(inputs.shape)


def _end_cost(problem: Problem, last: ca.MX) -> ca.MX:
    """Goal error and variance of the last belief, and the goal's modes by their log-weight."""
    automaton = problem.automaton
    mean, factor, weights = _unpacked(last, automaton.n)
    squares = {index: ca.sumsqr(factor[index, :]) for index in problem.goal.indices}
    cost: ca.MX = goal_cost(problem, mean) + variance_cost(problem, squares)
    if problem.goal.modes:
        weight = sum((weights[automaton.mode_index(name)] for name in problem.goal.modes), start=ca.MX(0))
        cost -= ca.log(ca.fmax(weight, 0.0) + _SMALLEST_WEIGHT)
    return cost


def mixture_step(automaton: HybridAutomaton, limits: Limits) -> ca.Function:
    """(z, u) -> z: one step of the belief z = (mean, lower factor column by column, weights of the modes)."""
    n, m = automaton.n, automaton.m
    z, (mean, factor, weights) = _symbols(automaton)
    u = ca.SX.sym("u", m)
    branches: list[tuple[int, ca.SX, ca.SX, ca.SX]] = []
    for number, mode in enumerate(automaton.modes):
        flow = compiled_mode(automaton, mode.name).predict
        after = flow.call([*put_at(mean, factor, mode.pins), u])
        moved, spread, left = ca.densify(after[0]), ca.sparsify(after[1]), weights[number]
        for edge in sorted(automaton.edges_from(mode.name), key=lambda e: e.is_self_transition):
            chance = _guard_chance(edge, moved, spread, u, limits)
            a, b, c = edge.reset.matrices(n, m)
            reset = ca.mtimes(ca.DM(a), moved) + ca.mtimes(ca.DM(b), u) + ca.DM(c)
            carried = lower_factor(ca.mtimes(ca.sparsify(ca.DM(a)), spread))
            entered = put_at(reset, carried, automaton.mode(edge.target).pins)
            branches.append((automaton.mode_index(edge.target), left * chance, *entered))
            left = left * (1 - chance)
        branches.append((number, left, moved, spread))
    arrived = [ca.SX(0)] * len(automaton.modes)
    for target, weight, _, _ in branches:
        arrived[target] += weight
    middle = sum((weight * center for _, weight, center, _ in branches), start=ca.SX(n, 1))
    columns = []
    for _, weight, center, spread in branches:
        root = ca.sqrt(ca.fmax(weight, 0.0) + _SMALLEST_WEIGHT**2)
        columns += [root * spread, root * (center - middle)]
    mixed = lower_factor(ca.sparsify(ca.horzcat(*columns)))
    for index, information in enumerate(_information(automaton, middle, arrived)):
        if not information.is_zero():
            middle, mixed = observe(middle, mixed, index, 1 / ca.sqrt(information))
    arrived_at = ca.vertcat(packed((middle, mixed), ca.Sparsity.lower(n)), *arrived)
    return ca.Function("mixture", [z, u], [ca.densify(arrived_at)])


def _symbols(automaton: HybridAutomaton) -> tuple[ca.SX, tuple[ca.SX, ca.SX, ca.SX]]:
    """A belief z as one symbol, and what is in it."""
    n = automaton.n
    z = ca.SX.sym("z", n + n * (n + 1) // 2 + len(automaton.modes))
    return z, _unpacked(z, n)


def _unpacked(z: Expression, n: int) -> tuple[Expression, Expression, Expression]:
    """Mean (n, 1), lower factor (n, n) and weights (q, 1) of a belief."""
    entries = n * (n + 1) // 2
    return z[:n], type(z)(ca.Sparsity.lower(n), z[n : n + entries]), z[n + entries :]


def _information(automaton: HybridAutomaton, mean: ca.SX, weights: list[ca.SX]) -> list[ca.SX]:
    """Inverse variance of a measurement of each coordinate: that of the modes, by their weights."""
    total = [ca.SX(0)] * automaton.n
    for mode, weight in zip(automaton.modes, weights, strict=True):
        for index, std in enumerate(sensing_std(automaton.sensing(mode), mean)):
            if isinstance(std, ca.SX) or np.isfinite(std):
                total[index] += (ca.fmax(weight, 0.0) + _SMALLEST_WEIGHT) / (std**2 + SMALLEST_STD**2)
    return total


def _guard_chance(edge: Edge, mean: ca.SX, factor: ca.SX, u: ca.SX, limits: Limits) -> ca.SX:
    """The smooth probability that a guard holds; rows on pinned or free coordinates alike."""
    log_chance = ca.SX(0)
    for half_space in edge.guard.half_spaces:
        a = ca.DM(half_space.a)
        margin = ca.dot(a, mean) + ca.dot(ca.DM(half_space.b), u) - half_space.c
        variance = ca.sumsqr(ca.mtimes(factor.T, a)) + (_SOFTNESS * _scale(half_space, limits)) ** 2
        log_chance += log_ndtr(margin / ca.sqrt(variance + edge.threshold_std**2))
    return ca.exp(log_chance)


def _scale(half_space: HalfSpace, limits: Limits) -> float:
    return float(np.abs(half_space.a) @ limits.speed + np.abs(half_space.b) @ limits.max_step) or 1.0


def _outside_function(automaton: HybridAutomaton, limits: Limits) -> ca.Function:
    """z -> squared steps outside of the invariants on x, weighted by the modes."""
    z, (mean, _, weights) = _symbols(automaton)
    total = ca.SX(0)
    for number, mode in enumerate(automaton.modes):
        for row in (h for h in mode.invariant.half_spaces if not h.on_input):
            short = (row.c - ca.dot(ca.DM(row.a), mean)) / _scale(row, limits)
            total += weights[number] * ca.fmax(short, 0.0) ** 2
    return ca.Function("outside", [z], [total])


def _admissible_function(automaton: HybridAutomaton) -> ca.Function:
    """(z, u) -> margins of the admissible inputs that all modes share; the others are cut when the plan is executed."""
    z, (mean, _, _) = _symbols(automaton)
    u, (first, *others) = ca.SX.sym("u", automaton.m), [mode.inputs.half_spaces for mode in automaton.modes]
    shared = [h for h in first if all(h in rows for rows in others)]
    rows = [ca.dot(ca.DM(h.a), mean) + ca.dot(ca.DM(h.b), u) - h.c for h in shared]
    return ca.Function("admissible", [z, u], [ca.vertcat(ca.SX(0, 1), *rows)])


def log_ndtr(t: ca.SX) -> ca.SX:
    """log Φ(t), element by element, with finite derivatives of all orders for |t| up to 1e100; of Φ to 1e-9.

    log(0.5 (1 + erf(t / √2))) is -inf below t = -8, where 1 + erf cancels. In the tail the reciprocal of Mills' ratio
    is taken from Laplace's continued fraction instead, 1 / (x + 1 / (x + 2 / (x + 3 / ...))), which converges for
    x = -t > 0.

    Source: Abramowitz and Stegun, "Handbook of Mathematical Functions", 26.2.14. NumPy twin: `scipy.special.log_ndtr`.
    """
    # Both branches are evaluated, so each gets only arguments of its own range; fmin would halve the slope at the seam.
    x, near = ca.if_else(t < _TAIL, -t, -_TAIL), ca.if_else(t < _TAIL, _TAIL, t)
    fraction = x
    for level in range(_LEVELS, 0, -1):
        fraction = x + level / fraction
    tail = -0.5 * x**2 - 0.5 * np.log(2 * np.pi) - ca.log(fraction)
    return ca.if_else(t < _TAIL, tail, ca.log(0.5 * (1 + ca.erf(near / np.sqrt(2)))))


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
        belief = update(automaton, predict_belief(automaton, belief, cut), after.x)
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
