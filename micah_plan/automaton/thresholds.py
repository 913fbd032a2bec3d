"""Thresholds that are known only so well: what the true object's may be.

An object has one threshold per boundary, the same at every passage and for both ways through it; `Edge.threshold_std`
says how well the model knows it. So a draw moves a boundary as a whole: in all guards and invariants that it bounds,
and with it the pins of the modes that are entered there. Joints stay as they are: where poses are drawn from a
configuration, those of the moving joints count.
"""

from __future__ import annotations

import operator
from collections.abc import Container
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.region import HalfSpace, Region

Floats = NDArray[np.float64]

_DIGITS = 9
_SMALLEST_STD = 1e-6
Boundary = tuple[float, ...]
"""Weights and threshold of a half-space's boundary, scaled so that both sides of it are the same value."""


def with_drawn_thresholds(automaton: HybridAutomaton, rng: np.random.Generator) -> HybridAutomaton:
    """An automaton that the object may truly be: thresholds drawn around the model's, independently per boundary.

    The automaton itself, without a draw from `rng`, where all thresholds are certain.
    """
    stds = threshold_stds(automaton)
    return with_shifted_thresholds(automaton, stds * rng.standard_normal(stds.size)) if stds.size else automaton


def threshold_stds(automaton: HybridAutomaton) -> Floats:
    """(b,) std of each boundary that is not certain, in the unit of its scaled threshold, in the order of the edges."""
    return np.array(list(boundary_stds(automaton).values()))


def with_shifted_thresholds(automaton: HybridAutomaton, by: Floats) -> HybridAutomaton:
    """The automaton with its uncertain boundaries moved by (b,) amounts, in the order of `threshold_stds`."""
    shifts = {boundary: float(shift) for boundary, shift in zip(boundary_stds(automaton), by, strict=True)}
    guards = [_moved(edge.guard, shifts) for edge in automaton.edges]
    edges = tuple(
        edge if guard is edge.guard else replace(edge, guard=guard)
        for edge, guard in zip(automaton.edges, guards, strict=True)
    )
    modes = tuple(_moved_mode(automaton, mode, shifts) for mode in automaton.modes)
    return replace(automaton, modes=modes, edges=edges)


def with_known_boundaries(automaton: HybridAutomaton, by: Floats, stds: Floats) -> HybridAutomaton:
    """The automaton with its uncertain boundaries moved by (b,) amounts, and known to (b,) stds instead of its own.

    A pin at a boundary is known better by what its boundary is.
    """
    moved, before = with_shifted_thresholds(automaton, by), boundary_stds(automaton)
    known = dict(zip(before, map(float, stds), strict=True))
    edges = []
    for old, new in zip(automaton.edges, moved.edges, strict=True):
        at = [boundary_of(h)[0] for h in old.guard.half_spaces]
        share = max((known[b] / before[b] for b in at if b in before), default=1.0)
        edges.append(replace(new, threshold_std=old.threshold_std * share))
    modes = []
    for mode, new_mode in zip(automaton.modes, moved.modes, strict=True):
        of_pin = boundaries_of_pins(automaton, mode)
        gained = {i: before[b] ** 2 - known[b] ** 2 for i, b in of_pin.items() if b in before}
        stds_now = (max(pin.std**2 - gained.get(pin.coordinate, 0.0), _SMALLEST_STD**2) ** 0.5 for pin in mode.pins)
        pins = (replace(pin, std=std) for pin, std in zip(new_mode.pins, stds_now, strict=True))
        modes.append(replace(new_mode, pins=tuple(pins)))
    return replace(moved, modes=tuple(modes), edges=tuple(edges))


def boundary_stds(automaton: HybridAutomaton) -> dict[Boundary, float]:
    """Std of every uncertain boundary, in the unit of its scaled threshold, in the order of the edges."""
    known: dict[Boundary, float] | None = automaton.derived.get("boundary_stds")
    if known is not None:
        return known
    stds: dict[Boundary, float] = {}
    for edge in automaton.edges:
        for half_space in edge.guard.half_spaces if edge.threshold_std > 0 else ():
            if half_space.on_state:
                boundary, scale = boundary_of(half_space)
                stds[boundary] = max(stds.get(boundary, 0.0), edge.threshold_std / abs(scale))
    automaton.derived["boundary_stds"] = stds
    return stds


@lru_cache(maxsize=1024)
def boundary_of(half_space: HalfSpace) -> tuple[Boundary, float]:
    """The boundary, and what its scaled threshold is to be multiplied by to give the half-space's."""
    scale = next((weight for weight in (*half_space.a, *half_space.b) if weight), 1.0)
    values = (*half_space.a, *half_space.b, half_space.c)
    return tuple(round(value / scale, _DIGITS) + 0.0 for value in values), scale


def _moved(region: Region, shifts: dict[Boundary, float]) -> Region:
    """The region with its uncertain boundaries moved; itself if it has none."""
    rows = []
    for half_space in region.half_spaces:
        boundary, scale = boundary_of(half_space)
        known = boundary not in shifts
        rows.append(half_space if known else replace(half_space, c=half_space.c + scale * shifts[boundary]))
    return region if all(map(operator.is_, rows, region.half_spaces)) else Region(tuple(rows))


def _moved_mode(automaton: HybridAutomaton, mode: Mode, shifts: dict[Boundary, float]) -> Mode:
    """The mode with its boundaries moved, and its pins with the boundary at which it is entered."""
    at = boundaries_of_pins(automaton, mode)
    carried = {coordinate: shifts.get(boundary, 0.0) for coordinate, boundary in at.items()}
    region = _moved(mode.invariant, shifts)
    if not carried and region is mode.invariant:
        return mode
    pins = tuple(replace(pin, value=pin.value + carried.get(pin.coordinate, 0.0)) for pin in mode.pins)
    rows = []
    for before, after in zip(mode.invariant.half_spaces, region.half_spaces, strict=True):
        held = held_coordinate(before, carried) if after == before else None
        moved = after if held is None else replace(before, c=before.c + before.a[held] * carried[held])
        rows.append(moved)
    return replace(mode, invariant=Region(tuple(rows)), pins=pins)


def boundaries_of_pins(automaton: HybridAutomaton, mode: Mode) -> dict[int, Boundary]:
    """The boundary, by coordinate, at which a mode holds it: that on the coordinate alone by which it was entered.

    A mode that is only entered from others that hold the coordinate at the same place holds it at their boundary.
    """
    memo: dict[str, dict[int, Boundary]] = automaton.derived.setdefault("boundaries_of_pins", {})
    if mode.name not in memo:
        memo[mode.name] = _boundaries_of_pins(automaton, mode)
    return memo[mode.name]


def _boundaries_of_pins(automaton: HybridAutomaton, mode: Mode) -> dict[int, Boundary]:
    found: dict[int, Boundary] = {}
    for edge in automaton.edges:
        for pin in automaton.pins_located_by(edge):
            if edge.target == mode.name or any(
                (p.coordinate, p.value) == (pin.coordinate, pin.value) for p in mode.pins
            ):
                on_it = (h for h in edge.guard.half_spaces if h.bound and h.bound.coordinate == pin.coordinate)
                first = next(on_it, None)
                if first is not None and (edge.target == mode.name or pin.coordinate not in found):
                    found[pin.coordinate] = boundary_of(first)[0]
    return found


def held_coordinate(half_space: HalfSpace, held: Container[int]) -> int | None:
    """The held coordinate around which a half-space bounds a mode's range, though it does not end at its boundary."""
    bound = half_space.bound
    return bound.coordinate if bound is not None and bound.coordinate in held else None
