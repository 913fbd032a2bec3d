"""Collisions of a held object with bodies, as overlaps of bounding boxes along every axis.

The box around the moving part grows and shrinks as the joint turns; its sides are bounded from outside by affine
functions of the joint over the range that a mode allows. So a set of collisions is an intersection of at most six
half-spaces on (hand, joint). It contains all true collisions of the swinging part, and somewhat more.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.touch import box_corners, moved
from micah_plan.automaton.contacts.values import AXES, Grip, Solid, Surroundings
from micah_plan.automaton.region import HalfSpace, Region

_COLLISION_SAMPLES = 181


def collision_regions(
    grip: Grip, surroundings: Surroundings, datum: float, low: float, high: float, turns: bool
) -> list[Region]:
    """The collisions that a hand within the surroundings' limits can run into, with the joint between low and high.

    Args:
        datum, turns: as in `touch_pieces`.
    """
    rotation = Rotation.from_rotvec(grip.rotation)
    grid = np.linspace(low, high, _COLLISION_SAMPLES)

    def box(points: Floats) -> Floats:
        """(2, 3) corners, relative to the hand, of the box along the base axes around points of the hinge frame."""
        placed = rotation.apply(points - np.array(grip.point))
        return np.stack([placed.min(axis=0), placed.max(axis=0)])

    held = np.tile(box(box_corners(grip.held.shapes)), (grid.size, 1, 1))
    swinging = np.array([box(moved(box_corners(grip.moving.shapes), c - datum, turns)) for c in grid])
    regions = [
        _overlap(solid, part, grid, boxes, surroundings)
        for solid in surroundings.solids
        for part, boxes in ((grip.held.name, held), (grip.moving.name, swinging))
    ]
    return [region for region in regions if region is not None]


def _overlap(solid: Solid, part: str, grid: Floats, boxes: Floats, surroundings: Surroundings) -> Region | None:
    """States at which a part's boxes (s, 2, 3) over the joint's range (s,) overlap a solid; None if there are none."""
    rows = []
    for axis, sign in product(range(3), (1, -1)):
        # Seen along this direction: the part's front, the side of the solid that it meets, and the hand's range.
        front = sign * boxes[:, int(sign > 0), axis]
        near = sign * (solid.lower if sign > 0 else solid.upper)[axis]
        least, most = sorted((sign * surroundings.lower[axis], sign * surroundings.upper[axis]))
        if most + float(np.max(front)) < near:
            return None
        if least + float(np.min(front)) < near:
            offset, slope = _affine_upper_bound(grid, front)
            a = [0.0, 0.0, 0.0, slope]
            a[axis] = float(sign)
            name = f"{part} at {solid.name}: from {'-' if sign > 0 else '+'}{AXES[axis]}"
            rows.append(HalfSpace(tuple(a), (0.0, 0.0, 0.0), near - offset, name=name))
    return Region(tuple(rows)) if rows else None


def _affine_upper_bound(grid: Floats, values: Floats) -> tuple[float, float]:
    """(offset, slope) of an affine upper bound of the values (s,) on the grid (s,)."""
    width = float(grid[-1] - grid[0])
    slope = float(values[-1] - values[0]) / width if width > 0 else 0.0
    return float(np.max(values - slope * grid)), slope
