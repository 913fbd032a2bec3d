"""What passes through the registers of an automaton in a step.

Registers change from step to step, not within one: an input is held for the whole step, so guards, resets and motion
of a step see the input that comes out, and the registers take their next values when the step ends.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.effects.form import Operations, Value
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.register import Register

Floats = NDArray[np.float64]


def at_rest(register: Register) -> tuple[float, ...]:
    """(size,) values of a register before any input."""
    effect = register.effect
    return tuple(map(float, form(effect.name).at_rest(effect.values)))


def passed_on(
    ops: Operations, registers: Sequence[Register], mode: str, x: Sequence[Value], u: Sequence[Value]
) -> tuple[list[Value], dict[int, Value]]:
    """What comes out of the registers in a step: the m inputs that reach the mode, and the registers' next values.

    An effect that acts in other modes only keeps its memory up to date, without changing the input.

    Args:
        x, u: n states and m inputs: floats, arrays or CasADi expressions.
    """
    passed, after = list(u), dict[int, Value]()
    for own in registers:
        memory = tuple(x[own.first + k] for k in range(own.size))
        known = form(own.effect.name)
        out, kept = known.remember(ops, own.scale * passed[own.input], memory, own.effect.values)
        after |= {own.first + k: value for k, value in enumerate(kept)}
        if own.effect.acts_in(mode):
            passed[own.input] = out / own.scale
    return passed, after


def passed_arrays(registers: Sequence[Register], mode: str, x: Floats, u: Floats) -> tuple[Floats, Floats]:
    """The inputs (..., m) that reach the mode, and the states with the registers' next values, for x (..., n)."""
    if not registers:
        return u, x
    passed, after = passed_on(np, registers, mode, np.moveaxis(x, -1, 0), np.moveaxis(u, -1, 0))  # type: ignore[arg-type]
    kept = np.array(x)
    for i, value in after.items():
        kept[..., i] = value
    return np.stack([np.broadcast_to(value, np.shape(u)[:-1]) for value in passed], axis=-1), kept
