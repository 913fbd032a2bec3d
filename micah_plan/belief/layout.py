"""Precomputed layout of an automaton for the filter: guards as rows of matrices, noise, sensing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.drawn_thresholds import threshold_stds, with_boundary_states
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Pin
from micah_plan.automaton.memo import memoised
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.sensing import Sensing
from micah_plan.automaton.step_noise import free_gain_std, free_process_std

# A half-space that many standard deviations away holds a share below 1e-15.
FAR_STDS = 8.0


@dataclass(frozen=True, eq=False)
class HalfSpaceRows:
    """Half-spaces a'x + b'u >= c, one per row: a (r, n), b (r, m), c (r, 1), strict (r, 1)."""

    a: Floats
    b: Floats
    c: Floats
    strict: Booleans

    @staticmethod
    def of(half_spaces: Sequence[HalfSpace], n: int, m: int) -> HalfSpaceRows:
        """Rows of half-spaces, in their order."""
        a, b = (np.array([getattr(h, name) for h in half_spaces], dtype=float) for name in ("a", "b"))
        c, strict = (np.array([[getattr(h, name)] for h in half_spaces]) for name in ("c", "strict"))
        size = len(half_spaces)
        return HalfSpaceRows(
            a.reshape(size, n), b.reshape(size, m), c.reshape(size, 1), strict.reshape(size, 1).astype(bool)
        )

    def __len__(self) -> int:
        return len(self.c)

    @cached_property
    def terms(self) -> tuple[tuple[int, float], ...]:
        """(coordinate, weight) of the first row, including coordinates that only other rows weight."""
        return tuple((int(i), float(self.a[0, i])) for i in np.flatnonzero(self.a.any(axis=0)))

    @cached_property
    def _is_driven(self) -> bool:
        return bool(self.b.any())

    def offsets(self, u: Floats) -> Floats:
        """(r, p) c - b'u for inputs u (m, p): the margins of states x (n, p) are a x minus these; (r, 1) without b."""
        return np.asarray(self.c - self.b @ u) if self._is_driven else self.c


@dataclass(frozen=True, eq=False)
class Exit:
    """A transition out of a mode, as arrays.

    Attributes:
        target: number of its mode; is_self: whether that is the mode itself.
        on_state, on_input: the guard's half-spaces, with those on the input alone separate.
        reset: A (n, n), B (n, m), c (n,); None: the identity.
        located, met: the target's pins that the guard locates, and others that add information.
        freed: coordinates (c,) that have process noise in the target only, and (c, 1) its std; None: an uncertain gain
            adds to the noise in one of the modes.
    """

    target: int
    is_self: bool
    on_state: HalfSpaceRows
    on_input: HalfSpaceRows
    reset: tuple[Floats, Floats, Floats] | None
    located: tuple[Pin, ...]
    met: tuple[Pin, ...]
    freed: tuple[Ints, Floats] | None

    def allowed(self, u: Floats) -> Booleans:
        """(p,) whether the half-spaces on the input alone hold for inputs u (m, p)."""
        margin = -self.on_input.offsets(u)
        return np.asarray(((margin > 0) | ((margin == 0) & ~self.on_input.strict)).all(axis=0))


@dataclass(frozen=True, eq=False)
class ExitBounds:
    """State half-spaces of the guards of several exits.

    Attributes:
        rows: their half-spaces, one exit after the other; far: (r, n) their absolute weights times FAR_STDS.
        of_exit: (e, r) 1 where a half-space belongs to an exit's guard; count: (e, 1) of its half-spaces.
    """

    rows: HalfSpaceRows
    far: Floats
    of_exit: Floats
    count: Floats

    def all_hold(self, holds: Booleans) -> Booleans:
        """(e, p) whether all half-spaces of each exit hold, where each row does (r, p)."""
        return np.asarray(self.of_exit @ holds >= self.count)

    def any_holds(self, holds: Booleans) -> Booleans:
        """(e, p) whether any half-space of each exit holds."""
        return np.asarray(self.of_exit @ holds > 0.0)


@dataclass(frozen=True, eq=False)
class ModeLayout:
    """One mode of the automaton over states and boundaries.

    Attributes:
        mode: itself; index: its number.
        pinned: coordinates that it pins; still: those and the additional ones, which nothing moves.
        process: (n, 1) std of the process noise; gain: whether an uncertain gain adds to it.
        noisy: coordinates that noise moves.
        exits: in the order in which they are tested, self transitions last.
        exit_bounds: the guards of the exits from the first, from the second ... on.
    """

    mode: Mode
    index: int
    pinned: tuple[int, ...]
    still: tuple[int, ...]
    process: Floats
    gain: bool
    noisy: tuple[int, ...]
    exits: tuple[Exit, ...]
    exit_bounds: tuple[ExitBounds, ...]


@dataclass(frozen=True, eq=False)
class Layout:
    """Precomputed arrays of an automaton.

    Attributes:
        automaton: over states and boundaries (`with_boundary_states`), of n states of which the first `own` are x.
        stds: (b,) of its uncertain boundaries in the model.
        modes: in the automaton's order.
        sensing: of each mode; std: (n, q) of it where it is the same everywhere in all modes, else None.
        outside: weights (l, n, q) and offsets (l, q): a mode's states lie where weights @ x >= offset, outside of its
            guards of one half-space on the state alone. Modes with fewer have offsets of minus infinity.
    """

    automaton: HybridAutomaton
    own: int
    stds: Floats
    modes: tuple[ModeLayout, ...]
    sensing: tuple[Sensing, ...]
    std: Floats | None
    outside: tuple[Floats, Floats]

    @property
    def n(self) -> int:
        return self.automaton.n


@memoised
def layout_of(automaton: HybridAutomaton) -> Layout:
    """The layout of an automaton, cached."""
    whole = with_boundary_states(automaton)
    sensing = tuple(whole.sensing(mode) for mode in whole.modes)
    uniform = all(sensing.is_uniform for sensing in sensing)
    return Layout(
        automaton=whole,
        own=automaton.n,
        stds=threshold_stds(automaton),
        modes=tuple(_mode(whole, index) for index in range(len(whole.modes))),
        sensing=sensing,
        std=np.array([sensing.std for sensing in sensing]).T if uniform else None,
        outside=_outside(whole),
    )


def _outside(whole: HybridAutomaton) -> tuple[Floats, Floats]:
    """`Layout.outside`."""
    guards = [[edge.guard.half_spaces for edge in whole.edges_from(mode.name)] for mode in whole.modes]
    rows = [
        [
            exit_rows[0]
            for exit_rows in mode
            if len(exit_rows) == 1 and exit_rows[0].on_state and not exit_rows[0].on_input
        ]
        for mode in guards
    ]
    longest, q = max(map(len, rows)), len(rows)
    weights, offsets = np.zeros((longest, whole.n, q)), np.full((longest, q), -np.inf)
    for index, exit_rows in enumerate(rows):
        for number, half_space in enumerate(exit_rows):
            weights[number, :, index], offsets[number, index] = -np.array(half_space.a), -half_space.c
    return weights, offsets


def _mode(whole: HybridAutomaton, index: int) -> ModeLayout:
    mode = whole.modes[index]
    edges = sorted(whole.edges_from(mode.name), key=lambda edge: edge.is_self_transition)
    pinned = tuple(pin.coordinate for pin in mode.pins)
    process, gain = np.array(free_process_std(whole, mode)), free_gain_std(whole, mode)
    return ModeLayout(
        mode=mode,
        index=index,
        pinned=pinned,
        still=tuple(i for i, coordinate in enumerate(whole.coordinates) if i in pinned or not coordinate.unit),
        process=process[:, None],
        gain=bool(gain.any()),
        noisy=tuple(int(i) for i in np.flatnonzero((process > 0) | (gain > 0))),
        exits=tuple(_exit(whole, edge) for edge in edges),
        exit_bounds=tuple(_exit_bounds(whole, edges[first:]) for first in range(len(edges))),
    )


def _exit_bounds(whole: HybridAutomaton, edges: Sequence[Edge]) -> ExitBounds:
    on_state = [_on_state(edge) for edge in edges]
    rows = HalfSpaceRows.of([h for exit_rows in on_state for h in exit_rows], whole.n, whole.m)
    count = np.array([len(exit_rows) for exit_rows in on_state])
    of_exit = np.repeat(np.eye(len(edges)), count, axis=1)
    return ExitBounds(rows, FAR_STDS * np.abs(rows.a), of_exit, count[:, None].astype(float))


def _exit(whole: HybridAutomaton, edge: Edge) -> Exit:
    n, m, modes = whole.n, whole.m, [whole.mode(name) for name in (edge.source, edge.target)]
    before, after = (np.array(free_process_std(whole, mode))[:, None] for mode in modes)
    freed = np.flatnonzero((before == 0) & (after > 0))
    gain = any(free_gain_std(whole, mode).any() for mode in modes)
    return Exit(
        target=whole.mode_index(edge.target),
        is_self=edge.is_self_transition,
        on_state=HalfSpaceRows.of(_on_state(edge), n, m),
        on_input=HalfSpaceRows.of([h for h in edge.guard.half_spaces if not h.on_state], n, m),
        reset=None if edge.reset.is_identity else edge.reset.matrices(n, m),
        located=whole.pins_located_by(edge),
        met=whole.pins_met_by(edge),
        freed=None if gain else (freed, after[freed]),
    )


def _on_state(edge: Edge) -> list[HalfSpace]:
    return [h for h in edge.guard.half_spaces if h.on_state]
