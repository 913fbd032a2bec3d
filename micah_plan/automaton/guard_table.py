"""A mode's flow and guards as plain floats, and when a straight motion meets them: the arithmetic of `transition`.

Verification takes hundreds of thousands of steps in one or a few coordinates. Such a step is some dozen
multiplications; NumPy would spend ten times that on calls. So the non-zero weights are laid out once per automaton.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from micah_plan.automaton.effects.motion import CoordinateMotion, motions
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.region import HalfSpace, Region

TOLERANCE = 1e-12
Terms = tuple[tuple[int, float], ...]


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
    """An edge as its source mode sees it. `A`, `B`, `c` are None for the identity reset."""

    edge: int
    source: str
    target: str
    is_self: bool
    rows: tuple[Row, ...]
    A: list[list[float]] | None
    B: list[list[float]] | None
    c: list[float] | None


@dataclass(frozen=True, slots=True)
class ModeTable:
    """A mode: the terms of B per coordinate (None where pinned) and its exits, mode changes before self transitions.

    `pins` are coordinates and their values, `followed` the coordinate that adds to the value of a pinned one.
    `effects` holds what changes the motion of a coordinate, by its index.
    A tie is (coordinate, weights of the others, offset).
    """

    name: str
    flow: tuple[Terms | None, ...]
    exits: tuple[Exit, ...]
    pins: tuple[tuple[int, float], ...]
    effects: dict[int, CoordinateMotion] = field(default_factory=dict)
    followed: tuple[tuple[int, int], ...] = ()
    ties: tuple[tuple[int, Terms, float], ...] = ()

    def pinned(self, x: list[float]) -> list[float]:
        """x with the pinned and the tied coordinates at their values."""
        if not self.pins and not self.ties:
            return x
        put = list(x)
        for i, value in self.pins:
            put[i] = value
        for i, j in self.followed:
            put[i] += x[j]
        for i, terms, offset in self.ties:
            put[i] = offset + sum(w * put[j] for j, w in terms)
        return put


class _Tables(dict[str, ModeTable]):
    """Tables by name of the mode, made when they are asked for: a roll-out sees few modes of its object."""

    def __init__(self, automaton: HybridAutomaton) -> None:
        super().__init__()
        self._automaton = automaton

    def __missing__(self, name: str) -> ModeTable:
        self[name] = _mode_table(self._automaton, name)
        return self[name]


def mode_tables(automaton: HybridAutomaton) -> dict[str, ModeTable]:
    """The tables of an automaton by name of the mode, to be had by indexing."""
    tables: dict[str, ModeTable] | None = automaton.derived.get("mode_tables")
    if tables is None:
        tables = _Tables(automaton)
        automaton.derived["mode_tables"] = tables
    return tables


def _mode_table(automaton: HybridAutomaton, name: str) -> ModeTable:
    mode = automaton.mode(name)
    pins = tuple((pin.coordinate, pin.value) for pin in mode.pins)
    flow = tuple(_terms(row) if mode.free[i] else None for i, row in enumerate(mode.input_matrix))
    exits = []
    for index, edge in enumerate(automaton.edges):
        if edge.source != name:
            continue
        identity = edge.reset.is_identity
        a, b, c = (None,) * 3 if identity else (m.tolist() for m in edge.reset.matrices(automaton.n, automaton.m))
        exits.append(Exit(index, name, edge.target, edge.is_self_transition, _guard_rows(edge.guard), a, b, c))
    exits.sort(key=lambda e: e.is_self)
    ties = tuple((tie.coordinate, _terms(tie.weights), tie.offset) for tie in mode.ties)
    acting = motions(automaton.effects, automaton.coordinate_names, name)
    followed = tuple((pin.coordinate, pin.follows) for pin in mode.pins if pin.follows is not None)
    return ModeTable(name, flow, tuple(exits), pins, acting, followed, ties)


def _guard_rows(guard: Region) -> tuple[Row, ...]:
    return tuple(map(_row, guard.half_spaces))


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


def next_entry(
    table: ModeTable, x: list[float], d: list[float], u: list[float], horizon: float, *, later_only: bool
) -> tuple[float, int] | None:
    """How much further on x + t d, t in [0, horizon], the first guard fires, and its edge; None if none does.

    Args:
        later_only: pass over guards that hold already at t = 0.
    """
    first = None
    for e in table.exits:
        at = entry(e, x, d, u, horizon)
        if at is not None and (at > 0.0 or not later_only) and (first is None or at < first[0]):
            first = (at, e.edge)
    return first


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
