"""Where a held object would hit a body: convex sets of states, one per pair of a part and a body.

A part and a body overlap only if the boxes around them do, along every axis of the base frame. The box around the
moving part grows and shrinks as the joint turns; its sides are bounded from outside by affine functions of the joint
over the range that a mode allows. So a set is an intersection of at most six half-spaces on (hand, joint). It contains
all true collisions of the swinging part, and somewhat more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.contacts.touch import corners, moved
from micah_plan.automaton.contacts.values import AXES, Grip, Solid, Surroundings
from micah_plan.automaton.region import HalfSpace, Region

Floats = NDArray[np.float64]

_SAMPLES = 181


def collision_regions(
    grip: Grip, surroundings: Surroundings, datum: float, low: float, high: float, turns: bool
) -> list[Region]:
    """The collisions that a hand within the surroundings' limits can run into, with the joint between low and high."""
    rotation = Rotation.from_rotvec(grip.rotation)
    held = np.tile(_box(rotation, corners(grip.held.shapes), grip), (_SAMPLES, 1, 1))
    grid = np.linspace(low, high, _SAMPLES)
    swinging = np.array(
        [_box(rotation, moved(corners(grip.moving.shapes), c - datum, turns), grip) for c in grid]
    ).reshape(_SAMPLES, 2, 3)
    regions = []
    for solid in surroundings.solids:
        for part, boxes in ((grip.held.name, held), (grip.moving.name, swinging)):
            region = _overlap(solid, part, grid, boxes, surroundings)
            if region is not None:
                regions.append(region)
    return regions


def _box(rotation: Rotation, points: Floats, grip: Grip) -> Floats:
    """(2, 3) corners, relative to the hand, of the box along the base axes around points of the hinge frame."""
    placed = rotation.apply(points - np.array(grip.point))
    return np.stack([placed.min(axis=0), placed.max(axis=0)])


def _overlap(solid: Solid, part: str, grid: Floats, boxes: Floats, surroundings: Surroundings) -> Region | None:
    """States at which a part's boxes (s, 2, 3) over the joint's range (s,) overlap a solid; None if there are none."""
    rows = []
    for axis in range(3):
        least, most = surroundings.lower[axis], surroundings.upper[axis]
        offset, slope = _bound(grid, boxes[:, 1, axis])
        if most + float(np.max(boxes[:, 1, axis])) < solid.lower[axis]:
            return None
        if least + float(np.min(boxes[:, 1, axis])) < solid.lower[axis]:
            rows.append(
                _row(axis, 1.0, slope, solid.lower[axis] - offset, f"{part} at {solid.name}: from -{AXES[axis]}")
            )
        offset, slope = _bound(grid, -boxes[:, 0, axis])
        if least + float(np.min(boxes[:, 0, axis])) > solid.upper[axis]:
            return None
        if most + float(np.max(boxes[:, 0, axis])) > solid.upper[axis]:
            rows.append(
                _row(axis, -1.0, slope, -solid.upper[axis] - offset, f"{part} at {solid.name}: from +{AXES[axis]}")
            )
    return Region(tuple(rows)) if rows else None


def _bound(grid: Floats, values: Floats) -> tuple[float, float]:
    """Offset and slope of an affine function of the joint that is nowhere below the values (s,) on the grid (s,)."""
    width = float(grid[-1] - grid[0])
    slope = float(values[-1] - values[0]) / width if width > 0 else 0.0
    return float(np.max(values - slope * grid)), slope


def _row(axis: int, sign: float, slope: float, c: float, name: str) -> HalfSpace:
    a = [0.0, 0.0, 0.0, slope]
    a[axis] = sign
    return HalfSpace(tuple(a), (0.0, 0.0, 0.0), c, name=name)
