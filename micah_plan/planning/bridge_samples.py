"""Random states in narrow corridors, by the bridge test: free midpoints of bridges between two states that are not.

A state is not free in the guard of another transition or out of range. Uniform samples rarely fall into a corridor;
bridges across it have their middle there. Source: Hsu, Jiang, Reif and Sun, "The bridge test for sampling narrow
passages with probabilistic roadmap planners", ICRA 2003.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.region import Region
from micah_plan.planning.polytope import TOLERANCE, Polytope

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

# How many bridges are tried for each state that is wanted.
_TRIED = 200
# Lengths of bridges, as shares of the mode's width: from 10^-3 to its third.
_LENGTHS = (-3.0, -0.5)


def bridge_samples(states: Polytope, obstacles: Sequence[Region], rng: np.random.Generator, count: int) -> Floats:
    """(at most count, n) free midpoints of bridges between states that are not; none where nothing is in the way."""
    if not obstacles or count < 1 or not all(region.half_spaces for region in obstacles):
        return np.zeros((0, states.n))
    ends = states.sample(rng, _TRIED * count)
    ends = ends[in_any(obstacles, ends, 0.0)]
    length = 10.0 ** rng.uniform(*_LENGTHS, (len(ends), 1)) * (states.upper - states.lower)
    others = ends + length * rng.standard_normal(ends.shape)
    middles = 0.5 * (ends + others)
    blocked = in_any(obstacles, others, 0.0) | ~states.contains(others)
    free = states.contains(middles) & ~in_any(obstacles, middles, -TOLERANCE)
    return np.asarray(middles[blocked & free][:count])


def in_any(regions: Sequence[Region], points: Floats, least: float) -> Booleans:
    """(k,) whether points (k, n) lie inside of any region, by more than a margin."""
    inside = np.zeros(len(points), dtype=bool)
    for region in regions:
        u = np.zeros((len(points), len(region.half_spaces[0].b)))
        inside |= (region.margins(points, u) > least).all(axis=1)
    return inside
