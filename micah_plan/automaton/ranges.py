"""What modes allow for one coordinate, from the half-spaces that bound it alone and from pins."""

from __future__ import annotations

import math
from collections.abc import Iterable

from micah_plan.automaton.hybrid import Mode
from micah_plan.automaton.region import HalfSpace, Region

Interval = tuple[float, float]


def single_bound(half_space: HalfSpace) -> tuple[int, float, bool] | None:
    """Coordinate, value and whether it is a lower bound, of a half-space on one coordinate alone; None for others."""
    indices = [i for i, weight in enumerate(half_space.a) if weight]
    if len(indices) != 1 or any(half_space.b):
        return None
    weight = half_space.a[indices[0]]
    return indices[0], half_space.c / weight, weight > 0


def region_interval(region: Region, index: int) -> Interval:
    """(low, high) that a region's half-spaces on one coordinate alone leave; infinite where there are none."""
    low, high = -math.inf, math.inf
    for half_space in region.half_spaces:
        bound = single_bound(half_space)
        if bound is not None and bound[0] == index:
            low, high = (max(low, bound[1]), high) if bound[2] else (low, min(high, bound[1]))
    return low, high


def mode_interval(mode: Mode, index: int) -> Interval:
    """(low, high) of one coordinate in a mode: its pin, or what the invariant leaves; low > high if that is nothing."""
    for pin in mode.pins:
        if pin.coordinate == index:
            return pin.value, pin.value
    return region_interval(mode.invariant, index)


def coordinate_ranges(index: int, modes: Iterable[Mode]) -> list[Interval]:
    """What modes allow for one coordinate, as intervals in increasing order; infinite where there is no limit.

    Only half-spaces on this coordinate alone count, and pins; others can narrow the true range further.
    """
    merged: list[Interval] = []
    for low, high in sorted(mode_interval(mode, index) for mode in modes):
        if low > high:
            continue
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return merged
