"""Starts, goals and noise of a problem by names of coordinates, for use in Python."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from math import isfinite
from typing import Any

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton, Noise
from micah_plan.errors import InputError, choices, shown
from micah_plan.task.goal import Goal, unharmed
from micah_plan.task.start import Start, start_mode

Spread = float | tuple[float, float] | Sequence[float]
"""A value, or a value with a standard deviation or a tolerance [rad or m]."""
_NOISES = ("process_std", "observation_std")


def with_start(start: Start, automaton: HybridAutomaton, values: Mapping[str, Spread], mode: str | None) -> Start:
    """A start with new values of some coordinates; tied coordinates are updated.

    Args:
        start: new values; others are unchanged, and a value alone keeps its standard deviation.
        values: (mean, std) by coordinate [rad or m].
        mode: that it is in; None: the first whose invariant holds the mean, if values are given.

    Raises:
        InputError: for an unknown name, or a value that is not a number.
    """
    mean, std = list(start.mean), list(start.std)
    for name, value in _items(values, "start"):
        index = _index(name, automaton, "start")
        mean[index], spread = _pair(value, f"start of {name}", "std")
        std[index] = std[index] if spread is None else spread
    if mode is not None:
        _check_modes([mode], automaton, "start mode")
    changed = replace(start, mean=tuple(mean), std=tuple(std), mode=mode or (None if values else start.mode))
    if not values:
        return changed
    # A start that no mode allows is refused when the problem is solved: here any mode will do.
    for tie in automaton.mode(start_mode(automaton, changed)[0] or automaton.mode_names[0]).ties:
        if automaton.coordinate_names[tie.coordinate] not in values:
            mean[tie.coordinate] = float(tie.value(np.array(mean)))
    return replace(changed, mean=tuple(mean))


def with_goal(
    goal: Goal, automaton: HybridAutomaton, values: Mapping[str, Spread] | None, modes: str | Sequence[str] | None
) -> Goal:
    """A goal with new targets, or other final modes.

    Args:
        goal: a value without a tolerance has that of this goal.
        values: (value, tolerance) by coordinate [rad or m], instead of the whole target; None: as it is.
        modes: to end in; none: any that is no collision. None: as they are, or any where there is another target.

    Raises:
        InputError: for an unknown name, a value that is not a number, or a missing tolerance.
    """
    if modes is None:
        wanted = goal.modes if values is None else ()
    else:
        wanted = (modes,) if isinstance(modes, str) else tuple(modes)
    _check_modes(wanted, automaton, "goal modes")
    wanted = wanted or unharmed(automaton.mode_names)
    if values is None:
        return replace(goal, modes=wanted)
    known = {index: tolerance for index, _, tolerance in goal.target}
    target = []
    for name, value in _items(values, "goal"):
        index = _index(name, automaton, "goal")
        place, tolerance = _pair(value, f"goal of {name}", "tolerance")
        tolerance = known.get(index) if tolerance is None else tolerance
        if tolerance == 0.0:
            raise InputError(f"goal of {name}: a tolerance of 0 is never met", remedy="give a larger one")
        if tolerance is None:
            raise InputError(
                f"the goal of {name} has no tolerance", remedy=f"give it, as in {{{name!r}: ({place:g}, 0.01)}}"
            )
        target.append((index, place, tolerance))
    return Goal(tuple(target), wanted)


def with_noise(noise: Noise, automaton: HybridAutomaton, values: Mapping[str, Mapping[str, float]]) -> Noise:
    """Noise with new standard deviations of some coordinates, by `process_std` and `observation_std`.

    Raises:
        InputError: for an unknown name, or a value that is not a standard deviation.
    """
    for kind, by_name in _items(values, "noise"):
        if kind not in _NOISES:
            raise InputError(f"noise has no {shown(kind)}", remedy=choices(kind, _NOISES))
        stds = list(getattr(noise, kind))
        for name, value in _items(by_name, f"noise, {kind}"):
            index = _index(name, automaton, f"noise, {kind}")
            if isinstance(value, bool) or not isinstance(value, int | float) or not (isfinite(value) and value >= 0):
                raise InputError(f"{kind} of {name}: expected a standard deviation, found {shown(value)}")
            stds[index] = float(value)
        stated: dict[str, Any] = {kind: tuple(stds)}
        noise = replace(noise, **stated)
    return noise


def _items(values: Mapping[str, Any], where: str) -> Iterable[tuple[str, Any]]:
    if not isinstance(values, Mapping):
        raise InputError(
            f"{where}: expected values by name, found {shown(values)}", remedy="give a dict, {name: value}"
        )
    return values.items()


def _index(name: str, automaton: HybridAutomaton, where: str) -> int:
    """The index of a coordinate; an InputError lists the names."""
    names = automaton.coordinate_names
    if name not in names:
        raise InputError(f"{where}: no coordinate {shown(name)}", remedy=choices(str(name), names))
    return names.index(name)


def _check_modes(modes: Collection[str], automaton: HybridAutomaton, where: str) -> None:
    for name in modes:
        if name not in automaton.mode_names:
            raise InputError(f"{where}: no mode {shown(name)}", remedy=choices(str(name), automaton.mode_names))


def _pair(value: Spread, where: str, second: str) -> tuple[float, float | None]:
    """(value, second number) of an entry."""
    numbers = () if isinstance(value, bool) else [value] if isinstance(value, int | float) else value
    try:
        pair = tuple(float(number) for number in numbers)
    except (TypeError, ValueError):
        pair = ()
    if not 1 <= len(pair) <= 2 or not all(map(isfinite, pair)) or any(number < 0 for number in pair[1:]):
        raise InputError(f"{where}: expected a number or (value, {second}), found {shown(value)}")
    return pair[0], pair[1] if len(pair) > 1 else None
