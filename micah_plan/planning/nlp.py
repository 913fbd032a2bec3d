"""Nonlinear programmes and their solver: IPOPT through CasADi. No other module depends on the solver.

    minimise cost(w)  with  lower <= w <= upper  and  row_lower <= rows(w) <= row_upper

Source: Wächter and Biegler, "On the implementation of an interior-point filter line-search algorithm for large-scale
nonlinear programming", Mathematical Programming 2006.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from micah_plan.arrays import Floats
from micah_plan.planning import messages

Bounds = tuple[Floats, Floats]

# Violation of a row or bound that a result may have [unit of the row]: ours, independent of the solver's status.
FEASIBLE = 1e-5

_SOLVER = "ipopt"
_MAX_ITERATIONS = 500
_OUT_OF_TIME = ("Maximum_WallTime_Exceeded", "Maximum_CpuTime_Exceeded")
# For a start that is nearly right: how far from the bounds the barrier begins, and starts are pushed away from them.
_BARRIER, _PUSH = 1e-4, 1e-8
_WARM_START = {
    "mu_strategy": "monotone",
    "mu_init": _BARRIER,
    "warm_start_init_point": "yes",
    "warm_start_bound_push": _PUSH,
    "warm_start_bound_frac": _PUSH,
    "warm_start_slack_bound_push": _PUSH,
    "warm_start_slack_bound_frac": _PUSH,
    "warm_start_mult_bound_push": _PUSH,
}


@dataclass(frozen=True, eq=False)
class Programme:
    """A nonlinear programme of d variables and r rows.

    Attributes:
        w: (d, 1) symbols; cost: (1, 1) and rows: (r, 1) expressions in them.
        start: (d,) where to begin.
        bounds: (d,) lower and upper bounds of w; row_bounds: (r,) of the rows; infinite where open.
    """

    w: ca.MX
    cost: ca.MX
    rows: ca.MX
    start: Floats
    bounds: Bounds
    row_bounds: Bounds

    @cached_property
    def _values(self) -> ca.Function:
        """CasADi function from w to cost and rows."""
        return ca.Function("values", [self.w], [self.cost, self.rows])

    def values(self, w: Floats) -> tuple[float, Floats]:
        """Cost and rows (r,) at w (d,)."""
        cost, rows = self._values(w)
        return float(cost), np.array(rows, dtype=float).ravel()


@dataclass(frozen=True, eq=False)
class Solution:
    """Final point of a solver.

    Attributes:
        w: (d,) variables; cost: there; rows: (r,) there.
        is_feasible: whether all rows hold to within `FEASIBLE` and no value is NaN.
        has_converged: whether the solver reports a local optimum.
        is_out_of_time: whether its time limit stopped it, so that an infeasible result is inconclusive.
        status: how it ended, in words.
        iterations: of the solver.
        multipliers: of bounds and rows, for a warm start.
    """

    w: Floats
    cost: float
    rows: Floats
    is_feasible: bool
    has_converged: bool
    is_out_of_time: bool
    status: str
    iterations: int
    multipliers: Bounds

    @property
    def is_number(self) -> bool:
        """Whether cost and rows are finite; the solver is not started where they are not."""
        return bool(np.isfinite(self.cost)) and bool(np.isfinite(self.rows).all())


class Solver:
    """A programme prepared for repeated solution with different starts and bounds."""

    def __init__(
        self, programme: Programme, time_limit_s: float, *, expand: bool = True, warm_start: bool = False
    ) -> None:
        """Prepare a programme.

        Args:
            programme: to solve.
            time_limit_s: limit of processor time of each solution [s].
            expand: into scalar operations. Steps of beliefs are small and sparse, so that this makes an iteration
                several times faster and costs little.
            warm_start: whether starts will be nearly optimal.
        """
        self._programme = programme
        stated: dict[str, Any] = {"x": programme.w, "f": programme.cost, "g": programme.rows}
        self._solver = ca.nlpsol("programme", _SOLVER, stated, _options(time_limit_s, expand, warm_start))

    def solve(
        self,
        start: Floats | None = None,
        bounds: Bounds | None = None,
        row_bounds: Bounds | None = None,
        before: Solution | None = None,
    ) -> Solution:
        """The local optimum near a start.

        Args:
            start: (d,); None: the programme's, as with the two bounds.
            bounds, row_bounds: (d,) and (r,) pairs.
            before: a solution whose multipliers to start from.

        Returns:
            The solver's last point; the start itself if cost or rows are not finite there, since a solver may then not
            terminate.
        """
        stated, multipliers = self._programme, {}
        start = stated.start if start is None else start
        lower, upper = stated.bounds if bounds is None else bounds
        row_lower, row_upper = stated.row_bounds if row_bounds is None else row_bounds
        if before is None:
            cost, rows = stated.values(start)
            status = messages.UNUSABLE_GUESS
            unusable = Solution(start, cost, rows, False, False, False, status, 0, (0.0 * start, 0.0 * rows))
            if not unusable.is_number:
                return unusable
        else:
            multipliers = {"lam_x0": before.multipliers[0], "lam_g0": before.multipliers[1]}
        solution = self._solver(x0=start, lbx=lower, ubx=upper, lbg=row_lower, ubg=row_upper, **multipliers)
        w, rows, of_bounds, of_rows = (np.array(solution[key], float).ravel() for key in ("x", "g", "lam_x", "lam_g"))
        cost, statistics = float(solution["f"]), self._solver.stats()
        missed = np.max(np.maximum(row_lower - rows, rows - row_upper), initial=0.0)  # NaN if a row is
        status = str(statistics["return_status"])
        return Solution(
            w,
            cost,
            rows,
            bool(np.isfinite(cost)) and bool(missed <= FEASIBLE),
            bool(statistics["success"]),
            status in _OUT_OF_TIME,
            messages.SOLVER_STATUS.get(status, status.replace("_", " ").lower()),
            int(statistics["iter_count"]),
            (of_bounds, of_rows),
        )


def _options(time_limit_s: float, expand: bool, warm_start: bool) -> dict[str, Any]:
    """IPOPT options: no terminal output, and the time limit."""
    options = {"print_level": 0, "sb": "yes", "max_iter": _MAX_ITERATIONS, "max_cpu_time": time_limit_s}
    options |= _WARM_START if warm_start else {"mu_strategy": "adaptive"}
    silent = {"print_time": False, "show_eval_warnings": False, "error_on_fail": False}
    # IPOPT has the multipliers: a gradient to compute them from is a fifth of all that is compiled.
    return {"expand": expand, "no_nlp_grad": True, **silent, _SOLVER: options}


def can_solve(linear_solver: str) -> bool:
    """Whether IPOPT solves a small programme with a linear solver.

    To be called in a process of its own: a solver that is missing ends in an error, a crash or a long wait.
    """
    x = ca.MX.sym("x", 2)
    programme: Any = {"x": x, "f": ca.sumsqr(x - 1), "g": x[0] * x[1]}
    options: Any = {"linear_solver": linear_solver, "print_level": 0, "sb": "yes", "max_cpu_time": 5.0}
    solver = ca.nlpsol("small", _SOLVER, programme, {_SOLVER: options, "print_time": False})
    solver(x0=[0.5, 0.3], lbg=0.2, ubg=2.0)
    return bool(solver.stats()["success"])
