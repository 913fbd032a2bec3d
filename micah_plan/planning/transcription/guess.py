"""Phases, knots and initial guess of a transcription: the search path with a belief roll-out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.input_reversal import matrix_after
from micah_plan.automaton.region import HalfSpace
from micah_plan.planning import messages
from micah_plan.planning.avoided_inputs import STRICT_SHARE, input_bounds
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.input_memories import linear_step, steps_of_memory
from micah_plan.planning.limits import Limits, drift_of, drifts, holding_inputs, input_length, motion_per_input
from micah_plan.planning.no_way import NoWayError
from micah_plan.planning.offers import larger_steps, more_knots
from micah_plan.planning.search.mode_search import ModeSequence
from micah_plan.planning.search.path_beliefs import MOST_LOCALISING_STEPS, WORTH_A_STEP, steps_to_correct_start
from micah_plan.planning.search.polytope import nominal_start
from micah_plan.planning.transcription.stops import planned_step
from micah_plan.planning.zero_time_transitions import ZeroTimeEdge, front_of, stds_of
from micah_plan.symbolic.compiled import CompiledMode, compiled_edge, compiled_mode
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Reason

# A mode that can move gets at least this many steps: time for measurements even if it is already there.
_FEWEST_STEPS = 3
# Plans of more knots are not tried for a remedy: of a door, 966 take 17 s of CPU, 9,600 longer than 6 minutes.
_MOST_TRIED_KNOTS = 400


@dataclass(frozen=True, eq=False)
class PhaseGuess:
    """One mode of the sequence with its guess.

    Attributes:
        mode: its name.
        edge: index of the edge that leaves it; None in the last phase.
        first_knot: number of its first knot in the whole plan.
        means: (N+1, n); factors: (N+1, n, n) lower Cholesky factors; inputs: (N, m).
        spreads: (N+1, n, n) covariance of the estimate around the mean in closed loop. Planning assumes that every
            measurement is the most likely one; real ones move the estimate, and the true state is spread around the
            planned mean by this and the belief's covariance together (van den Berg et al., LQG-MP, IJRR 2011).
        gains: (N, m, n) of the feedback; closed: (N, n, n) by which a step with feedback carries the estimate on.
    """

    mode: str
    edge: int | None
    first_knot: int
    means: Floats
    factors: Floats
    inputs: Floats
    spreads: Floats
    gains: Floats
    closed: Floats

    @property
    def steps(self) -> int:
        return len(self.inputs)


def guess(problem: Problem, limits: Limits, sequence: ModeSequence, stretch: float = 1.0) -> tuple[PhaseGuess, ...]:
    """Divide the path into knots and roll the belief out along it, through guards at the planned confidence.

    Args:
        stretch: multiplies the number of steps (within max_knots), for problems that need more time than the path's
            length suggests.

    Raises:
        NoWayError: if the path needs more than max_knots.
    """
    flows = [motion_per_input(problem.automaton, mode, limits.max_step) for mode in sequence.modes]
    needed = [
        _least_steps(problem, limits, mode, path, B)
        for mode, path, B in zip(sequence.modes, sequence.waypoints, flows, strict=True)
    ]
    steps = _divide(problem, limits, sequence, needed, stretch)
    # The overshoot into a guard lengthens a phase; it follows from the belief that is rolled out.
    rolled, needed = _roll(problem, limits, sequence, steps)
    again = _divide(problem, limits, sequence, needed, stretch)
    spare = problem.settings.max_knots - len(again) - sum(again)
    again[-1] += _localising_steps(problem, rolled[-1], spare)
    return rolled if again == steps else _roll(problem, limits, sequence, again)[0]


def guess_again(problem: Problem, limits: Limits, sequence: ModeSequence, steps: list[int]) -> tuple[PhaseGuess, ...]:
    """The initial guess from a path that is already followed, with its steps per mode."""
    return _roll(problem, limits, sequence, steps)[0]


def guess_at(
    problem: Problem, guess: tuple[PhaseGuess, ...], means: Floats, factors: Floats, inputs: Floats
) -> tuple[PhaseGuess, ...]:
    """The phases with another guess: means (K, n), factors (K, n, n) and inputs (K-1, m)."""
    phases, spread = list[PhaseGuess](), guess[0].spreads[0]
    for phase in guess:
        knots = slice(phase.first_knot, phase.first_knot + phase.steps + 1)
        mode = compiled_mode(problem.automaton, phase.mode)
        spreads = _spreads(mode, spread, factors[knots], phase.closed)
        own = inputs[knots.start : knots.start + phase.steps]
        phases.append(replace(phase, means=means[knots], factors=factors[knots], inputs=own, spreads=spreads))
        if phase.edge is not None:
            spread = _covariance_after_reset(problem.automaton, phase.edge, spreads[-1])
    return tuple(phases)


def _covariance_after_reset(automaton: HybridAutomaton, edge: int, spread: Floats) -> Floats:
    """(n, n) covariance of the estimate after a reset; zero for pinned coordinates."""
    taken = automaton.edges[edge]
    A, free = matrix_after(automaton, taken), automaton.mode(taken.target).free
    return np.asarray(A @ spread @ A.T * np.outer(free, free))


def _divide(problem: Problem, limits: Limits, sequence: ModeSequence, needed: list[float], stretch: float) -> list[int]:
    """Steps per phase for the least numbers of steps that each needs."""
    automaton, most = problem.automaton, problem.settings.max_knots - len(sequence.modes)
    least = [int(np.ceil(steps - 1e-9)) for steps in needed]
    wanted = [int(np.ceil(steps / problem.settings.pace - 1e-9)) for steps in needed]
    moving = next((p for p, mode in enumerate(sequence.modes) if automaton.mode(mode).B.any()), None)
    if moving is not None:
        wanted[moving] += steps_to_correct_start(problem, limits, automaton.mode(sequence.modes[moving]))
    felt, gone = steps_of_memory(automaton, limits.max_step)
    for p, mode in enumerate(sequence.modes):
        moves = bool(automaton.mode(mode).B.any())
        by_input = p > 0 and automaton.edges[sequence.edges[p - 1]].guard.on_input
        wanted[p] = max(wanted[p], _FEWEST_STEPS if moves else int(by_input))
        least[p] = max(least[p], int(by_input or (moves and wanted[p] > 0)))
        wanted[p] = int(np.ceil(stretch * wanted[p])) if moves else wanted[p]
        # Inputs are delayed: until the object is released, and until the last one has arrived.
        waits = felt * (p < len(sequence.edges) and automaton.edges[sequence.edges[p]].guard.on_input)
        least[p], wanted[p] = least[p] + waits, wanted[p] + waits + (gone if moves else 0)
    if sum(least) > most:
        raise NoWayError(_too_few_knots(sum(least) + len(sequence.modes), problem.settings.max_knots))
    spare = min(1.0, (most - sum(least)) / max(1, sum(wanted) - sum(least)))
    return [low + int(spare * max(0, high - low)) for low, high in zip(least, wanted, strict=True)]


def _too_few_knots(needed: int, allowed: int) -> Reason:
    """The reason for refusing a path that needs at least `needed` knots."""
    ways = [larger_steps(max(2.0, float(np.ceil(needed / allowed))))]
    if needed <= _MOST_TRIED_KNOTS:
        ways.insert(0, more_knots(needed / allowed))
    return Reason("too_few_knots", messages.too_few_knots(needed, allowed), tuple(ways))


def _roll(
    problem: Problem, limits: Limits, sequence: ModeSequence, steps: list[int]
) -> tuple[tuple[PhaseGuess, ...], list[float]]:
    """The phases with the belief rolled out, and the steps that each needs with its overshoot into the guard."""
    automaton = problem.automaton
    mean, factor = nominal_start(problem, limits, sequence.modes[0]), np.diag(np.array(problem.start.std, dtype=float))
    mean, factor = _belief(compiled_mode(automaton, sequence.modes[0]).condition(mean, factor))
    modes = [mode for mode, count in zip(sequence.modes, steps, strict=True) for _ in range(count + 1)]
    is_transition = np.zeros(len(modes) - 1, dtype=bool)
    is_transition[np.cumsum(np.array(steps) + 1)[:-1] - 1] = True
    gains = belief_lqr(problem, limits, tuple(modes), is_transition)
    is_late = drifts(problem)
    spread = np.zeros_like(factor)
    phases: list[PhaseGuess] = []
    needed, first_knot = [], 0
    for p, name in enumerate(sequence.modes):
        mode, count = compiled_mode(automaton, name), steps[p]
        A, slope = linear_step(automaton, name, mean, limits.max_step, limits.max_step)
        gain_of_step = gains[first_knot : first_knot + count]
        closed = A + slope @ gain_of_step
        edge = sequence.edges[p] if p < len(sequence.edges) else None
        # What drifts is elsewhere by now than where the search has met it.
        path = np.vstack([mean, *sequence.waypoints[p][0 if is_late and len(sequence.waypoints[p]) == 1 else 1 :]])
        if edge is not None:
            _, factors = _roll_phase(planned_step(automaton, name), mean, factor, np.zeros((count, automaton.m)))
            covariance = factors[-1] @ factors[-1].T + _spreads(mode, spread, factors, closed)[-1]
            path = np.vstack([path, _state_inside_guard(path[0], path[-1], covariance, edge, problem, limits)])
        B = motion_per_input(automaton, name, limits.max_step)
        needed.append(_least_steps(problem, limits, name, path, B))
        states = _resample(path, limits.speed, count)
        inputs = np.diff(states, axis=0) @ np.linalg.pinv(B).T + holding_inputs(automaton, name, states[:-1], B)
        if edge is not None and automaton.input_memories and not mode.mode.B.any():
            # The largest requirement of the guard while the object is still pinned.
            inputs[:] = limits.max_step * np.sign(sum(np.array(h.b) for h in automaton.edges[edge].guard.half_spaces))
        inputs = np.clip(inputs, -limits.max_step, limits.max_step)
        means, factors = _roll_phase(planned_step(automaton, name), mean, factor, inputs)
        spreads = _spreads(mode, spread, factors, closed)
        phases.append(PhaseGuess(name, edge, first_knot, means, factors, inputs, spreads, gain_of_step, closed))
        first_knot += count + 1
        if edge is not None:
            u = inputs[-1] if count else np.zeros(automaton.m)
            mean, factor = _belief(compiled_edge(automaton, edge).belief_reset(means[-1], factors[-1], u))
            spread = _covariance_after_reset(automaton, edge, spreads[-1])
    return tuple(phases), needed


def _least_steps(problem: Problem, limits: Limits, mode: str, path: Floats, B: Floats) -> float:
    """Least number of steps (not rounded) of a mode along a path (w, n), by inputs that move it through B (n, m)."""
    automaton = problem.automaton
    bounds = input_bounds(automaton, automaton.mode(mode), limits.max_step)
    return input_length(path, B, bounds, holding_inputs(automaton, mode, path, B), _drift(automaton, mode, path))


def _drift(automaton: HybridAutomaton, mode: str, path: Floats) -> Floats:
    """(n,) drift per step at the beginning of a path (w, n)."""
    return drift_of(automaton, automaton.mode(mode), path[0])


def _spreads(mode: CompiledMode, spread: Floats, factors: Floats, closed: Floats) -> Floats:
    """(N+1, n, n) covariance of the estimate along a phase, narrowed by feedback and widened by measurements."""
    spreads, (n, m), count = [spread], mode.mode.B.shape, len(closed)
    if count:
        _, side_by_side = mode.predict.map(count)(
            np.zeros((n, count)), np.hstack(list(factors[:-1])), np.zeros((m, count))
        )
        for predicted, after, carried in zip(_split_blocks(side_by_side), factors[1:], closed, strict=True):
            spreads.append(carried @ spreads[-1] @ carried.T + predicted @ predicted.T - after @ after.T)
    return np.array(spreads)


def _roll_phase(step: ca.Function, mean: Floats, factor: Floats, inputs: Floats) -> tuple[Floats, Floats]:
    """(N+1, n) means and (N+1, n, n) factors of a belief after steps with inputs (N, m)."""
    if not len(inputs):
        return mean[None], factor[None]
    means, side_by_side = step.mapaccum("rolled", len(inputs), 2)(mean, factor, inputs.T)
    return np.vstack([mean, np.array(means).T]), np.concatenate([factor[None], _split_blocks(side_by_side)])


def _split_blocks(side_by_side: ca.DM) -> Floats:
    """(k, n, n) matrices that lie side by side (n, k n)."""
    matrices = np.array(side_by_side, dtype=float)
    return matrices.reshape(len(matrices), -1, len(matrices)).transpose(1, 0, 2)


def _belief(pair: Any) -> tuple[Floats, Floats]:
    """A mean (n,) and factor (n, n) as arrays, from the result of a compiled function."""
    return np.array(pair[0], dtype=float).ravel(), np.array(pair[1], dtype=float)


def _localising_steps(problem: Problem, phase: PhaseGuess, spare: int) -> int:
    """Steps to append to the last phase until the belief is narrow enough for the goal.

    The belief before the last measurement counts: that measurement comes too late for any input.
    """
    k, rest = problem.settings.sigmas, np.zeros(problem.automaton.m)
    mode = compiled_mode(problem.automaton, phase.mode)
    mean, factor, before = phase.means[-1], phase.factors[-1], np.inf
    for extra in range(min(spare, MOST_LOCALISING_STEPS) + 1):
        prior = _belief(mode.predict(mean, factor, rest))[1]
        shares = [k * float(np.linalg.norm(prior[i])) / tolerance for i, _, tolerance in problem.goal.target]
        widest = max(shares, default=0.0)
        if widest <= 1.0:
            return extra
        if widest > WORTH_A_STEP * before:
            return extra - 1
        before = widest
        mean, factor = _belief(mode.belief_step(mean, factor, rest))
    return min(spare, MOST_LOCALISING_STEPS)


def _state_inside_guard(
    start: Floats, x: Floats, covariance: Floats, edge: int, problem: Problem, limits: Limits
) -> Floats:
    """A state near x at which a guard holds with the planned confidence, reachable by B from a start.

    Except for half-spaces that face the crossed one: they hold when it is crossed.
    """
    k = problem.settings.sigmas
    moved = x.copy()
    taken = problem.automaton.edges[edge]
    guard, source = taken.guard, problem.automaton.mode(taken.source)
    far = crossed(source, taken, start, x, k)[2]
    for _ in range(3):  # rows that are not perpendicular disturb each other a little
        for row, std in zip(guard.half_spaces, stds_of(taken), strict=True):
            need = guard_condition(problem.automaton, taken.source, row, std, (moved, covariance), k)
            direction = source.B @ (source.B.T @ need.a)
            if row.on_input or row in far or need.a @ direction <= 0:
                continue
            wanted = k * need.std(covariance) + 2 * STRICT_SHARE * float(np.abs(need.a) @ limits.speed)
            short = max(0.0, wanted - float(need.a @ moved - need.c))
            moved = moved + direction * short / float(need.a @ direction)
    return np.asarray(moved)


def crossed(
    mode: Mode, leaving: Edge, before: Floats, after: Floats, k: float
) -> tuple[list[HalfSpace], list[HalfSpace], list[HalfSpace]]:
    """Half-spaces on the state of a guard: all, those that a motion enters last, and those that face these.

    A transition happens when the last half-space is entered: the end of the mode, or otherwise the one that the motion
    from one state (n,) to another enters last. Half-spaces that face it (the far side of a plate) hold then, however
    far the step would continue.

    Args:
        k: standard deviations of both thresholds that must lie between a half-space and one that faces it.
    """
    guard = front_of(leaving) if isinstance(leaving, ZeroTimeEdge) else leaving.guard.half_spaces
    rows = [h for h in guard if h.on_state]
    if leaving.guard.on_input or not rows:
        return rows, [], []
    ends = [h for h in rows if any(inside.excludes(h) for inside in mode.invariant.half_spaces)]
    if not ends:
        here, there = (np.array([np.array(h.a) @ x - h.c for h in rows]) for x in (before, after))
        change = np.where(there > here, there - here, np.inf)
        ends = [rows[int(np.argmax(np.where(here < 0.0, -here / change, -np.inf)))]]
    stds = dict(zip(leaving.guard.half_spaces, stds_of(leaving), strict=True))

    def lies_beyond(h: HalfSpace, end: HalfSpace) -> bool:
        if not h.faces(end):
            return False
        sizes = float(np.linalg.norm(h.a)), float(np.linalg.norm(end.a))
        between = -h.c / sizes[0] - end.c / sizes[1]
        return between > k * float(np.hypot(stds[h] / sizes[0], stds[end] / sizes[1]))

    return rows, ends, [h for h in rows if any(lies_beyond(h, end) for end in ends)]


@dataclass(frozen=True, eq=False)
class ChanceConstraint:
    """Condition at k-sigma for a half-space of a guard to hold: a'x >= c.

    Attributes:
        a, c: (n,) and the threshold.
        own: std of the threshold.
    """

    a: Floats
    c: float
    own: float

    def std(self, covariance: Floats) -> float:
        """Std of a'x - c for a state of that covariance (n, n)."""
        return float(np.sqrt(self.a @ covariance @ self.a + self.own**2))


def guard_condition(
    automaton: HybridAutomaton, mode: str, row: HalfSpace, std: float, belief: tuple[Floats, Floats], k: float
) -> ChanceConstraint:
    """The half-space, or the same without coordinates that no input moves, at the worst value of their range.

    For a coordinate that no input moves, a plan need not assume more than its range: lower arms that hang down further
    than they can open need not be touched. The condition that requires less at a belief (mean (n,), covariance (n, n))
    is enough.

    Args:
        mode: that the guard leaves.
        std: of the threshold.
    """
    mode_of_edge, source = automaton.mode(mode), ChanceConstraint(np.array(row.a), row.c, std)
    idle = ~mode_of_edge.driven & mode_of_edge.free & (source.a != 0.0)
    if row.on_input or not idle.any() or idle.all(where=source.a != 0.0):
        return source
    worst, ends = 0.0, 0.0
    for i in np.flatnonzero(idle).tolist():
        low, high = mode_of_edge.interval(i)
        worst += source.a[i] * (low if source.a[i] > 0.0 else high)
        ends = float(np.hypot(ends, source.a[i] * _end_std(automaton, mode, i)))
    if not np.isfinite(worst):
        return source
    without = ChanceConstraint(np.where(idle, 0.0, source.a), row.c - worst, float(np.hypot(std, ends)))
    mean, covariance = belief
    asked = [k * need.std(covariance) - float(need.a @ mean - need.c) for need in (source, without)]
    return source if asked[0] <= asked[1] else without


def _end_std(automaton: HybridAutomaton, mode: str, coordinate: int) -> float:
    """Std of the thresholds at which a mode is left along a coordinate."""
    ends = [
        edge.threshold_std
        for edge in automaton.edges_from(mode)
        if any(h.bound and h.bound.coordinate == coordinate for h in edge.guard.half_spaces)
    ]
    return max(ends, default=0.0)


def _resample(path: Floats, speed: Floats, steps: int) -> Floats:
    """(steps + 1, n) states at equal distances (in steps) along a path (w, n)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.max(np.abs(np.diff(path, axis=0)) / speed, axis=1))])
    at = np.linspace(0.0, lengths[-1], steps + 1)
    return np.stack([np.interp(at, lengths, column) for column in path.T], axis=1)
