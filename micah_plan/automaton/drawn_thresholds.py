"""Uncertain thresholds: samples of the true ones, and thresholds as part of the state.

An object has one threshold per boundary, the same at every passage and in both directions; `Edge.threshold_std` is its
std. So a boundary moves as a whole: in all guards and invariants that it bounds, and with it the pins of the modes that
are entered there. Joints are unchanged: where poses are drawn from a configuration, those of the moving joints count.

`with_boundary_states` makes the shifts s (b,) of the uncertain boundaries a part of the state (x, s), so that a filter
can estimate them: a half-space ``a'x >= c`` whose threshold grows by g for each unit of s_i becomes ``a'x - g s_i >=
c``, and a pin at a boundary follows its coordinate. `with_boundaries` fixes s: a step of its automaton over x is
exactly a step of (x, s).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.augmented import augment_state, fix_augmented_state, mapped
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Pin
from micah_plan.automaton.memo import memoised, sharing_motion
from micah_plan.automaton.region import HalfSpace

_DIGITS = 9
_SMALLEST_STD = 1e-6
Boundary = tuple[float, ...]
"""Weights and threshold of a half-space's boundary, scaled so that both sides of it are the same value."""


def threshold_stds(automaton: HybridAutomaton) -> Floats:
    """(b,) std of each boundary that is not certain, in the unit of its scaled threshold, in the order of the edges."""
    return np.array(list(boundary_stds(automaton).values()))


def drawn_shifts(automaton: HybridAutomaton, rng: np.random.Generator, count: int) -> Floats:
    """(count, b) sampled displacements of the boundaries of `count` objects, in the order of `threshold_stds`.

    `rng` is not used where all thresholds are certain.
    """
    stds = threshold_stds(automaton)
    return stds * rng.standard_normal((count, stds.size))


def with_boundaries(automaton: HybridAutomaton, by: Floats, stds: Floats | None = None) -> HybridAutomaton:
    """The automaton with its uncertain boundaries moved by amounts (b,); unchanged if all are 0.

    Args:
        by: in the order of `threshold_stds`.
        stds: (b,) current ones; None: unchanged. The variance of a pin at a boundary decreases by as much as that of
            its boundary.
    """
    before = boundary_stds(automaton)
    now = before if stds is None else dict(zip(before, map(float, stds), strict=True))
    if now == before and not np.any(by):
        return automaton
    moved = fix_augmented_state(with_boundary_states(automaton), automaton.n, by.tolist())

    def pin_std(pin: Pin, at: Boundary | None) -> float:
        gained = 0.0 if at is None else before[at] ** 2 - now[at] ** 2
        return float(max(pin.std**2 - gained, _SMALLEST_STD**2) ** 0.5)

    def known_mode(old: Mode, new: Mode) -> Mode:
        at = _uncertain_pins(automaton, old)
        pairs = zip(old.pins, new.pins, strict=True)
        return replace(new, pins=tuple(replace(after, std=pin_std(pin, at.get(pin))) for pin, after in pairs))

    def known_edge(old: Edge, new: Edge) -> Edge:
        at = [boundary_of(h)[0] for h in old.guard.half_spaces]
        narrowed = max((now[b] / before[b] for b in at if b in before), default=1.0)
        return replace(new, threshold_std=old.threshold_std * narrowed)

    modes = tuple(map(known_mode, automaton.modes, moved.modes))
    edges = tuple(map(known_edge, automaton.edges, moved.edges))
    return sharing_motion(replace(moved, modes=modes, edges=edges), automaton)


@memoised
def with_boundary_states(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton over (x, s), cached; unchanged if all thresholds are certain."""
    stds = boundary_stds(automaton)
    if not stds:
        return automaton
    numbers = {boundary: automaton.n + i for i, boundary in enumerate(stds)}

    def weights(half_space: HalfSpace, mode: Mode | None) -> list[float]:
        growth = _moving_boundary(automaton, half_space, mode)
        return [0.0 if growth is None or growth[0] != boundary else -growth[1] for boundary in stds]

    def following(pin: Pin, at: Boundary) -> Pin:
        # The spread of its boundary is that of the new coordinate.
        rest = float(np.sqrt(max(0.0, pin.std**2 - stds[at] ** 2)))
        return replace(pin, std=rest, follows=numbers[at])

    def with_following_pins(mode: Mode) -> Mode:
        at = _uncertain_pins(automaton, mode)
        return replace(mode, pins=tuple(following(pin, at[pin]) if pin in at else pin for pin in mode.pins))

    added = [Coordinate(f"boundary {i + 1}", "") for i in range(len(stds))]
    whole = augment_state(automaton, added, weights)
    return mapped(whole, with_following_pins, lambda edge: replace(edge, threshold_std=0.0))


def _moving_boundary(
    automaton: HybridAutomaton, half_space: HalfSpace, mode: Mode | None
) -> tuple[Boundary, float] | None:
    """(boundary that moves a half-space, growth of its threshold per unit); None if fixed.

    That is its own boundary. A mode's invariant around a pinned coordinate moves with the boundary at which it is
    pinned. None where it does not move.
    """
    uncertain = boundary_stds(automaton)
    boundary, scale = boundary_of(half_space)
    if boundary in uncertain:
        return boundary, scale
    if mode is None or half_space.bound is None:
        return None
    at = boundaries_of_pins(automaton, mode).get(half_space.bound.coordinate)
    return None if at is None or at not in uncertain else (at, half_space.a[half_space.bound.coordinate])


def _uncertain_pins(automaton: HybridAutomaton, mode: Mode) -> dict[Pin, Boundary]:
    """The pins of a mode at uncertain boundaries."""
    at, uncertain = boundaries_of_pins(automaton, mode), boundary_stds(automaton)
    return {pin: at[pin.coordinate] for pin in mode.pins if at.get(pin.coordinate) in uncertain}


@memoised
def boundary_stds(automaton: HybridAutomaton) -> dict[Boundary, float]:
    """Std of every uncertain boundary, in the unit of its scaled threshold, in the order of the edges."""
    stds: dict[Boundary, float] = {}
    for edge in automaton.edges:
        for half_space in edge.guard.half_spaces if edge.threshold_std > 0 else ():
            if half_space.on_state:
                boundary, scale = boundary_of(half_space)
                stds[boundary] = max(stds.get(boundary, 0.0), edge.threshold_std / abs(scale))
    return stds


@lru_cache(maxsize=1024)
def boundary_of(half_space: HalfSpace) -> tuple[Boundary, float]:
    """(boundary, factor from its normalised threshold to the half-space's)."""
    scale = next((weight for weight in (*half_space.a, *half_space.b) if weight), 1.0)
    values = (*half_space.a, *half_space.b, half_space.c)
    return tuple(round(value / scale, _DIGITS) + 0.0 for value in values), scale


@memoised
def boundaries_of_pins(automaton: HybridAutomaton, mode: Mode) -> dict[int, Boundary]:
    """Boundaries by coordinate at which a mode pins it: the one on that coordinate alone by which it was entered.

    A mode that is only entered from others that pin the coordinate at the same place pins it at their boundary.
    """
    boundaries: dict[int, Boundary] = {}
    for edge in automaton.edges:
        for pin in automaton.pins_located_by(edge):
            if edge.target == mode.name or any(
                (p.coordinate, p.value) == (pin.coordinate, pin.value) for p in mode.pins
            ):
                on_it = (h for h in edge.guard.half_spaces if h.bound and h.bound.coordinate == pin.coordinate)
                first = next(on_it, None)
                if first is not None and (edge.target == mode.name or pin.coordinate not in boundaries):
                    boundaries[pin.coordinate] = boundary_of(first)[0]
    return boundaries
