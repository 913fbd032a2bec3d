"""Path constraints of a phase: boundaries of the model on x, and the user's constraints.

A margin g(x, u) >= 0 of a constraint on the path (`task.path`) is planned to hold with the confidence, linearised at
the mean μ: with a = ∂g/∂x and b = ∂g/∂u there,

    g(μ, u) >= k sqrt(||L'a||² + (a, b)' Σ (a, b)),

where Σ is the covariance of estimate and input together in closed loop: real measurements move the estimate, and the
feedback moves the input with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.optimize import linprog

from micah_plan.arrays import SMALLEST_STD, Floats, Ints
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.input_reversal import input_reversal_of
from micah_plan.automaton.region import HalfSpace
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.guess import PhaseGuess, crossed
from micah_plan.planning.transcription.packed_belief import factor_of, pack
from micah_plan.planning.transcription.rows import Row, boundary_name, unit_of
from micah_plan.planning.zero_time_transitions import ZeroTimeEdge, front_of
from micah_plan.symbolic.casadi_operations import CasadiOperations
from micah_plan.task.path import Pay, Require, path_terms
from micah_plan.task.problem import Problem

# Half-spaces within so many times k-sigma of a step are near; how far places around it are, in k-sigma.
_BESIDE, _SIZES = 4.0, (1.0, 2.0, 3.5)


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a boundary along a phase of N steps: sign * (a'mean - c) >= 0.

    Attributes:
        row: constraint on the mean at the first knot of the phase.
        normal, offset: sign * a (n,) and sign * c.
        scale: length of one step across it [its unit].
        spreads: (N+1,) variance across it by which the estimate wanders in closed loop and that of the boundary itself
            where it is a threshold, to be added to the belief's.
        margins, stds: (N+1,) of the guess, with the spread.
    """

    row: Row
    normal: Floats
    offset: float
    scale: float
    spreads: Floats
    margins: Floats
    stds: Floats


class CorridorRow(NamedTuple):
    """One side of a boundary at one knot.

    Attributes:
        side: of the boundary.
        step: knot within the phase, from 1.
        uncertain: whether it holds at k-sigma; otherwise (a clamp) for the mean only.
    """

    side: Side
    step: int
    uncertain: bool

    @property
    def row(self) -> Row:
        """The constraint on the mean."""
        return self.side.row._replace(knot=self.side.row.knot + self.step)

    def slack_start(self, k: float) -> float:
        """The slack that makes the guess feasible [steps]."""
        side = self.side
        return max(0.0, k * float(side.stds[self.step]) - float(side.margins[self.step])) / side.scale


def corridor(automaton: HybridAutomaton, limits: Limits, guess: PhaseGuess, k: float) -> list[CorridorRow]:
    """Rows of a phase at knots 1..N; boundaries that the mode cannot cross have none.

    Args:
        k: standard deviations of the planned confidence.
    """
    mode = automaton.mode(guess.mode)
    leaving = None if guess.edge is None else automaton.edges[guess.edge]
    exits = () if leaving is None else leaving.guard.half_spaces
    turn = None if leaving is None else input_reversal_of(automaton, leaving)
    fixed = _fixed_boundaries(automaton, mode, exits)
    obstacles = _obstacles(automaton, mode, guess.edge)
    inside: list[tuple[HalfSpace, ...]] = [(h.opposite,) for h, sign, uncertain in fixed if sign > 0.0 and uncertain]
    walls = _obstacle_sides(automaton, obstacles, inside, guess, k)
    walls += [
        [None if h.on_input else h for h in avoided_half_spaces(rows, guess, k)]
        for rows in mixed_guards(automaton, guess)
    ]
    sides = () if leaving is None else _entered_before(mode, leaving, guess)
    rows, boundaries = [], dict[tuple[str, HalfSpace, float], Side | None]()
    stds = _threshold_stds(automaton, mode, [h for h, *_ in fixed])
    for step in range(1, guess.steps + 1):
        near = [h for wall in walls for h in wall[step - 1 : step + 1] if h is not None]
        chosen = fixed + [(h, -1.0, True) for h in _nearest(near, stds)]
        if step == guess.steps - 1:
            chosen += [(h, 1.0, True) for h in sides]
        if turn is not None and step < guess.steps:
            chosen.append((turn.half_space, -1.0, True))
            chosen += [(h, 1.0, True) for h in turn.sides if step == guess.steps - 1]
        for half_space, sign, uncertain in chosen:
            key = half_space.name, half_space, sign
            if key not in boundaries:
                boundaries[key] = _side(automaton, limits, guess, half_space, sign, stds.get(half_space, 0.0))
            if (side := boundaries[key]) is not None:
                rows.append(CorridorRow(side, step, uncertain))
    return rows


def _nearest(outside: Iterable[HalfSpace], stds: Mapping[HalfSpace, float]) -> list[HalfSpace]:
    """The nearest half-space of each direction, which implies those behind it.

    Args:
        stds: of uncertain thresholds; only half-spaces with equal ones can replace each other.
    """
    nearest = dict[tuple[tuple[float, ...], float], HalfSpace]()
    for h in outside:
        key = h.direction, stds.get(h, 0.0)
        before = nearest.get(key)
        if before is None or h.offset < before.offset:
            nearest[key] = h
    return list(nearest.values())


def _side(
    automaton: HybridAutomaton, limits: Limits, guess: PhaseGuess, half_space: HalfSpace, sign: float, std: float
) -> Side | None:
    """One side of a boundary with a given std; None if the mode cannot cross it."""
    a, c = sign * np.array(half_space.a), sign * half_space.c
    if not np.any(a @ automaton.mode(guess.mode).B):
        return None
    spreads = guess.spreads @ a @ a + std**2
    stds = np.hypot(np.linalg.norm(a @ guess.factors, axis=-1), np.sqrt(np.maximum(0.0, spreads)))
    name, unit = boundary_name(half_space, sign), unit_of(automaton, half_space)
    row = Row(guess.mode, guess.first_knot, name, unit, 0.0, np.inf, "boundary", half_space, sign)
    return Side(row, a, c, float(np.abs(a) @ limits.speed), spreads, guess.means @ a - c, stds)


def _threshold_stds(automaton: HybridAutomaton, mode: Mode, boundaries: list[HalfSpace]) -> dict[HalfSpace, float]:
    """Stds of thresholds where the mode is left: of guards, and of boundaries that coincide with one."""
    stds: dict[HalfSpace, float] = {}
    for edge in automaton.edges_from(mode.name):
        for guard in edge.guard.half_spaces if edge.threshold_std else ():
            ends = [h for h in boundaries if h.excludes(guard)]
            for half_space in (guard, *ends):
                stds[half_space] = max(stds.get(half_space, 0.0), edge.threshold_std)
    return stds


def _fixed_boundaries(
    automaton: HybridAutomaton, mode: Mode, exits: tuple[HalfSpace, ...]
) -> list[tuple[HalfSpace, float, bool]]:
    """(boundary, sign, uncertain) of the invariant and clamps, without the boundary through which the phase leaves."""
    clamps = [edge.guard.half_spaces for edge in automaton.edges_from(mode.name) if edge.is_self_transition]
    ends = [rows[0] for rows in clamps if len(rows) == 1 and not rows[0].on_input]
    rows = [h for h in mode.invariant.half_spaces if not h.on_input and not any(h.faces(g) for g in exits)]
    inside = [(h, 1.0, not any(h.faces(end) for end in ends)) for h in rows]
    free_ends = [end for end in ends if not any(h.faces(end) for h in mode.invariant.half_spaces)]
    return inside + [(end, -1.0, False) for end in free_ends]


def _obstacles(automaton: HybridAutomaton, mode: Mode, exit_edge: int | None) -> list[tuple[HalfSpace, ...]]:
    """Guards on x of transitions that the phase does not take, except those outside the invariant."""
    obstacles = []
    for index, edge in enumerate(automaton.edges):
        rows = edge.guard.half_spaces
        if edge.source != mode.name or edge.is_self_transition or index == exit_edge or not rows:
            continue
        if not edge.guard.on_state or isinstance(edge, ZeroTimeEdge):
            continue
        outside = any(h.excludes(g) for h in mode.invariant.half_spaces for g in rows)
        if not outside and not edge.guard.on_input:
            obstacles.append(rows)
    return obstacles


def _entered_before(mode: Mode, leaving: Edge, guess: PhaseGuess) -> tuple[HalfSpace, ...]:
    """Half-spaces of a guard that hold at the start of the phase's last step.

    The transition happens within that step, when the last half-space is entered: the end of the mode, or otherwise the
    one that the guess enters last. The others must hold until then, not only at the next knot.
    """
    if leaving.guard.on_input or guess.steps < 2:
        return ()
    rows, ends, far = crossed(mode, leaving, guess.means[-2], guess.means[-1], 0.0)
    return tuple(h for h in rows if h not in (*ends, *far)) if len(rows) > 1 else ()


def mixed_guards(automaton: HybridAutomaton, guess: PhaseGuess) -> dict[tuple[HalfSpace, ...], Edge]:
    """The guards on x and u of transitions that a phase does not take, with the first edge of each.

    Undivided guards, although planned edges are divided where others happen first: the parts are on the input as well,
    and no input of the phase takes them either.
    """
    guards = dict[tuple[HalfSpace, ...], Edge]()
    for index, edge in enumerate(automaton.edges):
        if edge.source != guess.mode or index == guess.edge or edge.is_self_transition:
            continue
        if edge.guard.on_input and len(edge.guard.half_spaces) > 1 and not isinstance(edge, ZeroTimeEdge):
            guards.setdefault(front_of(edge), edge)
    return guards


def avoided_half_spaces(guard: tuple[HalfSpace, ...], guess: PhaseGuess, k: float) -> list[HalfSpace]:
    """(N,) half-space of a guard on x and u that each step avoids.

    One on x alone where the guess is clearly outside at both ends of the step; otherwise the one on u whose margin the
    input violates most.
    """
    on_state, on_input = ([h for h in guard if h.on_input == which] for which in (False, True))
    a, b = np.array([h.a for h in on_input]), np.array([h.b for h in on_input])
    missed = np.array([h.c for h in on_input]) - guess.means[:-1] @ a.T - guess.inputs @ b.T
    chosen = [on_input[i] for i in np.argmax(missed / np.linalg.norm(b, axis=1), axis=1).tolist()]
    if not on_state:
        return chosen
    apart = _stds_outside(on_state, guess, guess.spreads)
    best = np.argmax(apart, axis=0).tolist()
    return [on_state[i] if apart[i, step] >= k else chosen[step] for step, i in enumerate(best)]


def _obstacle_sides(
    automaton: HybridAutomaton,
    obstacles: list[tuple[HalfSpace, ...]],
    inside: list[tuple[HalfSpace, ...]],
    guess: PhaseGuess,
    k: float,
) -> list[list[HalfSpace | None]]:
    """The half-space of each obstacle that each step avoids.

    A step stays out of a convex set if both its ends are outside the same half-space: the one that they are outside of
    by most standard deviations. Where that is not enough, obstacles would contradict each other: two boxes that share a
    face each require their own side of it. So all constraints use the nearest place that is k-sigma outside all of them
    (an inflated region, as in Deits and Tedrake, "Computing large convex regions of obstacle-free space through
    semidefinite programming", WAFR 2014).

    None for a last step that leaves the mode and ends inside: of transitions at one instant the first listed happens.

    Args:
        inside: complements of the mode's invariant; they are not obstacles.
    """
    rows = [[h for h in guard if h.on_state] for guard in (*obstacles, *inside)]
    if not obstacles:
        return []
    apart = [_stds_outside(own, guess) for own in rows]
    best = [np.argmax(far, axis=0) for far in apart]
    sides: list[list[HalfSpace | None]] = [
        [own[i] for i in of.tolist()] for own, of in zip(rows, best[: len(obstacles)], strict=False)
    ]
    least = np.min([far.max(axis=0) for far in apart], axis=0)
    for step in np.flatnonzero(least < k).tolist():
        beside = _ObstaclesAroundStep.of(automaton, rows, [far[:, step] for far in apart], guess, step, k)
        if not beside.are_compatible([int(of[step]) for of in best]):
            for wall, h in zip(sides, beside.sides(rows), strict=False):
                wall[step] = h
    if guess.edge is not None and guess.steps:
        for wall, far in zip(sides, apart, strict=False):
            if far[:, -1].max() <= 0.0:
                wall[-1] = None
    return sides


@dataclass(frozen=True, eq=False)
class _ObstaclesAroundStep:
    """Obstacles around a step, and the directions of inputs past them.

    Attributes:
        far: (r,) standard deviations by which the step is outside of each half-space of all obstacles.
        slopes: (r, m) by how much that is less with each input.
        ways: (w, m) inputs away from nearby half-spaces, each by one standard deviation.
        firsts: number of the first half-space of each obstacle.
        k: standard deviations to be kept.
    """

    far: Floats
    slopes: Floats
    ways: Floats
    firsts: Ints
    k: float

    @classmethod
    def of(
        cls,
        automaton: HybridAutomaton,
        rows: list[list[HalfSpace]],
        apart: list[Floats],
        guess: PhaseGuess,
        step: int,
        k: float,
    ) -> _ObstaclesAroundStep:
        a = np.array([h.a for own in rows for h in own])
        stds = np.linalg.norm(a @ guess.factors[step], axis=1) + SMALLEST_STD * np.linalg.norm(a, axis=1)
        slopes, far = (a @ automaton.mode(guess.mode).B) / stds[:, None], np.concatenate(apart)
        squared = (slopes**2).sum(axis=1)
        near = np.flatnonzero((np.abs(far) < _BESIDE * k) & (squared > 0.0))
        firsts = np.cumsum([0, *map(len, rows[:-1])])
        return cls(far, slopes, -slopes[near] / squared[near, None], firsts, k)

    def are_compatible(self, chosen: list[int]) -> bool:
        """Whether inputs can reach a k-sigma distance from one half-space of each obstacle jointly."""
        at = self.firsts + np.array(chosen)
        at = at[np.any(self.slopes[at] != 0.0, axis=1)]
        free = [(None, None)] * self.slopes.shape[1]
        found = linprog(
            np.zeros(len(free)), A_ub=self.slopes[at], b_ub=self.far[at] - self.k, bounds=free, method="highs"
        )
        return bool(found.status == 0)

    def sides(self, rows: list[list[HalfSpace]]) -> list[HalfSpace]:
        """The half-space of each obstacle to avoid, at the nearest place k-sigma away from all."""
        ways = np.concatenate([np.zeros((1, self.slopes.shape[1])), *(size * self.k * self.ways for size in _SIZES)])
        ways = np.concatenate([ways, *(way + ways for way in ways[1:])])
        away = ways @ self.slopes.T
        clear = np.maximum.reduceat(self.far - away, self.firsts, axis=1).min(axis=1)
        far = np.abs(away).max(axis=1, where=np.abs(self.far) < _BESIDE * self.k, initial=0.0)
        best = int(np.argmin(np.where(clear >= self.k, far, np.inf)) if (clear >= self.k).any() else np.argmax(clear))
        after = np.split(self.far - away[best], self.firsts[1:])
        return [own[int(np.argmax(of))] for own, of in zip(rows, after, strict=True)]


def _stds_outside(rows: Sequence[HalfSpace], guess: PhaseGuess, spreads: Floats | float = 0.0) -> Floats:
    """(r, N) distance of each step from half-spaces on x in standard deviations, at its closer end.

    Args:
        spreads: (N+1, n, n) covariance to be added to the belief's.
    """
    a, c = np.array([h.a for h in rows]), np.array([[h.c] for h in rows])
    covariances = guess.factors @ guess.factors.transpose(0, 2, 1) + spreads
    stds = np.sqrt(np.maximum(np.einsum("ri,kij,rj->rk", a, covariances, a), 0.0))
    smallest = SMALLEST_STD * np.linalg.norm(a, axis=1, keepdims=True)
    away = (c - a @ guess.means.T) / (stds + smallest)
    return np.asarray(np.minimum(away[:, :-1], away[:, 1:]))


@dataclass(frozen=True, eq=False)
class PathTerms:
    """Constraints and costs on the path, for every step in a mode.

    Attributes:
        requirements: (r,) name and unit.
        uncertain: numbers of the requirements that depend on state or input, and so hold with a probability only.
        function: (state, u, Σ) -> (margins (r, 1), their stds (r, 1), lengths (r, 1), cost): Σ (n + m, n + m) column by
            column, lengths of one step across each margin [its unit].
    """

    requirements: tuple[tuple[str, str], ...]
    uncertain: list[int]
    function: ca.Function


@dataclass(frozen=True, eq=False)
class PathRows:
    """Steps of a phase that path constraints apply to.

    Attributes:
        terms: CasADi expressions.
        knots: (j,) within the phase, where the steps end.
        inputs: (j,) (number of the phase, number of the input in it) of the inputs that lead there.
        covariances: ((n + m)², j) Σ of each.
        lengths: (r, j) of one step across each margin.
        slack: (u, j) of the uncertain requirements, in steps, that makes the guess feasible.
    """

    terms: PathTerms
    knots: list[int]
    inputs: list[tuple[int, int]]
    covariances: Floats
    lengths: Floats
    slack: Floats


def path_terms_of(problem: Problem, limits: Limits, mode: str, pattern: ca.Sparsity) -> PathTerms:
    """Constraints and costs on the path in a mode, over states packed with a pattern of the factor (`pack`)."""
    automaton, n, m = problem.automaton, problem.automaton.n, problem.automaton.m
    state, u, covariance = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("u", m), ca.SX.sym("s", (n + m) ** 2)
    x, factor = state[:n], factor_of(state, pattern)
    std = ca.sqrt(ca.sum2(factor**2) + SMALLEST_STD**2)
    acting = [constraint for constraint in problem.constraints if constraint.acts_in(mode)]
    terms = [term for effect in acting for term in path_terms(effect, CasadiOperations(), automaton, x, u, std)]
    required = [term for term in terms if isinstance(term, Require)]
    margins = ca.vertcat(ca.SX(0, 1), *(ca.SX(term.margin) for term in required))
    cost = sum((term.amount for term in terms if isinstance(term, Pay)), start=ca.SX(0))
    a, b = ca.jacobian(margins, x), ca.jacobian(margins, u)
    ab = ca.horzcat(a, b)
    spread = ca.sum2(ca.mtimes(ab, ca.reshape(covariance, n + m, n + m)) * ab)
    stds = ca.sqrt(ca.sum2(ca.mtimes(a, factor) ** 2) + spread + SMALLEST_STD**2)
    lengths = ca.mtimes(ca.fabs(a), ca.DM(limits.speed)) + ca.mtimes(ca.fabs(b), ca.DM(limits.max_step))
    function = ca.Function("path", [state, u, covariance], [*map(ca.densify, (margins, stds, lengths)), cost])
    uncertain = [i for i in range(len(required)) if ab[i, :].nnz()]
    return PathTerms(tuple((term.name, term.unit) for term in required), uncertain, function)


def path_rows(
    problem: Problem, limits: Limits, guess: Sequence[PhaseGuess], pattern: ca.Sparsity
) -> list[PathRows | None]:
    """The constraints on the path of each phase; None where there are none.

    A guard on the state is crossed within the step that reaches it, so that step ends behind the reset.
    """
    path_rows: list[PathRows | None] = []
    crossing: tuple[int, int] | None = None
    for p, phase in enumerate(guess):
        inputs = {knot: (p, knot - 1) for knot in range(1, phase.steps + 1)}
        if crossing is not None:
            inputs = {0: crossing, **inputs}
        leaves = phase.edge is not None and not problem.automaton.edges[phase.edge].guard.on_input
        crossing = inputs.pop(phase.steps, None) if leaves else None
        path_rows.append(_rows(problem, limits, guess, p, inputs, pattern) if problem.constraints and inputs else None)
    return path_rows


def _rows(
    problem: Problem,
    limits: Limits,
    guess: Sequence[PhaseGuess],
    number: int,
    inputs: dict[int, tuple[int, int]],
    pattern: ca.Sparsity,
) -> PathRows:
    phase, knots, led = guess[number], list(inputs), list(inputs.values())
    terms = path_terms_of(problem, limits, phase.mode, pattern)
    covariances = [_covariance(guess[p], i, phase.spreads[knot], knot > 0) for knot, (p, i) in inputs.items()]
    columns = np.array(covariances).reshape(len(knots), -1).T
    states = pack(phase.means[knots], phase.factors[knots], pattern)
    commands = np.array([guess[p].inputs[i] for p, i in led]).T
    margins, stds, lengths, _ = (np.array(v) for v in terms.function.map(len(knots))(states, commands, columns))
    # A margin that is flat at one knot of the guess gets the length that it has at another.
    lengths = np.where(lengths > 0.0, lengths, lengths.max(axis=1, keepdims=True, initial=0.0))
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    slack = np.maximum(0.0, problem.settings.sigmas * stds - margins) / lengths
    return PathRows(terms, knots, led, columns, lengths, slack[terms.uncertain])


def _covariance(phase: PhaseGuess, number: int, spread: Floats, is_same_mode: bool) -> Floats:
    """Σ at the end of a step given the estimate's covariance; across a reset both are independent."""
    gain, before = phase.gains[number], phase.spreads[number]
    together = phase.closed[number] @ before @ gain.T * float(is_same_mode)
    return np.block([[spread, together], [together.T, gain @ before @ gain.T]])
