"""Steps of many roll-outs at once: motion and its events in arrays, with the rules and the arithmetic of `transition`.

In most steps no guard fires, and a step is one addition. Where guards fire one after the other, the arrays go from
event to event, all roll-outs of a mode together. What is rare is left to the scalar `transition.travel`, where the
rules are written: several events at one instant, and walls to slide along. A test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.effects.motion import CoordinateMotion
from micah_plan.automaton.guard_table import TOLERANCE, Exit, ModeTable, Row, Terms, mode_tables
from micah_plan.automaton.hybrid import HybridAutomaton, Mode, Tie
from micah_plan.automaton.step_noise import gain_factors, uncertain_gains
from micah_plan.automaton.thresholds import threshold_stds, with_shifted_thresholds
from micah_plan.automaton.transition import travel

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Ints = NDArray[np.int64]

# A roll-out with more events in one step than this is left to the scalar transition, which knows when to end.
_MOST_EVENTS = 16
# The half-space of a guard without any: it holds everywhere.
_ALWAYS = Row((), (), -1.0, False, TOLERANCE)


@dataclass(frozen=True, eq=False)
class _Mode:
    """A mode of t objects: what it pins where, its flow, and the half-spaces of all its exits one after the other.

    Attributes:
        pinned: (p,) coordinates; pins: (t, p) where [rad or m].
        B: (n, m) input matrix, rows of pinned coordinates zero; moved: (n, n) what a disturbance moves: nothing that is
            pinned, and what is tied as the others.
        ties: of the mode.
        table: of the model itself.
        exits: of the mode, mode changes before self transitions.
        targets: (e,) index of the mode that each exit leads to.
        states, inputs: (r, n), (r, m) scaled weights; thresholds, tolerances: (t, r); strict: (r,).
        first: (e,) first half-space of each exit; owner: (r,) exit of each half-space.
        effects: what changes the motion of a coordinate, by its index.
        gains: (t, n) what multiplies the motion of each object's coordinates; None: nothing.
    """

    pinned: Ints
    pins: Floats
    B: Floats
    moved: Floats
    ties: tuple[Tie, ...]
    table: ModeTable
    exits: tuple[Exit, ...]
    targets: Ints
    states: Floats
    inputs: Floats
    thresholds: Floats
    tolerances: Floats
    strict: Booleans
    first: Ints
    owner: Ints
    effects: dict[int, CoordinateMotion]
    gains: Floats | None

    def pin(self, rows: Ints, x: Floats) -> None:
        """Put the pinned and the tied coordinates of states x (k, n) of the objects `rows` (k,) at their values."""
        if self.pinned.size:
            x[:, self.pinned] = self.pins[rows]
        for tie in self.ties:
            x[:, tie.coordinate] = tie.value(x)

    def displacement(self, rows: Ints, x: Floats, u: Floats, pushed: Floats) -> Floats:
        """(k, n) motion of a whole step from x (k, n) with inputs (k, m) and disturbances (k, n)."""
        d = u @ self.B.T
        if self.gains is not None:
            d *= self.gains[rows]
        for i, motion in self.effects.items():
            d[:, i] = motion.displacement(np, x[:, i], d[:, i])
        for tie in self.ties:
            d[:, tie.coordinate] = d @ np.array(tie.weights)
        return np.asarray(d + pushed @ self.moved.T)

    def margins(self, rows: Ints, x: Floats, d: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
        """(k, r) margins of all half-spaces, their rates along d, and the margins that count as 0."""
        margin = x @ self.states.T + u @ self.inputs.T - self.thresholds[rows]
        return margin, d @ self.states.T, self.tolerances[rows]

    def entries(self, margin: Floats, rate: Floats, tolerance: Floats, horizon: Floats) -> Floats:
        """(k, e) how far along d each guard fires, within the horizon (k,); infinite if it does not.

        The arithmetic of `guard_table.entry`.
        """
        outside = margin < -tolerance
        grows, falls = rate > tolerance, rate < -tolerance
        enter, leave = np.zeros_like(margin), np.full_like(margin, np.inf)
        coming = grows & outside
        ahead = np.broadcast_to(horizon[:, None], margin.shape)
        enter[coming] = np.minimum(-margin[coming] / rate[coming], ahead[coming])
        leave[falls] = (tolerance[falls] - margin[falls]) / rate[falls]
        never = coming & (margin + ahead * rate < -tolerance)
        never |= ~grows & ~falls & (outside | (self.strict & (margin <= tolerance)))
        enter[never] = np.inf
        first = np.maximum.reduceat(enter, self.first, axis=1)
        last = np.minimum.reduceat(leave, self.first, axis=1)
        return np.where(first < last, first, np.inf)

    def of_one(self, number: int) -> ModeTable:
        """The table of one object."""
        thresholds, tolerances = iter(self.thresholds[number].tolist()), iter(self.tolerances[number].tolist())
        exits = []
        for e in self.exits:
            at = [(row, next(thresholds), next(tolerances)) for row in e.rows or (_ALWAYS,)]
            moved = any(row.c != c for row, c, _ in at)
            exits.append(replace(e, rows=tuple(replace(row, c=c, tolerance=t) for row, c, t in at)) if moved else e)
        flow = self.table.flow
        if self.gains is not None:
            gains = self.gains[number].tolist()
            flow = tuple(
                None if terms is None else tuple((j, gain * w) for j, w in terms)
                for terms, gain in zip(flow, gains, strict=True)
            )
        pins = tuple(zip(self.pinned.tolist(), self.pins[number].tolist(), strict=True))
        return replace(self.table, flow=flow, exits=tuple(exits), pins=pins)


class _TablesOfOne(dict[str, ModeTable]):
    """The tables of one object by name of the mode, made when they are asked for."""

    def __init__(self, names: Sequence[str], modes: Callable[[int], _Mode], number: int) -> None:
        super().__init__()
        self._names, self._modes, self._number = names, modes, number

    def __missing__(self, name: str) -> ModeTable:
        self[name] = self._modes(self._names.index(name)).of_one(self._number)
        return self[name]


@dataclass(frozen=True, eq=False)
class _Travellers:
    """Objects of one mode on their way through a step.

    Attributes:
        mode: index of the mode.
        rows: (k,) numbers of the objects.
        x, d: (k, n) states, and motions of a whole step.
        s: (k,) how much of the step lies behind them.
        events: how many events they had.
    """

    mode: int
    rows: Ints
    x: Floats
    d: Floats
    s: Floats
    events: int

    def where(self, chosen: Booleans) -> _Travellers:
        """Some of them."""
        return _Travellers(self.mode, self.rows[chosen], self.x[chosen], self.d[chosen], self.s[chosen], self.events)


class TransitionBatch:
    """t objects of one model, each with its own thresholds and gains."""

    def __init__(self, automaton: HybridAutomaton, shifts: Floats, gains: Floats | None = None) -> None:
        """
        Args:
            automaton: the model.
            shifts: (t, b) by how much each object's boundaries are moved (`thresholds.threshold_stds`).
            gains: (t, g) relative errors of its gains (`step_noise.drawn_gains`); None: they are the model's.
        """
        self._automaton = automaton
        self._names = [mode.name for mode in automaton.modes]
        self.shifts = shifts
        self.gains = np.zeros((len(shifts), len(uncertain_gains(automaton)))) if gains is None else gains
        unit = np.eye(threshold_stds(automaton).size)
        self._moved = [with_shifted_thresholds(automaton, by) for by in unit]
        self._modes: dict[int, _Mode] = {}

    def invariant_thresholds(self, mode: int) -> Floats:
        """(t, r) the thresholds of the half-spaces of a mode's invariant, of each object."""

        def values(automaton: HybridAutomaton) -> list[float]:
            return [h.c for h in automaton.modes[mode].invariant.half_spaces]

        return _affine(values(self._automaton), [values(moved) for moved in self._moved], self.shifts)

    def pins(self, mode: int) -> Floats:
        """(t, p) where the objects hold the coordinates that a mode pins, in the order of its pins."""
        return self._mode(mode).pins

    def step(self, modes: Ints, x: Floats, u: Floats, disturbance: Floats) -> tuple[Ints, Floats]:
        """Modes (t,), by index, and states (t, n) after one step with inputs (t, m) and disturbances (t, n)."""
        ends, final = modes.copy(), x.copy()
        travelling: list[_Travellers] = []
        for index in np.unique(modes):
            mode, rows = self._mode(int(index)), np.flatnonzero(modes == index)
            start = x[rows]
            mode.pin(rows, start)
            d = mode.displacement(rows, start, u[rows], disturbance[rows])
            travelling.append(_Travellers(int(index), rows, start, d, np.zeros(rows.size), 0))
        left: list[Ints] = []
        while travelling:
            group = travelling.pop()
            at, edge = self._next_entry(group, u[group.rows])
            quiet = edge < 0
            ends[group.rows[quiet]] = group.mode
            final[group.rows[quiet]] = group.x[quiet] + (1.0 - group.s[quiet])[:, None] * group.d[quiet]
            for number in np.unique(edge[~quiet]):
                chosen = edge == number
                arrived, hard = self._taken(group.where(chosen), int(number), at[chosen], u, disturbance)
                left.append(arrived.rows[hard])
                if not hard.all():
                    travelling.append(arrived.where(~hard))
        for i in np.concatenate(left).tolist() if left else ():
            tables = _TablesOfOne(self._names, self._mode, i)
            table = tables[self._names[modes[i]]]
            end, final[i], _, _ = travel(tables, table, x[i].tolist(), u[i].tolist(), disturbance[i].tolist())
            ends[i] = self._names.index(end.name)
        return ends, final

    def _mode(self, index: int) -> _Mode:
        """The tables of a mode, made when they are asked for: roll-outs see few modes of their object."""
        if index not in self._modes:
            automata = (self._automaton, *self._moved)
            tables = [mode_tables(automaton)[self._names[index]] for automaton in automata]
            self._modes[index] = _mode(self._automaton, tables[0], tables[1:], self.shifts, self.gains)
        return self._modes[index]

    def _next_entry(self, group: _Travellers, u: Floats) -> tuple[Floats, Ints]:
        """(k,) how much further the first guard fires, and the number of its exit; -1 where none does.

        After an event, guards that hold already are blocked ones: only later entries count.
        """
        mode = self._mode(group.mode)
        none = np.full(group.rows.size, -1)
        if not mode.exits:
            return np.zeros(group.rows.size), none
        at = mode.entries(*mode.margins(group.rows, group.x, group.d, u), 1.0 - group.s)
        if group.events:
            at[at <= 0.0] = np.inf
        edge = np.argmin(at, axis=1)
        ahead = at[np.arange(len(at)), edge]
        return ahead, np.where(np.isfinite(ahead), edge, none)

    def _taken(
        self, group: _Travellers, number: int, ahead: Floats, u: Floats, disturbance: Floats
    ) -> tuple[_Travellers, Booleans]:
        """A group behind the event of one of its mode's exits, and (k,) for whom that is not all of this instant."""
        leaving = self._mode(group.mode)
        chosen, target = leaving.exits[number], int(leaving.targets[number])
        mode, rows = self._mode(target), group.rows
        given, pushed = u[rows], disturbance[rows]
        x = group.x + ahead[:, None] * group.d
        if chosen.A is not None:
            x = x @ np.array(chosen.A).T + given @ np.array(chosen.B).T + np.array(chosen.c)
        mode.pin(rows, x)
        if chosen.is_self:
            kept = group.d if chosen.A is None else group.d @ np.array(chosen.A).T
            d = np.where(np.isin(np.arange(x.shape[1]), mode.pinned), 0.0, kept)
        else:
            d = mode.displacement(rows, x, given, pushed)
        arrived = _Travellers(target, rows, x, d, np.minimum(1.0, group.s + ahead), group.events + 1)
        if arrived.events >= _MOST_EVENTS:
            return arrived, np.ones(rows.size, dtype=bool)
        return arrived, self._goes_on(arrived, given, chosen.edge, group.mode)

    def _goes_on(self, group: _Travellers, u: Floats, edge: int, source: int) -> Booleans:
        """(k,) whether more happens at the instant of an event: a further transition, or a wall to slide along.

        An exit back to where the instant began, and the edge just taken, are blocked (no chattering).
        """
        mode = self._mode(group.mode)
        if not mode.exits:
            return np.zeros(group.rows.size, dtype=bool)
        margin, rate, tolerance = mode.margins(group.rows, group.x, group.d, u)
        holding = np.isfinite(mode.entries(margin, rate, tolerance, np.zeros(len(margin))))
        if not holding.any():
            return np.zeros(group.rows.size, dtype=bool)
        blocked = np.array(
            [
                e.edge == edge or (not e.is_self and t == source)
                for e, t in zip(mode.exits, mode.targets.tolist(), strict=True)
            ]
        )
        pressed = (rate > tolerance) & (np.abs(margin) <= tolerance) & holding[:, mode.owner]
        return np.asarray((holding & ~blocked).any(axis=1) | pressed.any(axis=1))


def _mode(automaton: HybridAutomaton, table: ModeTable, moved: list[ModeTable], shifts: Floats, gains: Floats) -> _Mode:
    """Everything is affine in the shifts, so tables with one boundary moved by one unit give the slopes."""
    n, m = automaton.n, automaton.m
    rows = _rows(table)
    sizes = [len(e.rows) or 1 for e in table.exits]
    thresholds = _affine([row.c for row in rows], [[row.c for row in _rows(t)] for t in moved], shifts)
    pins = _affine([value for _, value in table.pins], [[value for _, value in t.pins] for t in moved], shifts)
    free = np.array([flow is not None for flow in table.flow], dtype=float)
    mode: Mode = automaton.mode(table.name)
    names = [own.name for own in automaton.modes]
    moved_by = np.diag(free)
    for tie in mode.ties:
        moved_by[tie.coordinate] = np.array(tie.weights) @ moved_by
    return _Mode(
        pinned=np.array([i for i, _ in table.pins], dtype=np.int64),
        pins=pins,
        B=mode.B * free[:, None],
        moved=moved_by,
        ties=mode.ties,
        table=table,
        exits=table.exits,
        targets=np.array([names.index(e.target) for e in table.exits], dtype=np.int64),
        states=_matrix(rows, [row.states for row in rows], n),
        inputs=_matrix(rows, [row.inputs for row in rows], m),
        thresholds=thresholds,
        tolerances=TOLERANCE * np.maximum(1.0, np.abs(thresholds)),
        strict=np.array([row.strict for row in rows], dtype=bool),
        first=np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if sizes else np.zeros(0, dtype=np.int64),
        owner=np.repeat(np.arange(len(sizes)), sizes),
        effects={i: motion for i, motion in table.effects.items() if free[i]},
        gains=gain_factors(automaton, mode, gains) if gains.any() else None,
    )


def _rows(table: ModeTable) -> list[Row]:
    """The half-spaces of a mode's exits one after the other, at least one each."""
    return [row for e in table.exits for row in e.rows or (_ALWAYS,)]


def _affine(values: list[float], moved: list[list[float]], shifts: Floats) -> Floats:
    """(t, r) values at each object's shifts (t, b)."""
    base = np.array(values)
    slopes = np.array(moved).reshape(len(moved), base.size) - base
    return np.asarray(base + shifts @ slopes)


def _matrix(rows: list[Row], terms: list[Terms], width: int) -> Floats:
    matrix = np.zeros((len(rows), width))
    for weights, entries in zip(matrix, terms, strict=True):
        for i, w in entries:
            weights[i] = w
    return matrix
