"""One step of a hybrid automaton, with every event located exactly, in the order in which the motion meets it.

Source: Lygeros, Sastry and Tomlin, "Hybrid systems", for executions of hybrid automata; MICAH, section III-C. MICAH
tests guards between steps; here they are located within the step, so that the result does not depend on how finely the
motion is cut into steps and no threshold is overrun. When a guard fires, in which order, and with which effect is
described in docs/concepts/automaton.md, "One step, exactly".

A margin, or its change over a step, counts as 0 within ``TOLERANCE`` (relative to thresholds above 1), after a
half-space has been scaled to weights of length 1. `step` uses u as given, admissible (`Mode.inputs`) or not, as a plant
does.

A step is one of many objects at once, each with its own thresholds and gains: the arrays go from event to event, all
objects of a mode together, and in most steps no guard fires and a step is one addition. A single step is a batch of
one. Objects differ in the places of their boundaries, which are a part of the state here as in `augmented`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import Booleans, Floats, Ints, rows_by_number
from micah_plan.automaton.drawn_thresholds import threshold_stds, with_boundary_states
from micah_plan.automaton.effects.motion import motions
from micah_plan.automaton.hybrid import HybridAutomaton, vector
from micah_plan.automaton.input_memory import passed_on
from micah_plan.automaton.memo import memoised
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.step_noise import gain_factors, uncertain_gains
from micah_plan.errors import InputError

Values = Mapping[str, float] | ArrayLike
"""Of coordinates or inputs: by name, or in order."""

MOST_EVENTS = 256
TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False, slots=True)
class Event:
    """A transition that happened within a step.

    Attributes:
        edge: index into the automaton's edges.
        fraction: s in [0, 1] of the step at which it happened.
        x_before, x_after: (n,) state before and after the reset [rad or m].
        source, target: modes; equal for a self transition.
    """

    edge: int
    fraction: float
    x_before: Floats
    x_after: Floats
    source: str
    target: str

    @property
    def name(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True, eq=False, slots=True)
class Step:
    """Result of one step.

    Attributes:
        mode, x: at the end of the step; x is (n,).
        events: in the order in which they happened.
        complete: false if the limit on events ended the motion early.
    """

    mode: str
    x: Floats
    events: tuple[Event, ...] = ()
    complete: bool = True


@dataclass(frozen=True, eq=False)
class Run:
    """Result of `simulate` over k steps.

    Attributes:
        modes: (k+1,) from the initial mode on.
        states: (k+1, n) from the initial state on [rad or m].
        events: (step, event) of all events, step counted from 0.
        complete: whether all steps were.
    """

    modes: tuple[str, ...]
    states: Floats
    events: tuple[tuple[int, Event], ...]
    complete: bool


def step(automaton: HybridAutomaton, mode: str, x: Values, u: Values, disturbance: Values | None = None) -> Step:
    """The state after one step from x (n,) in `mode` under the input u (m,), as defined in the module.

    Args:
        x, u: in order, or by name: ``{"door": 1.2}``; unnamed inputs are 0, a state must be complete.
        disturbance: (n,) displacement over the whole step that adds to the flow [rad or m].

    Raises:
        InputError: unknown mode, wrong number of values, or a value that is not finite.
    """
    start, command = automaton.state(x), automaton.input(u)
    pushed = vector({} if disturbance is None else disturbance, automaton.coordinate_names, "disturbance", "coordinate")
    index, after = automaton.mode_index(mode), dict[int, float]()
    if automaton.input_memories:
        passed, after = passed_on(np, automaton.input_memories, mode, start.tolist(), command.tolist())
        command = np.array(passed, dtype=float)
    travel = _batch_of_one(automaton).step_with_events(np.array([index]), start[None], command[None], pushed[None])
    final = travel.x[0]
    for i, value in after.items():  # memories take their next values when the step ends
        final[i] = value
    events = tuple(event for _, event in travel.events)
    return Step(automaton.mode_names[travel.modes[0]], final, events, bool(travel.complete[0]))


@memoised
def _batch_of_one(automaton: HybridAutomaton) -> TransitionBatch:
    """The model as a batch of one object."""
    return TransitionBatch(automaton, np.zeros((1, threshold_stds(automaton).size)))


def simulate(
    automaton: HybridAutomaton,
    mode: str,
    x0: Values,
    inputs: ArrayLike | Sequence[Values],
    disturbances: ArrayLike | None = None,
) -> Run:
    """Repeated `step` with inputs (k, m) and disturbances (k, n) from x0 (n,) in `mode`; values may be given by name.

    Raises:
        InputError: as `step`, or the number of disturbances is not that of inputs.
    """
    if isinstance(inputs, Sequence) and any(isinstance(one, Mapping) for one in inputs):
        inputs = np.array([automaton.input(one) for one in inputs])
    rows = _rows(cast("ArrayLike", inputs), automaton.m, "inputs")
    pushes = [None] * len(rows) if disturbances is None else _rows(disturbances, automaton.n, "disturbances")
    if len(pushes) != len(rows):
        raise InputError(f"disturbances must have as many rows as inputs, {len(rows)}. Got {len(pushes)}")
    steps = [Step(automaton.mode(mode).name, automaton.state(x0))]
    for u, pushed in zip(rows, pushes, strict=True):
        steps.append(step(automaton, steps[-1].mode, steps[-1].x, u, pushed))
    return Run(
        tuple(each.mode for each in steps),
        np.array([each.x for each in steps]),
        tuple((k, event) for k, each in enumerate(steps[1:]) for event in each.events),
        all(each.complete for each in steps),
    )


@dataclass(frozen=True, eq=False)
class BatchStep:
    """One step of t objects.

    Attributes:
        modes: (t,) by index, x: (t, n) and complete: (t,), at the end of the step, as of `Step`.
        events: (object, event), those of each object in their order.
    """

    modes: Ints
    x: Floats
    complete: Booleans
    events: tuple[tuple[int, Event], ...]


class TransitionBatch:
    """t objects of one model, each with its own thresholds and gains."""

    def __init__(self, automaton: HybridAutomaton, shifts: Floats, gains: Floats | None = None) -> None:
        """Create a batch.

        Args:
            automaton: the model.
            shifts: (t, b) displacement of each object's boundaries (`drawn_thresholds.threshold_stds`).
            gains: (t, g) relative errors of its gains (`step_noise.drawn_gains`); None: those of the model.
        """
        self._automaton = with_boundary_states(automaton)
        self.shifts = shifts
        self.gains = np.zeros((len(shifts), len(uncertain_gains(automaton)))) if gains is None else gains
        self._modes: dict[int, _Mode] = {}

    def step(self, modes: Ints, x: Floats, u: Floats, disturbance: Floats) -> tuple[Ints, Floats]:
        """Modes (t,), by index, and states (t, n) after one step with inputs (t, m) and disturbances (t, n)."""
        done = self._run_step(modes, x, u, disturbance, None)
        return done.modes, done.x

    def step_with_events(self, modes: Ints, x: Floats, u: Floats, disturbance: Floats) -> BatchStep:
        """The step with all its events."""
        return self._run_step(modes, x, u, disturbance, [])

    def _run_step(
        self, modes: Ints, x: Floats, u: Floats, disturbance: Floats, events: list[tuple[int, Event]] | None
    ) -> BatchStep:
        n = x.shape[1]
        x, pushed = np.hstack([x, self.shifts]), np.hstack([disturbance, np.zeros_like(self.shifts)])
        ends, final, complete = modes.copy(), x.copy(), np.ones(len(x), dtype=bool)
        travelling: list[_StepState] = []
        for index, rows in rows_by_number(modes):
            mode, start = self._mode(index), x[rows]
            mode.pin(start)
            d = mode.displacement(rows, start, u[rows], pushed[rows])
            travelling.append(_StepState(index, rows, start, d, np.zeros(rows.size), 0))
        while travelling:
            group = travelling.pop()
            if group.instant is not None:
                onward, ended = self._after_event(group, group.instant, u, pushed, events)
                travelling += onward
                complete[ended.rows] = False
                ends[ended.rows], final[ended.rows] = group.mode, ended.x
                continue
            ahead, number = self._next_entry(group, u[group.rows])
            quiet = np.isinf(ahead)
            ends[group.rows[quiet]] = group.mode
            final[group.rows[quiet]] = group.x[quiet] + (1.0 - group.s[quiet])[:, None] * group.d[quiet]
            for k in np.unique(number[~quiet]).tolist():
                chosen = ~quiet & (number == k)
                travelling.append(self._moved_to_guard(group.where(chosen), k, ahead[chosen]))
        happened = tuple(
            (row, replace(event, x_before=event.x_before[:n], x_after=event.x_after[:n])) for row, event in events or ()
        )
        return BatchStep(ends, final[:, :n], complete, happened)

    def _mode(self, index: int) -> _Mode:
        """The arrays of a mode, created on demand: roll-outs visit few modes."""
        if index not in self._modes:
            self._modes[index] = _Mode(self._automaton, index, self.gains)
        return self._modes[index]

    def _next_entry(self, group: _StepState, u: Floats) -> tuple[Floats, Ints]:
        """(k,) distance to the next entry into a guard, infinite if there is none, and the exit's number.

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

    def _moved_to_guard(self, group: _StepState, number: int, ahead: Floats) -> _StepState:
        """A group at the instant of its arrival at a guard."""
        taken = np.zeros((len(self._automaton.edges), ahead.size), dtype=bool)
        entered = np.zeros((len(self._automaton.modes), ahead.size), dtype=bool)
        entered[group.mode] = True
        x, s = group.x + ahead[:, None] * group.d, np.minimum(1.0, group.s + ahead)
        return replace(group, x=x, s=s, instant=_Instant(number, taken, entered, np.zeros((0, *x.shape))))

    def _after_event(
        self,
        group: _StepState,
        instant: _Instant,
        u: Floats,
        pushed: Floats,
        events: list[tuple[int, Event]] | None,
    ) -> tuple[list[_StepState], _StepState]:
        """(groups after the next event of an instant or after its end, objects with too many events).

        An exit back to a mode entered at this instant, and an edge taken at it, are blocked (no chattering): walls.
        """
        mode = self._mode(group.mode)
        margin, rate = mode.margins(group.x, group.d, u[group.rows])
        holding = mode.holding(margin, rate)
        if instant.arrived >= 0:  # rounding may leave a state slightly short of it
            holding[instant.arrived] = True
        free = holding & ~instant.taken[mode.edges] & (mode.is_self[:, None] | ~instant.entered[mode.targets])
        leaves, number = np.asarray(free.any(axis=0)), free.argmax(axis=0)
        is_over = leaves & (group.events >= MOST_EVENTS)
        onward = [
            self._behind_exit(group.where(leaves & ~is_over & (number == k)), k, u, pushed, events)
            for k in np.unique(number[leaves & ~is_over]).tolist()
        ]
        pressed = (rate > mode.tolerances) & (np.abs(margin) <= mode.tolerances) & holding
        slides = np.asarray(~leaves & pressed.any(axis=(0, 1)))
        if slides.any():
            # The first half-space of the first exit.
            exits = pressed[..., slides].any(axis=0).argmax(axis=0)
            rows = pressed[:, exits, slides].argmax(axis=0)
            onward.append(
                _projected_on_walls(group.where(slides), mode.states[rows * len(mode.edges) + exits] * mode.free)
            )
        rests = ~leaves & ~slides
        if rests.any():
            onward.append(replace(group.where(rests), instant=None))
        return onward, group.where(is_over)

    def _behind_exit(
        self, group: _StepState, number: int, u: Floats, disturbance: Floats, events: list[tuple[int, Event]] | None
    ) -> _StepState:
        """A group behind one of its mode's exits."""
        leaving, instant = self._mode(group.mode), group.instant
        edge, target = int(leaving.edges[number]), int(leaving.targets[number])
        mode, rows, is_self = self._mode(target), group.rows, bool(leaving.is_self[number])
        command, pushed = u[rows], disturbance[rows]
        x, kept = group.x.copy(), group.d
        reset = leaving.resets[number]
        if reset is not None:
            A, B, c = reset
            x, kept = x @ A.T + command @ B.T + c, kept @ A.T
        mode.pin(x)
        d = mode.tied(np.where(mode.free, kept, 0.0)) if is_self else mode.displacement(rows, x, command, pushed)
        if events is not None:
            names = (self._automaton.mode_names[index] for index in (group.mode, target))
            source, entered = names
            for k, row in enumerate(rows.tolist()):
                events.append((row, Event(edge, float(group.s[k]), group.x[k], x[k], source, entered)))
        happened = None if instant is None else instant.after(edge, target)
        return _StepState(target, rows, x, d, group.s, group.events + 1, happened)


class _Mode:
    """A mode of t objects over n coordinates, boundaries among them, as arrays; e exits with r half-spaces each.

    Attributes:
        pins: coordinates, their values, and the coordinate that adds to the value or None.
        effects: on the motion of a coordinate, by its index.
        free: (n,) coordinates that move; B: (n, m) input matrix, zero for the rest.
        moved: (n, n) response to a disturbance: pinned coordinates do not move, tied ones follow.
        edges, targets, is_self: (e,) of the exits, mode changes before self transitions; targets by index.
        resets: of the exits, (A, B, c) or None for the identity.
        states, inputs: (r * e, n), (r * e, m) scaled weights, those of the first half-spaces of all exits first;
            thresholds, tolerances, strict: (r, e, 1).
        gains: (t, n) factors on the motion of each object's coordinates; None: none.
    """

    def __init__(self, automaton: HybridAutomaton, index: int, gains: Floats) -> None:
        """Args: the model over (x, s), the number of the mode, and each object's relative errors of gains (t, g)."""
        n, mode = automaton.n, automaton.modes[index]
        edges = [k for k, edge in enumerate(automaton.edges) if edge.source == mode.name]
        edges.sort(key=lambda k: automaton.edges[k].is_self_transition)
        exits = [automaton.edges[k] for k in edges]
        self.pins, self.ties = [(pin.coordinate, pin.value, pin.follows) for pin in mode.pins], mode.ties
        self.effects = motions(automaton, mode)
        self.free = np.array([free and bool(c.unit) for free, c in zip(mode.free, automaton.coordinates, strict=True)])
        self.B = mode.B * self.free[:, None]
        self.moved = np.diag(self.free.astype(float))
        for tie in self.ties:
            self.moved[tie.coordinate] = np.array(tie.weights) @ self.moved
        self.edges = np.array(edges or [-1])
        self.targets = np.array([automaton.mode_index(e.target) for e in exits] or [-1])
        self.is_self = np.array([e.is_self_transition for e in exits] or [True])
        self.resets = [None if e.reset.is_identity else e.reset.matrices(n, automaton.m) for e in exits]
        exit_rows = [tuple(map(_row, e.guard.half_spaces)) for e in exits]
        most = max(map(len, exit_rows), default=1) or 1
        guards = [(*rows, *(_ALWAYS,) * (most - len(rows))) for rows in exit_rows] or [(_NEVER,)]
        rows = list(zip(*guards, strict=True))
        self.states = np.array([_padded(row.states, n) for own in rows for row in own])
        self.inputs = np.array([_padded(row.inputs, automaton.m) for own in rows for row in own])
        self.thresholds = np.array([[[row.c] for row in row] for row in rows])
        self.tolerances = np.array([[[row.tolerance] for row in row] for row in rows])
        self.strict = np.array([[[row.strict] for row in row] for row in rows])
        self.gains = gain_factors(automaton, mode, gains) if gains.any() else None

    def pin(self, x: Floats) -> None:
        """Put the pinned and the tied coordinates of states x (k, n) at their values."""
        for i, value, follows in self.pins:
            x[:, i] = value if follows is None else value + x[:, follows]
        for tie in self.ties:
            x[:, tie.coordinate] = tie.value(x)

    def displacement(self, rows: Ints, x: Floats, u: Floats, pushed: Floats) -> Floats:
        """(k, n) displacement of a whole step for objects `rows` (k,) from x (k, n), with inputs and disturbances."""
        d = u @ self.B.T
        if self.gains is not None:
            d *= self.gains[rows]
        for i, motion in self.effects.items():
            d[:, i] = motion.displacement(np, x[:, i], d[:, i])
        return np.asarray(self.tied(d) + pushed @ self.moved.T)

    def tied(self, d: Floats) -> Floats:
        """(k, n) motions with tied coordinates moved along."""
        for tie in self.ties:
            d[:, tie.coordinate] = d @ np.array(tie.weights)
        return d

    def margins(self, x: Floats, d: Floats, u: Floats) -> tuple[Floats, Floats]:
        """(r, e, k) margins of all half-spaces, and their rates along d."""
        shape = (*self.strict.shape[:2], len(x))
        margin = (self.states @ x.T + self.inputs @ u.T).reshape(shape) - self.thresholds
        return margin, (self.states @ d.T).reshape(shape)

    def can_enter(self, margin: Floats, rate: Floats, horizon: Floats) -> Booleans:
        """(k,) whether any guard can fire within the horizon (k,)."""
        return np.asarray((np.maximum(margin, margin + horizon * rate) >= -self.tolerances).all(axis=0).any(axis=0))

    def entries(self, margin: Floats, rate: Floats, horizon: Floats) -> Floats:
        """(e, k) how far along d each guard fires, within the horizon (k,); infinite if it does not."""
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
        """(e, k) whether each guard fires at once: `entries` at distance 0."""
        within = (rate < -self.tolerances) | (self.strict & (rate <= self.tolerances))
        return np.asarray(np.where(within, margin > self.tolerances, margin >= -self.tolerances).all(axis=0))


@dataclass(frozen=True, eq=False)
class _StepState:
    """Objects of one mode during a step.

    Attributes:
        mode: index of the mode.
        rows: (k,) numbers of the objects.
        x, d: (k, n) states, and motions of a whole step.
        s: (k,) completed share of the step.
        events: how many events they had.
        instant: events at the present instant; None: they are between two.
    """

    mode: int
    rows: Ints
    x: Floats
    d: Floats
    s: Floats
    events: int
    instant: _Instant | None = None

    def where(self, chosen: Booleans) -> _StepState:
        """The objects selected by a mask."""
        if chosen.all():
            return self
        instant = None if self.instant is None else self.instant.where(chosen)
        moved = self.x[chosen], self.d[chosen], self.s[chosen]
        return _StepState(self.mode, self.rows[chosen], *moved, self.events, instant)


@dataclass(frozen=True, eq=False)
class _Instant:
    """The events of k objects at one instant.

    Attributes:
        arrived: number of the exit whose guard they arrived at; -1 as soon as an exit was taken.
        taken: (e, k) edges that were taken; entered: (q, k) modes that they were in.
        walls: (w, k, n) orthonormal normals of the walls that they slide along.
    """

    arrived: int
    taken: Booleans
    entered: Booleans
    walls: Floats

    def where(self, chosen: Booleans) -> _Instant:
        """The instant of the selected objects."""
        return replace(self, taken=self.taken[:, chosen], entered=self.entered[:, chosen], walls=self.walls[:, chosen])

    def after(self, edge: int, target: int) -> _Instant:
        """The instant after one more edge into a mode, whose walls are detected anew."""
        taken, entered = self.taken.copy(), self.entered.copy()
        taken[edge] = entered[target] = True
        return _Instant(-1, taken, entered, self.walls[:0])


def _projected_on_walls(group: _StepState, normals: Floats) -> _StepState:
    """A group whose motion is projected on the walls, with normals (k, n), that it has met at this instant."""
    instant = group.instant
    if instant is None:
        raise ValueError("walls are met at an instant")
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    for wall in instant.walls:
        normals = normals - (normals * wall).sum(axis=1, keepdims=True) * wall
    rest = np.linalg.norm(normals, axis=1, keepdims=True)
    # Where the earlier walls leave no direction to move in, all motion stops.
    gives = rest > TOLERANCE * size
    walls = np.concatenate([instant.walls, np.where(gives, normals / np.where(gives, rest, 1.0), 0.0)[None]])
    d = group.d
    for wall in walls:
        d = d - (d * wall).sum(axis=1, keepdims=True) * wall
    return replace(group, d=np.where(gives, d, 0.0), instant=replace(instant, walls=walls))


def _rows(value: ArrayLike, width: int, name: str) -> Floats:
    """A finite array of shape (k, width)."""
    array = np.asarray(value, dtype=float)
    if array.ndim != 2 or array.shape[1] != width or not np.isfinite(array).all():
        raise InputError(f"{name} must be finite and have shape (k, {width}). Got shape {array.shape}")
    return array


@dataclass(frozen=True, slots=True)
class _Row:
    """A scaled half-space: weights of states and inputs, threshold, whether strict, and the margin that counts as 0."""

    states: tuple[float, ...]
    inputs: tuple[float, ...]
    c: float
    strict: bool
    tolerance: float


# Half-spaces that pad guards with fewer than others, and represent the exits of a mode without any.
_ALWAYS = _Row((), (), -1.0, False, TOLERANCE)
_NEVER = replace(_ALWAYS, c=1.0)


# Objects with drawn thresholds share most of their half-spaces.
@lru_cache(maxsize=4096)
def _row(h: HalfSpace) -> _Row:
    """A half-space with its weights of states (of inputs, if there are only those) normalised to length 1.

    Margins are then distances [rad or m], so that the tolerance does not depend on how the half-space is written.
    """
    size = math.hypot(*h.a) or math.hypot(*h.b) or 1.0
    a, b, c = [w / size for w in h.a], [w / size for w in h.b], h.c / size
    if not math.isfinite(sum(map(abs, (*a, *b, c)))):  # weights next to 0 against a huge threshold
        a, b, c = list(h.a), list(h.b), h.c
    return _Row(tuple(a), tuple(b), c, h.strict, TOLERANCE * max(1.0, abs(c)))


def _padded(weights: Sequence[float], width: int) -> Floats:
    """Weights (width,), zeros if there are none."""
    return np.array(weights) if len(weights) == width else np.zeros(width)
