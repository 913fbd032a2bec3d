"""The low level of POMDP-HD: direct transcription of the belief trajectory along one mode sequence.

Source: Jain and Niekum, CoRL 2018; Platt et al., RSS 2010 (belief space, maximum-likelihood observations); Betts,
"Practical Methods for Optimal Control" (transcription in phases). The state of a knot is the mean and the lower
Cholesky factor L of the covariance. With k = Φ⁻¹(confidence), a half-space a'x >= c is planned to hold as
a'mean - c >= k sqrt(||L'a||² + a'Λa + σ²), where Λ is the spread of the estimate in closed loop
(`PhaseGuess.spreads`) and σ how well c is known (`Edge.threshold_std`):
- guards at the end of a phase: always;
- invariants, and guards of transitions that are not wanted, between: with a slack that costs, because a start or goal
  close to a boundary may leave no room; their mean must lie inside. Ends of a range that clamp bound the mean only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.region import HalfSpace
from micah_plan.planning.input_memory import steps_of_memory
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.corridor import CorridorRow, corridor
from micah_plan.planning.transcription.guess import STRICT_SHARE, PhaseGuess
from micah_plan.planning.transcription.layout import entries, factor_of, factor_pattern, pack, packed
from micah_plan.planning.transcription.rows import Row, RowNames
from micah_plan.quantities import percent
from micah_plan.symbolic.compiled import CompiledAutomaton, CompiledEdge, CompiledMode
from micah_plan.symbolic.square_root import norm as smooth_norm
from micah_plan.task.problem import Problem

Floats = NDArray[np.float64]

# Cost of one step's length of slack: above the other multipliers, so slack remains only where nothing else is possible.
_SLACK_WEIGHT = 10.0


@dataclass(frozen=True, eq=False)
class PhaseVariables:
    """Symbols of one phase: states (n + l, N+1) of mean and factor entries, inputs (m, N), slacks (s, 1)."""

    states: ca.MX
    inputs: ca.MX
    slacks: ca.MX
    corridor: list[CorridorRow]


@dataclass(eq=False)
class Transcription:
    """A nonlinear programme with names: minimise cost(w) with lower <= w <= upper and the bounds of `rows` on g(w).

    Attributes:
        guess: the phases with their warm start.
        pattern: of the factors.
        phases: the symbols of each phase.
        cost: expression.
        w, w_lower, w_upper, w_start: decision variables, bounds and start point, in blocks.
        g, rows: constraint expressions and their names, in the same order.
    """

    guess: tuple[PhaseGuess, ...]
    pattern: ca.Sparsity
    phases: list[PhaseVariables] = field(default_factory=list)
    cost: ca.MX = field(default_factory=lambda: ca.MX(0))
    w: list[ca.MX] = field(default_factory=list)
    w_lower: list[Floats] = field(default_factory=list)
    w_upper: list[Floats] = field(default_factory=list)
    w_start: list[Floats] = field(default_factory=list)
    g: list[ca.MX] = field(default_factory=list)
    rows: RowNames = field(default_factory=RowNames)

    def variables(self, size: tuple[int, int], start: Floats, lower: Floats, upper: Floats) -> ca.MX:
        """New decision variables of a shape (r, c); start and bounds (r, c)."""
        symbol = ca.MX.sym("w", *size)
        self.w.append(ca.vec(symbol))
        for block, values in ((self.w_start, start), (self.w_lower, lower), (self.w_upper, upper)):
            block.append(np.broadcast_to(values, size).ravel(order="F"))
        return symbol

    def require(self, expression: ca.MX, rows: list[Row]) -> None:
        """New constraints: one row per entry of the expression, in column-major order."""
        if rows:
            self.g.append(ca.vec(expression))
            self.rows.rows.extend(rows)


def transcribe(
    problem: Problem, limits: Limits, compiled: CompiledAutomaton, guess: tuple[PhaseGuess, ...]
) -> Transcription:
    """The nonlinear programme of a mode sequence."""
    taken = [phase.edge for phase in guess if phase.edge is not None]
    nlp = Transcription(guess, factor_pattern(compiled, guess[0].factors[0], [phase.mode for phase in guess], taken))
    for phase in guess:
        _add_phase(nlp, problem, limits, compiled, phase)
    for before, after in zip(range(len(guess) - 1), range(1, len(guess)), strict=True):
        _join(nlp, problem, limits, compiled, before, after)
    _add_goal(nlp, problem, limits, compiled)
    return nlp


def _step_function(mode: CompiledMode, pattern: ca.Sparsity, m: int) -> ca.Function:
    """(state, u) -> state: the belief step on packed states."""
    n = pattern.rows()
    state, u = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("u", m)
    stepped = mode.belief_step.call([state[:n], factor_of(state, pattern), u])
    return ca.Function("belief", [state, u], [packed(stepped, pattern)])


def _add_phase(
    nlp: Transcription, problem: Problem, limits: Limits, compiled: CompiledAutomaton, guess: PhaseGuess
) -> None:
    """Variables, dynamics, effort, inputs and the corridor of one phase."""
    automaton, settings = problem.automaton, problem.settings
    m, steps = automaton.m, guess.steps
    mode = compiled.modes[guess.mode]
    start = pack(guess.means, guess.factors, nlp.pattern)
    lower, upper = np.full(start.shape, -np.inf), np.full(start.shape, np.inf)
    if not nlp.phases:
        lower[:, 0] = upper[:, 0] = start[:, 0]
    states = nlp.variables(start.shape, start, lower, upper)
    largest = np.repeat(limits.max_step[:, None], steps, axis=1)
    inputs = nlp.variables((m, steps), guess.inputs.T, -largest, largest)
    rows = corridor(automaton, limits, guess)
    soft = sum(row.uncertain for row in rows)
    k = settings.sigmas
    slack_start = np.array([row.slack_start(k) for row in rows if row.uncertain]).reshape(soft, 1)
    slacks = nlp.variables((soft, 1), slack_start, np.zeros((soft, 1)), np.full((soft, 1), np.inf))
    nlp.phases.append(PhaseVariables(states, inputs, slacks, rows))
    if steps:
        stepped = _step_function(mode, nlp.pattern, m).map(steps)(states[:, :-1], inputs)
        nlp.require(states[:, 1:] - stepped, _defect_rows(automaton, guess, nlp.pattern))
        scaled = inputs / ca.DM(largest)
        nlp.cost += settings.weight_effort * ca.sumsqr(scaled)
    _require_inputs(nlp, problem, limits, compiled, guess, states, inputs)
    _require_corridor(nlp, problem, guess, nlp.phases[-1])


def _crossing_function(edge: CompiledEdge, pattern: ca.Sparsity, m: int) -> ca.Function:
    """(state, u of the guard, u of the reset) -> (margins, stds, state after it)."""
    n = pattern.rows()
    state, u, v = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("u", m), ca.SX.sym("v", m)
    factor = factor_of(state, pattern)
    margins, stds = edge.guard_belief.call([state[:n], factor, u])
    after = packed(edge.belief_reset.call([state[:n], factor, v]), pattern)
    return ca.Function("crossing", [state, u, v], [margins, stds, after])


def _defect_rows(automaton: HybridAutomaton, guess: PhaseGuess, pattern: ca.Sparsity) -> list[Row]:
    units = [coordinate.unit for coordinate in automaton.coordinates]
    names = [f"the dynamics of '{coordinate.name}'" for coordinate in automaton.coordinates]
    labels = list(zip(names, units, strict=True))
    for i, j in zip(*entries(pattern), strict=True):
        labels.append((f"the covariance of '{automaton.coordinates[i].name}', '{automaton.coordinates[j].name}'", ""))
    knots = range(guess.first_knot + 1, guess.first_knot + guess.steps + 1)
    return [Row(guess.mode, knot, name, unit, 0.0, 0.0) for knot in knots for name, unit in labels]


def _require_inputs(
    nlp: Transcription,
    problem: Problem,
    limits: Limits,
    compiled: CompiledAutomaton,
    guess: PhaseGuess,
    states: ca.MX,
    inputs: ca.MX,
) -> None:
    """Rows that depend on the input: admissible inputs, invariants, and guards on inputs that must not be triggered."""
    automaton, mode = problem.automaton, compiled.modes[guess.mode]
    groups = [(mode.inputs, mode.mode.inputs.half_spaces, 1.0), (mode.invariant, mode.mode.invariant.half_spaces, 1.0)]
    for number, edge in enumerate(automaton.edges):
        rows = edge.guard.half_spaces
        if edge.source == guess.mode and not edge.is_self_transition and len(rows) == 1 and edge.guard.on_input:
            groups.append((compiled.edges[number].guard, rows, -1.0))
    for function, half_spaces, sign in groups:
        chosen = [i for i, h in enumerate(half_spaces) if h.on_input]
        if not chosen or not guess.steps:
            continue
        margins = sign * function.map(guess.steps)(states[: automaton.n, :-1], inputs)[chosen, :]
        # A closed guard holds on its boundary already: stay a little away from it.
        names = [f"'{half_spaces[i].name}'" if sign > 0 else f"staying out of '{half_spaces[i].name}'" for i in chosen]
        lows = [
            STRICT_SHARE * float(np.abs(half_spaces[i].b) @ limits.max_step)
            if sign < 0 and not half_spaces[i].strict
            else 0.0
            for i in chosen
        ]
        units = [row_unit(automaton, half_spaces[i]) for i in chosen]
        nlp.require(
            margins,
            [
                Row(guess.mode, guess.first_knot + k, name, unit, low, np.inf, "input")
                for k in range(guess.steps)
                for name, unit, low in zip(names, units, lows, strict=True)
            ],
        )


def _require_corridor(nlp: Transcription, problem: Problem, guess: PhaseGuess, phase: PhaseVariables) -> None:
    """The boundaries between the ends of the phase: hard for the mean, with a slack that costs at k-sigma."""
    if not phase.corridor:
        return
    settings = problem.settings
    directions = np.array([row.sign * np.array(row.half_space.a) for row in phase.corridor]).T
    offsets = np.array([row.sign * row.half_space.c for row in phase.corridor])
    at = phase.states[:, [row.step for row in phase.corridor]]
    margins, stds = _margin_function(nlp.pattern).map(len(phase.corridor))(at, directions, offsets[None, :])
    uncertain = [i for i, row in enumerate(phase.corridor) if row.uncertain]
    scales = ca.DM([phase.corridor[i].scale for i in uncertain])
    k = settings.sigmas

    def named(i: int, suffix: str, spread: float | None = None) -> Row:
        row = phase.corridor[i]
        place = guess.mode, guess.first_knot + row.step, row.name + suffix, row_unit(problem.automaton, row.half_space)
        return Row(*place, 0.0, np.inf, "boundary", row.half_space, row.sign, spread)

    nlp.require(margins, [named(i, "") for i in range(len(phase.corridor))])
    if uncertain:
        spreads = ca.DM([phase.corridor[i].spread for i in uncertain])
        soft = margins[uncertain].T - k * _total_std(stds[uncertain].T, spreads) + scales * phase.slacks
        nlp.require(
            soft, [named(i, f" at {percent(settings.confidence)}", phase.corridor[i].spread) for i in uncertain]
        )
        nlp.cost += _SLACK_WEIGHT * ca.sum1(phase.slacks)


def _margin_function(pattern: ca.Sparsity) -> ca.Function:
    """(state, a, c) -> (a'mean - c, ||L'a||)."""
    n = pattern.rows()
    state, a, c = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("a", n), ca.SX.sym("c")
    std = smooth_norm(ca.mtimes(factor_of(state, pattern).T, a))
    return ca.Function("margin", [state, a, c], [ca.dot(a, state[:n]) - c, std])


def _total_std(std: ca.MX, spread: ca.DM | float) -> ca.MX:
    """Std of the true margin: of the belief, and of the estimate and the threshold, whose variance is given."""
    return ca.sqrt(std**2 + spread)


def _join(
    nlp: Transcription, problem: Problem, limits: Limits, compiled: CompiledAutomaton, before: int, after: int
) -> None:
    """The guard at the end of one phase and the reset into the next.

    A guard on the input is taken by the next phase's first input: the transition is the first event of that step.
    """
    automaton, n = problem.automaton, problem.automaton.n
    guess, target = nlp.guess[before], nlp.phases[after]
    edge = compiled.edges[guess.edge if guess.edge is not None else 0]
    state = nlp.phases[before].states[:, -1]
    u = target.inputs[:, 0] if nlp.guess[after].steps else ca.DM.zeros(automaton.m)
    by_input = edge.edge.guard.on_input
    last = nlp.phases[before].inputs[:, -1] if guess.steps else ca.MX.zeros(automaton.m, 1)
    crossing = _crossing_function(edge, nlp.pattern, automaton.m)
    margins, stds, reset = crossing(state, u, ca.MX(u) if by_input else last)
    k, knot = problem.settings.sigmas, guess.first_knot + guess.steps
    free = automaton.mode(guess.mode).free
    for i, half_space in enumerate(edge.edge.guard.half_spaces):
        # Where the mode pins x the guard's rows on it hold or not whatever the plan; the search has checked them.
        certain = not np.any(np.array(half_space.a)[free])
        if certain and not half_space.on_input:
            continue
        scale = float(np.abs(half_space.a) @ limits.speed + np.abs(half_space.b) @ limits.max_step)
        low = STRICT_SHARE * scale if half_space.strict else 0.0
        name = f"the guard '{half_space.name}' of '{edge.edge.name}'"
        name += "" if certain else f" at {percent(problem.settings.confidence)}"
        unit = row_unit(automaton, half_space)
        a = np.array(half_space.a)
        spread = float(a @ guess.spreads[-1] @ a + edge.edge.threshold_std**2)
        row = Row(guess.mode, knot, name, unit, low, np.inf, "guard", half_space, 1.0, None if certain else spread)
        nlp.require(margins[i] - (0.0 if certain else k) * _total_std(stds[i], spread), [row])
    first = nlp.guess[after].first_knot
    names = [f"the reset of '{edge.edge.name}'"] * (n + nlp.pattern.nnz())
    rows = [Row(edge.edge.target, first, name, "", 0.0, 0.0) for name in names]
    nlp.require(target.states[:, 0] - reset, rows)


def _add_goal(nlp: Transcription, problem: Problem, limits: Limits, compiled: CompiledAutomaton) -> None:
    """The goal at the last knot, and once all commands have arrived: the mean within the tolerance.

    Error and variance are in the cost.
    """
    automaton, settings = problem.automaton, problem.settings
    last = nlp.guess[-1]
    state = nlp.phases[-1].states[:, -1]
    factor = factor_of(state, nlp.pattern)
    settled = state[: automaton.n]
    for _ in range(steps_of_memory(automaton, limits.max_step)[1]):
        settled = compiled.modes[last.mode].step(settled, ca.DM.zeros(automaton.m))
    for index, value, tolerance in problem.goal.target:
        coordinate = automaton.coordinates[index]
        error = state[index] - value
        name = f"the goal {coordinate.name} = {value:g} ± {tolerance:g}"
        knot = last.first_knot + last.steps
        row = Row(last.mode, knot, name, coordinate.unit, -tolerance, tolerance, "goal")
        nlp.require(error, [row])
        nlp.cost += settings.weight_goal * (error / tolerance) ** 2
        if automaton.registers:
            later = settled[index] - value
            nlp.require(later, [replace(row, name=f"{name} when all commands have arrived")])
            nlp.cost += settings.weight_goal * (later / tolerance) ** 2
        nlp.cost += settings.weight_covariance * ca.sumsqr(factor[index, :]) / tolerance**2


def row_unit(automaton: HybridAutomaton, half_space: HalfSpace) -> str:
    """The unit of a half-space's margin if all its coordinates share one, else empty."""
    units = {c.unit for c, weight in zip(automaton.coordinates, half_space.a, strict=True) if weight}
    units |= {c.unit for c, weight in zip(automaton.inputs, half_space.b, strict=True) if weight}
    return units.pop() if len(units) == 1 else ""
