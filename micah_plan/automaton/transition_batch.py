"""Steps of many roll-outs at once: straight motion in arrays, and `transition.step` where a guard fires.

In most steps no guard fires, and then a step is one addition. Whether one does is asked of all roll-outs at once with
the arithmetic of `guard_table.entry`; the few steps with an event are left to the scalar transition, so that the rules
for events exist once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.effects.motion import CoordinateMotion
from micah_plan.automaton.gain import gain_factors, uncertain_gains, with_gains
from micah_plan.automaton.guard_table import TOLERANCE, ModeTable, Row, Terms, mode_tables
from micah_plan.automaton.hybrid import HybridAutomaton, Tie
from micah_plan.automaton.thresholds import threshold_stds, with_shifted_thresholds
from micah_plan.automaton.transition import step

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Mode:
    """A mode of t objects: what it pins where, its flow, and the half-spaces of all its exits one after the other.

    Attributes:
        pinned: (p,) coordinates; pins: (t, p) where [rad or m].
        B: (n, m) input matrix, rows of pinned coordinates zero; moved: (n, n) what a disturbance moves: nothing that is
            pinned, and what is tied as the others.
        ties: of the mode.
        states, inputs: (r, n), (r, m) scaled weights; thresholds, tolerances: (t, r); strict: (r,).
        first: (e,) first half-space of each exit.
        effects: what changes the motion of a coordinate, by its index.
        gains: (t, n) what multiplies the motion of each object's coordinates; None: nothing.
    """

    pinned: Ints
    pins: Floats
    B: Floats
    moved: Floats
    ties: tuple[Tie, ...]
    states: Floats
    inputs: Floats
    thresholds: Floats
    tolerances: Floats
    strict: Booleans
    first: Ints
    effects: dict[int, CoordinateMotion]
    gains: Floats | None


class TransitionBatch:
    """t objects of one model, each with its own thresholds and gains."""

    def __init__(self, automaton: HybridAutomaton, shifts: Floats, gains: Floats | None = None) -> None:
        """
        Args:
            automaton: the model.
            shifts: (t, b) by how much each object's boundaries are moved (`thresholds.threshold_stds`).
            gains: (t, g) relative errors of its gains (`gain.drawn_gains`); None: they are the model's.
        """
        self._automaton = automaton
        self.shifts = shifts
        self.gains = np.zeros((len(shifts), len(uncertain_gains(automaton)))) if gains is None else gains
        self._objects: dict[int, HybridAutomaton] = {}
        unit = np.eye(threshold_stds(automaton).size)
        moved = [mode_tables(with_shifted_thresholds(automaton, by)) for by in unit]
        self._modes = [
            _mode(
                automaton,
                mode_tables(automaton)[mode.name],
                [tables[mode.name] for tables in moved],
                shifts,
                self.gains,
            )
            for mode in automaton.modes
        ]

    def object(self, number: int) -> HybridAutomaton:
        """The automaton of one object."""
        if not self.shifts.shape[1] and not self.gains.shape[1]:
            return self._automaton
        if number not in self._objects:
            own = with_gains(self._automaton, self.gains[number])
            self._objects[number] = with_shifted_thresholds(own, self.shifts[number])
        return self._objects[number]

    def step(self, modes: Ints, x: Floats, u: Floats, disturbance: Floats) -> tuple[Ints, Floats]:
        """Modes (t,), by index, and states (t, n) after one step with inputs (t, m) and disturbances (t, n)."""
        modes, x = modes.copy(), x.copy()
        eventful: list[int] = []
        for index in np.unique(modes):
            mode, chosen = self._modes[index], np.flatnonzero(modes == index)
            start = x[chosen]
            start[:, mode.pinned] = mode.pins[chosen]
            for tie in mode.ties:
                start[:, tie.coordinate] = tie.value(start)
            d = _displacement(mode, chosen, start, u[chosen])
            for tie in mode.ties:
                d[:, tie.coordinate] = d @ np.array(tie.weights)
            d = d + disturbance[chosen] @ mode.moved.T
            fires = _fires(mode, chosen, start, d, u[chosen])
            quiet = chosen[~fires]
            x[quiet] = (start + d)[~fires]
            eventful += chosen[fires].tolist()
        names = [mode.name for mode in self._automaton.modes]
        for i in eventful:
            after = step(self.object(i), names[modes[i]], x[i], u[i], disturbance[i])
            modes[i], x[i] = names.index(after.mode), after.x
        return modes, x


def _displacement(mode: _Mode, chosen: Ints, x: Floats, u: Floats) -> Floats:
    """(k, n) motion without disturbance of the chosen objects from x (k, n)."""
    d = u @ mode.B.T
    if mode.gains is not None:
        d *= mode.gains[chosen]
    for i, motion in mode.effects.items():
        d[:, i] = motion.displacement(np, x[:, i], d[:, i])
    return np.asarray(d)


def _fires(mode: _Mode, chosen: Ints, x: Floats, d: Floats, u: Floats) -> Booleans:
    """(k,) whether any guard fires on the way from x to x + d; `guard_table.entry` for arrays."""
    if not mode.first.size:
        return np.zeros(len(x), dtype=bool)
    margin = x @ mode.states.T + u @ mode.inputs.T - mode.thresholds[chosen]
    rate, tolerance = d @ mode.states.T, mode.tolerances[chosen]
    grows, falls = rate > tolerance, rate < -tolerance
    with np.errstate(divide="ignore", invalid="ignore"):
        enter = np.where(grows & (margin < -tolerance), np.minimum(-margin / rate, 1.0), 0.0)
        leave = np.where(falls, (tolerance - margin) / rate, np.inf)
    never = grows & (margin < -tolerance) & (margin + rate < -tolerance)
    still = ~grows & ~falls
    never |= still & ((margin < -tolerance) | (mode.strict & (margin <= tolerance)))
    first = np.maximum.reduceat(np.where(never, np.inf, enter), mode.first, axis=1)
    last = np.minimum.reduceat(leave, mode.first, axis=1)
    return np.asarray((first < last).any(axis=1))


def _mode(automaton: HybridAutomaton, table: ModeTable, moved: list[ModeTable], shifts: Floats, gains: Floats) -> _Mode:
    """Everything is affine in the shifts, so tables with one boundary moved by one unit give the slopes."""
    n, m = automaton.n, automaton.m
    rows = [row for e in table.exits for row in e.rows]
    sizes = [len(e.rows) for e in table.exits]
    thresholds = _affine([row.c for row in rows], [[r.c for e in t.exits for r in e.rows] for t in moved], shifts)
    pins = _affine([value for _, value in table.pins], [[value for _, value in t.pins] for t in moved], shifts)
    free = np.array([flow is not None for flow in table.flow], dtype=float)
    ties = automaton.mode(table.name).ties
    moved_by = np.diag(free)
    for tie in ties:
        moved_by[tie.coordinate] = np.array(tie.weights) @ moved_by
    return _Mode(
        pinned=np.array([i for i, _ in table.pins], dtype=np.int64),
        pins=pins,
        B=automaton.mode(table.name).B * free[:, None],
        moved=moved_by,
        ties=ties,
        states=_matrix(rows, [row.states for row in rows], n),
        inputs=_matrix(rows, [row.inputs for row in rows], m),
        thresholds=thresholds,
        tolerances=TOLERANCE * np.maximum(1.0, np.abs(thresholds)),
        strict=np.array([row.strict for row in rows], dtype=bool),
        first=np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if sizes else np.zeros(0, dtype=np.int64),
        effects={i: motion for i, motion in table.effects.items() if free[i]},
        gains=gain_factors(automaton, automaton.mode(table.name), gains) if gains.any() else None,
    )


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
