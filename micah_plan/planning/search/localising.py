"""Paths through roadmaps with detours for localisation, ranked by length and predicted uncertainty.

A detour costs steps, but may make a belief narrow enough for the goal. The cheapest path has none. So paths are also
routed through any one vertex of the roadmaps (a wall to touch, a lit place), then through a second one, and compared by
cost and remaining uncertainty. With v vertices a round takes two shortest-path trees and one filter over v beliefs; it
visits only combinations of modes on these paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import dijkstra

from micah_plan.arrays import Floats, Ints
from micah_plan.planning.search.mode_paths import VertexPath
from micah_plan.planning.search.path_beliefs import PathBeliefs
from micah_plan.planning.search.roadmap import JoinedRoadmap, vertices_along
from micah_plan.task.deadline import NEVER, Deadline, TimeLimitError

# Stops on a path, and how many of the best beginnings get one more.
_MOST_STOPS = 2
_BEAM = 2
# Only this many of the cheapest paths of a round are evaluated in full; most differ by a corner that is cut anyway.
_MOST_TRACED = 200
# Less than this share of a step is no reason for a detour [steps].
WORTH_A_DETOUR = 0.1


@dataclass(frozen=True, eq=False)
class ScoredPath:
    """A path through the roadmaps.

    Attributes:
        vertices: of the joined roadmap, from start to goal.
        stops: places in `vertices` (start and goal included) between which the path is as short as possible.
        length: its steps, transitions and the goal error left [steps].
        uncertainty: cost of the predicted uncertainty: guards to be entered deeply, final variance [steps].
    """

    vertices: tuple[int, ...]
    stops: tuple[int, ...]
    length: float
    uncertainty: float

    @property
    def cost(self) -> float:
        return self.length + self.uncertainty


@dataclass(frozen=True, eq=False)
class _Front:
    """Beliefs of a search front: variance (v, n), overshoot and steps so far (v,), and visits of each mode (v, q)."""

    variance: Floats
    overshoot: Floats
    steps: Floats
    visits: Ints

    def rows(self, rows: Ints) -> _Front:
        """Copies of some rows."""
        return _Front(self.variance[rows], self.overshoot[rows], self.steps[rows], self.visits[rows])


@dataclass(frozen=True, eq=False)
class _Beginning:
    """A path to its last stop, with its steps and the belief there (a front of one)."""

    vertices: tuple[int, ...]
    stops: tuple[int, ...]
    length: float
    belief: _Front


def best_paths(
    roadmap: JoinedRoadmap, beliefs: PathBeliefs, shortest: Sequence[VertexPath], revisits: int, deadline: Deadline
) -> list[ScoredPath]:
    """Shortest paths and localising detours, one for each sequence of transitions, cheapest first."""
    localising = LocalisingSearch(roadmap, beliefs, revisits, deadline)
    detours: list[ScoredPath] = []
    with suppress(TimeLimitError):
        detours = localising.paths()
    best: dict[tuple[int, ...], ScoredPath] = {}
    for path in [*map(localising.score, shortest), *detours]:
        taken = edges_of(path, beliefs)
        # A detour through the same modes must be worth it: rounding is no reason.
        if taken not in best or path.cost < best[taken].cost - WORTH_A_DETOUR:
            best[taken] = path
    return sorted(best.values(), key=lambda path: path.cost)


def edges_of(path: ScoredPath, beliefs: PathBeliefs) -> tuple[int, ...]:
    """The automaton's edges that a path takes."""
    mode, pairs = beliefs.mode_of, pairwise(path.vertices)
    return tuple(beliefs.edge_of[i, j] for i, j in pairs if mode[i] != mode[j])


class LocalisingSearch:
    """Searches one joined roadmap."""

    def __init__(self, roadmap: JoinedRoadmap, beliefs: PathBeliefs, revisits: int, deadline: Deadline = NEVER) -> None:
        self.roadmap, self.beliefs, self.deadline = roadmap, beliefs, deadline
        self.most_visits = 1 + revisits
        self.to_go, self.following = roadmap.to_goal
        self.size = len(self.to_go)

    def paths(self) -> list[ScoredPath]:
        """The best path through each vertex that leads to the goal, with up to two stops; the best first.

        Raises:
            TimeLimitError: if the deadline passes.
        """
        found: dict[tuple[int, ...], ScoredPath] = {}
        beam, best = [self._start()], np.inf
        for _ in range(_MOST_STOPS):
            scored = [item for beginning in beam for item in self._through_all(beginning)]
            scored.sort(key=lambda item: (item[0].cost, item[0].vertices))
            for path, _ in scored:
                found.setdefault(path.vertices, path)
            if not scored or scored[0][0].cost > best - WORTH_A_DETOUR:
                break
            best = scored[0][0].cost
            beam = [beginning for _, beginning in scored[:_BEAM]]
        return sorted(found.values(), key=lambda path: (path.cost, path.vertices))

    def score(self, path: VertexPath) -> ScoredPath:
        """A path of the mode search, scored with its predicted uncertainty."""
        offsets = [self.roadmap.offsets[mode] for mode in path.modes]
        vertices = [offset + v for offset, part in zip(offsets, path.vertices, strict=True) for v in part]
        front, owner = self._start().belief, np.array([0])
        for i, j in pairwise(vertices):
            self._advance(front, np.array([i]), np.array([j]), owner, owner)
        ending = self.beliefs.ending(front.variance, np.array(vertices[-1:]), self._spare_steps(front))
        uncertainty = float(front.overshoot[0] + ending[0])
        return ScoredPath(tuple(vertices), (0, len(vertices) - 1), path.cost, uncertainty)

    def _start(self) -> _Beginning:
        mode, vertex = self.roadmap.start
        start = self.roadmap.offsets[mode] + vertex
        visits = np.zeros((1, len(self.beliefs.index)), dtype=np.int64)
        visits[0, self.beliefs.index[mode]] = 1
        belief = _Front(self.beliefs.start(start)[None], np.zeros(1), np.zeros(1), visits)
        return _Beginning((start,), (0,), 0.0, belief)

    def _through_all(self, beginning: _Beginning) -> list[tuple[ScoredPath, _Beginning]]:
        """Shortest paths from a beginning through each vertex, both to the goal and as beginnings with a stop there."""
        here = beginning.vertices[-1]
        distance, previous = dijkstra(self.roadmap.graph, indices=here, return_predecessors=True)
        distance, previous = distance[: self.size], previous[: self.size]
        reached = np.flatnonzero(np.isfinite(distance) & np.isfinite(self.to_go))
        there = self._propagate(beginning.belief, here, previous)
        at, ends = self._propagate_to_goal(there.rows(reached), reached)
        spare = self._spare_steps(ends)
        allowed = (ends.visits.max(axis=1, initial=0) <= self.most_visits) & (spare >= 0)
        ending = self.beliefs.ending(ends.variance, at, spare)
        costs = np.where(allowed, distance[reached] + self.to_go[reached] + ends.overshoot + ending, np.inf)
        best = np.argsort(costs, kind="stable")[:_MOST_TRACED]
        results = []
        for row in best[np.isfinite(costs[best])]:
            vertex = int(reached[row])
            vertices = (*beginning.vertices, *vertices_along(previous, vertex, here)[-2::-1])
            stops = (*beginning.stops, len(vertices) - 1)
            length = beginning.length + float(distance[vertex])
            whole = (*vertices, *vertices_along(self.following, vertex, self.size)[1:-1])
            uncertainty = float(ends.overshoot[row] + ending[row])
            path = ScoredPath(whole, (*stops, len(whole) - 1), length + float(self.to_go[vertex]), uncertainty)
            results.append((path, _Beginning(vertices, stops, length, there.rows(reached[[row]]))))
        return results

    def _propagate(self, belief: _Front, here: int, previous: Ints) -> _Front:
        """A belief at a vertex propagated along its shortest-path tree to all reachable vertices."""
        front, level = belief.rows(np.zeros(self.size, dtype=np.int64)), np.array([here])
        while (level := np.flatnonzero(np.isin(previous, level))).size:
            self._check_time()
            self._advance(front, previous[level], level, previous[level], level)
        return front

    def _propagate_to_goal(self, front: _Front, at: Ints) -> tuple[Ints, _Front]:
        """Beliefs at vertices propagated to the goal: their final vertices (r,), and the beliefs."""
        at = at.copy()
        while (moving := np.flatnonzero(self.following[at] != self.size)).size:
            self._check_time()
            self._advance(front, at[moving], self.following[at[moving]], moving, moving)
            at[moving] = self.following[at[moving]]
        return at, front

    def _advance(self, front: _Front, origin: Ints, end: Ints, out_of: Ints, into: Ints) -> None:
        """Move beliefs from vertices to neighbours; rows `out_of` of the front become rows `into`."""
        before, mode = front.rows(out_of), self.beliefs.mode_of
        front.variance[into], overshoot, steps = self.beliefs.hop(before.variance, origin, end)
        front.overshoot[into] = before.overshoot + overshoot
        front.steps[into] = before.steps + steps
        before.visits[np.arange(len(end)), mode[end]] += mode[origin] != mode[end]
        front.visits[into] = before.visits

    def _spare_steps(self, front: _Front) -> Floats:
        """(v,) steps left of max_knots."""
        return np.asarray(self.beliefs.problem.settings.max_knots - front.visits.sum(axis=1) - np.ceil(front.steps))

    def _check_time(self) -> None:
        self.deadline.check("search", "detours that localise were not compared", "samples_per_mode")
