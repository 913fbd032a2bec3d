"""True starts drawn from the problem's initial belief."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.planning.problem import Start

Floats = NDArray[np.float64]

_MOST_DRAWS = 200


def start_mode(automaton: HybridAutomaton, start: Start) -> str:
    """The mode that the object starts in: the stated one, or the first whose invariant holds the mean.

    Raises:
        InputError: if no invariant holds it.
    """
    if start.mode is not None:
        return automaton.mode(start.mode).name
    modes = automaton.modes_at(np.array(start.mean), tolerance=1e-9)
    if not modes:
        raise InputError(f"the start {start.mean} lies in no mode's invariant", remedy="choose a start in the range")
    return modes[0]


def sample_start(automaton: HybridAutomaton, start: Start, rng: np.random.Generator) -> tuple[str, Floats]:
    """A true start: its mode and x (n,), from the initial Gaussian given that the mode's invariant holds.

    Where the invariant is all but improbable under the belief, the mean is taken.
    """
    mode = automaton.mode(start_mode(automaton, start))
    mean, std = np.array(start.mean, dtype=float), np.array(start.std, dtype=float)
    chosen = mean.copy()
    for _ in range(_MOST_DRAWS):
        draw = mean + std * rng.standard_normal(automaton.n)
        if mode.invariant.contains(draw, np.zeros(automaton.m)):
            chosen = draw
            break
    for pin in mode.pins:
        chosen[pin.coordinate] = pin.value
    return mode.name, chosen
