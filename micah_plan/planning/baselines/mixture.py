"""Direct transcription without a mode hierarchy: one belief over all modes, whose dynamics is their soft mixture.

The belief of a knot is a Gaussian (mean μ, lower Cholesky factor L) and a weight per mode. In a step every mode moves
the Gaussian with its own flow; the share that takes an edge is the smooth probability of its guard,

    p = Φ(t),  t = (a'μ + b'u - c) / sqrt(||L'a||² + s²),

multiplied over its half-spaces, with a softness s of part of a step so that there is a slope from afar; resets and pins
act on the shares, and moment matching makes them one Gaussian again, which the most likely measurement narrows.

Source: the direct baseline of Jain and Niekum, CoRL 2018; Blom and Bar-Shalom, 1988, for the moment matching.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.region import HalfSpace
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.solve import ipopt_options
from micah_plan.symbolic.compiled import CompiledMode, compile_automaton, sensing_std
from micah_plan.symbolic.normal import log_ndtr
from micah_plan.symbolic.square_root import SMALLEST_STD, hold, lower_factor, observe
from micah_plan.task.problem import Problem

Floats = NDArray[np.float64]

# Softness of a guard, in steps across it.
_SOFTNESS = 0.25
# Keeps the square roots of weights and the logarithm of the goal's weight differentiable.
_SMALLEST_WEIGHT = 1e-6
# Cost of a step's length outside of an invariant, squared, in a mode that is certain.
_INVARIANT_WEIGHT = 10.0
_FEASIBLE = 1e-5


@dataclass(frozen=True, eq=False)
class MixturePath:
    """What one start of the optimisation came to.

    Attributes:
        feasible: whether dynamics, limits and goal hold.
        cost: of the result.
        inputs: (T, m) [rad or m].
        weights: (q,) probabilities of the modes at the end, as the mixture sees them.
        status: of the solver.
    """

    feasible: bool
    cost: float
    inputs: Floats
    weights: Floats
    status: str


class MixtureProgramme:
    """The nonlinear programme of T steps, built once and solved from several starts."""

    def __init__(self, problem: Problem, limits: Limits, mode: str, start: Floats, steps: int) -> None:
        """Args: the problem, its limits, the start's mode and mean (n,), and T."""
        self._problem, self._limits, self._steps = problem, limits, steps
        automaton = problem.automaton
        n, m = automaton.n, automaton.m
        self._size = n + n * (n + 1) // 2 + len(automaton.modes)
        self.step = mixture_step(automaton, limits)
        lower = np.tril_indices(n)[::-1]
        factor = np.diag(problem.start.std)[lower[1], lower[0]]
        weights = [float(q.name == mode) for q in automaton.modes]
        self._start = np.concatenate([start, factor, weights])
        self.states, self.inputs = ca.MX.sym("z", self._size, steps + 1), ca.MX.sym("u", m, steps)
        stepped = self.step.map(steps)(self.states[:, :-1], self.inputs)
        scaled = self.inputs / ca.DM(np.repeat(limits.max_step[:, None], steps, axis=1))
        outside = _outside_function(automaton, limits).map(steps + 1)(self.states)
        self.cost = problem.settings.weight_effort * ca.sumsqr(scaled) + _INVARIANT_WEIGHT * ca.sum2(outside)
        self.cost += self._end_cost()
        admissible = _admissible_function(automaton).map(steps)(self.states[:, :-1], self.inputs)
        goal = [self.states[i, -1] for i, _, _ in problem.goal.target]
        self.g = ca.vertcat(ca.vec(self.states[:, 1:] - stepped), ca.vec(admissible), *goal)
        free = admissible.numel()
        self._lower = np.concatenate(
            [np.zeros(self._size * steps + free), [value - tol for _, value, tol in problem.goal.target]]
        )
        self._upper = np.concatenate(
            [
                np.zeros(self._size * steps),
                np.full(free, np.inf),
                [value + tol for _, value, tol in problem.goal.target],
            ]
        )

    def solve(self, inputs: Floats, time_limit_s: float) -> MixturePath:
        """The local optimum next to inputs (T, m), whose belief is rolled out first."""
        rolled = [self._start]
        for u in inputs:
            rolled.append(np.array(self.step(rolled[-1], u), dtype=float).ravel())
        w = ca.vertcat(ca.vec(self.states), ca.vec(self.inputs))
        most = np.repeat(self._limits.max_step[None], self._steps, axis=0).ravel()
        later = np.full(self._size * self._steps, np.inf)
        # All modes in every step are too many scalar operations: they take longer to build than they save.
        options = ipopt_options(time_limit_s, expand=False)
        solver = ca.nlpsol("mixture", "ipopt", {"x": w, "f": self.cost, "g": self.g}, options)
        found = solver(
            x0=np.concatenate([np.array(rolled).ravel(), inputs.ravel()]),
            lbx=np.concatenate([self._start, -later, -most]),
            ubx=np.concatenate([self._start, later, most]),
            lbg=self._lower,
            ubg=self._upper,
        )
        values, rows = (np.array(found[key], dtype=float).ravel() for key in ("x", "g"))
        missed = np.maximum(np.maximum(self._lower - rows, rows - self._upper), 0.0).max()
        cost, at = float(found["f"]), self._size * (self._steps + 1)
        last = values[at - len(self._problem.automaton.modes) : at]
        path = values[at:].reshape(self._steps, -1)
        feasible = bool(np.isfinite(cost)) and float(missed) <= _FEASIBLE
        return MixturePath(feasible, cost, path, last, str(solver.stats()["return_status"]))

    def _end_cost(self) -> ca.MX:
        """Goal error and variance as in the hierarchical programme, and the goal's modes by their log-weight."""
        problem, settings, n = self._problem, self._problem.settings, self._problem.automaton.n
        last, cost = self.states[:, -1], ca.MX(0)
        factor = ca.MX(ca.Sparsity.lower(n), last[n : n + n * (n + 1) // 2])
        for index, value, tolerance in problem.goal.target:
            cost += settings.weight_goal * ((last[index] - value) / tolerance) ** 2
            cost += settings.weight_covariance * ca.sumsqr(factor[index, :]) / tolerance**2
        if problem.goal.modes:
            automaton = problem.automaton
            first = n + n * (n + 1) // 2
            weight = sum((last[first + automaton.mode_index(name)] for name in problem.goal.modes), start=ca.MX(0))
            cost -= ca.log(ca.fmax(weight, 0.0) + _SMALLEST_WEIGHT)
        return cost


def mixture_size(automaton: HybridAutomaton) -> int:
    """How many elementary rotations the moment matching of one step takes: what decides whether it can be built."""
    return (len(automaton.modes) + len(automaton.edges)) * (automaton.n + 1) * automaton.n**2


def mixture_step(automaton: HybridAutomaton, limits: Limits) -> ca.Function:
    """(z, u) -> z: one step of the belief z = (mean, lower factor column by column, weights of the modes)."""
    n, m = automaton.n, automaton.m
    z, u = ca.SX.sym("z", n + n * (n + 1) // 2 + len(automaton.modes)), ca.SX.sym("u", m)
    mean, factor, weights = _unpacked(z, n)
    branches: list[tuple[int, ca.SX, ca.SX, ca.SX]] = []
    compiled = compile_automaton(automaton)
    for number, mode in enumerate(automaton.modes):
        held, spread = _flowed(compiled.modes[mode.name], mean, factor, u)
        left = weights[number]
        for edge in sorted(automaton.edges_from(mode.name), key=lambda e: e.is_self_transition):
            chance = _guard_chance(edge, held, spread, u, limits)
            a, b, c = edge.reset.matrices(n, m)
            pins = [(p.coordinate, p.value, p.std, p.follows) for p in automaton.mode(edge.target).pins]
            reset = ca.mtimes(ca.DM(a), held) + ca.mtimes(ca.DM(b), u) + ca.DM(c)
            after = hold(reset, lower_factor(ca.mtimes(ca.sparsify(ca.DM(a)), spread)), pins)
            branches.append((automaton.mode_index(edge.target), left * chance, *after))
            left = left * (1 - chance)
        branches.append((number, left, held, spread))
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
            seen = observe(middle, mixed, index, 1 / ca.sqrt(information), None)
            middle, mixed = seen.mean, seen.factor
    packed = ca.vec(ca.project(mixed, ca.Sparsity.lower(n)).nz[:])
    return ca.Function("mixture", [z, u], [ca.densify(ca.vertcat(middle, packed, *arrived))])


def _unpacked(z: ca.SX, n: int) -> tuple[ca.SX, ca.SX, ca.SX]:
    entries = n * (n + 1) // 2
    return z[:n], ca.SX(ca.Sparsity.lower(n), z[n : n + entries]), z[n + entries :]


def _information(automaton: HybridAutomaton, mean: ca.SX, weights: list[ca.SX]) -> list[ca.SX]:
    """Inverse variance of a measurement of each coordinate: that of the modes, by their weights."""
    total = [ca.SX(0)] * automaton.n
    for mode, weight in zip(automaton.modes, weights, strict=True):
        for index, std in enumerate(sensing_std(automaton.sensing(mode), mean)):
            if isinstance(std, ca.SX) or np.isfinite(std):
                total[index] += (ca.fmax(weight, 0.0) + _SMALLEST_WEIGHT) / (std**2 + SMALLEST_STD**2)
    return total


def _flowed(compiled: CompiledMode, mean: ca.SX, factor: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Mean and factor after a mode's flow and process noise, its pins held."""
    held = hold(mean, factor, [(pin.coordinate, pin.value, pin.std, pin.follows) for pin in compiled.mode.pins])
    after = compiled.predict.call([*held, u])
    return ca.densify(after[0]), ca.sparsify(after[1])


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
    n = automaton.n
    z = ca.SX.sym("z", n + n * (n + 1) // 2 + len(automaton.modes))
    mean, _, weights = _unpacked(z, n)
    total = ca.SX(0)
    for number, mode in enumerate(automaton.modes):
        for row in (h for h in mode.invariant.half_spaces if not h.on_input):
            short = (row.c - ca.dot(ca.DM(row.a), mean)) / _scale(row, limits)
            total += weights[number] * ca.fmax(short, 0.0) ** 2
    return ca.Function("outside", [z], [total])


def _admissible_function(automaton: HybridAutomaton) -> ca.Function:
    """(z, u) -> margins of the admissible inputs that all modes share; the others are cut when the plan is executed."""
    n = automaton.n
    z, u = ca.SX.sym("z", n + n * (n + 1) // 2 + len(automaton.modes)), ca.SX.sym("u", automaton.m)
    first, *others = (mode.inputs.half_spaces for mode in automaton.modes)
    shared = [h for h in first if all(h in rows for rows in others)]
    rows = [ca.dot(ca.DM(h.a), z[:n]) + ca.dot(ca.DM(h.b), u) - h.c for h in shared]
    return ca.Function("admissible", [z, u], [ca.vertcat(*rows) if rows else ca.SX(0, 1)])
