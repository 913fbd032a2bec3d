"""What stands in the way of a plan, with amounts and the nearest remedy; start and goal first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from micah_plan.automaton.turning import turn_of
from micah_plan.planning.transcription.rows import Row, Shortfall
from micah_plan.quantities import percent, quantity
from micah_plan.task.plan import Finding, Level
from micah_plan.task.problem import Problem
from micah_plan.task.start import LIMIT_ROOM, start_mode

_LEAST_CONFIDENCE = 0.5


def endpoint_findings(problem: Problem) -> tuple[Finding, ...]:
    """What is wrong with the start, else with the goal, whatever leads from one to the other; empty if nothing is."""
    start = _start_finding(problem)
    return (start,) if start is not None else tuple(_goal_findings(problem))


def finding_of_reason(level: Level, reason: str, modes: tuple[str, ...] = ()) -> Finding:
    """An finding from a reason that ends with its remedy after a semicolon."""
    sentence, _, remedy = reason.rpartition("; ")
    return Finding(level, sentence or remedy, remedy if sentence else "", modes)


def finding_of_status(modes: tuple[str, ...], status: str) -> Finding:
    """An optimisation that failed although no constraint has to be broken."""
    remedy = "raise time_limit_s, samples_per_mode or candidates, or try another seed"
    return Finding("optimisation", f"the optimisation failed: {status}", remedy, modes)


def findings_of(problem: Problem, modes: tuple[str, ...], shortfalls: Sequence[Shortfall]) -> list[Finding]:
    """The findings of a mode sequence, in the order given; the two sides of one corridor are one."""
    found: dict[tuple[object, ...], Finding] = {}
    for number, shortfall in enumerate(shortfalls):
        row = shortfall.row
        side = number if shortfall.width is None else f"{shortfall.width:.9g}"
        found.setdefault((row.mode, row.knot, side), finding_of(problem, modes, shortfall))
    return list(found.values())


def finding_of(problem: Problem, modes: tuple[str, ...], shortfall: Shortfall) -> Finding:
    """A constraint of the optimisation that does not hold, in the words of the user."""
    row = shortfall.row
    room = need = None
    if shortfall.std is not None:
        need = problem.settings.sigmas * shortfall.std
        if shortfall.width is not None and shortfall.width < 2.0 * need:
            room, need = shortfall.width, 2.0 * need
        else:  # there would be room for the belief between the boundaries, but not where the path leads
            room, shortfall = need - shortfall.amount, replace(shortfall, width=None)
    return Finding(
        level="optimisation",
        sentence=_sentence(problem, shortfall, room, need),
        remedy=_remedy(problem, shortfall, room, need),
        modes=modes,
        mode=row.mode,
        knot=row.knot,
        constraint=row.name,
        amount=float(shortfall.amount) if np.isfinite(shortfall.amount) else None,
        room=room,
        need=need,
        unit=row.unit,
    )


def _sentence(problem: Problem, shortfall: Shortfall, room: float | None, need: float | None) -> str:
    row, confidence = shortfall.row, percent(problem.settings.confidence)
    if room is None or need is None or row.half_space is None:
        if not np.isfinite(shortfall.amount):
            return f"{row.name} is not a number"
        return f"{row.name} is missed by {quantity(shortfall.amount, row.unit)}"
    needs = f"the belief needs {quantity(need, row.unit)} at {confidence}"
    name = row.half_space.name
    if (turned := _turned_by(problem, row)) is not None:
        before = f"{quantity(room, row.unit)} before it" if room >= 0 else f"{quantity(-room, row.unit)} behind it"
        return (
            f"behind '{name}' the same input moves the other way ('{row.mode}' against '{turned}'), so one step must "
            f"surely lead across: it starts {before}, {needs}"
        )
    if shortfall.width is not None:
        return f"the corridor at '{name}' is {quantity(room, row.unit)} wide, {needs}"
    if row.kind == "guard":
        reached = f"{quantity(room, row.unit)} past it" if room >= 0 else f"{quantity(-room, row.unit)} before it"
        return f"the mean gets {reached} where the transition at '{name}' needs it {quantity(need, row.unit)} past it"
    return f"the path has {quantity(room, row.unit)} to '{name}', {needs}"


def _remedy(problem: Problem, shortfall: Shortfall, room: float | None, need: float | None) -> str:
    row = shortfall.row
    if room is None or need is None:
        return _plain_remedy(problem, shortfall)
    if _turned_by(problem, row) is not None:
        return "raise max_step, or lower the start's std or the noise"
    ways = ["lower the start's std or the noise"]
    contact = [
        edge.target
        for edge in problem.automaton.edges_from(row.mode)
        if row.sign < 0 and row.half_space in edge.guard.half_spaces
    ]
    ways += [f"allow contact with '{contact[0]}'"] if contact else []
    # The confidence at which the room suffices, rounded down.
    possible = int(100 * ndtr(problem.settings.sigmas * room / need)) / 100 if need > 0 else 0.0
    lower = possible > _LEAST_CONFIDENCE
    ways.append(
        f"lower `confidence` to {possible:.2f}" if lower else "make more room (no confidence above 0.5 suffices)"
    )
    return ", ".join(ways[:-1]) + f", or {ways[-1]}"


def _turned_by(problem: Problem, row: Row) -> str | None:
    """The mode behind a boundary that one step is to cross, because that mode moves the other way; None elsewhere."""
    for edge in problem.automaton.edges_from(row.mode) if row.kind == "boundary" and row.sign < 0 else ():
        turn = turn_of(problem.automaton, edge)
        if turn is not None and turn.half_space == row.half_space:
            return edge.target
    return None


def _plain_remedy(problem: Problem, shortfall: Shortfall) -> str:
    row, settings = shortfall.row, problem.settings
    steps = f"raise max_knots (now {settings.max_knots}) or max_step"
    if row.kind == "goal":
        return f"widen the goal's tolerance to {quantity(row.upper + shortfall.amount, row.unit)}, or {steps}"
    if row.kind == "input":
        return "raise max_step, or correct the inputs that the model admits"
    if row.kind == "boundary":
        return f"move the goal or the start away from it, or {steps}"
    return steps


def _start_finding(problem: Problem) -> Finding | None:
    """The start in no mode, or outside of its own: which coordinate is out of the nearest mode's range, and how far."""
    automaton, start = problem.automaton, problem.start
    mode, reason = start_mode(automaton, start)
    if mode is not None:
        return None
    sentence, _, remedy = reason.rpartition("; ")
    modes = [automaton.mode(start.mode)] if start.mode is not None else list(automaton.modes)
    nearest = min(modes, key=lambda mode: max(_outside(problem, mode.name)))
    outside = _outside(problem, nearest.name)
    worst = int(np.argmax(outside))
    if outside[worst] <= 0:  # it is out of a range that is not of one coordinate alone
        return Finding("start", sentence, remedy, mode=nearest.name)
    coordinate = automaton.coordinates[worst]
    low, high = nearest.interval(worst)
    place = min(max(start.mean[worst], low), high)
    return Finding(
        "start",
        f"{sentence}: it misses mode '{nearest.name}' by {quantity(outside[worst], coordinate.unit)}",
        f"start {coordinate.name} at {place:.4g} {coordinate.unit}, or name the mode that the object is in",
        mode=nearest.name,
        constraint=f"{coordinate.name} in [{low:g}, {high:g}] {coordinate.unit}",
        amount=outside[worst],
        unit=coordinate.unit,
    )


def _outside(problem: Problem, mode: str) -> list[float]:
    """How far each coordinate of the start's mean lies outside of a mode's range [its unit]; 0 inside."""
    intervals = [problem.automaton.mode(mode).interval(i) for i in range(problem.automaton.n)]
    return [max(0.0, low - x, x - high) for x, (low, high) in zip(problem.start.mean, intervals, strict=True)]


def _goal_findings(problem: Problem) -> list[Finding]:
    """Targets that no mode (of those that the goal names) holds."""
    goal, found = problem.goal, []
    modes = [mode for mode in problem.automaton.modes if goal.admits(mode.name)]
    for index, value, tolerance in goal.target:
        coordinate, ranges = problem.automaton.coordinates[index], problem.automaton.ranges(index, modes)
        if not ranges:
            continue
        nearest = min((min(max(value, low), high) for low, high in ranges), key=lambda x: abs(x - value))
        missing = abs(nearest - value) - tolerance
        room = LIMIT_ROOM * max((high - low for low, high in ranges if np.isfinite(high - low)), default=0.0)
        if missing > room:
            unit = coordinate.unit
            texts = " or ".join(f"[{low:g}, {high:g}]" for low, high in ranges)
            found.append(
                Finding(
                    "goal",
                    f"the goal {coordinate.name} = {value:g} ± {tolerance:g} {unit} misses the range {texts} {unit} "
                    f"by {quantity(missing, unit)}",
                    f"move its target to {nearest:.4g} {unit}",
                    constraint=f"{coordinate.name} in {texts} {unit}",
                    amount=missing,
                    unit=unit,
                )
            )
    return found
