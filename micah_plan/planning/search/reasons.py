"""Why the high-level search found no mode sequence, in one sentence with a remedy."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.planning.limits import Limits
from micah_plan.planning.search.polytope import mode_states
from micah_plan.planning.search.samples import Samples, guard_states
from micah_plan.task.problem import Problem


def why_unreachable(problem: Problem, limits: Limits, samples: Samples, start_mode: str) -> str:
    """Why no chain of transitions leads to the goal, whatever the path inside the modes; empty if one does."""
    if not samples.goals:
        return _no_mode_holds_goal(problem, limits)
    edges = [(i, edge) for i, edge in enumerate(problem.automaton.edges) if not edge.is_self_transition]
    if not set(samples.goals) & _reachable(start_mode, (edge for _, edge in edges)):
        goals = ", ".join(f"'{name}'" for name in samples.goals)
        return (
            f"no transitions lead from the start's mode '{start_mode}' to a mode that holds the goal ({goals}); "
            f"change the goal or add the missing transition to the model"
        )
    reached = _reachable(start_mode, (edge for i, edge in edges if i in samples.exits))
    if set(samples.goals) & reached:
        return ""
    return _closed_edge(problem, limits, next(e for i, e in edges if e.source in reached and e.target not in reached))


def why_disconnected(problem: Problem, start_mode: str, samples: Samples, in_the_way: tuple[str, ...] = ()) -> str:
    """Why the roadmaps do not connect start and goal although the transitions do.

    Args:
        in_the_way: guards without any one of which they would be connected.
    """
    automaton = problem.automaton
    edges = (automaton.edges[i] for i in samples.exits)
    moved = np.any([automaton.mode(name).driven for name in _reachable(start_mode, edges)], axis=0)
    for index, value, tolerance in problem.goal.target:
        start, coordinate = problem.start.mean[index], automaton.coordinates[index]
        if not moved[index] and abs(start - value) > tolerance:
            return (
                f"'{coordinate.name}' starts at {start:g} {coordinate.unit} and the goal is {value:g} ± {tolerance:g} "
                f"{coordinate.unit}, but no mode that can be reached moves it; change the goal or the start"
            )
    if in_the_way:
        return (
            f"no motion of the modes that can be reached leads to the goal without '{in_the_way[0]}', which alone is "
            f"in the way{_others(in_the_way[1:])}; make room there, or let the object change its mode first"
        )
    return (
        f"the roadmaps ({problem.settings.samples_per_mode} states per mode) do not connect the start to the goal: "
        f"guards of other transitions are in the way, or there are too few states; raise samples_per_mode"
    )


def _no_mode_holds_goal(problem: Problem, limits: Limits) -> str:
    automaton = problem.automaton
    wanted = _listed(
        f"{automaton.coordinates[i].name} = {value:g} ± {tolerance:g} {automaton.coordinates[i].unit}"
        for i, value, tolerance in problem.goal.target
    )
    names = problem.goal.modes or automaton.mode_names
    indices = list(problem.goal.indices)
    ranges = "; ".join(f"'{name}' {_range_text(automaton, limits, name, indices)}" for name in names)
    among = "the goal's modes" if problem.goal.modes else "the modes"
    return f"the goal {wanted} lies in the range of none of {among} ({ranges}); move the goal into a range"


def _range_text(automaton: HybridAutomaton, limits: Limits, name: str, indices: list[int]) -> str:
    states = mode_states(automaton.mode(name), limits.lower, limits.upper, limits.max_step)
    return "holds " + _listed(
        f"{automaton.coordinates[i].name} in [{states.lower[i]:g}, {states.upper[i]:g}] {automaton.coordinates[i].unit}"
        for i in indices
    )


def _closed_edge(problem: Problem, limits: Limits, edge: Edge) -> str:
    if guard_states(problem, limits, edge).is_empty:
        rows = _listed(f"'{h.name}'" for h in edge.guard.half_spaces)
        return (
            f"the guard of '{edge.name}' ({rows}) holds nowhere in mode '{edge.source}' with inputs up to max_step; "
            f"check it against the mode's invariant, or raise max_step"
        )
    return (
        f"the reset of '{edge.name}' leads out of the invariant of mode '{edge.target}'; "
        f"correct the reset or the invariant in the model"
    )


def _reachable(start: str, edges: Iterable[Edge]) -> set[str]:
    following: dict[str, list[str]] = {}
    for edge in edges:
        following.setdefault(edge.source, []).append(edge.target)
    reached, frontier = {start}, [start]
    while frontier:
        new = [target for target in following.get(frontier.pop(), []) if target not in reached]
        reached.update(new)
        frontier.extend(new)
    return reached


def _others(names: tuple[str, ...]) -> str:
    return f" (as is {_listed(repr(name) for name in names)})" if names else ""


def _listed(items: Iterable[str]) -> str:
    return ", ".join(items)
