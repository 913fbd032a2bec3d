"""Constraints on the input of each step, including the executed feedback.

The executed input is not the planned u but u + G (estimate - mean), and the true state lies around the estimate. So a
half-space a'x + b'u >= c is planned as

    a'mean + b'u - c >= k sqrt(||L'a||² + (a + G'b)' Λ (a + G'b)),

with G the gains and Λ the spread of the estimate in closed loop. Admissible inputs are met for any feedback, since the
executed input is clipped there: they bound the planned input alone. So do guards on the input alone without a
transition back (`avoided_inputs`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from micah_plan.arrays import EQUAL, SMALLEST_STD, Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.region import HalfSpace
from micah_plan.planning.avoided_inputs import STRICT_SHARE, needs_margin
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.corridor import avoided_half_spaces, mixed_guards
from micah_plan.planning.transcription.guess import PhaseGuess
from micah_plan.planning.transcription.rows import Row, boundary_name, unit_of


class InputRow(NamedTuple):
    """One side of a half-space on the input at one step: a'mean + b'u - c >= 0.

    Attributes:
        step: of the phase, from 0.
        row: constraint on the planned input.
        a, b, c: (n,), (m,) and the threshold, times the sign of the side.
        spread: variance across it of estimate and input together in closed loop [its unit²].
        scale: length of one step across it [its unit].
        is_sent: whether it bounds the sent input; otherwise the input that arrives, where the model has a memory of
            inputs.
        uncertain: whether it holds at k-sigma; otherwise for the planned input only.
        slack: that makes the guess feasible [steps].
    """

    step: int
    row: Row
    a: Floats
    b: Floats
    c: float
    spread: float
    scale: float
    is_sent: bool
    uncertain: bool
    slack: float


def input_rows(automaton: HybridAutomaton, limits: Limits, guess: PhaseGuess, k: float) -> list[InputRow]:
    """Admissible inputs, invariants, and guards on inputs to avoid, step by step.

    Args:
        k: standard deviations of the planned confidence.
    """
    mode, steps = automaton.mode(guess.mode), range(guess.steps)
    sides = [(step, h, 1.0, False) for step in steps for h in mode.inputs.half_spaces if h.on_input]
    sent = len(sides)
    sides += [(step, h, 1.0, True) for step in steps for h in mode.invariant.half_spaces if h.on_input]
    for edge in automaton.edges:
        (first, *others) = edge.guard.half_spaces or (None,)
        if edge.source == guess.mode and not edge.is_self_transition and not others and first and first.on_input:
            sides += [(step, first, -1.0, needs_margin(automaton, edge)) for step in steps]
    for guard, edge in mixed_guards(automaton, guess).items():
        of_steps = enumerate(avoided_half_spaces(guard, guess, k))
        sides += [(step, h, -1.0, needs_margin(automaton, edge)) for step, h in of_steps if h.on_input]
    rows = [_row(automaton, limits, guess, side, k, is_sent=False) for side in dict.fromkeys(sides[sent:])]
    return [_row(automaton, limits, guess, side, k, is_sent=True) for side in sides[:sent]] + rows


def _row(
    automaton: HybridAutomaton,
    limits: Limits,
    guess: PhaseGuess,
    side: tuple[int, HalfSpace, float, bool],
    k: float,
    *,
    is_sent: bool,
) -> InputRow:
    step, half_space, sign, may_vary = side
    a, b, c = sign * np.array(half_space.a), sign * np.array(half_space.b), sign * half_space.c
    # A closed guard holds on its boundary already: stay a little away from it.
    closed = sign < 0 and not half_space.strict
    low = STRICT_SHARE * float(np.abs(b) @ limits.max_step) if closed else 0.0
    name, unit = boundary_name(half_space, sign), unit_of(automaton, half_space)
    row = Row(guess.mode, guess.first_knot + step, name, unit, low, np.inf, "input")
    spread = spread_across(a, b, guess.gains[step], guess.spreads[step])
    std = float(np.sqrt(np.sum((a @ guess.factors[step]) ** 2) + spread))
    scale = float(np.abs(a) @ limits.speed + np.abs(b) @ limits.max_step)
    short = k * std - float(a @ guess.means[step] + b @ guess.inputs[step] - c)
    # Current feedback has no information on an input that arrives later.
    is_uncertain = may_vary and std > SMALLEST_STD and not automaton.input_memories
    return InputRow(step, row, a, b, c, spread, scale, is_sent, is_uncertain, max(0.0, short) / scale)


def spread_across(a: Floats, b: Floats, gain: Floats, spread: Floats) -> float:
    """Variance of a'x + b'u under deviations (n, n) and their feedback (m, n)."""
    across = a + b @ gain
    return max(0.0, float(across @ spread @ across))


def depth_limit(half_space: HalfSpace, limits: Limits) -> float:
    """The depth inside a half-space on the input that a plan can be asked for: that of the largest input."""
    if half_space.on_state:
        return np.inf
    return max(0.0, (1.0 - EQUAL) * float(np.abs(half_space.b) @ limits.max_step) - half_space.c)
