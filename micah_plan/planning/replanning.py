"""What a new plan starts from while another is being followed: the belief of now, and what is left of the old plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import own_size
from micah_plan.automaton.thresholds import with_known_boundaries
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.search.mode_search import ModeSequence
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start


def believed_problem(problem: Problem, belief: HybridBelief) -> Problem:
    """The problem from the most likely mode of a belief, its stds taken as independent.

    Thresholds are where the belief has learned that they are, and known as well.
    """
    index = belief.most_likely
    stds = np.linalg.norm(belief.factors[index], axis=1)
    mode = problem.automaton.modes[index].name
    start = Start(tuple(map(float, belief.means[index])), tuple(map(float, stds)), mode)
    automaton = problem.automaton
    if belief.shifts is not None and belief.shift_stds is not None:
        automaton = with_known_boundaries(automaton, belief.shifts[index], belief.shift_stds[index])
    return replace(problem, start=start, automaton=automaton)


def with_memory(problem: Problem, sequence: ModeSequence) -> ModeSequence:
    """A sequence found over x as one over (x, m), m as at the start of the problem: search asks for x only."""
    memory = np.array(problem.start.mean[own_size(problem.automaton) :])
    paths = [np.hstack([path, np.tile(memory, (len(path), 1))]) for path in sequence.waypoints]
    return replace(sequence, waypoints=tuple(paths))


def rest_of(automaton: HybridAutomaton, trajectory: Trajectory, knot: int) -> tuple[ModeSequence, list[int]]:
    """The modes and means that a trajectory goes through from a knot on, as a search would give them.

    Returns:
        the sequence, and the number of steps in each of its modes.
    """
    modes: list[str] = []
    edges: list[int] = []
    waypoints: list[list[Floats]] = []
    for k in range(knot, len(trajectory.modes)):
        if not modes or trajectory.is_transition[k - 1]:
            if modes:
                edges.append(_edge_taken(automaton, trajectory, k - 1))
            modes.append(trajectory.modes[k])
            waypoints.append([])
        waypoints[-1].append(trajectory.means[k])
    steps = [len(means) - 1 for means in waypoints]
    return ModeSequence(tuple(modes), tuple(edges), tuple(map(np.array, waypoints)), float(sum(steps))), steps


def _edge_taken(automaton: HybridAutomaton, trajectory: Trajectory, knot: int) -> int:
    """The edge of the transition after a knot: of several between its modes the one whose guard holds best."""
    ends = trajectory.modes[knot], trajectory.modes[knot + 1]
    u = trajectory.inputs[min(knot + 1, len(trajectory.inputs) - 1)]
    between = [i for i, edge in enumerate(automaton.edges) if (edge.source, edge.target) == ends]
    margins = [automaton.edges[i].guard.margins(trajectory.means[knot], u).min(initial=np.inf) for i in between]
    return between[int(np.argmax(margins))]
