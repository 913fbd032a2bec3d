"""Transitions that reverse the motion of an input, which a plan must cross in one known step.

Where an input moves a coordinate forwards in one mode and backwards in the next, one more step with the same input goes
the wrong way, so a plan must fix the step at which the mode changes. If the coordinate is the one across the boundary,
no input pushes the state deep into the guard either. The part of that step behind the boundary is then determined by
the next mode: the motion is mirrored, at the speed of the next mode, or, where a guard leads straight back or the next
mode does not move the coordinate, it ends at the boundary, which so is known exactly (`transition`, chattering).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.region import HalfSpace


@dataclass(frozen=True, eq=False)
class InputReversal:
    """A boundary to cross in one step, with the map of states behind it.

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


def input_reversal_of(automaton: HybridAutomaton, edge: Edge) -> InputReversal | None:
    """The reversal at an edge; None where motion continues alike, the state is pinned, or a reset acts."""
    crossed = None if edge.is_self_transition or not edge.reset.is_identity else _entered_row(automaton, edge)
    if crossed is None:
        return None
    a = np.array(crossed.a)
    before, after = automaton.mode(edge.source).B, automaton.mode(edge.target).B
    forth, onward = a @ before, float((a @ before) @ (a @ after))
    if onward > 0.0 and not np.any(np.sum(before * after, axis=1) < 0.0):
        return None
    mirrored = -1.0  # share of the motion behind the boundary by which the next mode leads back; -1: it leads on
    if onward <= 0.0:
        mirrored = 0.0 if _leads_back(automaton, edge, crossed) else -onward / float(forth @ forth)
    across = (1.0 + mirrored) * a / float(a @ a)
    sides = tuple(h for h in edge.guard.half_spaces if h is not crossed and not h.on_input)
    A = np.eye(automaton.n) - np.outer(across, a)
    return InputReversal(crossed, sides, A, across * crossed.c, across * edge.threshold_std)


def matrix_after(automaton: HybridAutomaton, edge: Edge) -> Floats:
    """(n, n) how a deviation before an edge continues behind it: through its reversal or its reset."""
    reversal = input_reversal_of(automaton, edge)
    return edge.reset.matrices(automaton.n, automaton.m)[0] if reversal is None else reversal.A


def _entered_row(automaton: HybridAutomaton, edge: Edge) -> HalfSpace | None:
    """The row of a guard through which motion enters it, if the target does not pin it."""
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    for half_space in edge.guard.half_spaces:
        a = np.array(half_space.a)
        if half_space.on_input or not np.any(a @ source.B) or a[~target.free].any():
            continue
        ends = any(h.excludes(half_space) for h in source.invariant.half_spaces)
        if len(edge.guard.half_spaces) == 1 or ends or _leads_back(automaton, edge, half_space):
            return half_space
    return None


def _leads_back(automaton: HybridAutomaton, edge: Edge, half_space: HalfSpace) -> bool:
    """Whether a transition leads back from the other side of a boundary."""
    others = [e for e in automaton.edges if (e.source, e.target) == (edge.target, edge.source)]
    rows = [h for other_edge in others for h in other_edge.guard.half_spaces]
    return any(h.excludes(half_space) for h in rows)
