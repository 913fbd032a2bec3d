"""A problem document and its model -> problem, and back to plain data; start and goal are checked against the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton, Mode, Noise
from micah_plan.planning.problem import Goal, PlannerSettings, Problem, Start
from micah_plan.spec.located import KeyPath, Located
from micah_plan.spec.model_values import by_name
from micah_plan.spec.problem_document import PROBLEM_FORMAT, GoalDocument, ProblemDocument, StartDocument

_EDGE_TOLERANCE = 1e-9
Interval = tuple[float, float]


def problem_of(document: ProblemDocument, automaton: HybridAutomaton, located: Located) -> Problem:
    """The problem that a file describes, without its source and digests.

    Args:
        document: the validated layout.
        automaton: the model that it names.
        located: the data that the document was validated from, for the places in messages.

    Raises:
        InputError: for unknown names, a start that no mode allows, or a goal outside the object's range.
    """
    automaton = replace(automaton, noise=_noise(document, automaton, located))
    planner = document.planner.model_dump(exclude={"max_step"})
    max_step = None
    if document.planner.max_step is not None:
        names = [item.name for item in automaton.inputs]
        max_step = tuple(by_name(document.planner.max_step, names, "input", located, ("planner", "max_step")))
    return Problem(
        automaton=automaton,
        start=_start(document.start, automaton, located),
        goal=_goal(document.goal, automaton, located),
        settings=PlannerSettings(confidence=document.confidence, max_step=max_step, **planner),
        plant=document.plant.model_dump(exclude_none=True),
    )


def problem_data(problem: Problem, model: str) -> dict[str, Any]:
    """The plain data of a problem file for a model of that name, with every setting written out; without its noise."""
    names = [item.name for item in problem.automaton.coordinates]
    settings = {key: value for key, value in vars(problem.settings).items() if key != "confidence"}
    if problem.settings.max_step is None:
        del settings["max_step"]
    else:
        inputs = [item.name for item in problem.automaton.inputs]
        settings["max_step"] = dict(zip(inputs, problem.settings.max_step, strict=True))
    start: dict[str, Any] = {
        "mean": dict(zip(names, problem.start.mean, strict=True)),
        "std": dict(zip(names, problem.start.std, strict=True)),
    }
    if problem.start.mode is not None:
        start["mode"] = problem.start.mode
    target = {names[index]: {"value": value, "tolerance": tol} for index, value, tol in problem.goal.target}
    return {
        "format": PROBLEM_FORMAT,
        "model": model,
        "start": start,
        "goal": {"target": target, "modes": list(problem.goal.modes)},
        "confidence": problem.settings.confidence,
        "planner": settings,
        "plant": dict(problem.plant),
    }


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


def _noise(document: ProblemDocument, automaton: HybridAutomaton, located: Located) -> Noise:
    """The model's noise, with the problem's where it states any."""
    names = [item.name for item in automaton.coordinates]
    values = {}
    for key in ("process_std", "observation_std"):
        own: Mapping[str, float] = getattr(document.noise, key)
        everything = {**dict(zip(names, getattr(automaton.noise, key), strict=True)), **own}
        values[key] = tuple(by_name(everything, names, "coordinate", located, ("noise", key)))
    return Noise(**values)


def _start(start: StartDocument, automaton: HybridAutomaton, located: Located) -> Start:
    names = [item.name for item in automaton.coordinates]
    mean = tuple(by_name(start.mean, names, "coordinate", located, ("start", "mean")))
    std = tuple(by_name(start.std, names, "coordinate", located, ("start", "std")))
    allowed = _modes_at(automaton, mean)
    state = ", ".join(
        f"{item.name} = {value:g} {item.unit}" for item, value in zip(automaton.coordinates, mean, strict=True)
    )
    if start.mode is not None:
        path: KeyPath = ("start", "mode")
        known = _mode_names(automaton)
        if start.mode not in known:
            raise located.unknown(path, "mode", start.mode, known)
        if start.mode not in allowed:
            remedy = f"start there in {' or '.join(allowed)}" if allowed else _invariants(automaton, [start.mode])
            raise located.error(path, f"mode '{start.mode}' does not allow the start {state}", remedy)
    elif not allowed:
        problem = f"the start {state} lies in no mode's invariant"
        raise located.error(("start", "mean"), problem, _invariants(automaton, _mode_names(automaton)))
    return Start(mean, std, start.mode)


def _modes_at(automaton: HybridAutomaton, mean: Sequence[float]) -> list[str]:
    """Modes whose invariant, and Init if the model has one, holds the mean."""
    x, u = np.array(mean), np.zeros(automaton.m)
    initial = {mode for mode, region in automaton.init if region.contains(x, u, _EDGE_TOLERANCE)}
    allowed = automaton.modes_at(x, _EDGE_TOLERANCE)
    return [mode for mode in allowed if mode in initial or not automaton.init]


def _invariants(automaton: HybridAutomaton, modes: Sequence[str]) -> str:
    """The remedy that says what the modes allow: ``allowed: swings (door >= 0, door <= 1.2)``."""
    texts = []
    for name in modes:
        regions = [automaton.mode(name).invariant, *(region for mode, region in automaton.init if mode == name)]
        rows = ", ".join(half_space.name for region in regions for half_space in region.half_spaces)
        texts.append(f"{name} ({rows or 'everywhere'})")
    return f"allowed: {'; '.join(texts[:6])}{'; ...' if len(texts) > 6 else ''}"


def _goal(goal: GoalDocument, automaton: HybridAutomaton, located: Located) -> Goal:
    known = _mode_names(automaton)
    for i, mode in enumerate(goal.modes):
        if mode not in known:
            raise located.unknown(("goal", "modes", i), "mode", mode, known)
    if not goal.target and not goal.modes:
        raise located.error(("goal",), "the goal is empty", "give a target, modes to end in, or both")
    modes = [mode for mode in automaton.modes if not goal.modes or mode.name in goal.modes]
    names = [item.name for item in automaton.coordinates]
    target = []
    for name, wanted in goal.target.items():
        path: KeyPath = ("goal", "target", name)
        if name not in names:
            raise located.unknown(path, "coordinate", name, names)
        index = names.index(name)
        ranges = coordinate_ranges(index, modes)
        nearest = _nearest(wanted.value, ranges)
        if abs(nearest - wanted.value) > wanted.tolerance:
            unit = automaton.coordinates[index].unit
            of = f" of {' or '.join(goal.modes)}" if goal.modes else ""
            problem = f"expected a value within the range{of}, {_ranges_text(ranges)} {unit}, found {wanted.value:g}"
            raise located.error((*path, "value"), problem, f"the nearest possible value is {nearest:g} {unit}")
        target.append((index, wanted.value, wanted.tolerance))
    return Goal(tuple(target), tuple(goal.modes))


def _nearest(value: float, ranges: Sequence[Interval]) -> float:
    candidates = [min(max(value, low), high) for low, high in ranges]
    return min(candidates, key=lambda candidate: abs(candidate - value), default=np.inf)


def _ranges_text(ranges: Sequence[Interval]) -> str:
    return " or ".join(f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in ranges) or "none"


def _mode_names(automaton: HybridAutomaton) -> list[str]:
    """The names of the modes, in order."""
    return [mode.name for mode in automaton.modes]
