"""One step of one hybrid automaton in plain numbers, event after event: what `automaton.transition` is compared with.

The rules are those of its docstring, written a second time, object by object and without arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.motion import CoordinateMotion, motions
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import passed_on
from micah_plan.automaton.memo import memoised
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.transition import MOST_EVENTS, Event, Step
from micah_plan.errors import InputError, shown


def step(
    automaton: HybridAutomaton, mode: str, x: ArrayLike, u: ArrayLike, disturbance: ArrayLike | None = None
) -> Step:
    """The state after one step from x (n,) in `mode` with the input u (m,), as the module's docstring defines it.

    Args:
        disturbance: (n,) displacement over the whole step that adds to the flow [rad or m].

    Raises:
        InputError: unknown mode, wrong number of values, or a value that is not finite.
    """
    start, given = _values(x, automaton.n, "x"), _values(u, automaton.m, "u")
    pushed = None if disturbance is None else _values(disturbance, automaton.n, "disturbance")
    table, after = mode_table(automaton, mode), dict[int, float]()
    if automaton.input_memories:
        passed, after = passed_on(np, automaton.input_memories, mode, start, given)
        given = list(map(float, passed))
    travel = Travel(partial(mode_table, automaton), table, start, given, pushed)
    complete = travel.to_the_end()
    final = np.array(travel.x)
    for i, value in after.items():  # memories take their next values when the step ends
        final[i] = value
    return Step(travel.table.name, final, tuple(travel.events), complete)


@dataclass(slots=True)
class Travel:
    """A step on its way from s = 0 to s = 1.

    Attributes:
        table_of: the table of a mode, by its name.
        table, x: the mode and the state (n,) that it has come to.
        u, pushed: its input (m,) and disturbance (n,).
        d: (n,) motion of a whole step, as it goes on from here.
        s, events: how far it has come, and what has happened.
    """

    table_of: Callable[[str], ModeTable]
    table: ModeTable
    x: list[float]
    u: list[float]
    pushed: list[float] | None
    d: list[float] = field(init=False)
    s: float = 0.0
    events: list[Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._enter(self.table, self.x)

    def to_the_end(self) -> bool:
        """Alternately on to the next instant with an event and through its events. False if there are too many."""
        while True:
            # Guards that still hold after an instant's events are blocked ones: from then on only later entries count.
            least, ahead, arrived = 0.0 if self.events else -1.0, math.inf, -1
            for e in self.table.exits:
                at = entry(e, self.x, self.d, self.u, 1.0 - self.s)
                if at is not None and least < at < ahead:
                    ahead, arrived = at, e.edge
            way = min(ahead, 1.0 - self.s)
            if way > 0.0:
                self.x = [xi + way * di for xi, di in zip(self.x, self.d, strict=True)]
            if arrived < 0:
                return True
            self.s = min(1.0, self.s + way)
            if not self._settle(arrived):
                return False

    def _enter(self, table: ModeTable, x: list[float]) -> None:
        self.table, self.x = table, table.pinned(x)
        self.d = _displacement(table, self.x, self.u, self.pushed)

    def _settle(self, arrived: int) -> bool:
        """Take all events of an instant, among them the edge whose guard the motion arrived at. False: too many."""
        entered, taken = {self.table.name}, set[int]()
        walls: list[Floats] = []
        while True:
            # Where rounding left the state slightly short of the guard it arrived at, testing the guard would miss it.
            holding = [
                e
                for e in self.table.exits
                if (not taken and e.edge == arrived) or entry(e, self.x, self.d, self.u, 0.0) is not None
            ]
            free = next((e for e in holding if e.edge not in taken and (e.is_self or e.target not in entered)), None)
            if free is not None:
                if len(self.events) >= MOST_EVENTS:
                    return False
                self._take(free)
                walls.clear()
                taken.add(free.edge)
                entered.add(free.target)
                continue
            wall = next((row for e in holding for row in e.rows if self._is_pressed(row)), None)
            if wall is None:
                return True
            self._slide(wall, walls)

    def _take(self, chosen: Exit) -> None:
        source, before = self.table, self.x
        after = _reset(chosen, before, self.u)
        if chosen.is_self:
            self.x = source.pinned(after)
            kept = self.d if chosen.reset is None else _times(chosen.reset[0], self.d)
            self.d = _tied(source, [0.0 if flow is None else di for flow, di in zip(source.flow, kept, strict=True)])
        else:
            self._enter(self.table_of(chosen.target), after)
        event = Event(chosen.edge, self.s, np.array(before), np.array(self.x), source.name, chosen.target)
        self.events.append(event)

    def _is_pressed(self, row: Row) -> bool:
        """Whether the state is on the boundary of a half-space and the flow goes into it."""
        margin, rate = margin_and_rate(row, self.x, self.d, self.u)
        return rate > row.tolerance and abs(margin) <= row.tolerance

    def _slide(self, wall: Row, walls: list[Floats]) -> None:
        """Take out of d what is normal to this wall and to those (orthonormal `walls`) met before at this instant."""
        normal = np.zeros(len(self.d))
        for i, w in wall.states:
            normal[i] = 0.0 if self.table.flow[i] is None else w
        size = float(np.linalg.norm(normal))
        for other in walls:
            normal -= (normal @ other) * other
        rest = float(np.linalg.norm(normal))
        if rest <= TOLERANCE * size:
            # The earlier walls leave no direction to give way in.
            self.d = [0.0] * len(self.d)
            return
        walls.append(normal / rest)
        d = np.array(self.d)
        for other in walls:
            d -= (d @ other) * other
        self.d = d.tolist()


def _displacement(table: ModeTable, x: list[float], u: list[float], pushed: list[float] | None) -> list[float]:
    """d = B u + disturbance of a mode, over a whole step, with the effects of the mode at x."""
    d = []
    for i, terms in enumerate(table.flow):
        if terms is None:
            d.append(0.0)
            continue
        moved = 0.0
        for j, w in terms:
            moved += w * u[j]
        if i in table.effects:
            moved = float(table.effects[i].displacement(np, x[i], moved))
        d.append(moved if pushed is None else moved + pushed[i])
    return _tied(table, d)


def _tied(table: ModeTable, d: list[float]) -> list[float]:
    """A motion with the tied coordinates moved along."""
    for i, weights, _ in table.ties:
        d[i] = sum(w * d[j] for j, w in weights)
    return d


def _reset(chosen: Exit, x: list[float], u: list[float]) -> list[float]:
    if chosen.reset is None:
        return list(x)
    A, B, offset = chosen.reset
    return [a + b + c for a, b, c in zip(_times(A, x), _times(B, u), offset, strict=True)]


def _times(matrix: list[list[float]], vector: list[float]) -> list[float]:
    return [sum(w * v for w, v in zip(row, vector, strict=True)) for row in matrix]


def _values(value: ArrayLike, size: int, name: str) -> list[float]:
    array = value if isinstance(value, np.ndarray) else np.asarray(value, dtype=float)
    values: list[float] = array.tolist()
    if array.shape != (size,) or not math.isfinite(sum(values)):
        raise InputError(f"{name} must be {size} finite numbers. Got {shown(values)}")
    return values


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
