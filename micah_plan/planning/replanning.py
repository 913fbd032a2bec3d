"""Replanning during execution: from the current belief, along the remaining modes of the plan if possible."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from micah_plan.automaton.drawn_thresholds import with_boundaries
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import own_size
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.around_bodies import with_scene
from micah_plan.planning.attempt import Attempt
from micah_plan.planning.input_memories import with_input_memory
from micah_plan.planning.limits import limits_of, motion_per_input
from micah_plan.planning.pomdp_hd import planned
from micah_plan.planning.search.mode_search import ModeSequence, SearchResult
from micah_plan.planning.tightening import verified_plan
from micah_plan.planning.verification import verify
from micah_plan.planning.zero_time_transitions import with_zero_time_transitions
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem
from micah_plan.task.start import Start


def replan(
    problem: Problem, belief: HybridBelief, followed: tuple[Trajectory, int] | None = None, seed: int = 0
) -> Trajectory | None:
    """A new trajectory from the most likely mode of a belief (`believed_problem`).

    The remaining modes of the followed plan are tried first; mode sequences are searched only if roll-outs confirm no
    trajectory through these. `verify` decides sequentially, with no more roll-outs than necessary.

    Args:
        problem: with the goal.
        belief: of the filter, now.
        followed: the trajectory that is followed and the knot that the next input belongs to; None: there is none.
        seed: of search and roll-outs.

    Returns:
        None if there is no trajectory, or none that roll-outs confirm.
    """
    here = with_scene(believed_problem(with_input_memory(pre_release_problem(problem)), belief))
    # Both attempts share one time limit: the execution waits for them.
    deadline, confirm = Deadline(here.settings.solve_time_limit_s), partial(verify, sequential=True)
    confirmed = partial(verified_plan, here, seed=seed, deadline=deadline, verifier=confirm)

    def planner(task: Problem, *, deadline: Deadline, search_result: SearchResult | None = None) -> Plan:
        return Attempt(task, seed, deadline).planned_by(partial(planned, search_result=search_result), "search")

    rest = None if followed is None else rest_through(here, *followed)
    if rest is not None:
        answer = confirmed(partial(planner, search_result=SearchResult((rest,))), rounds=0)
        if answer.outcome == "solved":
            return answer.trajectory
    answer = confirmed(planner)
    return answer.trajectory if answer.outcome == "solved" else None


def believed_problem(problem: Problem, belief: HybridBelief) -> Problem:
    """The problem from the most likely mode of a belief, its stds taken as independent.

    Thresholds lie where the belief estimates them, with the stds that it has left.
    """
    index = belief.most_likely
    stds = np.linalg.norm(belief.factors[index], axis=1)
    mode = problem.automaton.modes[index].name
    start = Start(tuple(map(float, belief.means[index])), tuple(map(float, stds)), mode)
    automaton = problem.automaton
    if belief.shifts is not None and belief.shift_stds is not None:
        automaton = with_boundaries(automaton, belief.shifts[index], belief.shift_stds[index])
    return replace(problem, start=start, automaton=automaton)


def rest_through(here: Problem, trajectory: Trajectory, knot: int) -> ModeSequence | None:
    """The path over x through the modes that remain of a trajectory, from a problem's start.

    It joins the trajectory where that is nearest, which may be before or after the knot.

    Args:
        here: starts in one of the trajectory's modes.
        trajectory, knot: followed so far, and the knot of the next input.

    Returns:
        None where the trajectory does not lead through the mode of the start, or leaves a memory of inputs out.
    """
    here = with_zero_time_transitions(here)
    mode, limits = here.start.mode, limits_of(here)
    at = [k for k, mode_here in enumerate(trajectory.modes) if mode_here == mode]
    if mode is None or not at or trajectory.means.shape[1] != here.automaton.n:
        return None
    # Of the visits of the mode the present one, otherwise the next, otherwise the last.
    visits = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    visit = next((visit for visit in visits if visit[-1] >= knot), visits[-1])
    start, inverse = np.array(here.start.mean), np.linalg.pinv(motion_per_input(here.automaton, mode, limits.max_step))
    steps = np.abs((trajectory.means[visit] - start) @ inverse.T) / limits.max_step
    sequence, _ = rest_of(here.automaton, trajectory, int(visit[steps.max(axis=1, initial=0.0).argmin()]))
    first, *later = sequence.waypoints
    object_state = slice(own_size(here.automaton))
    return replace(sequence, waypoints=tuple(path[:, object_state] for path in (np.vstack([start, first]), *later)))


def rest_of(automaton: HybridAutomaton, trajectory: Trajectory, knot: int) -> tuple[ModeSequence, list[int]]:
    """The modes and means of a trajectory from a knot on, in the format of a search.

    Returns:
        the sequence, and the number of steps in each of its modes.
    """
    begins = [knot, *(knot + 1 + np.flatnonzero(trajectory.is_transition[knot:])).tolist()]
    edges = [_edge_taken(automaton, trajectory, begin - 1) for begin in begins[1:]]
    waypoints = np.split(trajectory.means[knot:], np.array(begins[1:], dtype=np.int64) - knot)
    steps = [len(means) - 1 for means in waypoints]
    modes = tuple(trajectory.modes[begin] for begin in begins)
    return ModeSequence(modes, tuple(edges), tuple(waypoints), float(sum(steps))), steps


def _edge_taken(automaton: HybridAutomaton, trajectory: Trajectory, knot: int) -> int:
    """The edge of the transition after a knot: of parallel edges the one whose guard holds best."""
    ends = trajectory.modes[knot], trajectory.modes[knot + 1]
    u = trajectory.inputs[min(knot + 1, len(trajectory.inputs) - 1)]
    between = [i for i, edge in enumerate(automaton.edges) if (edge.source, edge.target) == ends]
    margins = [automaton.edges[i].guard.margins(trajectory.means[knot], u).min(initial=np.inf) for i in between]
    return between[int(np.argmax(margins))]
