"""Receding horizon: the remainder of a plan, optimised repeatedly from the beliefs of an execution.

The plan's programme is built once. Variables of past steps are fixed by their bounds, their rows are released; the
state of the knot where the plan is left is the belief there. The solver starts from the plan and its multipliers.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.drawn_thresholds import boundaries_of_pins, boundary_of, boundary_stds
from micah_plan.automaton.region import HalfSpace
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.input_memories import with_input_memory
from micah_plan.planning.limits import Limits, limits_of
from micah_plan.planning.nlp import Solution, Solver
from micah_plan.planning.pomdp_hd import trajectory_of
from micah_plan.planning.replanning import believed_problem, rest_of
from micah_plan.planning.transcription.guess import guess_again
from micah_plan.planning.transcription.packed_belief import pack
from micah_plan.planning.transcription.programme import Transcription, transcribe
from micah_plan.planning.transcription.solve import BeliefPath, blocks_of, path_of, solve_transcription
from micah_plan.planning.zero_time_transitions import with_zero_time_transitions
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem
from micah_plan.task.start import Start

# A threshold counts as learned once its estimate has moved by this many of its stds, or its std shrunk by this share.
_LEARNED = 0.1


class RecedingHorizon:
    """Replans the remainder of one plan: modes and numbers of steps are kept, without search, and never longer.

    The plan's programme is built once and reused (`WarmStartedProgramme`). A new one is built where it would differ: if
    the filter has updated a threshold ahead, or if the trajectory is not the end of the plan; and where the reused one
    has no feasible solution. Results do not depend on earlier ones.

    Attributes:
        reused, built: number of results from the plan's programme, and from new ones.
    """

    def __init__(self, problem: Problem, trajectory: Trajectory) -> None:
        """Args: the problem, and the plan's trajectory."""
        problem = pre_release_problem(problem)
        settings = problem.settings
        settings = replace(settings, time_limit_s=min(settings.time_limit_s, settings.solve_time_limit_s))
        self._problem, self._plan = with_input_memory(replace(problem, settings=settings)), trajectory
        self._limits = limits_of(self._problem)
        self._whole = rest_of(with_zero_time_transitions(self._problem).automaton, trajectory, 0)
        self.reused = self.built = 0

    def __call__(self, belief: HybridBelief, trajectory: Trajectory, knot: int) -> Trajectory | None:
        """The remainder of a trajectory from a knot, optimised from a belief in that knot's mode.

        None where the steps left do not suffice, the belief is in another mode, or the trajectory is of a planner that
        leaves a memory of inputs out.
        """
        here = with_zero_time_transitions(believed_problem(self._problem, belief))
        if here.start.mode != trajectory.modes[knot] or trajectory.means.shape[1] != here.automaton.n:
            return None
        if self._is_end_of_plan(trajectory, knot) and not self._has_new_threshold(belief, trajectory, knot):
            path = self.from_plan(here.start, trajectory, knot)
            if path.feasible:
                self.reused += 1
                return trajectory_of(here, self._limits, path)
        path = remainder_by_new_programme(here, trajectory, knot)
        self.built += path.feasible
        return trajectory_of(here, limits_of(here), path) if path.feasible else None

    def from_plan(self, start: Start, trajectory: Trajectory, knot: int) -> BeliefPath:
        """The remainder of the plan from a belief, by the reused programme; it may be infeasible."""
        return self._programme.remainder(np.array(start.mean), np.diag(np.array(start.std)), trajectory, knot)

    @cached_property
    def _programme(self) -> WarmStartedProgramme:
        """The programme of the whole plan."""
        plan, stds = self._plan, np.linalg.norm(self._plan.factors[0], axis=1)
        start = Start(tuple(map(float, plan.means[0])), tuple(map(float, stds)), plan.modes[0])
        whole = replace(self._problem, start=start)
        return WarmStartedProgramme(_programme(whole, self._limits, plan, 0), whole.settings.time_limit_s)

    def _is_end_of_plan(self, trajectory: Trajectory, knot: int) -> bool:
        """Whether a trajectory from a knot equals the end of the plan in modes, edges and steps."""
        (plan, steps), (remainder, remaining) = (
            self._whole,
            rest_of(with_zero_time_transitions(self._problem).automaton, trajectory, knot),
        )
        first = len(steps) - len(remaining)
        same = first >= 0 and (plan.modes[first:], plan.edges[first:]) == (remainder.modes, remainder.edges)
        return same and steps[first + 1 :] == remaining[1:] and steps[first] >= remaining[0]

    def _has_new_threshold(self, belief: HybridBelief, trajectory: Trajectory, knot: int) -> bool:
        """Whether the filter has changed the estimate of a threshold ahead, or its std."""
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
        ahead = {boundary_of(half_space)[0] for half_space in self._programme.half_spaces(trajectory, knot)}
        for mode in set(trajectory.modes[knot:]) - {trajectory.modes[knot]}:
            ahead |= set(boundaries_of_pins(automaton, automaton.mode(mode)).values())
        return bool(learned & ahead)


def remainder_by_new_programme(here: Problem, trajectory: Trajectory, knot: int) -> BeliefPath:
    """The remainder of a trajectory from a knot and a problem's start, by a programme built for it."""
    return solve_transcription(_programme(here, limits_of(here), trajectory, knot), here.settings.time_limit_s)


def _programme(problem: Problem, limits: Limits, trajectory: Trajectory, knot: int) -> Transcription:
    """The programme of the remainder of a trajectory from a knot and the problem's start."""
    problem = with_zero_time_transitions(problem)
    sequence, steps = rest_of(problem.automaton, trajectory, knot)
    return transcribe(problem, limits, guess_again(problem, limits, sequence, steps))


class WarmStartedProgramme:
    """The programme of a plan, solved once from its start.

    Attributes:
        path: the optimum, of which later answers are the end.
    """

    def __init__(self, nlp: Transcription, time_limit_s: float) -> None:
        """Args: the programme of the whole plan, and the limit of each solution [s]."""
        self._nlp, self._programme = nlp, nlp.programme
        self._solver = Solver(self._programme, time_limit_s, warm_start=True)
        # Where a plan is left at a knot, the rows that end there or before no longer apply: of inputs, of the dynamics
        # that led there, and of the state at that knot, which is now given by the belief.
        ended = [row.knot + (row.kind not in ("dynamics", "boundary", "path")) for row in nlp.rows]
        self._row_ends, (self._ends, self._is_state) = np.array(ended), _layout(nlp)
        self._first = self._solver.solve()
        self.path = self._path(self._first)

    def remainder(self, mean: Floats, factor: Floats, trajectory: Trajectory, knot: int) -> BeliefPath:
        """The remainder of the plan from a belief; infeasible if the solver did not converge to a feasible one.

        Args:
            mean, factor: (n,), (n, n) of the belief.
            trajectory, knot: the plan or a rest of it, and the knot that the belief is at.
        """
        done = len(self.path.modes) - (len(trajectory.modes) - knot)
        start = self._values(trajectory, knot, done)
        lower, upper = (bound.copy() for bound in self._programme.bounds)
        past, here = self._ends <= done, self._is_state & (self._ends == done + 1)
        lower[past] = upper[past] = start[past]
        lower[here] = upper[here] = start[here] = pack(mean[None], factor[None], self._nlp.pattern).ravel()
        gone = self._row_ends <= done
        row_lower, row_upper = self._programme.row_bounds
        rows = np.where(gone, -np.inf, row_lower), np.where(gone, np.inf, row_upper)
        path = self._path(self._solver.solve(start, (lower, upper), rows, self._first))
        rest_of_path = {
            name: getattr(path, name)[done:] for name in ("modes", "means", "factors", "inputs", "is_transition")
        }
        return replace(path, **rest_of_path)

    def half_spaces(self, trajectory: Trajectory, knot: int) -> set[HalfSpace]:
        """The boundaries that the rest of the plan must respect or cross."""
        done = len(self.path.modes) - (len(trajectory.modes) - knot)
        ahead = zip(self._nlp.rows, self._row_ends > done, strict=True)
        return {row.half_space for row, is_ahead in ahead if is_ahead and row.half_space is not None}

    def _path(self, solution: Solution) -> BeliefPath:
        """The path of a solution, feasible only if the solver has converged."""
        return path_of(self._nlp, replace(solution, is_feasible=solution.has_converged and solution.is_feasible))

    def _values(self, trajectory: Trajectory, knot: int, done: int) -> Floats:
        """Decision variables: of the plan up to a knot, of its remainder after it, and the plan's slacks."""
        means, factors, inputs = (
            np.concatenate([getattr(self.path, name)[:done], getattr(trajectory, name)[knot:]])
            for name in ("means", "factors", "inputs")
        )
        values = self._first.w.copy()
        for guess, (states, steps, _) in zip(self._nlp.guess, blocks_of(self._nlp, values), strict=True):
            knots = slice(guess.first_knot, guess.first_knot + guess.steps + 1)
            states[:] = pack(means[knots], factors[knots], self._nlp.pattern)
            steps[:] = inputs[guess.first_knot : guess.first_knot + guess.steps].T
        return values


def _layout(nlp: Transcription) -> tuple[Ints, Booleans]:
    """Per decision variable: the first knot at which it is in the past, and whether it belongs to a state."""
    ends, is_state = [], []
    for guess, phase in zip(nlp.guess, nlp.phases, strict=True):
        knots = guess.first_knot + np.arange(guess.steps + 1)
        slacks = [nlp.rows[number].knot for number, _ in phase.soft]
        blocks = np.repeat(knots + 1, phase.states.shape[0]), np.repeat(knots[:-1] + 1, phase.inputs.shape[0])
        ends += [*blocks, np.array(slacks, dtype=np.int64)]
        is_state += [np.ones(blocks[0].size, dtype=bool), np.zeros(blocks[1].size + len(slacks), dtype=bool)]
    return np.concatenate(ends), np.concatenate(is_state)
