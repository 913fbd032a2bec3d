"""Zero-time transitions for search and transcription: sequences within one instant, and parts behind earlier edges.

If several guards hold at one instant, the first listed transition happens. So a later one is taken only outside those
before it: if the hand opens high above the support, the object drops; if it opens just above, the object stands. Its
guard minus the earlier ones is not a half-space but a union: each part has the complement of one row of every earlier
guard that overlaps it.

A transition may lead to a state in which the next one happens at once: an almost shut stapler that touches the table is
already past the place where its contact spreads to a surface. There is no motion in between, so the mode in between has
no states for a roadmap and no knots for a transcription. A sequence is one edge from the first mode to the last: its
guard is the first guard intersected with the later ones pulled back through the resets, its reset is the composition of
all. Roll-outs and executions do not use sequences: they take each transition as it comes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np
from scipy.optimize import linprog

from micah_plan.arrays import EQUAL, Floats
from micah_plan.automaton.check import preceding
from micah_plan.automaton.feasibility import is_empty
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Reset
from micah_plan.automaton.memo import memoised, sharing_motion
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.task.problem import Problem
from micah_plan.task.start import is_final

# A transition that others divide into more parts is planned as if they were not there; roll-outs decide.
_MOST_PARTS = 12
_WHOLE, _IN_PARTS = "", "in parts"
# Transitions in one instant; a sequence of more is left to roll-outs.
_LONGEST = 4


@dataclass(frozen=True)
class PlannedEdge(Edge):
    """A transition with further half-spaces in its guard.

    Attributes:
        entered: number of half-spaces of the guard that belong to the transition itself: a motion crosses these.
        stds: of the threshold of each half-space of the guard, in its unit; `threshold_std` is 0.
    """

    entered: int = 0
    stds: tuple[float, ...] = ()


@dataclass(frozen=True)
class ZeroTimeEdge(PlannedEdge):
    """Consecutive transitions at one instant.

    Attributes:
        through: the modes between.
    """

    through: tuple[str, ...] = ()


def with_zero_time_transitions(problem: Problem, in_parts: bool = False) -> Problem:
    """The problem with the edges its model can take, and the zero-time sequences they allow.

    Args:
        in_parts: whether transitions are divided where others listed before them happen first. Few problems need it: a
            plan seldom leads to where two guards hold, and every part is one more branch of the search.
    """
    automaton = _with_zero_time_edges(
        problem.automaton, "\0".join((_IN_PARTS if in_parts else _WHOLE, *problem.goal.modes))
    )
    return problem if automaton is problem.automaton else replace(problem, automaton=automaton)


def front_of(edge: Edge) -> tuple[HalfSpace, ...]:
    """The half-spaces of a guard through which motions enter it."""
    return edge.guard.half_spaces[: edge.entered] if isinstance(edge, PlannedEdge) else edge.guard.half_spaces


def stds_of(edge: Edge) -> tuple[float, ...]:
    """Std of the threshold of each half-space of a guard, in its unit."""
    return edge.stds if isinstance(edge, PlannedEdge) else (edge.threshold_std,) * len(edge.guard.half_spaces)


@memoised
def _with_zero_time_edges(automaton: HybridAutomaton, asked: str) -> HybridAutomaton:
    """Args: the automaton, and joined by null bytes whether its edges are divided and the goal's modes."""
    divided, *goal_modes = asked.split("\0")
    if any(isinstance(edge, PlannedEdge) for edge in automaton.edges):
        return automaton
    covered = [preceding(automaton, i) is not None for i in range(len(automaton.edges))]
    parts = [_parts(automaton, i) if divided == _IN_PARTS else [edge] for i, edge in enumerate(automaton.edges)]
    taken = tuple(part for of_part, never in zip(parts, covered, strict=True) if not never for part in of_part)
    if taken != automaton.edges:
        automaton = sharing_motion(replace(automaton, edges=taken), automaton)
    after = {mode.name: _continuing_edges(automaton, mode.name, goal_modes) for mode in automaton.modes}
    edges: list[ZeroTimeEdge] = []
    begun: list[Edge] = [edge for edge in automaton.edges if not edge.is_self_transition and after[edge.target]]
    for _ in range(_LONGEST - 1):
        begun = [sequence for edge in begun for sequence in _extended_sequences(automaton, edge, after[edge.target])]
        edges += [sequence for sequence in begun if isinstance(sequence, ZeroTimeEdge)]
    if not edges:
        return automaton
    return sharing_motion(replace(automaton, edges=(*automaton.edges, *edges)), automaton)


def _parts(automaton: HybridAutomaton, number: int) -> list[Edge]:
    """The parts of a transition's guard outside the guards listed before it; the edge itself if there are none."""
    edge = automaton.edges[number]
    mode, guard = automaton.mode(edge.source), edge.guard
    if edge.is_self_transition or not guard.half_spaces:
        return [edge]
    within = [h for h in mode.invariant.half_spaces if not any(h.excludes(g) for g in guard.half_spaces)]
    within += mode.inputs.half_spaces
    rows = [tuple(zip(guard.half_spaces, stds_of(edge), strict=True))]
    for earlier in takewhile(lambda listed: listed is not edge, automaton.edges_from(edge.source)):
        if earlier.is_self_transition or earlier.guard.on_input != guard.on_input:
            continue
        cut = []
        for part in rows:
            held = (*within, *(h for h, _ in part))
            if not _overlap(held, earlier.guard.half_spaces):
                cut.append(part)
                continue
            ways = [h.opposite for h in earlier.guard.half_spaces]
            cut += [(*part, (h, earlier.threshold_std)) for h in ways if _overlap(held, (h,))]
        rows = cut
    if rows == [tuple(zip(guard.half_spaces, stds_of(edge), strict=True))] or len(rows) > _MOST_PARTS:
        return [edge]
    front = len(guard.half_spaces)
    return [
        PlannedEdge(
            edge.source,
            edge.target,
            Region(tuple(h for h, _ in part)),
            edge.reset,
            entered=front,
            stds=tuple(std for _, std in part),
        )
        for part in rows
    ]


def _overlap(first: Sequence[HalfSpace], second: Sequence[HalfSpace]) -> bool:
    """Whether two sets share more than a boundary."""
    return not is_empty(Region(tuple(replace(h, strict=True) for h in (*first, *second))))


def _continuing_edges(automaton: HybridAutomaton, name: str, goal_modes: list[str]) -> list[Edge]:
    """Edges from a mode that can continue a zero-time sequence: on the state alone, and not into a final mode."""
    ends = {mode.name for mode in automaton.modes if is_final(automaton, mode)}
    return [
        edge
        for edge in automaton.edges_from(name)
        if edge.target not in ends - set(goal_modes)
        and not edge.is_self_transition
        and edge.guard.on_state
        and not edge.guard.on_input
    ]


def _extended_sequences(automaton: HybridAutomaton, first: Edge, following: list[Edge]) -> list[ZeroTimeEdge]:
    """Sequences of an edge, which may be a sequence itself, with each edge that can follow it."""
    following = [edge for edge in following if edge.target not in (first.source, *_modes_passed(first))]
    if not following:
        return []
    A, B, c = _reset_of_edge(automaton, first)
    low, high = _box_image(*_box(automaton, first), A, c)
    sequences = []
    for edge in following:
        a = np.array([h.a for h in edge.guard.half_spaces])
        least = np.array([h.c for h in edge.guard.half_spaces]) + EQUAL * np.linalg.norm(a, axis=1)
        with np.errstate(invalid="ignore"):
            most = np.where(a > 0, a * high, np.where(a < 0, a * low, 0.0)).sum(axis=1)
        if B.any() or not (most > least).all():
            continue
        if _is_possible(automaton, first, a @ A, least - a @ c):
            sequences.append(_joined(automaton, first, edge, (A, c)))
    return sequences


def _joined(automaton: HybridAutomaton, first: Edge, second: Edge, arrival: tuple[Floats, Floats]) -> ZeroTimeEdge:
    """Two consecutive transitions as one; the first maps to A x + c."""
    (A, c), rows, stds = arrival, list(first.guard.half_spaces), list(stds_of(first))
    for h in second.guard.half_spaces:
        a = np.array(h.a) @ A
        if np.abs(a).max() > EQUAL * np.linalg.norm(h.a):  # otherwise it holds wherever the first leads
            rows.append(replace(h, a=tuple(a.tolist()), c=h.c - float(np.array(h.a) @ c)))
            stds.append(second.threshold_std)
    reset = None
    if not (np.array_equal(A, np.eye(automaton.n)) and not c.any() and second.reset.is_identity):
        last, _, offset = second.reset.matrices(automaton.n, automaton.m)
        reset = Reset(A=tuple(map(tuple, (last @ A).tolist())), c=tuple((last @ c + offset).tolist()))
    return ZeroTimeEdge(
        first.source,
        second.target,
        Region(tuple(rows)),
        reset or Reset(),
        entered=len(front_of(first)),
        stds=tuple(stds),
        through=(*_modes_passed(first), first.target),
    )


def _modes_passed(edge: Edge) -> tuple[str, ...]:
    return edge.through if isinstance(edge, ZeroTimeEdge) else ()


def _reset_of_edge(automaton: HybridAutomaton, edge: Edge) -> tuple[Floats, Floats, Floats]:
    """A, B and c of the state A x + B u + c after an edge, with the target's pins and ties."""
    A, B, c = edge.reset.matrices(automaton.n, automaton.m)
    target: Mode = automaton.mode(edge.target)
    for pin in target.pins:
        A[pin.coordinate], B[pin.coordinate], c[pin.coordinate] = 0.0, 0.0, pin.value
    for tie in target.ties:
        weights, i = np.array(tie.weights), tie.coordinate
        A[i], B[i], c[i] = weights @ A, weights @ B, tie.offset + weights @ c
    return A, B, c


def _box(automaton: HybridAutomaton, edge: Edge) -> tuple[Floats, Floats]:
    """(n,) least and greatest values of the source's states at the guard, by bounds on single coordinates."""
    source = automaton.mode(edge.source)
    low, high = np.array([source.interval(i) for i in range(automaton.n)]).T
    for h in edge.guard.half_spaces:
        if h.bound is not None:
            i, value, is_lower = h.bound
            low[i], high[i] = (max(low[i], value), high[i]) if is_lower else (low[i], min(high[i], value))
    front = front_of(edge)
    if len(front) == 1 and (bound := front[0].bound) is not None and source.driven[bound.coordinate]:
        low[bound.coordinate] = high[bound.coordinate] = bound.value
    return low, high


def _box_image(low: Floats, high: Floats, A: Floats, c: Floats) -> tuple[Floats, Floats]:
    """The box around the image of a box under A x + c."""
    with np.errstate(invalid="ignore"):
        ends = np.where(A > 0, A * high, np.where(A < 0, A * low, 0.0)), np.where(A < 0, A * high, A * low)
    return np.where(A == 0, 0.0, ends[1]).sum(axis=1) + c, ends[0].sum(axis=1) + c


def _is_possible(automaton: HybridAutomaton, first: Edge, rows: Floats, least: Floats) -> bool:
    """Whether rows @ x >= least is feasible after the first guard."""
    source = automaton.mode(first.source)
    inside = [h for h in (*source.invariant.half_spaces, *first.guard.half_spaces) if not h.on_input]
    A = np.vstack([rows, *(h.a for h in inside)])
    b = np.append(least, [h.c for h in inside])
    bounds: list[tuple[float | None, float | None]] = [(None, None)] * automaton.n
    for pin in source.pins:
        bounds[pin.coordinate] = (pin.value, pin.value)
    fixed = [(np.eye(automaton.n)[tie.coordinate] - np.array(tie.weights), tie.offset) for tie in source.ties]
    crossed = [
        h for h in front_of(first) if not h.on_input and np.any(np.array(h.a) @ (source.B * source.free[:, None]))
    ]
    for h in crossed if crossed and not first.guard.on_input else [None]:
        equal = fixed if h is None else [*fixed, (np.array(h.a), h.c)]
        E, e = (np.array([row for row, _ in equal]), np.array([v for _, v in equal])) if equal else (None, None)
        if linprog(np.zeros(automaton.n), A_ub=-A, b_ub=-b, A_eq=E, b_eq=e, bounds=bounds).status == 0:
            return True
    return False
