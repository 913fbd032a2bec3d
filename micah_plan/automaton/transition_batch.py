"""Steps of many roll-outs at once: motion and its events in arrays, with the rules and the arithmetic of `transition`.

In most steps no guard fires, and a step is one addition. Where guards fire, the arrays go from event to event, all
roll-outs of a mode together. What is rare is left to the scalar `transition.Travel`, where the rules are written: many
events in one step, and several walls met at one instant. A test compares the two.

Objects differ in the places of their boundaries, which are a part of the state here as in `lifted`, and in gains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints, alike
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.lifted import with_boundary_states
from micah_plan.automaton.step_noise import gain_factors, uncertain_gains
from micah_plan.automaton.transition import TOLERANCE, ModeTable, Row, Terms, Travel, mode_table

# A roll-out with more events in one step than this is left to the scalar transition, which knows when to end.
_MOST_EVENTS = 16
# Half-spaces that fill up guards with fewer than others, and stand for the exits of a mode without any.
_ALWAYS = Row((), (), -1.0, False, TOLERANCE)
_NEVER = replace(_ALWAYS, c=1.0)


class _Mode:
    """A mode of t objects over n coordinates, boundaries among them, as arrays; e exits with r half-spaces each.

    Attributes:
        table: of the model.
        free: (n,) what moves; B: (n, m) input matrix, zero for the rest.
        moved: (n, n) what a disturbance moves: nothing that is pinned, and what is tied as the others.
        edges, targets, is_self: (e,) of the exits, mode changes before self transitions; targets by index.
        states, inputs: (r * e, n), (r * e, m) scaled weights, those of the first half-spaces of all exits first;
            thresholds, tolerances, strict: (r, e, 1).
        gains: (t, n) what multiplies the motion of each object's coordinates; None: nothing.
    """

    def __init__(self, automaton: HybridAutomaton, index: int, gains: Floats) -> None:
        """Args: the model over (x, s), the number of the mode, and each object's relative errors of gains (t, g)."""
        n, mode = automaton.n, automaton.modes[index]
        self.table, self.ties = mode_table(automaton, mode.name), mode.ties
        exits = self.table.exits
        self.free = np.array([terms is not None for terms in self.table.flow])
        self.B = mode.B * self.free[:, None]
        self.moved = np.diag(self.free.astype(float))
        for tie in self.ties:
            self.moved[tie.coordinate] = np.array(tie.weights) @ self.moved
        self.edges = np.array([e.edge for e in exits] or [-1])
        self.targets = np.array([automaton.mode_index(e.target) for e in exits] or [-1])
        self.is_self = np.array([e.is_self for e in exits] or [True])
        most = max((len(e.rows) for e in exits), default=1) or 1
        guards = [(*e.rows, *(_ALWAYS,) * (most - len(e.rows))) for e in exits] or [(_NEVER,)]
        rows = list(zip(*guards, strict=True))
        self.states = np.array([_dense(row.states, n) for own in rows for row in own])
        self.inputs = np.array([_dense(row.inputs, automaton.m) for own in rows for row in own])
        self.thresholds = np.array([[[row.c] for row in own] for own in rows])
        self.tolerances = np.array([[[row.tolerance] for row in own] for own in rows])
        self.strict = np.array([[[row.strict] for row in own] for own in rows])
        self.gains = gain_factors(automaton, mode, gains) if gains.any() else None

    def pin(self, x: Floats) -> None:
        """Put the pinned and the tied coordinates of states x (k, n) at their values."""
        for i, value, follows in self.table.pins:
            x[:, i] = value if follows is None else value + x[:, follows]
        for tie in self.ties:
            x[:, tie.coordinate] = tie.value(x)

    def displacement(self, rows: Ints, x: Floats, u: Floats, pushed: Floats) -> Floats:
        """(k, n) motion of a whole step of the objects `rows` (k,) from x (k, n) with inputs and disturbances."""
        d = u @ self.B.T
        if self.gains is not None:
            d *= self.gains[rows]
        for i, motion in self.table.effects.items():
            d[:, i] = motion.displacement(np, x[:, i], d[:, i])
        return np.asarray(self.tied(d) + pushed @ self.moved.T)

    def tied(self, d: Floats) -> Floats:
        """(k, n) motions with the tied coordinates moved along."""
        for tie in self.ties:
            d[:, tie.coordinate] = d @ np.array(tie.weights)
        return d

    def margins(self, x: Floats, d: Floats, u: Floats) -> tuple[Floats, Floats]:
        """(r, e, k) margins of all half-spaces, and their rates along d."""
        shape = (*self.strict.shape[:2], len(x))
        margin = (self.states @ x.T + self.inputs @ u.T).reshape(shape) - self.thresholds
        return margin, (self.states @ d.T).reshape(shape)

    def can_enter(self, margin: Floats, rate: Floats, horizon: Floats) -> Booleans:
        """(k,) whether any guard may fire within the horizon (k,): none of its half-spaces stays far."""
        return np.asarray((np.maximum(margin, margin + horizon * rate) >= -self.tolerances).all(axis=0).any(axis=0))

    def entries(self, margin: Floats, rate: Floats, horizon: Floats) -> Floats:
        """(e, k) how far along d each guard fires, within the horizon (k,); infinite if it does not.

        The arithmetic of `transition.entry`.
        """
        outside = margin < -self.tolerances
        grows, falls = rate > self.tolerances, rate < -self.tolerances
        coming = grows & outside
        enter = np.minimum(np.divide(-margin, rate, out=np.zeros_like(margin), where=coming), horizon)
        leave = np.divide(self.tolerances - margin, rate, out=np.full_like(margin, np.inf), where=falls)
        never = coming & (margin + horizon * rate < -self.tolerances)
        never |= ~grows & ~falls & (outside | (self.strict & (margin <= self.tolerances)))
        enter[never] = np.inf
        first, last = enter.max(axis=0), leave.min(axis=0)
        return np.where(first < last, first, np.inf)

    def holding(self, margin: Floats, rate: Floats) -> Booleans:
        """(e, k) whether each guard fires at once: `entries` with nothing ahead."""
        within = (rate < -self.tolerances) | (self.strict & (rate <= self.tolerances))
        return np.asarray(np.where(within, margin > self.tolerances, margin >= -self.tolerances).all(axis=0))

    def table_of(self, number: int) -> ModeTable:
        """The table of one object."""
        if self.gains is None:
            return self.table
        gained = zip(self.table.flow, self.gains[number].tolist(), strict=True)
        flow = (None if terms is None else tuple((j, gain * w) for j, w in terms) for terms, gain in gained)
        return replace(self.table, flow=tuple(flow))


@dataclass(frozen=True, eq=False)
class _Travellers:
    """Objects of one mode on their way through a step.

    Attributes:
        mode: index of the mode.
        rows: (k,) numbers of the objects.
        x, d: (k, n) states, and motions of a whole step.
        s: (k,) how much of the step lies behind them.
        events: how many events they had.
        instant: what has happened at the present instant; None: they are between two.
    """

    mode: int
    rows: Ints
    x: Floats
    d: Floats
    s: Floats
    events: int
    instant: _Instant | None = None

    def where(self, chosen: Booleans) -> _Travellers:
        """Some of them."""
        if chosen.all():
            return self
        instant = None if self.instant is None else self.instant.where(chosen)
        moved = self.x[chosen], self.d[chosen], self.s[chosen]
        return _Travellers(self.mode, self.rows[chosen], *moved, self.events, instant)


@dataclass(frozen=True, eq=False)
class _Instant:
    """The events of k objects at one instant.

    Attributes:
        arrived: number of the exit whose guard they arrived at; -1 as soon as an exit was taken.
        taken: (e, k) edges that were taken; entered: (q, k) modes that they were in.
        slides: whether they slide along a wall.
    """

    arrived: int
    taken: Booleans
    entered: Booleans
    slides: bool = False

    def where(self, chosen: Booleans) -> _Instant:
        """The instant of some of the objects."""
        return replace(self, taken=self.taken[:, chosen], entered=self.entered[:, chosen])

    def after(self, edge: int, target: int) -> _Instant:
        """The instant with one more edge taken, into a mode."""
        taken, entered = self.taken.copy(), self.entered.copy()
        taken[edge] = entered[target] = True
        return _Instant(-1, taken, entered)


class TransitionBatch:
    """t objects of one model, each with its own thresholds and gains."""

    def __init__(self, automaton: HybridAutomaton, shifts: Floats, gains: Floats | None = None) -> None:
        """
        Args:
            automaton: the model.
            shifts: (t, b) by how much each object's boundaries are moved (`thresholds.threshold_stds`).
            gains: (t, g) relative errors of its gains (`step_noise.drawn_gains`); None: they are the model's.
        """
        self._automaton = with_boundary_states(automaton)
        self.shifts = shifts
        self.gains = np.zeros((len(shifts), len(uncertain_gains(automaton)))) if gains is None else gains
        self._modes: dict[int, _Mode] = {}

    def step(self, modes: Ints, x: Floats, u: Floats, disturbance: Floats) -> tuple[Ints, Floats]:
        """Modes (t,), by index, and states (t, n) after one step with inputs (t, m) and disturbances (t, n)."""
        n = x.shape[1]
        x, pushed = np.hstack([x, self.shifts]), np.hstack([disturbance, np.zeros_like(self.shifts)])
        ends, final = modes.copy(), x.copy()
        travelling: list[_Travellers] = []
        for index, rows in alike(modes):
            mode, start = self._mode(index), x[rows]
            mode.pin(start)
            d = mode.displacement(rows, start, u[rows], pushed[rows])
            travelling.append(_Travellers(index, rows, start, d, np.zeros(rows.size), 0))
        left: list[int] = []
        while travelling:
            group = travelling.pop()
            if group.instant is not None:
                onward, hard = self._settled(group, group.instant, u, pushed)
                travelling += onward
                left += hard
                continue
            ahead, number = self._next_entry(group, u[group.rows])
            quiet = np.isinf(ahead)
            ends[group.rows[quiet]] = group.mode
            final[group.rows[quiet]] = group.x[quiet] + (1.0 - group.s[quiet])[:, None] * group.d[quiet]
            for k in np.unique(number[~quiet]).tolist():
                chosen = ~quiet & (number == k)
                travelling.append(self._arrived(group.where(chosen), k, ahead[chosen]))
        for i in left:
            of_mode = partial(self._table, i)
            start_table = of_mode(self._automaton.mode_names[modes[i]])
            travel = Travel(of_mode, start_table, x[i].tolist(), u[i].tolist(), pushed[i].tolist())
            travel.to_the_end()
            ends[i], final[i] = self._automaton.mode_index(travel.table.name), travel.x
        return ends, final[:, :n]

    def _mode(self, index: int) -> _Mode:
        """The arrays of a mode, made when they are asked for: roll-outs see few modes of their object."""
        if index not in self._modes:
            self._modes[index] = _Mode(self._automaton, index, self.gains)
        return self._modes[index]

    def _table(self, number: int, name: str) -> ModeTable:
        """The table of one object in the mode of that name."""
        return self._mode(self._automaton.mode_index(name)).table_of(number)

    def _next_entry(self, group: _Travellers, u: Floats) -> tuple[Floats, Ints]:
        """(k,) how much further the first guard fires, infinite where none does, and the number of its exit.

        After an event, guards that hold already are blocked ones: only later entries count.
        """
        mode, horizon = self._mode(group.mode), 1.0 - group.s
        margin, rate = mode.margins(group.x, group.d, u)
        first, number = np.full(len(horizon), np.inf), np.zeros(len(horizon), dtype=np.int64)
        near = np.flatnonzero(mode.can_enter(margin, rate, horizon))
        if near.size:
            at = mode.entries(margin[..., near], rate[..., near], horizon[near])
            if group.events:
                at[at <= 0.0] = np.inf
            first[near], number[near] = at.min(axis=0), at.argmin(axis=0)
        return first, number

    def _arrived(self, group: _Travellers, number: int, ahead: Floats) -> _Travellers:
        """A group at the instant at which it arrives at the guard of an exit of its mode."""
        taken = np.zeros((len(self._automaton.edges), ahead.size), dtype=bool)
        entered = np.zeros((len(self._automaton.modes), ahead.size), dtype=bool)
        entered[group.mode] = True
        x, s = group.x + ahead[:, None] * group.d, np.minimum(1.0, group.s + ahead)
        return replace(group, x=x, s=s, instant=_Instant(number, taken, entered))

    def _settled(
        self, group: _Travellers, instant: _Instant, u: Floats, pushed: Floats
    ) -> tuple[list[_Travellers], list[int]]:
        """The groups after the next event of an instant, or after it; and the numbers of objects left to `Travel`.

        An exit back to a mode entered at this instant, and an edge taken at it, are blocked (no chattering): walls.
        """
        mode = self._mode(group.mode)
        margin, rate = mode.margins(group.x, group.d, u[group.rows])
        holding = mode.holding(margin, rate)
        if instant.arrived >= 0:  # rounding may leave a state slightly short of it
            holding[instant.arrived] = True
        free = holding & ~instant.taken[mode.edges] & (mode.is_self[:, None] | ~instant.entered[mode.targets])
        leaves, number = np.asarray(free.any(axis=0)), free.argmax(axis=0)
        onward = [
            self._taken(group.where(leaves & (number == k)), k, u, pushed) for k in np.unique(number[leaves]).tolist()
        ]
        pressed = (rate > mode.tolerances) & (np.abs(margin) <= mode.tolerances) & holding
        slides = np.asarray(~leaves & pressed.any(axis=(0, 1)))
        if slides.any() and not instant.slides:
            # The first half-space of the first exit.
            exits = pressed[..., slides].any(axis=0).argmax(axis=0)
            rows = pressed[:, exits, slides].argmax(axis=0)
            onward.append(_slid(group.where(slides), mode.states[rows * len(mode.edges) + exits] * mode.free))
        rests = ~leaves & ~slides
        if rests.any():
            onward.append(replace(group.where(rests), instant=None))
        hard = [own.rows for own in onward if own.events >= _MOST_EVENTS] + [group.rows[slides & instant.slides]]
        return [own for own in onward if own.events < _MOST_EVENTS], np.concatenate(hard).tolist()

    def _taken(self, group: _Travellers, number: int, u: Floats, disturbance: Floats) -> _Travellers:
        """A group behind the event of one of its mode's exits."""
        leaving, instant = self._mode(group.mode), group.instant
        chosen, target = leaving.table.exits[number], int(leaving.targets[number])
        mode, rows = self._mode(target), group.rows
        given, pushed = u[rows], disturbance[rows]
        x, kept = group.x.copy(), group.d
        if chosen.reset is not None:
            A, B, c = map(np.array, chosen.reset)
            x, kept = x @ A.T + given @ B.T + c, kept @ A.T
        mode.pin(x)
        d = mode.tied(np.where(mode.free, kept, 0.0)) if chosen.is_self else mode.displacement(rows, x, given, pushed)
        happened = None if instant is None else instant.after(chosen.edge, target)
        return _Travellers(target, rows, x, d, group.s, group.events + 1, happened)


def _slid(group: _Travellers, normals: Floats) -> _Travellers:
    """A group without what of its motion is normal to a wall, normals (k, n)."""
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    along = normals / np.where(size > 0.0, size, 1.0)
    # A wall that nothing can give way to stops all motion.
    d = np.where(size > 0.0, group.d - (group.d * along).sum(axis=1, keepdims=True) * along, 0.0)
    return replace(group, d=d, instant=None if group.instant is None else replace(group.instant, slides=True))


def _dense(terms: Terms, width: int) -> Floats:
    row = np.zeros(width)
    for i, w in terms:
        row[i] = w
    return row
