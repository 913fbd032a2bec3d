"""A plan's programme with a warm start: what is left of the plan is optimised again without building anything anew.

The variables of what has been done are fixed by their bounds, its rows are left open, and the state of the knot where
the plan is left is the belief of then. The solver starts from the plan and its multipliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.region import HalfSpace
from micah_plan.planning.nlp import Solution, Solver
from micah_plan.planning.transcription.layout import pack
from micah_plan.planning.transcription.programme import Transcription
from micah_plan.planning.transcription.solve import BeliefPath, blocks_of, path_of
from micah_plan.task.plan import Trajectory


class WarmStartedProgramme:
    """The programme of a plan, solved once from its start.

    Attributes:
        path: the optimum; what is asked for later is a rest of it.
    """

    def __init__(self, nlp: Transcription, time_limit_s: float) -> None:
        """Args: the programme of the whole plan, and the limit of each solution [s]."""
        self._nlp, self._programme = nlp, nlp.programme
        self._solver = Solver(self._programme, time_limit_s, warm_start=True)
        # A plan that is left at a knot has no more to do with what ends there or before: its inputs and what they must
        # be, the dynamics that led there, and what is asked of that knot itself, since the belief is where it is.
        ended = [row.knot + (row.kind not in ("dynamics", "boundary", "path")) for row in nlp.rows]
        self._row_ends, (self._ends, self._is_state) = np.array(ended), _layout(nlp)
        self._first = self._solver.solve()
        self.path = self._path(self._first)

    def rest(self, mean: Floats, factor: Floats, trajectory: Trajectory, knot: int) -> BeliefPath:
        """What is left of the plan from a belief on; infeasible if the solver did not find that it can be.

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
        after = slice(done, None)
        return replace(
            path,
            modes=path.modes[after],
            means=path.means[after],
            factors=path.factors[after],
            inputs=path.inputs[after],
            is_transition=path.is_transition[after],
        )

    def half_spaces(self, trajectory: Trajectory, knot: int) -> set[HalfSpace]:
        """The boundaries that a rest of the plan still has to stay within, or to cross."""
        done = len(self.path.modes) - (len(trajectory.modes) - knot)
        ahead = zip(self._nlp.rows, self._row_ends > done, strict=True)
        return {row.half_space for row, is_ahead in ahead if is_ahead and row.half_space is not None}

    def _path(self, found: Solution) -> BeliefPath:
        """The path of a solution, which counts only if the solver itself is content: it may have stopped on its way."""
        return path_of(self._nlp, replace(found, is_feasible=found.has_converged and found.is_feasible))

    def _values(self, trajectory: Trajectory, knot: int, done: int) -> Floats:
        """The decision variables of the plan up to a knot of it, and from there of a rest of it; slacks of the plan."""
        means = np.concatenate([self.path.means[:done], trajectory.means[knot:]])
        factors = np.concatenate([self.path.factors[:done], trajectory.factors[knot:]])
        inputs = np.concatenate([self.path.inputs[:done], trajectory.inputs[knot:]])
        values = self._first.w.copy()
        for guess, (states, steps, _) in zip(self._nlp.guess, blocks_of(self._nlp, values), strict=True):
            knots = slice(guess.first_knot, guess.first_knot + guess.steps + 1)
            states[:] = pack(means[knots], factors[knots], self._nlp.pattern)
            steps[:] = inputs[guess.first_knot : guess.first_knot + guess.steps].T
        return values


def _layout(nlp: Transcription) -> tuple[Ints, Booleans]:
    """Per decision variable: the first knot at which it belongs to the past, and whether it is of a state."""
    ends, is_state = [], []
    for guess, phase in zip(nlp.guess, nlp.phases, strict=True):
        knots = guess.first_knot + np.arange(guess.steps + 1)
        slacks = [nlp.rows[number].knot for number, _ in phase.soft]
        blocks = np.repeat(knots + 1, phase.states.shape[0]), np.repeat(knots[:-1] + 1, phase.inputs.shape[0])
        ends += [*blocks, np.array(slacks, dtype=np.int64)]
        is_state += [np.ones(blocks[0].size, dtype=bool), np.zeros(blocks[1].size + len(slacks), dtype=bool)]
    return np.concatenate(ends), np.concatenate(is_state)
