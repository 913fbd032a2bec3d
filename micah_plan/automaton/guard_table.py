"""A mode's flow and guards as plain floats, and when a straight motion meets them: the arithmetic of `transition`.

Verification takes hundreds of thousands of steps in one or a few coordinates. Such a step is some dozen
multiplications; NumPy would spend ten times that on calls. So the non-zero weights are laid out once per automaton.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from micah_plan.automaton.effects.motion import CoordinateMotion, motions
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.memo import memoised
from micah_plan.automaton.region import HalfSpace

TOLERANCE = 1e-12
Terms = tuple[tuple[int, float], ...]
Rows = list[list[float]]


@dataclass(frozen=True, slots=True)
class Row:
    """A scaled half-space: weights of states and inputs, threshold, whether strict, and the margin that counts as 0."""

    states: Terms
    inputs: Terms
    c: float
    strict: bool
    tolerance: float


@dataclass(frozen=True, slots=True)
class Exit:
    """An edge as its source mode sees it. `reset` is (A, B, c), or None for the identity."""

    edge: int
    target: str
    is_self: bool
    rows: tuple[Row, ...]
    reset: tuple[Rows, Rows, list[float]] | None


@dataclass(frozen=True, slots=True)
class ModeTable:
    """A mode: the terms of B per coordinate (None: nothing moves it), and its exits, changes of the mode first.

    `pins` are coordinates, their values, and the coordinate that adds to the value or None.
    `effects` holds what changes the motion of a coordinate, by its index.
    A tie is (coordinate, weights of the others, offset).
    """

    name: str
    flow: tuple[Terms | None, ...]
    exits: tuple[Exit, ...]
    pins: tuple[tuple[int, float, int | None], ...]
    effects: dict[int, CoordinateMotion]
    ties: tuple[tuple[int, Terms, float], ...]

    def pinned(self, x: list[float]) -> list[float]:
        """x with the pinned and the tied coordinates at their values."""
        if not self.pins and not self.ties:
            return x
        put = list(x)
        for i, value, follows in self.pins:
            put[i] = value if follows is None else value + x[follows]
        for i, terms, offset in self.ties:
            put[i] = offset + sum(w * put[j] for j, w in terms)
        return put


@memoised
def mode_table(automaton: HybridAutomaton, name: str) -> ModeTable:
    """The table of the mode of that name."""
    mode = automaton.mode(name)
    moved = [free and bool(own.unit) for free, own in zip(mode.free, automaton.coordinates, strict=True)]
    exits = [_exit(automaton, number) for number, edge in enumerate(automaton.edges) if edge.source == name]
    return ModeTable(
        name,
        flow=tuple(_terms(row) if moves else None for moves, row in zip(moved, mode.input_matrix, strict=True)),
        exits=tuple(sorted(exits, key=lambda e: e.is_self)),
        pins=tuple((pin.coordinate, pin.value, pin.follows) for pin in mode.pins),
        effects=motions(automaton, mode),
        ties=tuple((tie.coordinate, _terms(tie.weights), tie.offset) for tie in mode.ties),
    )


def _exit(automaton: HybridAutomaton, number: int) -> Exit:
    edge = automaton.edges[number]
    a, b, c = edge.reset.matrices(automaton.n, automaton.m)
    reset = None if edge.reset.is_identity else (a.tolist(), b.tolist(), c.tolist())
    return Exit(number, edge.target, edge.is_self_transition, tuple(map(_row, edge.guard.half_spaces)), reset)


# Objects with drawn thresholds share most of their half-spaces.
@lru_cache(maxsize=4096)
def _row(h: HalfSpace) -> Row:
    """A half-space with its weights of states (of inputs, if there are only those) scaled to length 1.

    Margins are then distances [rad or m], so that the tolerance does not depend on how the half-space is written.
    """
    size = math.hypot(*h.a) or math.hypot(*h.b) or 1.0
    a, b, c = [w / size for w in h.a], [w / size for w in h.b], h.c / size
    if not math.isfinite(sum(map(abs, (*a, *b, c)))):  # weights next to 0 against a huge threshold
        a, b, c = list(h.a), list(h.b), h.c
    return Row(_terms(a), _terms(b), c, h.strict, TOLERANCE * max(1.0, abs(c)))


def _terms(weights: Sequence[float]) -> Terms:
    return tuple((i, float(w)) for i, w in enumerate(weights) if w)


def entry(e: Exit, x: list[float], d: list[float], u: list[float], horizon: float) -> float | None:
    """The first t in [0, horizon] at which the guard fires on x + t d; None if it does not."""
    enter, leave = 0.0, math.inf
    for row in e.rows:
        margin, rate = margin_and_rate(row, x, d, u)
        tolerance = row.tolerance
        if rate > tolerance:
            if margin < -tolerance:
                if margin + horizon * rate < -tolerance:
                    return None
                enter = max(enter, min(-margin / rate, horizon))
        elif rate < -tolerance:
            leave = min(leave, (tolerance - margin) / rate)
        elif margin < -tolerance or (row.strict and margin <= tolerance):
            return None
    return enter if enter < leave else None


def margin_and_rate(row: Row, x: list[float], d: list[float], u: list[float]) -> tuple[float, float]:
    """The margin of a half-space at (x, u), positive inside, and its rate along d."""
    margin, rate = -row.c, 0.0
    for i, w in row.states:
        margin += w * x[i]
        rate += w * d[i]
    for j, w in row.inputs:
        margin += w * u[j]
    return margin, rate
