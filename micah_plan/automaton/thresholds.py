"""Thresholds that are known only so well: what the true object's may be.

An object has one threshold per boundary, the same at every passage and for both ways through it; `Edge.threshold_std`
says how well the model knows it. So a draw moves a boundary as a whole: in all guards and invariants that it bounds,
and with it the pins of the modes that are entered there. Joints stay as they are: where poses are drawn from a
configuration, those of the moving joints count.
"""

from __future__ import annotations

import operator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.region import HalfSpace, Region

Floats = NDArray[np.float64]

_DIGITS = 9
_Boundary = tuple[float, ...]
"""Weights and threshold of a half-space's boundary, scaled so that both sides of it are the same value."""


def with_drawn_thresholds(automaton: HybridAutomaton, rng: np.random.Generator) -> HybridAutomaton:
    """An automaton that the object may truly be: thresholds drawn around the model's, independently per boundary.

    The automaton itself, without a draw from `rng`, where all thresholds are certain.
    """
    stds = threshold_stds(automaton)
    return with_shifted_thresholds(automaton, stds * rng.standard_normal(stds.size)) if stds.size else automaton


def threshold_stds(automaton: HybridAutomaton) -> Floats:
    """(b,) std of each boundary that is not certain, in the unit of its scaled threshold, in the order of the edges."""
    return np.array(list(_boundary_stds(automaton).values()))


def with_shifted_thresholds(automaton: HybridAutomaton, by: Floats) -> HybridAutomaton:
    """The automaton with its uncertain boundaries moved by (b,) amounts, in the order of `threshold_stds`."""
    shifts = {boundary: float(shift) for boundary, shift in zip(_boundary_stds(automaton), by, strict=True)}
    guards = [_moved(edge.guard, shifts) for edge in automaton.edges]
    edges = tuple(
        edge if guard is edge.guard else replace(edge, guard=guard)
        for edge, guard in zip(automaton.edges, guards, strict=True)
    )
    modes = tuple(_moved_mode(automaton, mode, shifts) for mode in automaton.modes)
    return replace(automaton, modes=modes, edges=edges)


def _boundary_stds(automaton: HybridAutomaton) -> dict[_Boundary, float]:
    """Std of every uncertain boundary, in the unit of its scaled threshold, in the order of the edges."""
    stds: dict[_Boundary, float] = {}
    for edge in automaton.edges:
        for half_space in edge.guard.half_spaces if edge.threshold_std > 0 else ():
            if any(half_space.a):
                boundary, scale = _boundary(half_space)
                stds[boundary] = max(stds.get(boundary, 0.0), edge.threshold_std / abs(scale))
    return stds


@lru_cache(maxsize=1024)
def _boundary(half_space: HalfSpace) -> tuple[_Boundary, float]:
    """The boundary, and what its scaled threshold is to be multiplied by to give the half-space's."""
    scale = next((weight for weight in (*half_space.a, *half_space.b) if weight), 1.0)
    values = (*half_space.a, *half_space.b, half_space.c)
    return tuple(round(value / scale, _DIGITS) + 0.0 for value in values), scale


def _moved(region: Region, shifts: dict[_Boundary, float]) -> Region:
    """The region with its uncertain boundaries moved; itself if it has none."""
    rows = []
    for half_space in region.half_spaces:
        boundary, scale = _boundary(half_space)
        known = boundary not in shifts
        rows.append(half_space if known else replace(half_space, c=half_space.c + scale * shifts[boundary]))
    return region if all(map(operator.is_, rows, region.half_spaces)) else Region(tuple(rows))


def _moved_mode(automaton: HybridAutomaton, mode: Mode, shifts: dict[_Boundary, float]) -> Mode:
    """The mode with its boundaries moved, and its pins with the boundary at which it is entered."""
    carried = {}
    for edge in automaton.edges:
        if edge.target == mode.name:
            for pin in automaton.pins_located_by(edge):
                carried[pin.coordinate] = _shift_along(edge, pin.coordinate, shifts)
    region = _moved(mode.invariant, shifts)
    if not carried and region is mode.invariant:
        return mode
    pins = tuple(replace(pin, value=pin.value + carried.get(pin.coordinate, 0.0)) for pin in mode.pins)
    rows = []
    for before, after in zip(mode.invariant.half_spaces, region.half_spaces, strict=True):
        along = [i for i, weight in enumerate(before.a) if weight]
        # The range of a mode that is held at a boundary lies around it, though it does not end there.
        held = len(along) == 1 and after == before and not any(before.b)
        moved = replace(before, c=before.c + before.a[along[0]] * carried.get(along[0], 0.0)) if held else after
        rows.append(moved)
    return replace(mode, invariant=Region(tuple(rows)), pins=pins)


def _shift_along(edge: Edge, coordinate: int, shifts: dict[_Boundary, float]) -> float:
    """How far the boundary on a coordinate alone moves by which an edge enters its target."""
    for half_space in edge.guard.half_spaces:
        if [i for i, weight in enumerate(half_space.a) if weight] == [coordinate] and not any(half_space.b):
            return shifts.get(_boundary(half_space)[0], 0.0)
    return 0.0
