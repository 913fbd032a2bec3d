"""The k cheapest mode sequences through roadmaps that are joined by directed guard edges.

A best-first search over prefixes of mode sequences. A prefix has the cheapest cost of entering its last mode at every
vertex; the exact cost-to-go of the joined roadmaps (which ignores that revisits are forbidden, so it never
overestimates) guides the search, so only prefixes that compete with the k cheapest sequences are ever expanded.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.sparse.csgraph import dijkstra

from micah_plan.arrays import Floats, Ints
from micah_plan.planning.search.roadmap import TRANSITION_COST, JoinedRoadmap, vertices_along

# Digits [steps] in which costs must differ to count as different.
_DIGITS = 9


@dataclass(frozen=True)
class VertexPath:
    """A mode sequence, the vertices visited in each mode, the edges (indices) between them, and the cost [steps]."""

    modes: tuple[str, ...]
    edges: tuple[int, ...]
    vertices: tuple[tuple[int, ...], ...]
    cost: float


@dataclass(frozen=True, eq=False)
class _Prefix:
    """A partial sequence at its entry to `mode`.

    Attributes:
        entry: (v,) cost of entering at each vertex; infinite where it cannot enter.
        exit_of: (v,) vertex of the parent's mode from which each entry was made.
    """

    mode: str
    entry: Floats
    parent: _Prefix | None
    edge: int
    exit_of: Ints

    @property
    def modes(self) -> tuple[str, ...]:
        return (*(self.parent.modes if self.parent else ()), self.mode)


def cheapest_sequences(
    roadmap: JoinedRoadmap, k: int, *, revisits: int = 0, is_over: Callable[[], bool] = lambda: False
) -> list[VertexPath]:
    """At most k sequences with different edges, cheapest first; empty if the goal is not reachable.

    Args:
        revisits: how many times a sequence may come back to a mode that it has been in.
        is_over: polled; when it returns True, the sequences found so far are returned.
    """
    search, paths = _Search(roadmap), list[VertexPath]()
    queue: list[tuple[float, int, int, float, _Prefix, bool]] = []

    def push(cost: float, prefix: _Prefix, complete: bool) -> None:
        if np.isfinite(cost):
            # Orders of independent transitions cost the same except for rounding: the longest prefix goes on, or all of
            # their permutations would be expanded side by side.
            depth = len(prefix.modes) + int(complete)
            heapq.heappush(queue, (round(cost, _DIGITS), -depth, next(tickets), cost, prefix, complete))

    tickets, (mode, vertex) = count(), roadmap.start
    entry = np.full(roadmap.graphs[mode].shape[0], np.inf)
    entry[vertex] = 0.0
    push(float(search.to_go[mode][vertex]), _Prefix(mode, entry, None, -1, np.full(len(entry), -1)), False)
    while queue and len(paths) < k and not is_over():
        *_, cost, prefix, complete = heapq.heappop(queue)
        if complete:
            paths.append(search.trace(prefix, cost))
            continue
        reached = search.reached(prefix)
        if prefix.mode in roadmap.goals:
            push(float(search.ending(prefix.mode, reached).min(initial=np.inf)), prefix, True)
        for edge, (source, target) in roadmap.ends.items():
            if source == prefix.mode and prefix.modes.count(target) <= revisits:
                child = search.follow(prefix, reached, edge, target)
                push(float(np.min(child.entry + search.to_go[target])), child, False)
    return paths


class _Search:
    """Shortest paths of the joined roadmap, computed on demand."""

    def __init__(self, roadmap: JoinedRoadmap) -> None:
        self.roadmap, offsets, costs = roadmap, roadmap.offsets, roadmap.to_goal[0]
        self.to_go = {name: costs[offsets[name] : offsets[name] + g.shape[0]] for name, g in roadmap.graphs.items()}
        self._distances: dict[str, tuple[Floats, Ints]] = {}

    def distances(self, mode: str) -> tuple[Floats, Ints]:
        """(v, v) shortest costs between the vertices of a mode and the predecessors on the paths."""
        if mode not in self._distances:
            self._distances[mode] = dijkstra(self.roadmap.graphs[mode], return_predecessors=True)
        return self._distances[mode]

    def reached(self, prefix: _Prefix) -> Floats:
        """(v,) cheapest cost at each vertex of the prefix's last mode."""
        entries = np.flatnonzero(np.isfinite(prefix.entry))
        costs = prefix.entry[entries, None] + self.distances(prefix.mode)[0][entries]
        return np.asarray(costs.min(axis=0, initial=np.inf))

    def ending(self, mode: str, reached: Floats) -> Floats:
        """(g,) total cost of ending at each goal vertex of a mode."""
        return np.asarray(reached[self.roadmap.goals[mode]] + self.roadmap.goal_costs[mode])

    def follow(self, prefix: _Prefix, reached: Floats, edge: int, target: str) -> _Prefix:
        """The prefix extended by one guard edge."""
        entry = np.full(self.roadmap.graphs[target].shape[0], np.inf)
        exit_of = np.full(len(entry), -1)
        for before, after in self.roadmap.exits.get(edge, ()):
            if reached[before] + TRANSITION_COST < entry[after]:
                entry[after] = reached[before] + TRANSITION_COST
                exit_of[after] = before
        return _Prefix(target, entry, prefix, edge, exit_of)

    def trace(self, prefix: _Prefix, cost: float) -> VertexPath:
        """The vertices of the cheapest path through a complete prefix."""
        best = np.argmin(self.ending(prefix.mode, self.reached(prefix)))
        vertex = int(self.roadmap.goals[prefix.mode][best])
        vertices, edges, last = list[tuple[int, ...]](), list[int](), prefix
        while True:
            distance, predecessor = self.distances(last.mode)
            entry = int(np.argmin(last.entry + distance[:, vertex]))
            vertices.append(tuple(vertices_along(predecessor[entry], vertex, entry)[::-1]))
            if last.parent is None:
                return VertexPath(prefix.modes, tuple(edges[::-1]), tuple(vertices[::-1]), cost)
            edges.append(last.edge)
            vertex, last = int(last.exit_of[entry]), last.parent
