"""Solving a transcription with IPOPT, and what came of it in words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from micah_plan.planning.transcription.layout import unpack
from micah_plan.planning.transcription.programme import Transcription
from micah_plan.planning.transcription.rows import Row, Shortfall
from micah_plan.quantities import percent
from micah_plan.task.problem import Problem

Floats = NDArray[np.float64]

# Constraint violation that a result may have when the solver stopped early [unit of the row].
FEASIBLE = 1e-5
_MAX_ITERATIONS = 500
# Slack in steps from which a boundary counts as not kept.
_VISIBLE_SLACK = 1e-3
# Weight of the plan's own cost where the least violation is looked for: it only makes the answer unique.
_ELASTIC_COST = 1e-5

_STATUS = {
    "Solve_Succeeded": "optimal",
    "Solved_To_Acceptable_Level": "nearly optimal",
    "Feasible_Point_Found": "feasible",
    "Infeasible_Problem_Detected": "the constraints contradict each other",
    "Restoration_Failed": "no point that satisfies the constraints was found",
    "Maximum_Iterations_Exceeded": f"stopped after {_MAX_ITERATIONS} iterations",
    "Maximum_WallTime_Exceeded": "stopped at the time limit (time_limit_s)",
    "Maximum_CpuTime_Exceeded": "stopped at the time limit (time_limit_s)",
    "Search_Direction_Becomes_Too_Small": "no further progress was possible",
    "Diverging_Iterates": "the iterates diverged: the cost has no lower limit",
    "Invalid_Number_Detected": "a constraint or the cost became not a number",
    "Not_Enough_Degrees_Of_Freedom": "there are more conditions than inputs to meet them with",
}


@dataclass(frozen=True, eq=False)
class BeliefPath:
    """A transcription's result.

    Attributes:
        feasible: whether all constraints hold.
        cost: of the result, slack included.
        message: what the solver said, and which boundaries are kept only in part; `unmet` tells why it is infeasible.
        iterations: of the solver.
        in_part: the boundaries that are kept only in part, if it is feasible.
        modes: (K,) per knot; means: (K, n); factors: (K, n, n); inputs: (K-1, m); is_transition: (K-1,).
    """

    feasible: bool
    cost: float
    message: str
    iterations: int
    modes: tuple[str, ...]
    means: Floats
    factors: Floats
    inputs: Floats
    is_transition: NDArray[np.bool_]
    in_part: tuple[Shortfall, ...] = ()


def solve(nlp: Transcription, problem: Problem) -> BeliefPath:
    """The locally optimal belief path. A problem without a solution does not raise: `feasible` and `message` say so."""
    w, g = ca.vertcat(*nlp.w), ca.vertcat(*nlp.g)
    start = np.concatenate(nlp.w_start)
    values = ca.Function("values", [w], [nlp.cost, g])
    cost, rows = (np.array(v, dtype=float).ravel() for v in values(start))
    if not (np.isfinite(cost).all() and np.isfinite(rows).all()):
        worst = "; ".join(nlp.rows.worst(rows)) or "the cost is not a number"
        said = f"the start of the optimisation is unusable: {worst}"
        return path_of(nlp, problem, start, float("inf"), False, said, 0)
    programme: dict[str, Any] = {"x": w, "f": nlp.cost, "g": g}
    solver = ca.nlpsol("belief_path", "ipopt", programme, ipopt_options(problem.settings.time_limit_s, expand=True))
    found = solver(
        x0=start,
        lbx=np.concatenate(nlp.w_lower),
        ubx=np.concatenate(nlp.w_upper),
        lbg=nlp.rows.lower,
        ubg=nlp.rows.upper,
    )
    result = np.array(found["x"], dtype=float).ravel()
    cost, rows = (np.array(v, dtype=float).ravel() for v in values(result))
    statistics = solver.stats()
    status = str(statistics["return_status"])
    said = _STATUS.get(status, status.replace("_", " ").lower())
    feasible = bool(np.isfinite(cost).all()) and nlp.rows.largest_violation(rows) <= FEASIBLE
    partly = _kept_in_part(nlp, problem, result) if feasible else []
    message = "; ".join([said, *(_in_part_text(shortfall, problem) for shortfall in partly)])
    path = path_of(nlp, problem, result, float(cost[0]), feasible, message, int(statistics["iter_count"]))
    return replace(path, in_part=tuple(partly))


def unmet(nlp: Transcription, problem: Problem) -> list[Shortfall]:
    """What stands in the way of an infeasible problem: the fewest rows to relax, with the amounts, worst first.

    Minimises the summed violation of guards, boundaries, inputs and goal while the dynamics hold ("elastic mode", Gill,
    Murray and Saunders, SIAM Review 2005). Empty if the solver finds no such point or no violation.
    """
    w, g = ca.vertcat(*nlp.w), ca.vertcat(*nlp.g)
    lower, upper = nlp.rows.lower, nlp.rows.upper
    elastic = np.flatnonzero(lower < upper).tolist()
    kept = np.flatnonzero(lower == upper).tolist()
    e = ca.MX.sym("e", len(elastic))
    programme: dict[str, Any] = {
        "x": ca.vertcat(w, e),
        "f": ca.sum1(e) + _ELASTIC_COST * nlp.cost,
        "g": ca.vertcat(g[kept], g[elastic] + e, g[elastic] - e),
    }
    start = np.concatenate(nlp.w_start)
    rows = np.array(ca.Function("rows", [w], [g])(start), dtype=float).ravel()
    if not np.isfinite(rows).all():
        return [Shortfall(nlp.rows.rows[i], float("inf")) for i in nlp.rows.worst_indices(rows)]
    missing = np.maximum(np.maximum(lower - rows, rows - upper), 0.0)[elastic]
    solver = ca.nlpsol("unmet", "ipopt", programme, ipopt_options(problem.settings.time_limit_s, expand=True))
    free = np.full(len(elastic), np.inf)
    found = solver(
        x0=np.concatenate([start, missing]),
        lbx=np.concatenate([*nlp.w_lower, np.zeros(len(elastic))]),
        ubx=np.concatenate([*nlp.w_upper, free]),
        lbg=np.concatenate([lower[kept], lower[elastic], -free]),
        ubg=np.concatenate([upper[kept], free, upper[elastic]]),
    )
    result = np.array(found["x"], dtype=float).ravel()[: len(start)]
    rows = np.array(ca.Function("rows", [w], [g])(result), dtype=float).ravel()
    rows = np.where(lower < upper, rows, lower)
    violated = ((nlp.rows.rows[i], rows[i]) for i in nlp.rows.worst_indices(rows))
    return [_shortfall(nlp, result, row, row.violation(float(value))) for row, value in violated]


def ipopt_options(time_limit_s: float, *, expand: bool) -> dict[str, Any]:
    """IPOPT without a word on the terminal, and never longer than the time limit.

    Args:
        expand: into scalar operations. Belief steps are small and sparse, so that this makes an iteration several times
            faster and costs little.
    """
    return {
        "expand": expand,
        "print_time": False,
        "show_eval_warnings": False,
        "error_on_fail": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "max_iter": _MAX_ITERATIONS,
            "max_wall_time": time_limit_s,
            "mu_strategy": "adaptive",
        },
    }


def blocks_of(nlp: Transcription, values: Floats) -> list[tuple[Floats, Floats, Floats]]:
    """States, inputs and slacks of each phase as views into the decision variables."""
    blocks, at = [], 0
    for phase in nlp.phases:
        found = []
        for symbol in (phase.states, phase.inputs, phase.slacks):
            rows, columns = symbol.shape
            found.append(values[at : at + rows * columns].reshape((rows, columns), order="F"))
            at += rows * columns
        blocks.append((found[0], found[1], found[2]))
    return blocks


def _kept_in_part(nlp: Transcription, problem: Problem, values: Floats) -> list[Shortfall]:
    """For each boundary that does not hold at k-sigma somewhere: where it is missed most."""
    worst: dict[tuple[str, str], tuple[float, Row, float]] = {}
    named = {(row.mode, row.knot, row.name): row for row in nlp.rows.rows if row.spread is not None}
    suffix = f" at {percent(problem.settings.confidence)}"
    for phase, guess, (_, _, slacks) in zip(nlp.phases, nlp.guess, blocks_of(nlp, values), strict=True):
        uncertain = [row for row in phase.corridor if row.uncertain]
        for row, slack in zip(uncertain, slacks.ravel(), strict=True):
            key = (guess.mode, row.name)
            if slack > max(_VISIBLE_SLACK, worst[key][0] if key in worst else 0.0):
                place = named[guess.mode, guess.first_knot + row.step, row.name + suffix]
                worst[key] = (float(slack), place, float(slack) * row.scale)
    return [_shortfall(nlp, values, row, amount) for _, row, amount in worst.values()]


def _in_part_text(shortfall: Shortfall, problem: Problem) -> str:
    row, confidence = shortfall.row, percent(problem.settings.confidence)
    name = row.name.removesuffix(f" at {confidence}")
    return f"{name} holds with less than {confidence} around knot {row.knot} in mode '{row.mode}'"


def _shortfall(nlp: Transcription, values: Floats, row: Row, amount: float) -> Shortfall:
    """The row with what the belief of its knot makes of it."""
    if row.spread is None or row.half_space is None:
        return Shortfall(row, amount)
    number = next(i for i, guess in enumerate(nlp.guess) if row.knot <= guess.first_knot + guess.steps)
    states = blocks_of(nlp, values)[number][0]
    factor = unpack(states, nlp.pattern)[1][row.knot - nlp.guess[number].first_knot]
    std = float(np.sqrt(np.square(np.array(row.half_space.a) @ factor).sum() + row.spread))
    others = [r for r in nlp.rows.rows if (r.mode, r.knot) == (row.mode, row.knot) and r.kind in ("boundary", "guard")]
    widths = [width for width in (_width(row, other) for other in others) if width is not None]
    return Shortfall(row, amount, std, min(widths, default=None))


def _width(row: Row, other: Row) -> float | None:
    """The width of the corridor between two boundaries, in the unit of the first; None if they do not face."""
    if row.half_space is None or other.half_space is None:
        return None
    a, b = row.sign * np.array(row.half_space.a), other.sign * np.array(other.half_space.a)
    size, other_size = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    if not np.allclose(a / size, -b / other_size, rtol=0.0, atol=1e-9):
        return None
    return -other.sign * other.half_space.c / other_size * size - row.sign * row.half_space.c


def path_of(
    nlp: Transcription, problem: Problem, values: Floats, cost: float, feasible: bool, message: str, iterations: int
) -> BeliefPath:
    """The belief path that values of the decision variables stand for."""
    means, factors, inputs, modes, transitions = [], [], [], [], []
    for number, (guess, (states, steps, _)) in enumerate(zip(nlp.guess, blocks_of(nlp, values), strict=True)):
        if number:
            inputs.append(np.zeros((1, problem.automaton.m)))
            transitions.append(True)
        phase_means, phase_factors = unpack(states, nlp.pattern)
        means.append(phase_means)
        factors.append(phase_factors)
        inputs.append(steps.T)
        modes += [guess.mode] * (guess.steps + 1)
        transitions += [False] * guess.steps
    return BeliefPath(
        feasible,
        cost,
        message,
        iterations,
        tuple(modes),
        np.concatenate(means),
        np.concatenate(factors),
        np.concatenate(inputs),
        np.array(transitions, dtype=bool),
    )
