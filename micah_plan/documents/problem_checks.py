"""Whether a problem's start and goal are possible for its object; said with the place in the problem file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.region import Interval
from micah_plan.documents.expressions import Variables, short_number, short_text
from micah_plan.documents.located import Located
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.start import LIMIT_ROOM, Start, start_mode, start_regions

_MOST_LISTED = 6


def check_problem(problem: Problem, located: Located) -> None:
    """Raise an InputError if the start is in no mode or the goal outside the object's range.

    Args:
        problem: made from the data in `located`.
        located: the problem file, for the places in messages.
    """
    _check_start(problem.start, problem.automaton, located)
    _check_goal(problem.goal, problem.automaton, located)


def _check_start(start: Start, automaton: HybridAutomaton, located: Located) -> None:
    """By the planner's own rule, so that a file is refused exactly where the planner would find no mode to start in."""
    if start_mode(automaton, start)[0] is not None:
        return
    names = automaton.mode_names
    allowed = [name for name in names if start_mode(automaton, replace(start, mode=name))[0] is not None]
    values = zip(automaton.coordinates, start.mean, strict=True)
    state = ", ".join(f"{item.name} = {short_number(value)} {item.unit}" for item, value in values)
    if start.mode is not None:
        remedy = f"start there in {' or '.join(allowed)}" if allowed else _invariants(automaton, [start.mode])
        raise located.at("start", "mode").error(f"mode '{start.mode}' does not allow the start {state}", remedy)
    problem = f"the start {state} lies in no mode's invariant"
    raise located.at("start", "mean").error(problem, _invariants(automaton, names))


def _invariants(automaton: HybridAutomaton, modes: Sequence[str]) -> str:
    """The remedy that says what the modes allow: ``allowed: swings (door >= 0, door <= 1.2)``."""
    variables = Variables(automaton.coordinate_names, automaton.input_names)
    texts = []
    for name in modes[:_MOST_LISTED]:
        regions = start_regions(automaton, automaton.mode(name))
        rows = [", ".join(short_text(h, variables) for h in region.half_spaces) or "everywhere" for region in regions]
        texts.append(f"{name} ({' or '.join(rows) or 'nowhere'})")
    return f"allowed: {'; '.join(texts)}{'; ...' if len(modes) > _MOST_LISTED else ''}"


def _check_goal(goal: Goal, automaton: HybridAutomaton, located: Located) -> None:
    if not goal.target and not goal.modes:
        raise located.at("goal").error("the goal is empty", "give a target, modes to end in, or both")
    modes = [mode for mode in automaton.modes if goal.admits(mode.name)]
    for index, value, tolerance in goal.target:
        name, unit = automaton.coordinates[index].name, automaton.coordinates[index].unit
        ranges = automaton.ranges(index, modes)
        nearest = _nearest(value, ranges)
        room = LIMIT_ROOM * max((high - low for low, high in ranges if np.isfinite(high - low)), default=0.0)
        if abs(nearest - value) > tolerance + room:
            of = f"mode {' or '.join(goal.modes)}" if goal.modes else "the object"
            problem = f"expected a value that {of} can reach, {_written(ranges)} {unit}, found {short_number(value)}"
            remedy = f"the nearest possible value is {short_number(nearest)} {unit}"
            raise located.at("goal", "target", name, "value").error(problem, remedy)


def _nearest(value: float, ranges: Sequence[Interval]) -> float:
    candidates = [min(max(value, low), high) for low, high in ranges]
    return min(candidates, key=lambda candidate: abs(candidate - value), default=np.inf)


def _written(ranges: Sequence[Interval]) -> str:
    texts = [(short_number(low), short_number(high)) for low, high in ranges]
    return " or ".join(low if low == high else f"{low} to {high}" for low, high in texts) or "none"
