"""The low level of POMDP-HD: direct transcription of the belief trajectory along one mode sequence.

Source: Jain and Niekum, CoRL 2018; Platt et al., RSS 2010 (belief space, maximum-likelihood observations); Betts,
"Practical Methods for Optimal Control" (transcription in phases). The state of a knot is the mean and the lower
Cholesky factor L of the covariance. With k = Φ⁻¹(confidence), a half-space a'x >= c is planned to hold as
a'mean - c >= k sqrt(||L'a||² + a'Λa + σ²), where Λ is the spread of the estimate in closed loop
(`PhaseGuess.spreads`) and σ the std of c (`Edge.threshold_std`):
- guards at the end of a phase: always;
- invariants, and guards of transitions that are not wanted, between: with a slack that costs, because a start or goal
  close to a boundary may leave no room; their mean must lie inside. Ends of a range that clamp bound the mean only.
  The same holds for constraints that a user puts on the path (`corridor`);
- all of them further than that, as far as it pays: what misses a guard or crosses a boundary misses the goal, so the
  probability of it costs as much as missing the goal by its tolerance does;
- rows on the input likewise, with the feedback that is executed around it (`inputs`);
- what is moved while the guard may have been passed already, and is lost then: at a cost (`lost_motion`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import casadi as ca
import numpy as np

from micah_plan.arrays import SMALLEST_STD, Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.planning.avoided_inputs import STRICT_SHARE
from micah_plan.planning.input_memories import steps_of_memory
from micah_plan.planning.limits import Limits
from micah_plan.planning.nlp import Programme
from micah_plan.planning.plan_cost import effort_cost, goal_cost, variance_cost
from micah_plan.planning.transcription.corridor import CorridorRow, PathRows, corridor, path_rows
from micah_plan.planning.transcription.guess import PhaseGuess, crossed, guard_condition
from micah_plan.planning.transcription.inputs import InputRow, depth_limit, input_rows, spread_across
from micah_plan.planning.transcription.late_motion import lost_motion
from micah_plan.planning.transcription.packed_belief import factor_of, factor_pattern, pack, packed, pattern_entries
from micah_plan.planning.transcription.rows import ConstraintRows, Row, unit_of
from micah_plan.planning.transcription.stops import planned_step
from micah_plan.planning.zero_time_transitions import stds_of
from micah_plan.symbolic.compiled import CompiledEdge, compiled_edge, compiled_mode, passed_input
from micah_plan.symbolic.square_root import norm as smooth_norm
from micah_plan.task.problem import Problem

# Cost of one step's length of slack: above the other multipliers, so slack remains only where nothing else is possible.
_SLACK_WEIGHT = 10.0


@dataclass(frozen=True, eq=False)
class PhaseVariables:
    """Symbols of one phase.

    Attributes:
        states: (n + l, N+1) of mean and factor entries; inputs: (m, N); slacks: (s, 1) in steps.
        soft: per slack the number of its row, and the length of one step across it [unit of the row].
    """

    states: ca.MX
    inputs: ca.MX
    slacks: ca.MX
    soft: list[tuple[int, float]] = field(default_factory=list)


@dataclass(eq=False)
class Transcription:
    """The nonlinear programme of a mode sequence, with named constraints.

    Attributes:
        problem, limits: its inputs.
        guess: the phases with their start point.
        pattern: of the factors.
        phases: the symbols of each phase.
        cost: expression.
        w, w_lower, w_upper, w_start: decision variables, bounds and start point, in blocks.
        g, rows: constraint expressions and their descriptions, in the same order.
        stds: std of the true margin of every row that is to hold with a confidence, NaN of the others, as `g`.
    """

    problem: Problem
    limits: Limits
    guess: tuple[PhaseGuess, ...]
    pattern: ca.Sparsity
    phases: list[PhaseVariables] = field(default_factory=list)
    cost: ca.MX = field(default_factory=lambda: ca.MX(0))
    w: list[ca.MX] = field(default_factory=list)
    w_lower: list[Floats] = field(default_factory=list)
    w_upper: list[Floats] = field(default_factory=list)
    w_start: list[Floats] = field(default_factory=list)
    g: list[ca.MX] = field(default_factory=list)
    rows: ConstraintRows = field(default_factory=ConstraintRows)
    stds: list[ca.MX] = field(default_factory=list)

    @property
    def programme(self) -> Programme:
        """The programme for a solver."""
        bounds = np.concatenate(self.w_lower), np.concatenate(self.w_upper)
        rows = self.rows.lower, self.rows.upper
        return Programme(
            ca.vertcat(*self.w), self.cost, ca.vertcat(*self.g), np.concatenate(self.w_start), bounds, rows
        )

    def variables(self, size: tuple[int, int], start: Floats, lower: Floats, upper: Floats) -> ca.MX:
        """New decision variables of a shape (r, c); start and bounds (r, c)."""
        symbol = ca.MX.sym("w", *size)
        self.w.append(ca.vec(symbol))
        for block, values in ((self.w_start, start), (self.w_lower, lower), (self.w_upper, upper)):
            block.append(np.broadcast_to(values, size).ravel(order="F"))
        return symbol

    def require(self, expression: ca.MX, rows: list[Row], stds: ca.MX | None = None) -> None:
        """New constraints: one row per entry of the expression (and of `stds`), in column-major order."""
        if rows:
            self.g.append(ca.vec(expression))
            self.rows.extend(rows)
            self.stds.append(ca.MX.nan(len(rows)) if stds is None else ca.vec(stds))

    def stds_at(self, w: Floats) -> Floats:
        """(r,) `stds` at values of the decision variables."""
        return np.array(ca.Function("stds", [ca.vertcat(*self.w)], [ca.vertcat(*self.stds)])(w), dtype=float).ravel()


def transcribe(problem: Problem, limits: Limits, guess: tuple[PhaseGuess, ...]) -> Transcription:
    """The nonlinear programme of a mode sequence from the guess of its phases."""
    taken = [phase.edge for phase in guess if phase.edge is not None]
    pattern = factor_pattern(problem.automaton, guess[0].factors[0], [phase.mode for phase in guess], taken)
    nlp = Transcription(problem, limits, guess, pattern)
    for phase, path in zip(guess, path_rows(problem, limits, guess, pattern), strict=True):
        _add_phase(nlp, phase, path)
    for before, after in pairwise(range(len(guess))):
        _join(nlp, before, after)
    _add_goal(nlp)
    return nlp


def _add_phase(nlp: Transcription, guess: PhaseGuess, path: PathRows | None) -> None:
    """Variables, dynamics, effort, inputs, the corridor and constraints on the path of one phase."""
    automaton, steps = nlp.problem.automaton, guess.steps
    start = pack(guess.means, guess.factors, nlp.pattern)
    lower, upper = np.full(start.shape, -np.inf), np.full(start.shape, np.inf)
    if not nlp.phases:
        lower[:, 0] = upper[:, 0] = start[:, 0]
    states = nlp.variables(start.shape, start, lower, upper)
    largest = np.repeat(nlp.limits.max_step[:, None], steps, axis=1)
    inputs = nlp.variables(largest.shape, guess.inputs.T, -largest, largest)
    k = nlp.problem.settings.sigmas
    boundaries = corridor(automaton, nlp.limits, guess, k)
    slack_start = np.array([row.slack_start(k) for row in boundaries if row.uncertain])
    if path is not None:
        slack_start = np.append(slack_start, path.slack.ravel(order="F"))
    wanted = input_rows(automaton, nlp.limits, guess, k)
    before_inputs = len(slack_start)
    slack_start = np.append(slack_start, [row.slack for row in wanted if row.uncertain])[:, None]
    slacks = nlp.variables(slack_start.shape, slack_start, 0.0 * slack_start, np.full_like(slack_start, np.inf))
    nlp.phases.append(PhaseVariables(states, inputs, slacks))
    if steps:
        step = _step_function(planned_step(automaton, guess.mode), nlp.pattern, automaton.m)
        stepped = step.map(steps)(states[:, :-1], inputs)
        nlp.require(states[:, 1:] - stepped, _defect_rows(automaton, guess, nlp.pattern))
        nlp.cost += effort_cost(nlp.problem, ca.sumsqr(inputs / ca.DM(largest)))
        if wanted:
            _require_inputs(nlp, guess.mode, nlp.phases[-1], wanted, slacks[before_inputs:])
        if (lost := lost_motion(automaton, nlp.limits, guess, nlp.pattern)) is not None:
            nlp.cost += _SLACK_WEIGHT * lost(states, inputs)
    if boundaries:
        _require_corridor(nlp, nlp.phases[-1], boundaries)
    if path is not None:
        _require_path(nlp, guess, nlp.phases[-1], path, slacks[before_inputs - path.slack.size : before_inputs])
    if slack_start.size:
        nlp.cost += _SLACK_WEIGHT * ca.sum1(slacks)


def _step_function(step: ca.Function, pattern: ca.Sparsity, m: int) -> ca.Function:
    """(state, u) -> state: a belief step on packed states."""
    n = pattern.rows()
    state, u = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("u", m)
    stepped = step.call([state[:n], factor_of(state, pattern), u])
    return ca.Function("belief", [state, u], [packed(stepped, pattern)])


def _defect_rows(automaton: HybridAutomaton, guess: PhaseGuess, pattern: ca.Sparsity) -> list[Row]:
    units = [coordinate.unit for coordinate in automaton.coordinates]
    names = [f"the dynamics of '{coordinate.name}'" for coordinate in automaton.coordinates]
    labels = list(zip(names, units, strict=True))
    for i, j in zip(*pattern_entries(pattern), strict=True):
        labels.append((f"the covariance of '{automaton.coordinates[i].name}', '{automaton.coordinates[j].name}'", ""))
    knots = range(guess.first_knot + 1, guess.first_knot + guess.steps + 1)
    return [Row(guess.mode, knot, name, unit, 0.0, 0.0) for knot in knots for name, unit in labels]


def _require_inputs(
    nlp: Transcription, mode: str, phase: PhaseVariables, wanted: list[InputRow], slacks: ca.MX
) -> None:
    """Add the constraints on inputs, including the feedback around them."""
    steps = [row.step for row in wanted]
    a, b, c = (np.array([getattr(row, name) for row in wanted]) for name in "abc")
    margins, stds = _margin_function(nlp.pattern).map(len(wanted))(phase.states[:, steps], a.T, c[None, :])
    inputs, automaton = phase.inputs[:, steps], nlp.problem.automaton
    if automaton.input_memories:
        arriving = passed_input(automaton, mode).map(len(wanted))(phase.states[: automaton.n, steps], inputs)
        is_sent = ca.DM([[float(row.is_sent) for row in wanted]])
        inputs = inputs * ca.repmat(is_sent, automaton.m, 1) + arriving * ca.repmat(1.0 - is_sent, automaton.m, 1)
    margins += ca.sum1(ca.DM(b.T) * inputs)
    uncertain = [i for i, row in enumerate(wanted) if row.uncertain]
    total = ca.sqrt(stds[uncertain].T ** 2 + ca.DM([wanted[i].spread + SMALLEST_STD**2 for i in uncertain]))
    scales = np.array([wanted[i].scale for i in uncertain])
    _require_with_room(nlp, phase, [row.row for row in wanted], margins, (uncertain, total, scales, slacks))


def _require_corridor(nlp: Transcription, phase: PhaseVariables, boundaries: list[CorridorRow]) -> None:
    """Add the corridor of a phase."""
    directions = np.array([boundary.side.normal for boundary in boundaries]).T
    offsets = np.array([boundary.side.offset for boundary in boundaries])
    at = phase.states[:, [boundary.step for boundary in boundaries]]
    margins, stds = _margin_function(nlp.pattern).map(len(boundaries))(at, directions, offsets[None, :])
    uncertain = [i for i, boundary in enumerate(boundaries) if boundary.uncertain]
    total = ca.sqrt(
        stds[uncertain].T ** 2 + ca.DM([float(boundaries[i].side.spreads[boundaries[i].step]) for i in uncertain])
    )
    scales = np.array([boundaries[i].side.scale for i in uncertain])
    rows, slacks = [boundary.row for boundary in boundaries], phase.slacks[: len(uncertain)]
    _require_with_room(nlp, phase, rows, margins, (uncertain, total, scales, slacks))


def _require_path(nlp: Transcription, guess: PhaseGuess, phase: PhaseVariables, path: PathRows, slacks: ca.MX) -> None:
    """Add the path constraints and costs of a phase."""
    terms, count = path.terms, len(path.terms.requirements)
    inputs = ca.horzcat(*(nlp.phases[p].inputs[:, i] for p, i in path.inputs))
    at = phase.states[:, path.knots]
    margins, stds, _, costs = terms.function.map(len(path.knots))(at, inputs, path.covariances)
    nlp.cost += ca.sum2(costs)
    rows = [
        Row(guess.mode, guess.first_knot + knot, f"'{name}'", unit, 0.0, np.inf, "path")
        for knot in path.knots
        for name, unit in terms.requirements
    ]
    uncertain = [j * count + i for j in range(len(path.knots)) for i in terms.uncertain]
    scales = path.lengths[terms.uncertain].ravel(order="F")
    _require_with_room(nlp, phase, rows, margins, (uncertain, ca.vec(stds)[uncertain], scales, slacks))


def _require_with_room(
    nlp: Transcription,
    phase: PhaseVariables,
    rows: list[Row],
    margins: ca.MX,
    uncertain: tuple[list[int], ca.MX, Floats, ca.MX],
) -> None:
    """Add rows on the mean, and for some of them k-sigma margins with a penalised slack.

    Args:
        uncertain: numbers of these rows, stds of their margins, lengths of one step across them, slacks in steps.
    """
    nlp.require(margins, rows)
    numbers, stds, scales, slacks = uncertain
    if numbers:
        settings = nlp.problem.settings
        phase.soft.extend(zip(range(len(nlp.rows), len(nlp.rows) + len(numbers)), scales.tolist(), strict=True))
        soft = ca.vec(margins)[numbers] - settings.sigmas * stds + ca.DM(scales) * slacks
        nlp.require(soft, [rows[i]._replace(confidence=settings.confidence) for i in numbers], stds)
        nlp.cost += ca.sum1(_missing_cost(settings.weight_goal, ca.vec(margins)[numbers], stds))


def _missing_cost(weight: float, margins: ca.MX, stds: ca.MX) -> ca.MX:
    """Expected cost of negative margins (r, 1) with these stds, each weighted like a goal missed by its tolerance."""
    return ca.MX(weight * 0.5 * (1.0 - ca.erf(margins / (np.sqrt(2.0) * stds))))


def _margin_function(pattern: ca.Sparsity) -> ca.Function:
    """(state, a, c) -> (a'mean - c, ||L'a||)."""
    n = pattern.rows()
    state, a, c = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("a", n), ca.SX.sym("c")
    std = smooth_norm(ca.mtimes(factor_of(state, pattern).T, a))
    return ca.Function("margin", [state, a, c], [ca.dot(a, state[:n]) - c, std])


def _join(nlp: Transcription, before: int, after: int) -> None:
    """Add the guard at the end of a phase and the reset into the next.

    A guard on the input is taken by the next phase's first input: the transition is the first event of that step.
    """
    automaton, n = nlp.problem.automaton, nlp.problem.automaton.n
    guess, target = nlp.guess[before], nlp.phases[after]
    edge = compiled_edge(automaton, guess.edge if guess.edge is not None else 0)
    state = nlp.phases[before].states[:, -1]
    u = target.inputs[:, 0] if nlp.guess[after].steps else ca.DM.zeros(automaton.m)
    by_input = edge.edge.guard.on_input
    last = nlp.phases[before].inputs[:, -1] if guess.steps else ca.MX.zeros(automaton.m, 1)
    crossing = _crossing_function(edge, nlp.pattern, automaton.m)
    margins, stds, reset = crossing(state, u, ca.MX(u) if by_input else last)
    settings, knot = nlp.problem.settings, guess.first_knot + guess.steps
    source = automaton.mode(guess.mode)
    free, before_last = source.free, guess.means[-2] if guess.steps else guess.means[-1]
    beyond = crossed(source, edge.edge, before_last, guess.means[-1], settings.sigmas)[2]
    for i, (half_space, own) in enumerate(zip(edge.edge.guard.half_spaces, stds_of(edge.edge), strict=True)):
        # Where the mode pins x the guard's rows on it are constant; the search has checked them.
        certain = not np.any(np.array(half_space.a)[free])
        if (certain and not half_space.on_input) or half_space in beyond:
            continue
        scale = float(np.abs(half_space.a) @ nlp.limits.speed + np.abs(half_space.b) @ nlp.limits.max_step)
        low = STRICT_SHARE * scale if half_space.strict else 0.0
        name = f"the guard '{half_space.name}' of '{edge.edge.name}'"
        place = guess.mode, knot, name, unit_of(automaton, half_space)
        row = Row(*place, low, np.inf, "guard", half_space, 1.0, None if certain else settings.confidence)
        margin, std = margins[i], stds[i]
        covariance = guess.factors[-1] @ guess.factors[-1].T + guess.spreads[-1]
        need = guard_condition(automaton, guess.mode, half_space, own, (guess.means[-1], covariance), settings.sigmas)
        if not np.array_equal(need.a, half_space.a):
            margin, std = _margin_function(nlp.pattern)(state, need.a, need.c)
        gains = nlp.guess[after].gains
        is_fed_back = half_space.on_input and len(gains) > 0 and not automaton.input_memories
        gain = gains[0] if is_fed_back else np.zeros((automaton.m, n))
        spread = spread_across(need.a, np.array(half_space.b), gain, guess.spreads[-1])
        total = ca.sqrt(std**2 + spread + need.own**2)
        if certain:  # the state does not matter, but what the feedback adds to the input does
            far = min(settings.sigmas * float(np.sqrt(spread)), depth_limit(half_space, nlp.limits))
            nlp.require(margin - far, [row])
        else:
            nlp.require(margin - settings.sigmas * total, [row], total)
        if not certain:
            nlp.cost += _missing_cost(settings.weight_goal, margin, total)
    name = f"the reset of '{edge.edge.name}'"
    same = Row(edge.edge.target, nlp.guess[after].first_knot, name, "", 0.0, 0.0)
    nlp.require(target.states[:, 0] - reset, [same] * (n + nlp.pattern.nnz()))


def _crossing_function(edge: CompiledEdge, pattern: ca.Sparsity, m: int) -> ca.Function:
    """(state, u of the guard, u of the reset) -> (margins, stds, state after it)."""
    n = pattern.rows()
    state, u, v = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("u", m), ca.SX.sym("v", m)
    factor = factor_of(state, pattern)
    margins, stds = edge.guard_belief.call([state[:n], factor, u])
    after = packed(edge.belief_reset.call([state[:n], factor, v]), pattern)
    return ca.Function("crossing", [state, u, v], [margins, stds, after])


def _add_goal(nlp: Transcription) -> None:
    """Add the goal at the last knot, and after delayed commands: the mean within the tolerance.

    Error and variance are in the cost.
    """
    problem, automaton, last = nlp.problem, nlp.problem.automaton, nlp.guess[-1]
    state = nlp.phases[-1].states[:, -1]
    mean, factor = state[: automaton.n], factor_of(state, nlp.pattern)
    settled, mode = mean, compiled_mode(automaton, last.mode)
    for _ in range(steps_of_memory(automaton, nlp.limits.max_step)[1]):
        settled = mode.step(settled, ca.DM.zeros(automaton.m))
    ends = [(mean, "")]
    ends += [(settled, " when all commands have arrived")] if automaton.input_memories else []
    for index, value, tolerance in problem.goal.target:
        coordinate = automaton.coordinates[index]
        for end, when in ends:
            name = f"the goal {coordinate.name} = {value:g} ± {tolerance:g}{when}"
            place = last.mode, last.first_knot + last.steps, name, coordinate.unit
            nlp.require(end[index] - value, [Row(*place, -tolerance, tolerance, "goal", coordinate=index)])
    nlp.cost += sum(goal_cost(problem, end) for end, _ in ends)
    nlp.cost += variance_cost(problem, {index: ca.sumsqr(factor[index, :]) for index in problem.goal.indices})
