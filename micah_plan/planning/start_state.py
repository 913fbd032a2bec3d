"""Where a problem starts: the mode of its start belief, and true states drawn from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.errors import InputError
from micah_plan.planning.problem import Start

Floats = NDArray[np.float64]

# A start this many standard deviations outside of a mode's range still counts as inside: the mean is uncertain too.
_START_SIGMAS = 3.0
_MOST_DRAWS = 200


def start_mode(automaton: HybridAutomaton, start: Start) -> tuple[str | None, str]:
    """The mode that a start is in; None with the reason if its mean lies in no mode's (or not in the named) range."""
    if start.mode is not None:
        mode = automaton.mode(start.mode)
        if _sigmas_outside(automaton, start, mode) <= _START_SIGMAS:
            return mode.name, ""
        text = _start_text(automaton, start)
        return None, f"the start {text} lies outside the range of its mode '{mode.name}'; correct either"
    outside = {mode.name: _sigmas_outside(automaton, start, mode) for mode in automaton.modes}
    nearest = min(outside, key=outside.__getitem__)
    if outside[nearest] <= _START_SIGMAS:
        return nearest, ""
    names = ", ".join(f"'{name}'" for name in outside)
    return None, f"the start {_start_text(automaton, start)} lies in the range of no mode ({names}); move it into one"


def sample_start(automaton: HybridAutomaton, start: Start, rng: np.random.Generator) -> tuple[str, Floats]:
    """A true start: its mode and x (n,), from the initial Gaussian given that the mode's invariant holds.

    Where the invariant is all but improbable under the belief, the mean is taken. Pinned coordinates are at their pins.

    Raises:
        InputError: if the start is in no mode.
    """
    name, reason = start_mode(automaton, start)
    if name is None:
        raise InputError(reason)
    mode = automaton.mode(name)
    mean, std = np.array(start.mean, dtype=float), np.array(start.std, dtype=float)
    at_rest = np.zeros(automaton.m)
    chosen = mean.copy()
    for _ in range(_MOST_DRAWS):
        draw = mean + std * rng.standard_normal(automaton.n)
        for pin in mode.pins:
            draw[pin.coordinate] = pin.value
        if mode.invariant.contains(draw, at_rest):
            chosen = draw
            break
    for pin in mode.pins:
        chosen[pin.coordinate] = pin.value
    return name, chosen


def _sigmas_outside(automaton: HybridAutomaton, start: Start, mode: Mode) -> float:
    """By how many standard deviations the start's mean lies outside of a mode's invariant and pins; 0 inside."""
    mean, std = np.array(start.mean), np.array(start.std)
    outside = [0.0]
    for half_space in mode.invariant.half_spaces:
        shortage = -float(half_space.margin(mean, np.zeros(automaton.m)))
        if shortage > 0:
            outside.append(shortage / max(float(np.linalg.norm(std * np.array(half_space.a))), 1e-9))
    for pin in mode.pins:
        distance = abs(float(mean[pin.coordinate]) - pin.value)
        spread = float(np.hypot(std[pin.coordinate], pin.std))
        outside.append(distance / max(spread, 1e-9))
    return max(outside)


def _start_text(automaton: HybridAutomaton, start: Start) -> str:
    pairs = zip(automaton.coordinates, start.mean, start.std, strict=True)
    return ", ".join(f"{c.name} = {mean:g} ± {std:g} {c.unit}" for c, mean, std in pairs)
