"""Many shares of beliefs pressed against modes that they left at this very instant. Twin of `belief.sliding`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.belief.batch.crossing import Pieces
from micah_plan.belief.gaussian import SMALLEST_STD
from micah_plan.belief.sliding import blocked_edges, free_normal

Floats = NDArray[np.float64]


def slid(automaton: HybridAutomaton, pieces: Pieces, u: Floats) -> Pieces:
    """The pieces, inputs u (p, m), with the ends of their steps on the boundaries that lead back."""
    mode = automaton.modes[pieces.mode]
    for edge in blocked_edges(automaton, mode.name) if pieces.events.any() else ():
        blocked = pieces.entered[:, automaton.mode_index(edge.target)] & (pieces.events > 0)
        if blocked.any():
            pieces = _slid_along(mode, pieces, edge, u, blocked)
    return pieces


def _slid_along(mode: Mode, pieces: Pieces, edge: Edge, u: Floats, blocked: NDArray[np.bool_]) -> Pieces:
    n, rows = pieces.n, edge.guard.half_spaces
    starts, ends = (np.stack([h.margin(pieces.mean[:, part], u) for h in rows]) for part in (slice(n), slice(n, None)))
    pressed = np.argmin(starts, axis=0)
    at_it = blocked & (np.abs(starts.min(axis=0)) <= SMALLEST_STD) & (ends.min(axis=0) >= 0.0)
    mean, factor, displacement = pieces.mean.copy(), pieces.factor.copy(), pieces.displacement.copy()
    for number, half_space in enumerate(rows):
        a = np.array(half_space.a)
        normal = free_normal(mode, a)
        chosen = np.flatnonzero(at_it & (pressed == number) & (ends[number] > SMALLEST_STD))
        if not chosen.size or not normal.any():
            continue
        back = normal / float(normal @ normal)
        mean[chosen, n:] -= back * ends[number, chosen, None]
        factor[chosen, n:] -= back[:, None] * (a @ factor[chosen, n:])[:, None, :]
        displacement[chosen] -= back * (displacement[chosen] @ a)[:, None]
    return replace(pieces, mean=mean, factor=factor, displacement=displacement)
