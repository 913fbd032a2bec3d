"""Whether anything satisfies all of some half-spaces."""

from __future__ import annotations

import math

import numpy as np

from micah_plan.automaton.region import Region

_ROOM = 1e-9


def is_empty(region: Region) -> bool:
    """Whether no (x, u) is in an intersection of half-spaces; strict ones need room inside their boundary."""
    rows = region.half_spaces
    if not rows:
        return False
    if all(sum(map(bool, (*h.a, *h.b))) <= 1 for h in rows):
        return _is_empty_box(region)
    # Only sets that couple variables need a linear programme; the import takes longer than all other checks.
    from scipy.optimize import linprog

    weights = np.array([[*h.a, *h.b] for h in rows])
    slack = np.array([[1.0 if h.strict else 0.0] for h in rows])
    bounds = [(None, None)] * weights.shape[1] + [(0.0, 1.0)]
    objective = np.append(np.zeros(weights.shape[1]), -1.0)
    found = linprog(objective, np.hstack([-weights, slack]), [-h.c for h in rows], bounds=bounds, method="highs")
    strict = any(h.strict for h in rows)
    return bool(found.status == 2 or (strict and found.status == 0 and found.x[-1] <= _ROOM))


def _is_empty_box(region: Region) -> bool:
    """`is_empty` for half-spaces of one variable each: its largest lower bound against its smallest upper bound."""
    tightest: dict[tuple[int, bool], tuple[float, bool]] = {}
    for h in region.half_spaces:
        index, weight = next(((i, w) for i, w in enumerate((*h.a, *h.b)) if w), (0, 0.0))
        if not weight and (h.c > 0 or (h.strict and h.c == 0)):
            return True
        if weight:
            key = index, weight > 0
            tightest[key] = max(tightest.get(key, (-math.inf, False)), (h.c / abs(weight), h.strict))
    # A lower bound and, with its sign changed, an upper one leave nothing where their sum is above 0.
    both = [(low, tightest[i, False]) for (i, is_lower), low in tightest.items() if is_lower and (i, False) in tightest]
    return any(low + high > 0 or (low + high == 0 and (a or b)) for (low, a), (high, b) in both)
