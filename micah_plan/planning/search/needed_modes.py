"""Purpose of a mode: the best path from start to goal, over the same states, that never leaves through it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from scipy.sparse import csr_array

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Edge
from micah_plan.planning.findings import why_disconnected, why_unreachable
from micah_plan.planning.limits import Limits
from micah_plan.planning.search.leaves import leaves_of
from micah_plan.planning.search.localising import best_paths
from micah_plan.planning.search.mode_paths import cheapest_sequences
from micah_plan.planning.search.path_beliefs import PathBeliefs
from micah_plan.planning.search.roadmap import JoinedRoadmap, motions_of, roadmap_of, without_each_obstacle
from micah_plan.planning.search.samples import Samples
from micah_plan.planning.zero_time_transitions import ZeroTimeEdge
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import ModePurpose
from micah_plan.task.problem import Problem

# Largest number of linear programmes for the reason why there is no path without a mode: a search may solve thousands.
_PROGRAMMES = 50


@dataclass(frozen=True, eq=False)
class PathsWithoutMode:
    """Paths through roadmaps that avoid one mode.

    Attributes:
        problem, limits, samples, roadmap, beliefs: of the search.
        deadline: of the search; once it has passed, no purposes are determined.
    """

    problem: Problem
    limits: Limits
    samples: Samples
    roadmap: JoinedRoadmap
    beliefs: PathBeliefs
    deadline: Deadline

    def purposes(self, modes: Iterable[str]) -> dict[str, ModePurpose]:
        """The purposes of modes by name, as far as the deadline allows."""
        purposes = dict[str, ModePurpose]()
        for mode in modes:
            purpose = self._purpose(mode)
            if self.deadline.is_over():  # what was not found in time is inconclusive
                break
            purposes[mode] = purpose
        return purposes

    @cached_property
    def _relaxed(self) -> dict[str, dict[str, csr_array]]:
        return relaxed_graphs(self.problem, self.limits, self.roadmap, self.samples.points, self.deadline)

    def _purpose(self, mode: str) -> ModePurpose:
        """The alternative without a mode: neither left nor ended in."""
        samples, roadmap, automaton = self.samples, self.roadmap, self.problem.automaton
        if not samples.goals.keys() - {mode}:
            return ModePurpose(mode, is_goal=True)
        kept = [i for i, edge in enumerate(automaton.edges) if not _leaves(edge, mode)]
        goals = {name: vertices for name, vertices in samples.goals.items() if name != mode}
        exits = {new: samples.exits[old] for new, old in enumerate(kept) if old in samples.exits}
        ends = {new: roadmap.ends[old] for new, old in enumerate(kept) if old in roadmap.ends}
        reduced = replace(roadmap, exits=exits, ends=ends, goals=goals)
        revisits = self.problem.settings.revisits
        if shortest := cheapest_sequences(reduced, 1, revisits=revisits, is_over=self.deadline.is_over):
            best = best_paths(reduced, self.beliefs, shortest, revisits, self.deadline)[0]
            names = list(self.beliefs.index)
            taken = [names[k] for k in self.beliefs.mode_of[list(best.vertices)]]
            without = tuple(name for k, name in enumerate(taken) if k == 0 or name != taken[k - 1])
            return ModePurpose(mode, without=without, steps_without=best.cost)
        model = replace(automaton, edges=tuple(automaton.edges[i] for i in kept))
        goal = replace(self.problem.goal, modes=tuple(goals))
        settings = replace(self.problem.settings, search_limit=min(self.problem.settings.search_limit, _PROGRAMMES))
        problem = replace(self.problem, automaton=model, goal=goal, settings=settings)
        left = replace(samples, exits=exits, goals=goals)
        if (reason := why_unreachable(problem, self.limits, left)) is None:
            in_the_way = blocking_constraints(reduced, self._relaxed, revisits, self.deadline)
            reason = why_disconnected(problem, self.limits, left, in_the_way, revisiting=False)
        return ModePurpose(mode, why=reason.sentence)


def _leaves(edge: Edge, mode: str) -> bool:
    """Whether a transition leaves a mode, or passes through it."""
    return mode == edge.source or (isinstance(edge, ZeroTimeEdge) and mode in edge.through)


def avoidable_modes(purposes: Sequence[ModePurpose]) -> tuple[ModePurpose, ...]:
    """The purposes of modes that can be avoided."""
    return tuple(purpose for purpose in purposes if purpose.without)


def relaxed_graphs(
    problem: Problem, limits: Limits, roadmap: JoinedRoadmap, points: Mapping[str, Floats], deadline: Deadline
) -> dict[str, dict[str, csr_array]]:
    """(v, v) graphs of all modes without one constraint or guard each; empty if time runs out."""
    leaves = {mode.name: leaves_of(mode, limits) for mode in problem.automaton.modes}
    easier = dict[str, dict[str, csr_array]]()
    for constraint in problem.constraints:
        others = tuple(c for c in problem.constraints if c.name != constraint.name)
        motions = motions_of(replace(problem, constraints=others), limits)
        if deadline.is_over():
            return {}
        easier[constraint.name] = {mode: roadmap_of(points[mode], leaves[mode], motions[mode]) for mode in points}
    motions = motions_of(problem, limits)
    for mode in points:
        for name, graph in without_each_obstacle(points[mode], leaves[mode], motions[mode]).items():
            easier[name] = {**easier.get(name, roadmap.graphs), mode: graph}
    return easier


def blocking_constraints(
    roadmap: JoinedRoadmap, easier: Mapping[str, Mapping[str, csr_array]], revisits: int, deadline: Deadline
) -> tuple[str, ...]:
    """Constraints and guards without any one of which the samples connect start and goal.

    That nothing connects start and goal is certain; the constraints in the way are not determined once the deadline has
    passed.
    """
    found = []
    for name, graphs in easier.items():
        if deadline.is_over():
            return ()
        if cheapest_sequences(replace(roadmap, graphs=graphs), 1, revisits=revisits):
            found.append(name)
    return tuple(found)
