"""Transitions behind which an input moves the state another way than before, so that one step must surely lead across.

Where one input moves a coordinate forth in a mode and back in the next, a plan must know at which step the mode
changes: a step more with the same input goes the wrong way. If it is the coordinate across the boundary, nothing can
even be pushed deep into the guard. What a step leads behind it is turned within that step: mirrored, as fast as the
next mode moves, or, where a guard leads back or the next mode does not move it, held at the boundary, which then is
known exactly (`automaton.transition`, chattering).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.region import HalfSpace

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Turn:
    """A boundary to cross in one step, and what becomes of the state that the step led behind it.

    Attributes:
        half_space: the row of the guard that is crossed.
        sides: its other rows, which bound the face.
        A, c: (n, n) and (n,); the state behind it becomes A x + c.
        spread: (n,) how far that moves with one std of the boundary's place [rad or m].
    """

    half_space: HalfSpace
    sides: tuple[HalfSpace, ...]
    A: Floats
    c: Floats
    spread: Floats


def turn_of(automaton: HybridAutomaton, edge: Edge) -> Turn | None:
    """The turn at an edge; None where the next mode moves on as before, holds the state, or a reset leads elsewhere."""
    crossed = None if edge.is_self_transition or not edge.reset.is_identity else _way_out(automaton, edge)
    if crossed is None:
        return None
    a = np.array(crossed.a)
    before, after = automaton.mode(edge.source).B, automaton.mode(edge.target).B
    forth, onward = a @ before, float((a @ before) @ (a @ after))
    if onward > 0.0 and not np.any(np.sum(before * after, axis=1) < 0.0):
        return None
    share = -1.0  # of the way behind the boundary, by which the next mode leads back; -1: it is gone
    if onward <= 0.0:
        share = 0.0 if _returns(automaton, edge, crossed) else -onward / float(forth @ forth)
    across = (1.0 + share) * a / float(a @ a)
    sides = tuple(h for h in edge.guard.half_spaces if h is not crossed and not h.on_input)
    A = np.eye(automaton.n) - np.outer(across, a)
    return Turn(crossed, sides, A, across * crossed.c, across * edge.threshold_std)


def matrix_after(automaton: HybridAutomaton, edge: Edge) -> Floats:
    """(n, n) how a deviation before an edge continues behind it: through its turn or its reset."""
    turn = turn_of(automaton, edge)
    return edge.reset.matrices(automaton.n, automaton.m)[0] if turn is None else turn.A


def _way_out(automaton: HybridAutomaton, edge: Edge) -> HalfSpace | None:
    """The row of a guard by which it is entered, if the source can move across it and the target does not hold it."""
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    for half_space in edge.guard.half_spaces:
        a = np.array(half_space.a)
        if half_space.on_input or not np.any(a @ source.B) or a[~target.free].any():
            continue
        ends = any(h.faces(half_space) and h.leaves_out(half_space) for h in source.invariant.half_spaces)
        if len(edge.guard.half_spaces) == 1 or ends or _returns(automaton, edge, half_space):
            return half_space
    return None


def _returns(automaton: HybridAutomaton, edge: Edge, half_space: HalfSpace) -> bool:
    """Whether a transition leads back through the same boundary."""
    others = [e for e in automaton.edges if (e.source, e.target) == (edge.target, edge.source)]
    rows = [h for other in others for h in other.guard.half_spaces]
    return any(h.meets(half_space) for h in rows)
