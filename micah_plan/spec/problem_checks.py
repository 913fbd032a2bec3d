"""Whether a problem's start and goal are possible for its object; said with the place in the problem file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.planning.problem import Goal, Problem, Start
from micah_plan.spec.located import Located

_EDGE_TOLERANCE = 1e-9
_MOST_LISTED = 6
Interval = tuple[float, float]


def check_problem(problem: Problem, located: Located) -> None:
    """Raise an InputError if the start lies in no mode's invariant or the goal outside the object's range.

    Args:
        problem: made from the data in `located`.
        located: the problem file, for the places in messages.
    """
    _check_start(problem.start, problem.automaton, located)
    _check_goal(problem.goal, problem.automaton, located)


def coordinate_ranges(index: int, modes: Sequence[Mode]) -> list[Interval]:
    """What modes allow for one coordinate, as intervals in increasing order; infinite where there is no limit.

    Only half-spaces on this coordinate alone count, and pins; others can narrow the true range further.
    """
    ranges = []
    for mode in modes:
        low, high = -np.inf, np.inf
        for half_space in mode.invariant.half_spaces:
            weight = half_space.a[index]
            if weight == 0.0 or any(half_space.b) or sum(w != 0.0 for w in half_space.a) > 1:
                continue
            bound = half_space.c / weight
            low, high = (max(low, bound), high) if weight > 0 else (low, min(high, bound))
        for pin in mode.pins:
            if pin.coordinate == index:
                low = high = pin.value
        if low <= high:
            ranges.append((float(low), float(high)))
    return _merged(sorted(ranges))


def _merged(ranges: list[Interval]) -> list[Interval]:
    merged: list[Interval] = []
    for low, high in ranges:
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return merged


def _check_start(start: Start, automaton: HybridAutomaton, located: Located) -> None:
    allowed = _modes_at(automaton, start.mean)
    values = zip(automaton.coordinates, start.mean, strict=True)
    state = ", ".join(f"{item.name} = {value:g} {item.unit}" for item, value in values)
    if start.mode is not None and start.mode not in allowed:
        remedy = f"start there in {' or '.join(allowed)}" if allowed else _invariants(automaton, [start.mode])
        raise located.error(("start", "mode"), f"mode '{start.mode}' does not allow the start {state}", remedy)
    if not allowed:
        remedy = _invariants(automaton, [mode.name for mode in automaton.modes])
        raise located.error(("start", "mean"), f"the start {state} lies in no mode's invariant", remedy)


def _modes_at(automaton: HybridAutomaton, mean: Sequence[float]) -> list[str]:
    """Modes whose invariant, and Init if the model has one, holds the mean."""
    x, u = np.array(mean), np.zeros(automaton.m)
    initial = {mode for mode, region in automaton.init if region.contains(x, u, _EDGE_TOLERANCE)}
    return [mode for mode in automaton.modes_at(x, _EDGE_TOLERANCE) if mode in initial or not automaton.init]


def _invariants(automaton: HybridAutomaton, modes: Sequence[str]) -> str:
    """The remedy that says what the modes allow: ``allowed: swings (door >= 0, door <= 1.2)``."""
    texts = []
    for name in modes[:_MOST_LISTED]:
        regions = [automaton.mode(name).invariant, *(region for mode, region in automaton.init if mode == name)]
        rows = ", ".join(half_space.name for region in regions for half_space in region.half_spaces)
        texts.append(f"{name} ({rows or 'everywhere'})")
    return f"allowed: {'; '.join(texts)}{'; ...' if len(modes) > _MOST_LISTED else ''}"


def _check_goal(goal: Goal, automaton: HybridAutomaton, located: Located) -> None:
    if not goal.target and not goal.modes:
        raise located.error(("goal",), "the goal is empty", "give a target, modes to end in, or both")
    modes = [mode for mode in automaton.modes if not goal.modes or mode.name in goal.modes]
    for index, value, tolerance in goal.target:
        name, unit = automaton.coordinates[index].name, automaton.coordinates[index].unit
        ranges = coordinate_ranges(index, modes)
        nearest = _nearest(value, ranges)
        if abs(nearest - value) > tolerance:
            of = f"mode {' or '.join(goal.modes)}" if goal.modes else "the object"
            problem = f"expected a value that {of} can reach, {_written(ranges)} {unit}, found {value:g}"
            remedy = f"the nearest possible value is {nearest:g} {unit}"
            raise located.error(("goal", "target", name, "value"), problem, remedy)


def _nearest(value: float, ranges: Sequence[Interval]) -> float:
    candidates = [min(max(value, low), high) for low, high in ranges]
    return min(candidates, key=lambda candidate: abs(candidate - value), default=np.inf)


def _written(ranges: Sequence[Interval]) -> str:
    return " or ".join(f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in ranges) or "none"
