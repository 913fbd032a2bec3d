"""Which linear solvers this CasADi's IPOPT can use."""

from __future__ import annotations

from typing import Any

import casadi as ca

LINEAR_SOLVERS = ("mumps", "ma27", "ma57", "ma86", "ma97", "spral", "pardisomkl")


def can_solve(linear_solver: str) -> bool:
    """Whether IPOPT solves a small programme with a linear solver.

    To be asked in a process of its own: one that is not there ends in an error, a crash or a long wait, as it likes.
    """
    x = ca.MX.sym("x", 2)
    programme: Any = {"x": x, "f": ca.sumsqr(x - 1), "g": x[0] * x[1]}
    options: Any = {"linear_solver": linear_solver, "print_level": 0, "sb": "yes", "max_wall_time": 5.0}
    solver = ca.nlpsol("small", "ipopt", programme, {"ipopt": options, "print_time": False})
    solver(x0=[0.5, 0.3], lbg=0.2, ubg=2.0)
    return bool(solver.stats()["success"])
