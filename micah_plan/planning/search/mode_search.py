"""The high level of POMDP-HD: which mode sequences lead from the start to the goal, cheapest first.

1. sample the states of every mode                                        `samples`
2. connect them within each mode, and the modes by guard edges            `roadmap`
3. take the cheapest mode sequences through all of it                     `mode_paths`
4. look for detours that localise, and rank by length and uncertainty     `localising`, `path_beliefs`

**Localising paths.** A detour costs steps, but may leave a belief narrow enough for the goal.

The cheapest path makes no detour. So paths are also routed through any one vertex of the roadmaps (a wall to touch, a
place in the light), then through a second one, and compared by cost and remaining uncertainty. With v vertices a round
is two shortest-path trees and one filter over v beliefs; it visits no combination of modes that its paths do not lead
through.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.hybrid import Mode
from micah_plan.planning.findings import why_disconnected, why_unreachable
from micah_plan.planning.limits import Limits
from micah_plan.planning.path_constraints import goal_cost, in_steps
from micah_plan.planning.roll_outs import FEW_MODES
from micah_plan.planning.search.leaves import leaves_of
from micah_plan.planning.search.mode_paths import VertexPath, cheapest_sequences
from micah_plan.planning.search.path_beliefs import PathBeliefs
from micah_plan.planning.search.roadmap import (
    JoinedRoadmap,
    ModeMotion,
    along,
    motions_of,
    obstacles_on_state,
    roadmap_of,
    without_each_obstacle,
)
from micah_plan.planning.search.samples import Samples, sample_modes
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Reason
from micah_plan.task.settings import NEVER, Deadline, TimeLimitError

# Times as many states before what does not connect is called unconnected.
_MORE_STATES = 6
# Transitions more than the shortest sequence has: there and back once.
_MORE_TRANSITIONS = 2


@dataclass(frozen=True, eq=False)
class ModeSequence:
    """A mode sequence with the path that the roadmaps found through it.

    Attributes:
        modes: (P,) names.
        edges: (P-1,) indices into the automaton's edges.
        waypoints: per mode (w, n) corners of the path, w >= 1, from entering to leaving the mode [rad or m].
        cost: length of the path in steps of the largest input, one per transition, and the goal error left, in steps.
        uncertainty: cost of the predicted uncertainty, in steps; the sum of both ranks sequences.
    """

    modes: tuple[str, ...]
    edges: tuple[int, ...]
    waypoints: tuple[Floats, ...]
    cost: float
    uncertainty: float = 0.0

    @property
    def total(self) -> float:
        """Cost and uncertainty together, by which sequences are ranked [steps]."""
        return self.cost + self.uncertainty


@dataclass(frozen=True)
class SearchResult:
    """What a search found.

    Attributes:
        sequences: cheapest first.
        reason: why there are none.
        is_sparse: whether more states might have connected start and goal.
    """

    sequences: tuple[ModeSequence, ...]
    reason: Reason | None = None
    is_sparse: bool = False


def search_modes(
    problem: Problem, limits: Limits, start_mode: str, seed: int = 0, *, deadline: Deadline = NEVER
) -> SearchResult:
    """The cheapest mode sequences from the start to the goal. The same seed gives the same result.

    The shortest sequences compete with detours that localise (`localising`) by length and predicted uncertainty.

    Args:
        deadline: of the search; detours are left out where it passes while they are compared.

    Of an automaton with many modes those near a shortest sequence of transitions are searched first: roadmaps of all
    the others cost most of the time and hardly ever matter.

    Raises:
        TimeLimitError: if it passes before there is a mode sequence.
    """
    edges, near = problem.automaton.edges, _modes_near_the_way(problem, start_mode)
    if len(near) < len(problem.automaton.modes):
        kept = [i for i, edge in enumerate(edges) if {edge.source, edge.target} <= near]
        modes = tuple(mode for mode in problem.automaton.modes if mode.name in near)
        automaton = replace(problem.automaton, modes=modes, edges=tuple(edges[i] for i in kept))
        part = replace(problem, automaton=automaton)
        if sequences := _searched(part, limits, start_mode, seed, deadline).sequences:
            named = (replace(path, edges=tuple(kept[i] for i in path.edges)) for path in sequences)
            return SearchResult(tuple(named))
    return _searched(problem, limits, start_mode, seed, deadline)


def _modes_near_the_way(problem: Problem, start_mode: str) -> set[str]:
    """The modes of sequences with at most so many more transitions than the shortest to the goal; all, if few."""
    automaton, names = problem.automaton, set(problem.automaton.mode_names)
    if len(names) <= FEW_MODES:
        return names
    onward, back = dict[str, set[str]](), dict[str, set[str]]()
    for edge in automaton.edges:
        onward.setdefault(edge.source, set()).add(edge.target)
        back.setdefault(edge.target, set()).add(edge.source)
    goals = {name for name in names if all(_holds(automaton.mode(name), *target) for target in problem.goal.target)}
    from_start = _distances(onward, {start_mode})
    to_goal = _distances(back, {name for name in goals if problem.goal.admits(name)})
    length = {name: from_start[name] + to_goal[name] for name in names & from_start.keys() & to_goal.keys()}
    most = length.get(start_mode, np.inf) + _MORE_TRANSITIONS + 2 * problem.settings.revisits
    return {name for name, steps_to_it in length.items() if steps_to_it <= most} or names


def _holds(mode: Mode, index: int, value: float, tolerance: float) -> bool:
    """Whether a mode allows a coordinate to be in the goal."""
    low, high = mode.interval(index)
    return low <= value + tolerance and high >= value - tolerance


def _distances(neighbours: Mapping[str, set[str]], first: set[str]) -> dict[str, int]:
    """How many transitions lead from the first modes to each that they reach."""
    steps_to, level, steps = dict.fromkeys(first, 0), first, 0
    while level:
        steps += 1
        level = {after for name in level for after in neighbours.get(name, set())} - steps_to.keys()
        steps_to.update(dict.fromkeys(level, steps))
    return steps_to


def _searched(problem: Problem, limits: Limits, start_mode: str, seed: int, deadline: Deadline) -> SearchResult:
    """`search_modes` in all modes of a problem; among obstacles once more with more states if few do not connect."""
    among = any(obstacles_on_state(problem.automaton, mode.name) for mode in problem.automaton.modes)
    if not among:
        return _among_states(problem, limits, start_mode, seed, deadline)
    found = _among_states(problem, limits, start_mode, seed, deadline, is_last=False)
    if not found.is_sparse:
        return found
    many = replace(problem.settings, samples_per_mode=_MORE_STATES * problem.settings.samples_per_mode)
    return _among_states(replace(problem, settings=many), limits, start_mode, seed, deadline)


def _among_states(
    problem: Problem, limits: Limits, start_mode: str, seed: int, deadline: Deadline, *, is_last: bool = True
) -> SearchResult:
    samples = sample_modes(problem, limits, start_mode, np.random.default_rng(seed), deadline)
    if (reason := why_unreachable(problem, limits, samples)) is not None:
        return SearchResult((), reason)
    motions = motions_of(problem, limits)
    roadmap = _joined(problem, limits, samples, motions, deadline)
    revisits, candidates = problem.settings.revisits, problem.settings.candidates
    shortest = cheapest_sequences(roadmap, candidates, revisits=revisits, is_over=deadline.is_over)
    if not shortest:
        deadline.check("search", "no mode sequence was complete", "samples_per_mode")
        if not is_last and not samples.is_cut_short:
            return SearchResult((), is_sparse=True)
        in_the_way = _in_the_way(problem, limits, roadmap, samples.points, deadline)
        return SearchResult((), why_disconnected(problem, limits, samples, in_the_way))
    beliefs = PathBeliefs(problem, limits, roadmap, samples.points)
    localising = LocalisingSearch(roadmap, beliefs, revisits, deadline)
    detours: list[ScoredPath] = []
    with suppress(TimeLimitError):
        detours = localising.paths()
    best: dict[tuple[int, ...], ScoredPath] = {}
    for path in [*map(localising.score, shortest), *detours]:
        taken = _edges(path, beliefs)
        # A detour through the same modes must be worth it: rounding is no reason.
        if taken not in best or path.cost < best[taken].cost - WORTH_A_DETOUR:
            best[taken] = path
    chosen = sorted(best.values(), key=lambda path: path.cost)[:candidates]
    return SearchResult(tuple(_mode_sequence(path, beliefs, motions) for path in chosen))


def _joined(
    problem: Problem, limits: Limits, samples: Samples, motions: Mapping[str, ModeMotion], deadline: Deadline
) -> JoinedRoadmap:
    """The roadmaps of all modes, with the guard edges that the samples take."""
    edges, graphs = problem.automaton.edges, dict[str, csr_array]()
    for name, points in samples.points.items():
        deadline.check("search", f"{len(graphs)} of {len(samples.points)} modes had a roadmap", "samples_per_mode")
        leaves = leaves_of(problem.automaton.mode(name), limits)
        graphs[name] = roadmap_of(points, leaves, motions[name], deadline)
    ends = {index: (edges[index].source, edges[index].target) for index in samples.exits}
    # The goal error that is left, as the optimisation will weigh it against effort.
    costs = {
        name: np.broadcast_to(in_steps(problem, goal_cost(problem, samples.points[name][vertices].T)), len(vertices))
        for name, vertices in samples.goals.items()
    }
    return JoinedRoadmap(graphs, samples.exits, ends, samples.start, samples.goals, costs)


def _edges(path: ScoredPath, beliefs: PathBeliefs) -> tuple[int, ...]:
    """The automaton's edges that a path takes."""
    mode, pairs = beliefs.mode_of, pairwise(path.vertices)
    return tuple(beliefs.edge_of[i, j] for i, j in pairs if mode[i] != mode[j])


def _mode_sequence(path: ScoredPath, beliefs: PathBeliefs, motions: dict[str, ModeMotion]) -> ModeSequence:
    """The path divided into its modes, its corners cut between the stops."""
    names, mode_of = list(beliefs.index), beliefs.mode_of[list(path.vertices)]
    points = beliefs.points[list(path.vertices)]
    begins = [0, *(np.flatnonzero(np.diff(mode_of)) + 1).tolist(), len(mode_of)]
    modes, waypoints = [], []
    for begin, end in pairwise(begins):
        name = names[mode_of[begin]]
        ends = [begin, *(stop for stop in path.stops if begin < stop < end - 1), end - 1]
        parts = [motions[name].shortcut(points[i : j + 1]) for i, j in pairwise(ends)]
        modes.append(name)
        waypoints.append(np.concatenate([parts[0], *(part[1:] for part in parts[1:])]))
    return ModeSequence(tuple(modes), _edges(path, beliefs), tuple(waypoints), path.length, path.uncertainty)


def _in_the_way(
    problem: Problem, limits: Limits, roadmap: JoinedRoadmap, points: Mapping[str, Floats], deadline: Deadline
) -> tuple[str, ...]:
    """The constraints on the path, and the guards on states in all modes, without any one of which the same samples
    would connect start and goal."""
    leaves = {mode.name: leaves_of(mode, limits) for mode in problem.automaton.modes}
    easier = dict[str, dict[str, csr_array]]()
    for constraint in problem.constraints:
        others = tuple(c for c in problem.constraints if c.name != constraint.name)
        motions = motions_of(replace(problem, constraints=others), limits)
        if deadline.is_over():  # that nothing connects them is certain; what is in the way is not
            return ()
        easier[constraint.name] = {mode: roadmap_of(points[mode], leaves[mode], motions[mode]) for mode in points}
    motions = motions_of(problem, limits)
    for mode in points:
        for name, graph in without_each_obstacle(points[mode], leaves[mode], motions[mode]).items():
            easier[name] = {**easier.get(name, roadmap.graphs), mode: graph}
    found, revisits = [], problem.settings.revisits
    for name, graphs in easier.items():
        if deadline.is_over():
            return ()
        if cheapest_sequences(replace(roadmap, graphs=graphs), 1, revisits=revisits):
            found.append(name)
    return tuple(found)


# Stops on the way, and how many of the best beginnings get one more.
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
class _Front:
    """Beliefs on their way: variance (v, n), overshoot and steps so far (v,), and visits of each mode (v, q)."""

    variance: Floats
    overshoot: Floats
    steps: Floats
    visits: Ints

    def rows(self, rows: Ints) -> _Front:
        """Copies of some of them."""
        return _Front(self.variance[rows], self.overshoot[rows], self.steps[rows], self.visits[rows])


@dataclass(frozen=True, eq=False)
class _Beginning:
    """A path from the start to its last stop, its steps, and the belief there (a front of one)."""

    vertices: tuple[int, ...]
    stops: tuple[int, ...]
    length: float
    belief: _Front


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
        """A path of the mode search with its predicted uncertainty."""
        offsets = [self.roadmap.offsets[mode] for mode in path.modes]
        vertices = [offset + v for offset, part in zip(offsets, path.vertices, strict=True) for v in part]
        front, owner = self._start().belief, np.array([0])
        for i, j in pairwise(vertices):
            self._advance(front, np.array([i]), np.array([j]), owner, owner)
        ending = self.beliefs.ending(front.variance, np.array(vertices[-1:]), self._spare(front))
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
        """The beginning, on to every vertex by the shortest way, and from there to the goal by the shortest way."""
        here = beginning.vertices[-1]
        distance, previous = dijkstra(self.roadmap.graph, indices=here, return_predecessors=True)
        distance, previous = distance[: self.size], previous[: self.size]
        reached = np.flatnonzero(np.isfinite(distance) & np.isfinite(self.to_go))
        there = self._spread(beginning.belief, here, previous)
        at, ends = self._onward(there.rows(reached), reached)
        spare = self._spare(ends)
        allowed = (ends.visits.max(axis=1, initial=0) <= self.most_visits) & (spare >= 0)
        ending = self.beliefs.ending(ends.variance, at, spare)
        costs = np.where(allowed, distance[reached] + self.to_go[reached] + ends.overshoot + ending, np.inf)
        best = np.argsort(costs, kind="stable")[:_MOST_TRACED]
        results = []
        for row in best[np.isfinite(costs[best])]:
            vertex = int(reached[row])
            vertices = (*beginning.vertices, *along(previous, vertex, here)[-2::-1])
            stops = (*beginning.stops, len(vertices) - 1)
            length = beginning.length + float(distance[vertex])
            whole = (*vertices, *along(self.following, vertex, self.size)[1:-1])
            uncertainty = float(ends.overshoot[row] + ending[row])
            path = ScoredPath(whole, (*stops, len(whole) - 1), length + float(self.to_go[vertex]), uncertainty)
            results.append((path, _Beginning(vertices, stops, length, there.rows(reached[[row]]))))
        return results

    def _spread(self, belief: _Front, here: int, previous: Ints) -> _Front:
        """A belief at a vertex carried along its tree of shortest paths to all vertices that it reaches."""
        front, level = belief.rows(np.zeros(self.size, dtype=np.int64)), np.array([here])
        while (level := np.flatnonzero(np.isin(previous, level))).size:
            self._check_time()
            self._advance(front, previous[level], level, previous[level], level)
        return front

    def _onward(self, front: _Front, at: Ints) -> tuple[Ints, _Front]:
        """Beliefs at these vertices carried on to the goal: where they end (r,), and they themselves."""
        at = at.copy()
        while (moving := np.flatnonzero(self.following[at] != self.size)).size:
            self._check_time()
            self._advance(front, at[moving], self.following[at[moving]], moving, moving)
            at[moving] = self.following[at[moving]]
        return at, front

    def _advance(self, front: _Front, origin: Ints, end: Ints, out_of: Ints, into: Ints) -> None:
        """Hop from vertices to neighbours; rows `out_of` of the front become rows `into`."""
        before, mode = front.rows(out_of), self.beliefs.mode_of
        front.variance[into], overshoot, steps = self.beliefs.hop(before.variance, origin, end)
        front.overshoot[into] = before.overshoot + overshoot
        front.steps[into] = before.steps + steps
        before.visits[np.arange(len(end)), mode[end]] += mode[origin] != mode[end]
        front.visits[into] = before.visits

    def _spare(self, front: _Front) -> Floats:
        """(v,) steps that max_knots leaves."""
        return np.asarray(self.beliefs.problem.settings.max_knots - front.visits.sum(axis=1) - np.ceil(front.steps))

    def _check_time(self) -> None:
        self.deadline.check("search", "detours that localise were not compared", "samples_per_mode")
