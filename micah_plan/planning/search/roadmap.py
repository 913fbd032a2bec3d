"""Roadmaps: straight motions inside the modes that dynamics and guards allow, all joined by directed guard edges.

The roadmaps are OMPL's PRM* over the coordinates that a mode leaves free (Karaman and Frazzoli, IJRR 2011). All states
come from our own generator through a valid-state sampler and growth stops by count, so that the result depends on the
seed alone, not on earlier calls in the process. OMPL has no other callback: motions are checked afterwards in one NumPy
batch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import permutations
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from micah_plan.arrays import EQUAL, ROUND_OFF, Booleans, Floats, Ints
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.planning.limits import Limits, holding_inputs, room_for_motion
from micah_plan.planning.path_constraints import admitted
from micah_plan.planning.search.leaves import Leaves
from micah_plan.planning.search.ompl_library import base as ob
from micah_plan.planning.search.ompl_library import geometric as og
from micah_plan.planning.search.ompl_library import util as ou
from micah_plan.planning.zero_time_transitions import ZeroTimeEdge
from micah_plan.task.deadline import NEVER, Deadline
from micah_plan.task.problem import Problem

# Share of a step by which the reachable end of a motion may miss its target: rounding of the pseudo-inverse.
_MISS = 1e-7
# Cost of a transition, in steps: with equal motion the sequence with fewer modes comes first.
TRANSITION_COST = 1.0
# Margins within which a state is on a boundary, and normals of the same plane.
_ON_BOUNDARY, _SAME_NORMAL = 2.0 * EQUAL, 1e-8
# Fewer states than this are all connected with each other, about as PRM* would.
_FEWEST_GROWN = 8


@dataclass(frozen=True, eq=False)
class ModeMotion:
    """Straight motions x -> y of one mode.

    Attributes:
        B: (n, m) input matrix.
        max_step: (m,) largest input per step.
        speed: (n,) scale of each coordinate [rad or m per step].
        obstacles: guards on x alone that leave the mode: a motion may end on the boundary of one, where the transition
            happens, but not enter it.
        outside: complements of the mode's invariant, a region for each of its half-spaces on x.
        forwards: (m,) inputs that cannot be negative.
        admits: (k,) whether constraints on the path let states (k, n) be passed; None: there are none.
        held: (k, m) inputs that keep states (k, n) where they are; None: none are needed.
    """

    B: Floats
    max_step: Floats
    speed: Floats
    obstacles: tuple[Region, ...]
    outside: tuple[Region, ...]
    forwards: Booleans
    admits: Callable[[Floats], Booleans] | None = None
    held: Callable[[Floats], Floats] | None = None

    @cached_property
    def shared_faces(self) -> dict[tuple[int, int], Booleans]:
        """(i, j) -> (h, g): pairs of regions, one an obstacle, with the boundaries they share and inputs can cross."""
        every = (*self.obstacles, *self.outside)
        boundaries = [(i, h, row) for i, region in enumerate(every) for h, row in enumerate(region.half_spaces)]
        a = np.array([row.a for _, _, row in boundaries]).reshape(-1, len(self.B))
        size = np.maximum(np.linalg.norm(a, axis=1), ROUND_OFF)
        normal, place = a / size[:, None], np.array([row.c for _, _, row in boundaries]) / size
        owner, moves = np.array([i for i, _, _ in boundaries]), (a @ self.B).any(axis=1)
        shared = dict[tuple[int, int], Booleans]()
        for k in np.flatnonzero(moves & (owner < len(self.obstacles))).tolist():
            near = _ON_BOUNDARY * (1.0 / size[k] + 1.0 / size) + _SAME_NORMAL
            faces = moves & (owner > owner[k]) & (np.abs(place + place[k]) <= near)
            faces &= np.abs(normal + normal[k]).max(axis=1) <= _SAME_NORMAL
            i, h, _ = boundaries[k]
            for j, g, _ in (boundaries[other] for other in np.flatnonzero(faces)):
                count = len(every[i].half_spaces), len(every[j].half_spaces)
                shared.setdefault((i, j), np.zeros(count, dtype=bool))[h, g] = True
        return shared

    def steps(self, x: Floats, y: Floats) -> Floats:
        """(k,) number of steps (not rounded) of the straight motions x (k, n) -> y (k, n); infinite if not allowed."""
        delta = y - x
        u = delta @ np.linalg.pinv(self.B).T
        missed = np.max(np.abs(delta - u @ self.B.T) / self.speed, axis=-1, initial=0.0)
        free = self.max_step
        if self.held is not None:
            free = room_for_motion(np.maximum(np.abs(self.held(x)), np.abs(self.held(y))), self.max_step)
        steps = np.linalg.norm(u / free, axis=-1)
        steps[missed > _MISS * (1.0 + steps)] = np.inf
        steps[(u[:, self.forwards] < -_MISS * self.max_step[self.forwards]).any(axis=1)] = np.inf
        for obstacle in self.obstacles:
            steps[_blocked(obstacle, x, y)] = np.inf
        open_ways = np.flatnonzero(np.isfinite(steps))
        steps[open_ways[_runs_between_obstacles(self, x[open_ways], y[open_ways])]] = np.inf
        possible = np.flatnonzero(np.isfinite(steps))
        if self.admits is not None and possible.size:
            # Tested where steps of a motion end, as in a plan: not where it begins.
            for share in np.linspace(0.0, 1.0, 1 + int(np.ceil(max(1.0, steps[possible].max()))))[1:]:
                passed = self.admits(x[possible] + share * delta[possible])
                steps[possible[~passed]] = np.inf
        return np.asarray(steps)

    def shortcut(self, path: Floats) -> Floats:
        """(w, n) the path (k, n) without states that straight motions can skip."""
        corners, i = [0], 0
        while i < len(path) - 1:
            ends = np.arange(len(path) - 1, i, -1)
            allowed = np.isfinite(self.steps(np.repeat(path[i : i + 1], len(ends), axis=0), path[ends]))
            i = int(ends[np.argmax(allowed)]) if allowed.any() else i + 1
            corners.append(i)
        return path[corners]


def motions_of(problem: Problem, limits: Limits) -> dict[str, ModeMotion]:
    """The motions of each mode, within the constraints on the path."""
    automaton, motions = problem.automaton, {}
    for mode in automaton.modes:
        admits = partial(admitted, problem, limits, mode.name) if problem.constraints else None
        obstacles = obstacles_on_state(automaton, mode.name)
        forwards = _nonnegative_inputs(mode)
        held = partial(holding_inputs, automaton, mode.name, B=mode.B * ~forwards) if automaton.effects else None
        outside = tuple(Region((h.opposite,)) for h in mode.invariant.half_spaces if not h.on_input)
        motions[mode.name] = ModeMotion(
            mode.B, limits.max_step, limits.speed, obstacles, outside, forwards, admits, held
        )
    return motions


def _nonnegative_inputs(mode: Mode) -> Booleans:
    """(m,) inputs that cannot be negative: time, or a ratchet."""
    found = np.zeros(mode.B.shape[1], dtype=bool)
    for h in mode.inputs.half_spaces:
        b = np.array(h.b)
        if not h.on_state and h.c >= 0.0 and np.count_nonzero(b) == 1 and b.max() > 0.0:
            found |= b > 0.0
    return found


def obstacles_on_state(automaton: HybridAutomaton, mode: str) -> tuple[Region, ...]:
    """The guards on x alone that leave a mode; guards on inputs are avoided by the choice of the input."""
    edges = [edge for edge in automaton.edges_from(mode) if not edge.is_self_transition]
    # A chain lies within the guard of its first transition.
    guards = [edge.guard for edge in edges if not isinstance(edge, ZeroTimeEdge)]
    return tuple(g for g in guards if g.half_spaces and not g.on_input)


def _blocked(guard: Region, x: Floats, y: Floats) -> Booleans:
    """(k,) whether a motion passes through the interior of a guard."""
    enter, leave = _crossing_interval(guard, x, y, ROUND_OFF)
    return np.asarray(leave - enter > ROUND_OFF)


def _crossing_interval(guard: Region, x: Floats, y: Floats, depth: float) -> tuple[Floats, Floats]:
    """(k,) fractions of each motion at which it enters and leaves the guard, shrunk by a depth."""
    u = np.zeros((*x.shape[:-1], len(guard.half_spaces[0].b)))
    before, after = guard.margins(x, u), guard.margins(y, u)
    slope = after - before
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        crossing = (depth - before) / slope
    enter = np.where(slope > 0, crossing, np.where(before > depth, -np.inf, np.inf))
    enter = np.where(slope < 0, -np.inf, enter)
    leave = np.where(slope < 0, crossing, np.inf)
    return np.maximum(enter.max(axis=-1), 0.0), np.minimum(leave.min(axis=-1), 1.0)


def _runs_between_obstacles(motion: ModeMotion, x: Floats, y: Floats) -> Booleans:
    """(k,) whether a motion runs along a face shared by two obstacles, where there is no clearance.

    The complement of a mode's invariant is an obstacle too; but a mode may be as thin as its invariant alone makes it.
    """
    obstacles = (*motion.obstacles, *motion.outside)
    found = np.zeros(len(x), dtype=bool)
    needed = {number for pair in motion.shared_faces for number in pair}
    ends = {number: _crossing_interval(obstacles[number], x, y, -EQUAL) for number in needed}
    beside = {number: leave - enter > EQUAL for number, (enter, leave) in ends.items()}
    for (i, j), shared in motion.shared_faces.items():
        begin, end = (limit([ends[i][side], ends[j][side]], axis=0) for side, limit in ((0, np.max), (1, np.min)))
        k = np.flatnonzero(~found & beside[i] & beside[j] & (end - begin > EQUAL))
        at = x[k] + 0.5 * (begin + end)[k, None] * (y[k] - x[k])
        touched = [_touched_boundaries(obstacles[number], at, motion.B) for number in (i, j)]
        # At an edge there is a way past one of them.
        other = (touched[0][:, :, None] & touched[1][:, None, :] & ~shared).any(axis=(1, 2))
        found[k] = touched[0].any(axis=1) & touched[1].any(axis=1) & ~other
    return found


def _inputs_cross(boundary: HalfSpace, moves: Floats) -> bool:
    """Whether inputs through B (n, m) move a state across a boundary."""
    return bool(np.any(np.array(boundary.a) @ moves))


def _touched_boundaries(obstacle: Region, x: Floats, moves: Floats) -> Booleans:
    """(k, h) boundaries of an obstacle that states (k, n) lie on and inputs through B (n, m) can cross."""
    margins = obstacle.margins(x, np.zeros((len(x), len(obstacle.half_spaces[0].b))))
    return (np.abs(margins) <= _ON_BOUNDARY) & [_inputs_cross(h, moves) for h in obstacle.half_spaces]


@dataclass(frozen=True, eq=False)
class JoinedRoadmap:
    """Roadmaps of all modes and the guard edges between them.

    Attributes:
        graphs: (v, v) directed motion costs [steps] by mode.
        exits: (k, 2) vertex pairs by edge index.
        ends: (source, target) mode by edge index.
        start: (mode, vertex).
        goals: vertices by mode.
        goal_costs: cost [steps] of ending at each of these vertices, by mode.
    """

    graphs: Mapping[str, csr_array]
    exits: Mapping[int, Ints]
    ends: Mapping[int, tuple[str, str]]
    start: tuple[str, int]
    goals: Mapping[str, Ints]
    goal_costs: Mapping[str, Floats]

    @cached_property
    def offsets(self) -> dict[str, int]:
        """Number of each mode's first vertex where the vertices of all modes are counted in one row."""
        sizes = [graph.shape[0] for graph in self.graphs.values()]
        return dict(zip(self.graphs, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))

    @cached_property
    def graph(self) -> csr_array:
        """(V+1, V+1) costs of all motions and transitions; the last vertex lies behind all goals.

        Arriving there from a goal costs one step more than it counts: a sparse graph would drop a cost of zero.
        """
        offsets, total = self.offsets, sum(graph.shape[0] for graph in self.graphs.values())
        parts = [(graph.tocoo(), offsets[mode]) for mode, graph in self.graphs.items()]
        motions = [(part.row + offset, part.col + offset, part.data) for part, offset in parts]
        firsts = [[offsets[mode] for mode in self.ends[edge]] for edge in self.exits]
        pairs = np.concatenate([np.zeros((0, 2), dtype=np.int64), *map(np.add, self.exits.values(), firsts)])
        pairs = np.unique(pairs, axis=0)  # of several edges between two vertices one is enough: all cost the same
        transitions = (*pairs.T, np.full(len(pairs), TRANSITION_COST))
        endings = [
            (vertices + offsets[mode], np.full(len(vertices), total), self.goal_costs[mode] + 1.0)
            for mode, vertices in self.goals.items()
        ]
        row, column, costs = map(np.concatenate, zip(*motions, transitions, *endings, strict=True))
        return coo_array((costs, (row, column)), shape=(total + 1, total + 1)).tocsr()

    @cached_property
    def to_goal(self) -> tuple[Floats, Ints]:
        """(V,) cheapest cost from each vertex to the goal [steps], with revisits, and (V,) next vertex.

        A vertex of the goal is followed by V, which lies behind all goals.
        """
        last = self.graph.shape[0] - 1
        costs, following = dijkstra(self.graph.T.tocsr(), indices=last, return_predecessors=True)
        return costs[:last] - 1.0, following[:last]


def vertices_along(links: Ints, vertex: int, end: int) -> list[int]:
    """The vertices from one to another along predecessor links."""
    path = [vertex]
    while path[-1] != end:
        path.append(int(links[path[-1]]))
    return path


def roadmap_of(points: Floats, leaves: Leaves, motion: ModeMotion, deadline: Deadline = NEVER) -> csr_array:
    """(v, v) costs [steps] of the allowed motions along PRM*'s connections between the states (v, n) on each leaf."""
    pairs = connections_of(points, leaves, deadline)
    return _graph(points, pairs, motion.steps(points[pairs[:, 0]], points[pairs[:, 1]]))


def connections_of(points: Floats, leaves: Leaves, deadline: Deadline = NEVER) -> Ints:
    """(e, 2) connections of PRM* between the states (v, n) of each leaf, ignoring obstacles."""
    numbers, leaf, none = leaves.own(points), leaves.numbers(points), np.zeros((0, 2), dtype=np.int64)
    rows_of = np.split(np.argsort(leaf, kind="stable"), np.cumsum(np.bincount(leaf))[:-1]) if len(leaf) else []
    return np.concatenate([none, *(rows[_prm_connections(numbers[rows], deadline)] for rows in rows_of)])


def _graph(points: Floats, pairs: Ints, steps: Floats) -> csr_array:
    allowed = np.isfinite(steps)
    pairs, steps = pairs[allowed], np.maximum(steps[allowed], ROUND_OFF)
    return coo_array((steps, (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points))).tocsr()


def without_each_obstacle(points: Floats, leaves: Leaves, motion: ModeMotion) -> dict[str, csr_array]:
    """`roadmap_of` a mode without the obstacles of each name in turn."""
    pairs = connections_of(points, leaves)
    x, y = points[pairs[:, 0]], points[pairs[:, 1]]
    free = replace(motion, obstacles=()).steps(x, y)
    blocked = {number: _blocked(obstacle, x, y) for number, obstacle in enumerate(motion.obstacles)}
    by_all = np.sum(list(blocked.values()), axis=0) if blocked else np.zeros(len(pairs), dtype=np.int64)
    graphs = dict[str, csr_array]()
    for name in dict.fromkeys(obstacle.name for obstacle in motion.obstacles):
        own = np.sum([blocked[k] for k, obstacle in enumerate(motion.obstacles) if obstacle.name == name], axis=0)
        graphs[name] = _graph(points, pairs, np.where(by_all > own, np.inf, free))
    return graphs


def _prm_connections(points: Floats, deadline: Deadline) -> Ints:
    """(e, 2) sorted connections, in both directions, that PRM* makes between distinct states (v, n) added in order."""
    free = np.flatnonzero(np.ptp(points, axis=0) > 0) if len(points) else np.zeros(0, dtype=np.int64)
    if not len(free):
        return np.zeros((0, 2), dtype=np.int64)
    if len(points) <= _FEWEST_GROWN:
        return np.array(list(permutations(range(len(points)), 2)), dtype=np.int64)
    states = np.ascontiguousarray(points[:, free])
    # Distinct states may agree in the last bits after scaling; PRM* sees each only once.
    numbers: dict[bytes, int] = {}
    for number, state in enumerate(states):
        numbers.setdefault((state + 0.0).tobytes(), number)
    grown, links = _grow_prm(states[list(numbers.values())] + 0.0, deadline)
    vertices = np.array([numbers[state.tobytes()] for state in grown], dtype=np.int64)
    pairs = vertices[np.array(links, dtype=np.int64).reshape(-1, 2)]
    both = np.concatenate([pairs, pairs[:, ::-1]]) @ [len(points), 1]
    return np.stack(np.divmod(np.unique(both), len(points)), axis=1)


def _grow_prm(states: Floats, deadline: Deadline) -> tuple[Floats, list[tuple[int, int]]]:
    """OMPL's PRM* roadmap over exactly these states (v, d): its vertices (v, d), in its order, and its edges."""
    ou.setLogLevel(ou.LogLevel.LOG_ERROR)
    space = ob.RealVectorStateSpace(states.shape[1])
    lower = states.min(axis=0)
    space.setBounds(bounding_box(lower, np.maximum(states.max(axis=0), lower + EQUAL)))
    information = ob.SpaceInformation(space)
    samplers: list[_GivenStates] = []

    def allocate(owner: Any) -> _GivenStates:
        samplers.append(_GivenStates(owner, states))
        return samplers[-1]

    information.setValidStateSamplerAllocator(allocate)
    information.setup()
    planner = og.PRMstar(information)
    planner.setProblemDefinition(ob.ProblemDefinition(information))
    planner.setup()
    is_done = lambda: any(s.used >= len(states) for s in samplers) or deadline.is_over()  # noqa: E731
    planner.growRoadmapPtc(ob.PlannerTerminationCondition(is_done))
    deadline.check("search", "a roadmap was being grown", "samples_per_mode")
    data = ob.PlannerData(information)
    planner.getPlannerData(data)
    # The data points into the planner's memory: copy it while the planner lives.
    vertices = [data.getVertex(i).getState() for i in range(data.numVertices())]
    grown = np.array([[state[i] for i in range(states.shape[1])] for state in vertices])
    return grown, [(i, j) for i in range(len(vertices)) for j in data.getEdges(i)]


def bounding_box(lower: Floats, upper: Floats) -> Any:
    """Corners (n,) as OMPL wants them."""
    bounds = ob.RealVectorBounds(len(lower))
    for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(high))
    return bounds


class _GivenStates(ob.ValidStateSampler):  # type: ignore[misc]  # OMPL's wheel has no type information
    """Feeds given states to a planner in order."""

    def __init__(self, information: Any, states: Floats) -> None:
        super().__init__(information)
        self.states = states
        self.used = 0

    def sample(self, state: Any) -> bool:
        for i, value in enumerate(self.states[min(self.used, len(self.states) - 1)]):
            state[i] = float(value)
        self.used += 1
        return True

    def sampleNear(self, _state: Any, _near: Any, _distance: float) -> bool:  # noqa: N802  # OMPL's name
        return False
