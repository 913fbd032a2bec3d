"""Paths that localise: a detour costs steps, but may leave a belief narrow enough for the goal.

The cheapest path passes by nothing that it does not have to. So paths are also laid through a vertex on the way, any
one of the roadmaps' (a wall to touch, a place in the light), then through a second one, and compared by what they cost
together with the uncertainty that they leave. With v vertices a round is two shortest-path trees and one filter over v
beliefs; it visits no combination of modes that its paths do not lead through.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import dijkstra

from micah_plan.arrays import Floats, Ints
from micah_plan.planning.search.mode_paths import VertexPath
from micah_plan.planning.search.path_beliefs import PathBeliefs
from micah_plan.planning.search.roadmap import JoinedRoadmap
from micah_plan.task.deadline import NEVER, Deadline

# Stops on the way, and how many of the best beginnings get one more.
_MOST_STOPS = 2
_BEAM = 2
# Only so many of the cheapest paths of a round are looked at in full; most differ by a corner that is cut anyway.
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
        uncertainty: what the predicted uncertainty costs: guards to be entered deeply, final variance [steps].
    """

    vertices: tuple[int, ...]
    stops: tuple[int, ...]
    length: float
    uncertainty: float

    @property
    def cost(self) -> float:
        return self.length + self.uncertainty


@dataclass(frozen=True, eq=False)
class _Beginning:
    """A path from the start to its last stop: cost, steps and overshoot so far [steps], variance (n,), visits (q,)."""

    vertices: tuple[int, ...]
    stops: tuple[int, ...]
    length: float
    overshoot: float
    steps: float
    variance: Floats
    visits: Ints


@dataclass(frozen=True, eq=False)
class _Front:
    """Beliefs on their way (v, ...): variance, overshoot and steps so far, visits of each mode."""

    variance: Floats
    overshoot: Floats
    steps: Floats
    visits: Ints


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
        first = self._first()
        found: dict[tuple[int, ...], ScoredPath] = {}
        beam, best = [first], np.inf
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
        """A path of the mode search with its predicted uncertainty."""
        offsets = [self.roadmap.offsets[mode] for mode in path.modes]
        vertices = [offset + v for offset, part in zip(offsets, path.vertices, strict=True) for v in part]
        first = self._first()
        variance, overshoot, steps = first.variance[None], 0.0, 0.0
        for i, j in pairwise(vertices):
            variance, extra, taken = self.beliefs.hop(variance, np.array([i]), np.array([j]))
            overshoot, steps = overshoot + float(extra[0]), steps + float(taken[0])
        spare = self._spare(np.array([steps]), np.array([len(path.modes)]))
        left = self.beliefs.ending(variance, np.array(vertices[-1:]), spare)
        uncertainty = overshoot + float(left[0])
        return ScoredPath(tuple(vertices), (0, len(vertices) - 1), path.cost, uncertainty)

    def _first(self) -> _Beginning:
        mode, vertex = self.roadmap.start
        start = self.roadmap.offsets[mode] + vertex
        visits = np.zeros(len(self.beliefs.index), dtype=np.int64)
        visits[self.beliefs.index[mode]] = 1
        return _Beginning((start,), (0,), 0.0, 0.0, 0.0, self.beliefs.start(start), visits)

    def _through_all(self, beginning: _Beginning) -> list[tuple[ScoredPath, _Beginning]]:
        """The beginning, on to every vertex by the shortest way, and from there to the goal by the shortest way."""
        here = beginning.vertices[-1]
        distance, previous = dijkstra(self.roadmap.graph, indices=here, return_predecessors=True)
        distance, previous = distance[: self.size], previous[: self.size]
        reached = np.flatnonzero(np.isfinite(distance) & np.isfinite(self.to_go))
        there = self._spread(beginning, here, previous, np.flatnonzero(np.isfinite(distance)))
        at, ends = self._onward(there, reached)
        spare = self._spare(ends.steps, ends.visits.sum(axis=1))
        allowed = (ends.visits.max(axis=1, initial=0) <= self.most_visits) & (spare >= 0)
        left = self.beliefs.ending(ends.variance, at, spare)
        costs = np.where(allowed, distance[reached] + self.to_go[reached] + ends.overshoot + left, np.inf)
        best = np.argsort(costs, kind="stable")[:_MOST_TRACED]
        results = []
        for row in best[np.isfinite(costs[best])]:
            vertex = int(reached[row])
            to_stop = _traced(previous, here, vertex)
            vertices = (*beginning.vertices, *to_stop[1:])
            stops = (*beginning.stops, len(vertices) - 1)
            length = beginning.length + float(distance[vertex])
            onward = self._to_goal(vertex)
            whole = (*vertices, *onward[1:])
            uncertainty = float(ends.overshoot[row] + left[row])
            path = ScoredPath(whole, (*stops, len(whole) - 1), length + float(self.to_go[vertex]), uncertainty)
            state = (there.overshoot[vertex], there.steps[vertex], there.variance[vertex], there.visits[vertex])
            results.append((path, _Beginning(vertices, stops, length, *state)))
        return results

    def _spread(self, beginning: _Beginning, here: int, previous: Ints, reached: Ints) -> _Front:
        """The belief of a beginning carried along a shortest-path tree to all vertices that it reaches."""
        front = _Front(
            np.tile(beginning.variance, (self.size, 1)),
            np.full(self.size, beginning.overshoot),
            np.full(self.size, beginning.steps),
            np.tile(beginning.visits, (self.size, 1)),
        )
        depth = {here: 0}
        for vertex in reached:
            chain = [int(vertex)]
            while chain[-1] not in depth:
                chain.append(int(previous[chain[-1]]))
            for v in reversed(chain[:-1]):
                depth[v] = depth[int(previous[v])] + 1
        levels: dict[int, list[int]] = {}
        for vertex, level in depth.items():
            levels.setdefault(level, []).append(vertex)
        for level in range(1, len(levels)):
            self._advance(front, previous[levels[level]], np.array(levels[level]), into=np.array(levels[level]))
        return front

    def _onward(self, there: _Front, reached: Ints) -> tuple[Ints, _Front]:
        """Each of the beliefs at these vertices carried on to the goal: where they end (r,), and they themselves."""
        front = _Front(there.variance[reached], there.overshoot[reached], there.steps[reached], there.visits[reached])
        at = reached.copy()
        while True:
            moving = np.flatnonzero(self.following[at] != self.size)
            if not moving.size:
                return at, front
            self._advance(front, at[moving], self.following[at[moving]], into=moving, out_of=moving)
            at[moving] = self.following[at[moving]]

    def _advance(self, front: _Front, origin: Ints, end: Ints, into: Ints, out_of: Ints | None = None) -> None:
        """Hop from vertices to neighbours; rows `out_of` of the front (those of the origins) become rows `into`."""
        self.deadline.check("search", "detours that localise were not compared", "samples_per_mode")
        rows = origin if out_of is None else out_of
        variance, overshoot, steps = self.beliefs.hop(front.variance[rows], origin, end)
        front.variance[into] = variance
        front.overshoot[into] = front.overshoot[rows] + overshoot
        front.steps[into] = front.steps[rows] + steps
        visits = front.visits[rows].copy()
        mode = self.beliefs.mode_of
        visits[np.arange(len(end)), mode[end]] += mode[origin] != mode[end]
        front.visits[into] = visits

    def _to_goal(self, vertex: int) -> list[int]:
        path = [vertex]
        while self.following[path[-1]] != self.size:
            path.append(int(self.following[path[-1]]))
        return path

    def _spare(self, steps: Floats, modes: Ints) -> Floats:
        """(p,) steps that max_knots leaves."""
        return np.asarray(self.beliefs.problem.settings.max_knots - modes - np.ceil(steps))


def _traced(previous: Ints, here: int, vertex: int) -> list[int]:
    """The path of a shortest-path tree from its root to a vertex."""
    path = [vertex]
    while path[-1] != here:
        path.append(int(previous[path[-1]]))
    return path[::-1]
