"""Feasibility of systems of half-spaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import ROUND_OFF
from micah_plan.automaton.region import Region


def is_empty(*regions: Region) -> bool:
    """Whether no (x, u) is in an intersection of regions; strict half-spaces need room inside their boundary."""
    if all(region.tightest is not None for region in regions):
        return _is_empty_box(regions)
    # Only sets that couple variables need a linear programme; the import takes longer than all other checks.
    from scipy.optimize import linprog

    rows = [half_space for region in regions for half_space in region.half_spaces]
    weights = np.array([[*h.a, *h.b] for h in rows])
    slack = np.array([[1.0 if h.strict else 0.0] for h in rows])
    bounds = [(None, None)] * weights.shape[1] + [(0.0, 1.0)]
    objective = np.append(np.zeros(weights.shape[1]), -1.0)
    solution = linprog(objective, np.hstack([-weights, slack]), [-h.c for h in rows], bounds=bounds, method="highs")
    strict = any(h.strict for h in rows)
    return bool(solution.status == 2 or (strict and solution.status == 0 and solution.x[-1] <= ROUND_OFF))


def _is_empty_box(regions: Sequence[Region]) -> bool:
    """`is_empty` for half-spaces of one variable each: largest lower against smallest upper bound."""
    tightest: dict[tuple[int, bool], tuple[float, bool]] = {}
    for region in regions:
        for key, limit in (region.tightest or {}).items():
            tightest[key] = max(tightest.get(key, limit), limit)
    # A lower bound and, with its sign changed, an upper one leave no room where their sum is above 0.
    both = [(low, tightest[i, False]) for (i, is_lower), low in tightest.items() if is_lower and (i, False) in tightest]
    return any(low + high > 0 or (low + high == 0 and (a or b)) for (low, a), (high, b) in both)
