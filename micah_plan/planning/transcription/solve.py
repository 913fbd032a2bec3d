"""Solving a transcription: the belief path that comes of it, or the constraints that stand in the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.planning.findings import partly_held, sentence_of
from micah_plan.planning.nlp import Programme, Solution, Solver
from micah_plan.planning.transcription.layout import unpack
from micah_plan.planning.transcription.programme import Transcription
from micah_plan.planning.transcription.rows import NEGLIGIBLE, Row, Shortfall

# Slack in steps from which a boundary counts as held only in part.
_VISIBLE_SLACK = 1e-3
# Weight of the plan's own cost where the least violation is looked for: it only makes the answer unique.
_ELASTIC_COST = 1e-5


@dataclass(frozen=True, eq=False)
class BeliefPath:
    """A transcription's result.

    Attributes:
        feasible: whether all constraints hold.
        cost: of the result, slack included.
        message: how the optimisation ended, and which boundaries hold only in part; `unmet` tells why it is infeasible.
        is_out_of_time: whether the time limit ended it.
        iterations: of the solver.
        modes: (K,) per knot; means: (K, n); factors: (K, n, n); inputs: (K-1, m); is_transition: (K-1,).
        in_part: the boundaries that hold only in part, if it is feasible.
    """

    feasible: bool
    cost: float
    message: str
    is_out_of_time: bool
    iterations: int
    modes: tuple[str, ...]
    means: Floats
    factors: Floats
    inputs: Floats
    is_transition: Booleans
    in_part: tuple[Shortfall, ...] = ()


def solve(nlp: Transcription, time_limit_s: float) -> BeliefPath:
    """The locally optimal belief path. A problem without a solution does not raise: `feasible` and `message` say so."""
    found = Solver(nlp.programme, time_limit_s).solve()
    if not found.is_number:
        worst = "; ".join(map(sentence_of, _worst(nlp, found.w, found.rows))) or "the cost is not a number"
        return path_of(nlp, replace(found, said=f"{found.said}: {worst}"))
    return path_of(nlp, found, tuple(_held_in_part(nlp, found.w)) if found.is_feasible else ())


def unmet(nlp: Transcription, time_limit_s: float) -> list[Shortfall]:
    """What stands in the way of an infeasible problem, worst first.

    Constraints on the path, and how far each must be relaxed, if that is enough; else the fewest rows to relax, with
    the amounts. Empty if the solver finds no such point or no violation.
    """
    programme = nlp.programme
    rows = programme.values(programme.start)[1]
    if not np.isfinite(rows).all():
        return _worst(nlp, programme.start, rows)
    return _constraints_to_relax(nlp, programme, rows, time_limit_s) or _rows_to_relax(
        nlp, programme, rows, time_limit_s
    )


def _constraints_to_relax(nlp: Transcription, programme: Programme, rows: Floats, limit_s: float) -> list[Shortfall]:
    """The constraints on the path that would hold if each were relaxed by one amount at all knots; empty if none would.

    The row is that of the knot where the constraint is tightest.
    """
    asked = [i for i, row in enumerate(nlp.rows) if row.kind == "path" and row.confidence is None]
    names = [nlp.rows[i].name for i in asked]
    own = list(dict.fromkeys(names))
    if not asked:
        return []
    found = Solver(_elastic(programme, rows, asked, list(map(own.index, names))), limit_s).solve()
    if not found.is_feasible:
        return []
    g = programme.values(found.w[: len(programme.start)])[1]
    amounts = dict(zip(own, found.w[len(programme.start) :].tolist(), strict=True))
    tightest = {name: min((i for i in asked if nlp.rows[i].name == name), key=g.__getitem__) for name in own}
    missed = sorted((name for name in own if amounts[name] > NEGLIGIBLE), key=lambda name: -amounts[name])
    return [Shortfall(nlp.rows[tightest[name]], amounts[name]) for name in missed]


def _rows_to_relax(nlp: Transcription, programme: Programme, rows: Floats, limit_s: float) -> list[Shortfall]:
    """The worst rows where the summed violation of all but the dynamics is least.

    Source: "elastic mode", Gill, Murray and Saunders, SIAM Review 2005.
    """
    loose = np.flatnonzero(nlp.rows.lower < nlp.rows.upper).tolist()
    found = Solver(_elastic(programme, rows, loose, list(range(len(loose)))), limit_s).solve()
    w = found.w[: len(programme.start)]
    return _worst(nlp, w, np.where(nlp.rows.lower < nlp.rows.upper, programme.values(w)[1], nlp.rows.lower))


def _elastic(programme: Programme, rows: Floats, loose: list[int], amounts: list[int]) -> Programme:
    """The programme in which some rows may be missed, each by the amount of that number, at the cost of all amounts.

    Args:
        rows: (r,) values at the start.
        loose, amounts: numbers of the rows, and of the amount of each.
    """
    lower, upper = programme.row_bounds
    fixed = np.setdiff1d(np.arange(len(lower)), loose).tolist()
    missing = np.zeros(max(amounts) + 1)
    np.maximum.at(missing, amounts, np.maximum(lower - rows, rows - upper)[loose])
    e, g, free = ca.MX.sym("e", len(missing)), programme.rows, np.full(len(loose), np.inf)
    missed = ca.vec(e[amounts])  # a scalar's entries come as a row
    return Programme(
        w=ca.vertcat(programme.w, e),
        cost=ca.sum1(e) + _ELASTIC_COST * programme.cost,
        rows=ca.vertcat(g[fixed], g[loose] + missed, g[loose] - missed),
        start=np.concatenate([programme.start, missing]),
        bounds=(
            np.concatenate([programme.bounds[0], np.zeros(len(missing))]),
            np.concatenate([programme.bounds[1], np.full(len(missing), np.inf)]),
        ),
        row_bounds=(
            np.concatenate([lower[fixed], lower[loose], -free]),
            np.concatenate([upper[fixed], free, upper[loose]]),
        ),
    )


def _worst(nlp: Transcription, w: Floats, rows: Floats) -> list[Shortfall]:
    """The rows that are missed most, where the decision variables are w and the rows have these values."""
    return [_shortfall(nlp, w, i, nlp.rows[i].violation(float(rows[i]))) for i in nlp.rows.worst(rows)]


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


def _held_in_part(nlp: Transcription, w: Floats) -> list[Shortfall]:
    """For each boundary that does not hold at k-sigma somewhere: where it is missed most."""
    worst: dict[tuple[str, str], tuple[float, int, float]] = {}
    for phase, (_, _, slacks) in zip(nlp.phases, blocks_of(nlp, w), strict=True):
        for (number, scale), slack in zip(phase.soft, slacks.ravel().tolist(), strict=True):
            key = (nlp.rows[number].mode, nlp.rows[number].name)
            if slack > max(_VISIBLE_SLACK, worst[key][0] if key in worst else 0.0):
                worst[key] = slack, number, slack * scale
    return [_shortfall(nlp, w, number, amount) for _, number, amount in worst.values()]


def _shortfall(nlp: Transcription, w: Floats, number: int, amount: float) -> Shortfall:
    """The row of a number with what the belief of its knot makes of it."""
    row = nlp.rows[number]
    if row.confidence is None:
        return Shortfall(row, amount)
    others = [r for r in nlp.rows if (r.mode, r.knot) == (row.mode, row.knot) and r.kind in ("boundary", "guard")]
    widths = [width for width in (_width(row, other) for other in others) if width is not None]
    return Shortfall(row, amount, float(nlp.stds_at(w)[number]), min(widths, default=None))


def _width(row: Row, other: Row) -> float | None:
    """The width of the corridor between two boundaries, in the unit of the first; None if they do not face."""
    if row.half_space is None or other.half_space is None:
        return None
    a, b = row.sign * np.array(row.half_space.a), other.sign * np.array(other.half_space.a)
    size, other_size = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    if not np.allclose(a / size, -b / other_size, rtol=0.0, atol=1e-9):
        return None
    return -other.sign * other.half_space.c / other_size * size - row.sign * row.half_space.c


def path_of(nlp: Transcription, found: Solution, in_part: tuple[Shortfall, ...] = ()) -> BeliefPath:
    """The belief path that a solution stands for."""
    means, factors, inputs, modes, transitions = [], [], [], [], []
    for number, (guess, (states, steps, _)) in enumerate(zip(nlp.guess, blocks_of(nlp, found.w), strict=True)):
        if number:
            inputs.append(np.zeros((1, nlp.problem.automaton.m)))
            transitions.append(True)
        phase_means, phase_factors = unpack(states, nlp.pattern)
        means.append(phase_means)
        factors.append(phase_factors)
        inputs.append(steps.T)
        modes += [guess.mode] * (guess.steps + 1)
        transitions += [False] * guess.steps
    return BeliefPath(
        feasible=found.is_feasible,
        cost=found.cost,
        message="; ".join([found.said, *map(partly_held, in_part)]),
        is_out_of_time=found.is_out_of_time,
        iterations=found.iterations,
        modes=tuple(modes),
        means=np.concatenate(means),
        factors=np.concatenate(factors),
        inputs=np.concatenate(inputs),
        is_transition=np.array(transitions, dtype=bool),
        in_part=in_part,
    )
