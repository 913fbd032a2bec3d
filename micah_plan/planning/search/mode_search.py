"""High level of POMDP-HD: mode sequences from start to goal, cheapest first.

1. sample the states of every mode                                        `samples`
2. connect them within each mode, and the modes by guard edges            `roadmap`
3. take the cheapest mode sequences through all of it                     `mode_paths`
4. look for detours that localise, and rank by length and uncertainty     `localising`, `path_beliefs`
5. ask what of each of their modes is needed                              `needed_modes`
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Mode
from micah_plan.planning.findings import why_disconnected, why_unreachable
from micah_plan.planning.limits import Limits
from micah_plan.planning.plan_cost import goal_cost, in_steps
from micah_plan.planning.roll_outs import FEW_MODES
from micah_plan.planning.search.leaves import leaves_of
from micah_plan.planning.search.localising import ScoredPath, best_paths, edges_of
from micah_plan.planning.search.mode_paths import cheapest_sequences
from micah_plan.planning.search.needed_modes import (
    PathsWithoutMode,
    avoidable_modes,
    blocking_constraints,
    relaxed_graphs,
)
from micah_plan.planning.search.path_beliefs import PathBeliefs
from micah_plan.planning.search.roadmap import (
    JoinedRoadmap,
    ModeMotion,
    motions_of,
    obstacles_on_state,
    roadmap_of,
)
from micah_plan.planning.search.samples import Samples, sample_modes
from micah_plan.task.deadline import NEVER, Deadline
from micah_plan.task.plan import ModePurpose
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Reason

# Times as many states before what does not connect is called unconnected.
_MORE_STATES = 6
# Transitions more than the shortest sequence has: there and back once.
_MORE_TRANSITIONS = 2


@dataclass(frozen=True, eq=False)
class ModeSequence:
    """A mode sequence with its path through the roadmaps.

    Attributes:
        modes: (P,) names.
        edges: (P-1,) indices into the automaton's edges.
        waypoints: per mode (w, n) corners of the path, w >= 1, from entering to leaving the mode [rad or m].
        cost: length of the path in steps of the largest input, one per transition, and the goal error left, in steps.
        uncertainty: cost of the predicted uncertainty, in steps; the sum of both ranks sequences.
        purposes: of its modes, as far as the search could determine.
    """

    modes: tuple[str, ...]
    edges: tuple[int, ...]
    waypoints: tuple[Floats, ...]
    cost: float
    uncertainty: float = 0.0
    purposes: tuple[ModePurpose, ...] = ()

    @property
    def total(self) -> float:
        """Cost plus uncertainty [steps], by which sequences are ranked."""
        return self.cost + self.uncertainty


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

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
    """The cheapest mode sequences from start to goal, determined by the seed.

    The shortest sequences compete with detours that localise (`localising`) by length and predicted uncertainty.

    Args:
        deadline: of the search; detours are left out where it passes while they are compared.

    In an automaton with many modes, those near a shortest sequence of transitions are searched first: roadmaps of all
    others take most of the time and rarely matter.

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
            # That there is no other path near this one does not prove that there is none.
            named = (
                replace(path, edges=tuple(kept[i] for i in path.edges), purposes=avoidable_modes(path.purposes))
                for path in sequences
            )
            return SearchResult(tuple(named))
    return _searched(problem, limits, start_mode, seed, deadline)


def _modes_near_the_way(problem: Problem, start_mode: str) -> set[str]:
    """Modes of sequences with a limited number of transitions beyond the shortest; all if there are few."""
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
    """Number of transitions from the first modes to each reachable mode."""
    steps_to, level, steps = dict.fromkeys(first, 0), first, 0
    while level:
        steps += 1
        level = {after for name in level for after in neighbours.get(name, set())} - steps_to.keys()
        steps_to.update(dict.fromkeys(level, steps))
    return steps_to


def _searched(problem: Problem, limits: Limits, start_mode: str, seed: int, deadline: Deadline) -> SearchResult:
    """`search_modes` over all modes; among obstacles repeated with more states if few do not connect."""
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
        easier = relaxed_graphs(problem, limits, roadmap, samples.points, deadline)
        in_the_way = blocking_constraints(roadmap, easier, revisits, deadline)
        return SearchResult((), why_disconnected(problem, limits, samples, in_the_way))
    beliefs = PathBeliefs(problem, limits, roadmap, samples.points)
    chosen = best_paths(roadmap, beliefs, shortest, revisits, deadline)[:candidates]
    found = [_mode_sequence(path, beliefs, motions) for path in chosen]
    # Every path visits the mode that it starts in.
    visited = dict.fromkeys(mode for sequence in found for mode in sequence.modes if mode != start_mode)
    purposes = PathsWithoutMode(problem, limits, samples, roadmap, beliefs, deadline).purposes(visited)
    return SearchResult(
        tuple(
            replace(way, purposes=tuple(purposes[mode] for mode in dict.fromkeys(way.modes) if mode in purposes))
            for way in found
        )
    )


def _joined(
    problem: Problem, limits: Limits, samples: Samples, motions: Mapping[str, ModeMotion], deadline: Deadline
) -> JoinedRoadmap:
    """Roadmaps of all modes joined by the guard edges of the samples."""
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


def _mode_sequence(path: ScoredPath, beliefs: PathBeliefs, motions: dict[str, ModeMotion]) -> ModeSequence:
    """The path split into modes, with corners shortcut between stops."""
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
    return ModeSequence(tuple(modes), edges_of(path, beliefs), tuple(waypoints), path.length, path.uncertainty)
