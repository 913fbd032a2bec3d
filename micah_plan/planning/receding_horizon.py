"""What is left of a plan, optimised again and again from the beliefs of an execution."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.thresholds import boundaries_of_pins, boundary_of, boundary_stds
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.input_memory import with_input_memory
from micah_plan.planning.limits import Limits, limits_of
from micah_plan.planning.pomdp_hd import believed_problem, trajectory_of
from micah_plan.planning.search.mode_search import ModeSequence
from micah_plan.planning.transcription.guess import guess_again
from micah_plan.planning.transcription.programme import Transcription, transcribe
from micah_plan.planning.transcription.solve import BeliefPath, solve
from micah_plan.planning.transcription.warm_start import WarmStartedProgramme
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

# Nothing was learned of a threshold while it is believed to lie less than this many of its stds elsewhere, and its std
# has become smaller by less than this share.
_LEARNED = 0.1


class RecedingHorizon:
    """Continues one plan: modes and numbers of steps stay, there is no search, and the end comes no later.

    The plan's programme is built once and reused (`transcription.warm_start`). A new one is built where it would be
    another: if the filter has learned where a threshold lies that is still ahead, or if the trajectory is no rest of
    the plan; and where the reused one gives no answer that meets all its rows. Answers do not depend on earlier ones.

    Attributes:
        reused, built: how many answers came from the plan's programme, and from new ones.
    """

    def __init__(self, problem: Problem, trajectory: Trajectory) -> None:
        """Args: the problem, and the plan's trajectory."""
        settings = problem.settings
        settings = replace(settings, time_limit_s=min(settings.time_limit_s, settings.solve_time_limit_s))
        self._problem, self._plan = with_input_memory(replace(problem, settings=settings)), trajectory
        self._limits, self._whole = limits_of(self._problem), rest_of(problem.automaton, trajectory, 0)
        self.reused = self.built = 0

    def __call__(self, belief: HybridBelief, trajectory: Trajectory, knot: int) -> Trajectory | None:
        """What is left of a trajectory from a knot on, optimised again from a belief in that knot's mode.

        None where the steps left do not suffice, the belief is in another mode, or the trajectory is of a planner that
        leaves a memory of inputs out.
        """
        here = believed_problem(self._problem, belief)
        if here.start.mode != trajectory.modes[knot] or trajectory.means.shape[1] != here.automaton.n:
            return None
        if self._is_rest(trajectory, knot) and not self._has_learned(belief, trajectory, knot):
            path = self.from_plan(here.start, trajectory, knot)
            if path.feasible:
                self.reused += 1
                return trajectory_of(here, self._limits, path)
        path = from_new(here, trajectory, knot)
        self.built += path.feasible
        return trajectory_of(here, limits_of(here), path) if path.feasible else None

    def from_plan(self, start: Start, trajectory: Trajectory, knot: int) -> BeliefPath:
        """What is left of the plan from a belief on, by the plan's programme; it may be infeasible."""
        return self._programme.rest(np.array(start.mean), np.diag(np.array(start.std)), trajectory, knot)

    @cached_property
    def _programme(self) -> WarmStartedProgramme:
        """That of the whole plan, from where it starts."""
        plan, stds = self._plan, np.linalg.norm(self._plan.factors[0], axis=1)
        start = Start(tuple(map(float, plan.means[0])), tuple(map(float, stds)), plan.modes[0])
        whole = replace(self._problem, start=start)
        return WarmStartedProgramme(_programme(whole, self._limits, plan, 0), whole.settings.time_limit_s)

    def _is_rest(self, trajectory: Trajectory, knot: int) -> bool:
        """Whether a trajectory from a knot on goes the way that the plan does at its end, in as many steps."""
        (plan, steps), (rest, left) = self._whole, rest_of(self._problem.automaton, trajectory, knot)
        first = len(steps) - len(left)
        same = first >= 0 and (plan.modes[first:], plan.edges[first:]) == (rest.modes, rest.edges)
        return same and steps[first + 1 :] == left[1:] and steps[first] >= left[0]

    def _has_learned(self, belief: HybridBelief, trajectory: Trajectory, knot: int) -> bool:
        """Whether a threshold that is still ahead was learned to lie elsewhere, or where it lies more precisely."""
        automaton, number = self._problem.automaton, belief.most_likely
        if belief.shifts is None or belief.shift_stds is None:
            return False
        shifts, stds = belief.shifts[number].tolist(), belief.shift_stds[number].tolist()
        learned = {
            boundary
            for (boundary, before), shift, now in zip(boundary_stds(automaton).items(), shifts, stds, strict=True)
            if abs(shift) > _LEARNED * before or now < (1.0 - _LEARNED) * before
        }
        if not learned:
            return False
        entered = set(trajectory.modes[knot:]) - {trajectory.modes[knot]}
        ahead = {boundary_of(half_space)[0] for half_space in self._programme.half_spaces(trajectory, knot)}
        for mode in entered:
            ahead |= set(boundaries_of_pins(automaton, automaton.mode(mode)).values())
        return bool(learned & ahead)


def from_new(here: Problem, trajectory: Trajectory, knot: int) -> BeliefPath:
    """What is left of a trajectory from a knot on, from a problem's start, by a programme of its own."""
    return solve(_programme(here, limits_of(here), trajectory, knot), here.settings.time_limit_s)


def _programme(problem: Problem, limits: Limits, trajectory: Trajectory, knot: int) -> Transcription:
    """The programme of what is left of a trajectory from a knot on, from the problem's start."""
    sequence, steps = rest_of(problem.automaton, trajectory, knot)
    return transcribe(problem, limits, guess_again(problem, limits, sequence, steps))


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
