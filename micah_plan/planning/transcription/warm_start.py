"""A plan's programme that is kept: what is left of the plan is optimised again without building anything anew.

What has been done is held fixed by bounds on its variables, its rows are let go, and the state of the knot where the
plan is left is the belief of then. IPOPT starts from the plan and its multipliers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.region import HalfSpace
from micah_plan.planning.transcription.layout import pack
from micah_plan.planning.transcription.programme import Transcription
from micah_plan.planning.transcription.solve import FEASIBLE, BeliefPath, blocks_of, ipopt_options, path_of
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Bounds = tuple[Floats, Floats]

# How far from the boundaries the barrier begins, and starts are moved away from them, for a start that is nearly right.
_BARRIER, _PUSH = 1e-4, 1e-8
_WARM = {
    "mu_strategy": "monotone",
    "mu_init": _BARRIER,
    "warm_start_init_point": "yes",
    "warm_start_bound_push": _PUSH,
    "warm_start_bound_frac": _PUSH,
    "warm_start_slack_bound_push": _PUSH,
    "warm_start_slack_bound_frac": _PUSH,
    "warm_start_mult_bound_push": _PUSH,
}


class WarmStartedProgramme:
    """The programme of a plan, solved once from its start.

    Attributes:
        path: the optimum; what is asked for later is a rest of it.
    """

    def __init__(self, nlp: Transcription, problem: Problem) -> None:
        """Args: the programme of the whole plan, and its problem."""
        self._nlp, self._problem = nlp, problem
        programme: dict[str, Any] = {"x": ca.vertcat(*nlp.w), "f": nlp.cost, "g": ca.vertcat(*nlp.g)}
        options = ipopt_options(problem.settings.time_limit_s, expand=True)
        options["ipopt"] |= _WARM
        self._solver = ca.nlpsol("kept", "ipopt", programme, options)
        self._bounds = np.concatenate(nlp.w_lower), np.concatenate(nlp.w_upper)
        self._rows = nlp.rows.lower, nlp.rows.upper
        # A plan that is left at a knot has no more to do with what ends there or before: its inputs and what they must
        # be, the dynamics that led there, and the boundaries at that knot itself, since the belief is where it is.
        ended = [row.knot + (row.kind not in ("dynamics", "boundary")) for row in nlp.rows.rows]
        self._row_ends, (self._ends, self._is_state) = np.array(ended), _layout(nlp)
        self._first = self._solved(np.concatenate(nlp.w_start), self._bounds, self._rows)
        self.path = self._path(self._first, self._rows)

    def rest(self, mean: Floats, factor: Floats, trajectory: Trajectory, knot: int) -> BeliefPath:
        """What is left of the plan from a belief on; infeasible if the solver did not find that it can be.

        Args:
            mean, factor: (n,), (n, n) of the belief.
            trajectory, knot: the plan or a rest of it, and the knot that the belief is at.
        """
        done = len(self.path.modes) - (len(trajectory.modes) - knot)
        start = self._values(trajectory, knot, done)
        lower, upper = (bounds.copy() for bounds in self._bounds)
        past, here = self._ends <= done, self._is_state & (self._ends == done + 1)
        lower[past] = upper[past] = start[past]
        lower[here] = upper[here] = start[here] = pack(mean[None], factor[None], self._nlp.pattern).ravel()
        gone = self._row_ends <= done
        rows = np.where(gone, -np.inf, self._rows[0]), np.where(gone, np.inf, self._rows[1])
        path = self._path(self._solved(start, (lower, upper), rows, self._first), rows)
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
        """The boundaries that a rest of the plan still has to keep, or to cross."""
        done = len(self.path.modes) - (len(trajectory.modes) - knot)
        ahead = zip(self._nlp.rows.rows, self._row_ends > done, strict=True)
        return {row.half_space for row, is_ahead in ahead if is_ahead and row.half_space is not None}

    def _solved(
        self, start: Floats, bounds: Bounds, rows: Bounds, before: dict[str, ca.DM] | None = None
    ) -> dict[str, ca.DM]:
        """The solver's answer, from the multipliers of another one if there is one."""
        multipliers = {} if before is None else {"lam_x0": before["lam_x"], "lam_g0": before["lam_g"]}
        found: dict[str, ca.DM] = self._solver(
            x0=start, lbx=bounds[0], ubx=bounds[1], lbg=rows[0], ubg=rows[1], **multipliers
        )
        return found

    def _path(self, found: dict[str, ca.DM], rows: Bounds) -> BeliefPath:
        values, g = (np.array(found[key], dtype=float).ravel() for key in ("x", "g"))
        statistics = self._solver.stats()
        missed = np.max(np.maximum(rows[0] - g, g - rows[1]), initial=0.0)
        feasible = bool(statistics["success"]) and bool(missed <= FEASIBLE)  # a NaN is none
        said, iterations = str(statistics["return_status"]), int(statistics["iter_count"])
        return path_of(self._nlp, self._problem, values, float(found["f"]), feasible, said, iterations)

    def _values(self, trajectory: Trajectory, knot: int, done: int) -> Floats:
        """The decision variables of the plan up to a knot of it, and from there of a rest of it; slacks of the plan."""
        means = np.concatenate([self.path.means[:done], trajectory.means[knot:]])
        factors = np.concatenate([self.path.factors[:done], trajectory.factors[knot:]])
        inputs = np.concatenate([self.path.inputs[:done], trajectory.inputs[knot:]])
        values = np.array(self._first["x"], dtype=float).ravel()
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
        slacks = [guess.first_knot + row.step for row in phase.corridor if row.uncertain]
        blocks = np.repeat(knots + 1, phase.states.shape[0]), np.repeat(knots[:-1] + 1, phase.inputs.shape[0])
        ends += [*blocks, np.array(slacks, dtype=np.int64)]
        is_state += [np.ones(blocks[0].size, dtype=bool), np.zeros(blocks[1].size + len(slacks), dtype=bool)]
    return np.concatenate(ends), np.concatenate(is_state)
