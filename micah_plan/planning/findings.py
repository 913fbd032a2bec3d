"""Findings on failed plans: what prevents a plan, by how much, and the remedies closest to the problem.

In the order of planning: start and goal, search, optimisation. `verification` adds what roll-outs show, and `explain`
puts all of it in order: the level that failed, the place, the constraint, its amount and the nearest remedy.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from micah_plan.arrays import EQUAL, ROUND_OFF, Floats
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.input_reversal import input_reversal_of
from micah_plan.planning import messages
from micah_plan.planning.limits import Limits
from micah_plan.planning.offers import (
    LARGER_STEPS,
    LESS_NOISE,
    LONGER_SEARCH,
    MORE_CANDIDATES,
    MORE_KNOTS,
    MORE_STATES,
    SURER_START,
    larger_steps,
    lower_confidence,
    more_revisits,
    moved_target,
)
from micah_plan.planning.purposes import purpose_sentences
from micah_plan.planning.search.leaves import leaves_of
from micah_plan.planning.search.passages import passage_exists
from micah_plan.planning.search.polytope import mode_states
from micah_plan.planning.search.roadmap import obstacles_on_state
from micah_plan.planning.search.samples import Samples, guard_states, inside_any
from micah_plan.planning.transcription.rows import Row, Shortfall, unit_of
from micah_plan.task.plan import Finding, Level, Outcome, Plan
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Code, Offer, Reason, one_of
from micah_plan.task.start import is_final, modes_to_be_in, start_mode

LEAST_CONFIDENCE = 0.5
# A remedy asks for at most so many more revisits: each makes the search for them several times longer.
_MOST_MORE_REVISITS = 2
# Factors of larger steps that are tested: the last represents any.
_LARGER = tuple(2.0**k for k in range(1, 31))
# Modes that one message describes.
_MOST_NAMED = 4


def endpoint_findings(problem: Problem) -> tuple[Finding, ...]:
    """Findings on the start, else on the goal, that hold for any path between them; empty if there are none."""
    _, reason = start_mode(problem.automaton, problem.start)
    return tuple(_goal_findings(problem)) if reason is None else (_start_finding(problem, reason),)


def _start_finding(problem: Problem, reason: Reason) -> Finding:
    """Finding on a start outside the ranges of its mode, with the coordinate and the amount."""
    automaton, start = problem.automaton, problem.start
    outside = []
    for mode in [automaton.mode(start.mode)] if start.mode is not None else modes_to_be_in(automaton):
        ranges = enumerate(map(mode.interval, range(automaton.n)))
        outside.append((mode, [max(0.0, low - start.mean[i], start.mean[i] - high) for i, (low, high) in ranges]))
    nearest, amounts = min(outside, key=lambda pair: max(pair[1]))
    worst = int(np.argmax(amounts))
    amount, coordinate, (low, high) = amounts[worst], automaton.coordinates[worst], nearest.interval(worst)
    finding = replace(Finding.of("start", reason), mode=nearest.name)
    if amount <= 0:  # it is out of a range that is not of one coordinate alone
        return finding
    unit, place = coordinate.unit, min(max(start.mean[worst], low), high)
    name = coordinate.name
    moved = Offer(messages.within_range(name), messages.start_at(name), "start", ((worst, place),))
    ways = moved, messages.NAME_THE_MODE
    return replace(
        finding,
        sentence=messages.start_misses_mode(finding.sentence, nearest.name, amount, unit),
        remedy=one_of(ways),
        ways=ways,
        constraint=f"{name} in [{low:g}, {high:g}] {unit}",
        amount=amount,
        unit=unit,
    )


def _goal_findings(problem: Problem) -> Iterator[Finding]:
    """Targets outside the ranges of all modes that the goal admits."""
    named = problem.goal.modes
    modes = [mode for mode in modes_to_be_in(problem.automaton) if not named or mode.name in named]
    modes = modes or [mode for mode in problem.automaton.modes if problem.goal.admits(mode.name)]
    for index, value, tolerance in problem.goal.target:
        coordinate, ranges = problem.automaton.coordinates[index], problem.automaton.ranges(index, modes)
        if not ranges:
            continue
        nearest = min((min(max(value, low), high) for low, high in ranges), key=lambda x: abs(x - value))
        missing, name, unit = abs(nearest - value) - tolerance, coordinate.name, coordinate.unit
        if missing > EQUAL * max((high - low for low, high in ranges if np.isfinite(high - low)), default=0.0):
            texts = " or ".join(f"[{low:g}, {high:g}]" for low, high in ranges)
            way = moved_target(index, nearest)
            yield Finding(
                "goal",
                "goal_outside_range",
                messages.goal_outside_range(name, value, tolerance, unit, texts, missing),
                way.words,
                constraint=f"{name} in {texts} {unit}",
                amount=missing,
                unit=unit,
                ways=(way,),
            )


def why_unreachable(problem: Problem, limits: Limits, samples: Samples) -> Reason | None:
    """The reason why no sequence of transitions leads to the goal, for any paths in modes; None if one does."""
    if not samples.goals:
        return _no_mode_holds_goal(problem, limits)
    edges = [(i, edge) for i, edge in enumerate(problem.automaton.edges) if not edge.is_self_transition]
    if not set(samples.goals) & _reachable(samples.start[0], (edge for _, edge in edges)):
        sentence = messages.no_transition_to_goal(samples.start[0], tuple(samples.goals))
        return Reason("no_transition_to_goal", sentence, (messages.CHANGE_GOAL_OR_ADD_TRANSITION,))
    reached = _reachable(samples.start[0], (edge for i, edge in edges if i in samples.exits))
    if set(samples.goals) & reached:
        return None
    return _closed_edge(problem, limits, next(e for i, e in edges if e.source in reached and e.target not in reached))


def why_disconnected(
    problem: Problem, limits: Limits, samples: Samples, in_the_way: tuple[str, ...], *, revisiting: bool = True
) -> Reason:
    """The reason why the roadmaps do not connect start and goal although transitions do.

    Args:
        in_the_way: constraints on the path and guards without any one of which they would be connected.
        revisiting: whether to test if more revisits would be enough.
    """
    automaton = problem.automaton
    edges = [automaton.edges[i] for i in samples.exits]
    reached = _reachable(samples.start[0], edges)
    leading_on = reached & _reachable(samples.goals, [replace(e, source=e.target, target=e.source) for e in edges])
    moved = np.any([automaton.mode(name).driven for name in leading_on], axis=0)
    missed = problem.goal.misses(np.array(problem.start.mean))
    for (index, value, tolerance), apart in zip(problem.goal.target, missed, strict=True):
        start, coordinate = problem.start.mean[index], automaton.coordinates[index]
        if apart and not moved[index]:
            is_moved = any(automaton.mode(name).driven[index] for name in reached)
            goal = value, tolerance
            sentence = messages.coordinate_not_moved(coordinate.name, coordinate.unit, start, goal, is_moved)
            return Reason("coordinate_not_moved", sentence, (messages.CHANGE_GOAL_OR_START,))
    if (reason := _why_inside(problem, samples)) is not None:
        return reason
    if samples.is_cut_short:
        sentence = messages.search_limit_reached(problem.settings.search_limit)
        return Reason("search_limit_reached", sentence, (LONGER_SEARCH,))
    if (reason := _why_excluded(problem, limits, samples.start[0], revisiting)) is not None:
        return reason
    if in_the_way:
        is_asked = in_the_way[0] in [constraint.name for constraint in problem.constraints]
        remedy = messages.RELAX_CONSTRAINT if is_asked else messages.MAKE_ROOM_OR_CHANGE_MODE
        return Reason("constraint_in_the_way", messages.constraint_in_the_way(in_the_way), (remedy,))
    return Reason("not_connected", messages.not_connected(problem.settings.samples_per_mode), (MORE_STATES,))


def _why_inside(problem: Problem, samples: Samples) -> Reason | None:
    """The reason if the start, or all of the goal, lies in a guard on the state that leaves the mode; else None."""
    automaton, (mode, number) = problem.automaton, samples.start
    start = samples.points[mode][[number]]
    if (inside := _deepest(automaton, mode, start)) is not None:
        edge, depth, unit = inside
        sentence = messages.start_in_obstacle(edge.guard.name, edge.name, depth, unit)
        return Reason("start_in_obstacle", sentence, (messages.MOVE_START_OR_OBSTACLE,))
    guards = dict[tuple[str, str], None]()
    for name, numbers in samples.goals.items():
        # On unreachable leaves the goal has no states; final modes do not count either.
        if not len(numbers) or (is_final(automaton, automaton.mode(name)) and name not in problem.goal.modes):
            continue
        points = samples.points[name][numbers]
        if not inside_any(obstacles_on_state(automaton, name), points).all():
            return None
        if (inside := _deepest(automaton, name, points[:1])) is not None:
            guards[inside[0].guard.name, inside[0].name] = None
    if not guards:
        return None
    return Reason("goal_in_obstacle", messages.goal_in_obstacle(tuple(guards)), (messages.MOVE_GOAL_OR_OBSTACLE,))


def _deepest(automaton: HybridAutomaton, mode: str, point: Floats) -> tuple[Edge, float, str] | None:
    """(edge, depth, unit): the edge with a guard on the state alone in which a state (1, n) lies deepest."""
    candidates: list[tuple[float, Edge, str]] = []
    for edge in automaton.edges_from(mode):
        rows = [h for h in edge.guard.half_spaces if h.on_state]
        if edge.is_self_transition or not rows or edge.guard.on_input:
            continue
        margins = [float(h.margin(point[0], np.zeros(automaton.m))) / float(np.linalg.norm(h.a)) for h in rows]
        least = int(np.argmin(margins))
        if margins[least] > ROUND_OFF:
            candidates.append((margins[least], edge, unit_of(automaton, rows[least])))
    if not candidates:
        return None
    depth, edge, unit = max(candidates, key=lambda item: item[0])
    return edge, depth, unit


def _why_excluded(problem: Problem, limits: Limits, start_mode: str, revisiting: bool) -> Reason | None:
    """The reason why the goal is unreachable even without obstacles, if the invariants of inputs show it; else None."""
    automaton, revisits = problem.automaton, problem.settings.revisits
    leaves = [
        leaves_of_mode
        for leaves_of_mode in (leaves_of(mode, limits) for mode in automaton.modes)
        if leaves_of_mode.are_many
    ]
    if not leaves or passage_exists(problem, limits, start_mode, revisits) is not False:
        return None
    for more in range(revisits + 1, revisits + 1 + _MOST_MORE_REVISITS) if revisiting else ():
        if passage_exists(problem, limits, start_mode, more):
            return Reason("too_few_revisits", messages.too_few_revisits(revisits), (more_revisits(more),))
    kept = [
        (leave.mode.name, leave.kept_words(automaton.coordinate_names))
        for leave in leaves
        if not is_final(automaton, leave.mode)
    ]
    sentence = messages.inputs_keep_coordinates(kept[:_MOST_NAMED], len(kept) > _MOST_NAMED)
    return Reason("inputs_keep_coordinates", sentence, (messages.CHANGE_GOAL_OR_START,))


def _no_mode_holds_goal(problem: Problem, limits: Limits) -> Reason:
    automaton, goal = problem.automaton, problem.goal
    items = [(automaton.coordinates[i], i, value, tolerance) for i, value, tolerance in goal.target]
    wanted = ", ".join(f"{c.name} = {value:g} ± {tolerance:g} {c.unit}" for c, _, value, tolerance in items)
    ranges = []
    for name in goal.modes or automaton.mode_names:
        states = mode_states(automaton.mode(name), limits)
        texts = [f"{c.name} in [{states.lower[i]:g}, {states.upper[i]:g}] {c.unit}" for c, i, _, _ in items]
        texts += [tie.words(automaton.coordinate_names) for tie in automaton.mode(name).ties]
        ranges.append(f"'{name}' allows {', '.join(texts)}")
    sentence = messages.goal_in_no_mode(wanted, bool(goal.modes), ranges)
    return Reason("goal_in_no_mode", sentence, (messages.MOVE_GOAL_INTO_RANGE,))


def _closed_edge(problem: Problem, limits: Limits, edge: Edge) -> Reason:
    if guard_states(problem, limits, edge).is_empty:
        guard = edge.name, [half_space.name for half_space in edge.guard.half_spaces], edge.source
        for factor in _LARGER:
            larger = replace(limits, max_step=factor * limits.max_step)
            if not guard_states(problem, larger, edge).is_empty:
                return Reason("guard_unreachable", messages.guard_unreachable(*guard), (larger_steps(factor),))
        return Reason("guard_empty", messages.guard_empty(*guard), (messages.CORRECT_GUARD,))
    sentence = messages.reset_outside_mode(edge.name, edge.target)
    return Reason("reset_outside_mode", sentence, (messages.CORRECT_RESET,))


def _reachable(start: str | Iterable[str], edges: Iterable[Edge]) -> set[str]:
    """The modes reachable by edges from one or several."""
    edges, reached = list(edges), {start} if isinstance(start, str) else set(start)
    for _ in edges:  # no chain of transitions is longer
        reached |= {edge.target for edge in edges if edge.source in reached}
    return reached


def sentence_of(shortfall: Shortfall) -> str:
    """The violated row, with the amount and the place."""
    return messages.at_knot(_missed(shortfall), shortfall.row.knot, shortfall.row.mode)


def partly_met(shortfall: Shortfall) -> str:
    """Finding on a boundary that a plan keeps with less than its confidence."""
    row = shortfall.row
    return messages.holds_in_part(row.name, row.confidence or 0.0, row.knot, row.mode)


def finding_of_status(modes: tuple[str, ...], status: str, *, is_out_of_time: bool = False) -> Finding:
    """Finding on an optimisation that failed without a violated constraint."""
    ways = (messages.RAISE_TIME_LIMIT,) if is_out_of_time else (MORE_STATES, MORE_CANDIDATES, messages.OTHER_SEED)
    code: Code = "time_limit_reached" if is_out_of_time else "optimisation_failed"
    return Finding.of("optimisation", Reason(code, messages.optimisation_failed(status), ways), modes)


def findings_of(problem: Problem, modes: tuple[str, ...], shortfalls: Sequence[Shortfall]) -> list[Finding]:
    """The findings of a mode sequence in the given order, with the two sides of a corridor merged."""
    findings: dict[tuple[object, ...], Finding] = {}
    for number, shortfall in enumerate(shortfalls):
        row = shortfall.row
        side = number if shortfall.width is None else f"{shortfall.width:.9g}"
        findings.setdefault((row.mode, row.knot, side), finding_of(problem, modes, shortfall))
    return list(findings.values())


def finding_of(problem: Problem, modes: tuple[str, ...], shortfall: Shortfall) -> Finding:
    """Finding on a violated constraint of the optimisation, in the user's terms."""
    row, amount = shortfall.row, float(shortfall.amount)
    ways = _mean_remedies(shortfall)
    finding = Finding(
        "optimisation",
        "constraint_missed",
        _missed(shortfall),
        one_of(ways),
        modes,
        row.mode,
        row.knot,
        row.label,
        amount if np.isfinite(amount) else None,
        unit=row.unit,
        ways=ways,
    )
    if shortfall.std is None:
        return finding
    need = problem.settings.sigmas * shortfall.std
    room = need - amount  # between the boundaries there would be more, but not where the path leads
    is_narrow = shortfall.width is not None and shortfall.width < 2.0 * need
    if is_narrow:
        room, need = shortfall.width or 0.0, 2.0 * need
    sentence = _space_sentence(problem, row, room, need, is_narrow)
    # The confidence at which the room suffices, rounded down.
    possible = int(100 * ndtr(problem.settings.sigmas * room / need)) / 100 if need > 0 else 0.0
    ways = _space_remedies(problem, row, room, need, possible)
    return replace(
        finding, code="too_little_room", sentence=sentence, remedy=one_of(ways), room=room, need=need, ways=ways
    )


def _missed(shortfall: Shortfall) -> str:
    if not np.isfinite(shortfall.amount):
        return messages.not_a_number(shortfall.row.label)
    return messages.constraint_missed(shortfall.row.label, float(shortfall.amount), shortfall.row.unit)


def _space_sentence(problem: Problem, row: Row, room: float, need: float, is_narrow: bool) -> str:
    """The available space, and the space that the belief needs."""
    name = row.name if row.half_space is None else f"'{row.half_space.name}'"
    confidence = problem.settings.confidence
    if (behind := _reversing_mode(problem, row)) is not None:
        return messages.no_room_to_reverse(name, (row.mode, behind), room, need, row.unit, confidence)
    if is_narrow:
        return messages.corridor_too_narrow(name, room, need, row.unit, confidence)
    if row.kind == "guard":
        return messages.guard_not_entered(name, room, need, row.unit)
    sentence = messages.margin_too_small if row.kind == "path" else messages.path_too_close
    return sentence(name, room, need, row.unit, confidence)


def _space_remedies(problem: Problem, row: Row, room: float, need: float, possible: float) -> tuple[str | Offer, ...]:
    """Remedies where a belief lacks space.

    Args:
        room, need: available, and required by the belief [unit].
        possible: the confidence at which the room suffices.
    """
    if _reversing_mode(problem, row) is not None:
        return LARGER_STEPS, SURER_START, LESS_NOISE
    edges = problem.automaton.edges_from(row.mode)
    contact = [
        edge.target
        for edge in edges
        if row.sign < 0
        and row.half_space in edge.guard.half_spaces
        and not is_final(problem.automaton, problem.automaton.mode(edge.target))
    ]
    if row.kind == "guard" and room < 0.0:  # the mean does not get there either
        return MORE_KNOTS, LARGER_STEPS, SURER_START, LESS_NOISE
    ways: list[str | Offer] = [SURER_START, LESS_NOISE]
    ways += [messages.allow_contact(contact[0])] if contact else []
    ways += [messages.relax_by(row.name, need - room, row.unit)] if row.kind == "path" else []
    ways += [more_revisits(1)] if not problem.settings.revisits else []  # it may localise elsewhere
    is_enough = possible > LEAST_CONFIDENCE
    return *ways, lower_confidence(possible) if is_enough else messages.MORE_ROOM


def _reversing_mode(problem: Problem, row: Row) -> str | None:
    """The mode behind a boundary that a single step must cross, since motion reverses there; None elsewhere."""
    for edge in problem.automaton.edges_from(row.mode) if row.kind == "boundary" and row.sign < 0 else ():
        turn = input_reversal_of(problem.automaton, edge)
        if turn is not None and turn.half_space == row.half_space:
            return edge.target
    return None


def _mean_remedies(shortfall: Shortfall) -> tuple[str | Offer, ...]:
    """Remedies for a constraint that is violated by the mean."""
    row, amount = shortfall.row, float(shortfall.amount)
    steps = MORE_KNOTS, LARGER_STEPS
    if row.kind == "goal":
        wider = messages.WIDEN_GOAL
        if row.coordinate is None or not np.isfinite(amount):
            return wider, *steps
        return Offer(wider, f"{wider} to", "tolerance", ((row.coordinate, row.upper + amount),)), *steps
    if row.kind == "input":
        return *steps, messages.CORRECT_INPUTS
    if row.kind == "boundary":
        return messages.MOVE_GOAL_OR_START_AWAY, *steps
    if row.kind == "path" and np.isfinite(amount):
        return messages.relax_by("it", amount, row.unit), *steps
    return steps


@dataclass(frozen=True)
class Explanation:
    """A plan in words.

    Attributes:
        outcome: of the plan.
        summary: one sentence on the whole.
        level: at which it failed; None if it is solved.
        findings: obstacles to the plan, first those of the first level that failed and of the cheapest mode sequence.
        lines: all of it to be read, one sentence each.
    """

    outcome: Outcome
    summary: str
    level: Level | None
    findings: tuple[Finding, ...]
    lines: tuple[str, ...]


def explain(problem: Problem, plan: Plan) -> Explanation:
    """Explain a plan of any outcome, also one read from a file: the findings that prevent or weaken it.

    A plan file of an older version has no findings; then start and goal are checked again, and otherwise its reason is
    used.
    """
    findings = plan.ranked_findings
    if plan.outcome == "no_plan" and not findings:
        findings = endpoint_findings(problem)
    level = None if plan.outcome == "solved" or not findings else findings[0].level
    lines = [_outcome_line(plan, level), *(line for finding in findings for line in finding_lines(finding))]
    lines += [f"mode '{mode}': {sentence}" for mode, sentence in purpose_sentences(plan)]
    if not findings and plan.outcome != "solved":
        lines.append(messages.WITHOUT_FINDINGS)
    lines += [messages.candidate(one.modes, one.cost, one.message) for one in plan.candidates]
    return Explanation(plan.outcome, plan.reason, level, findings, tuple(lines))


def finding_lines(finding: Finding) -> list[str]:
    """Level and sentence of a finding, and its remedy, as lines."""
    place: str = finding.level
    place += f", {' -> '.join(finding.modes)}" if finding.modes else ""
    if finding.knot is not None:
        place += f", knot {finding.knot} in mode '{finding.mode}'"
    lines = [f"{place}: {finding.sentence}"]
    return [*lines, f"  remedy: {finding.remedy}"] if finding.remedy else lines


def _outcome_line(plan: Plan, level: Level | None) -> str:
    if plan.outcome == "solved":
        return messages.solved_through(plan.mode_sequence, plan.success_probability)
    return messages.failed_at(plan.outcome == "not_verified", level, plan.reason)
