"""A share of the belief that is pressed against a mode which it left at this very instant slides along the boundary.

Where one input moves a coordinate forth in a mode and back in the next, the step that enters the next mode would lead
straight back. No mode is entered twice at one instant (`automaton.transition`), so the boundary is a wall: the end of
the step is put on it, and nothing is left of the spread across.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scalar_belief.scalar_crossing import Piece
from scalar_belief.scalar_gaussian import SMALLEST_STD

from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode

Floats = NDArray[np.float64]


def slid(automaton: HybridAutomaton, piece: Piece, u: Floats) -> Piece:
    """The piece with the end of its step on the boundaries that lead back to modes entered at this instant."""
    for edge in blocked_edges(automaton, piece.mode):
        if edge.target in piece.entered:
            piece = _slid_along(automaton.mode(piece.mode), piece, edge, u)
    return piece


def blocked_edges(automaton: HybridAutomaton, mode: str) -> list[Edge]:
    """The transitions out of a mode, with guards on the state, that may be blocked after it was entered."""
    edges = automaton.edges_from(mode)
    return [edge for edge in edges if not edge.is_self_transition and edge.guard.on_state]


def free_normal(mode: Mode, a: Floats) -> Floats:
    """(n,) the part of a boundary's normal along which the mode can give way; zeros where it holds the coordinate."""
    return np.asarray(np.where(mode.free, a, 0.0))


def _slid_along(mode: Mode, piece: Piece, edge: Edge, u: Floats) -> Piece:
    n, rows = piece.n, edge.guard.half_spaces
    starts, ends = ([h.margin(piece.mean[part], u) for h in rows] for part in (slice(n), slice(n, None)))
    pressed = int(np.argmin(starts))
    a = np.array(rows[pressed].a)
    normal = free_normal(mode, a)
    at_it = abs(starts[pressed]) <= SMALLEST_STD and ends[pressed] > SMALLEST_STD
    if not at_it or min(ends) < 0.0 or not normal.any():
        return piece
    back = normal / float(normal @ normal)
    mean, factor = piece.mean.copy(), piece.factor.copy()
    mean[n:] -= back * ends[pressed]
    factor[n:] -= np.outer(back, a @ factor[n:])
    return replace(piece, mean=mean, factor=factor, displacement=piece.displacement - back * (a @ piece.displacement))
