"""Solving a transcription: the belief path that comes of it, or the constraints that stand in the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from micah_plan.planning.findings import partly_held, sentence_of
from micah_plan.planning.nlp import Programme, Solution, Solver
from micah_plan.planning.transcription.layout import unpack
from micah_plan.planning.transcription.programme import Transcription
from micah_plan.planning.transcription.rows import Row, Shortfall

Floats = NDArray[np.float64]

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
    is_transition: NDArray[np.bool_]
    in_part: tuple[Shortfall, ...] = ()


def solve(nlp: Transcription, time_limit_s: float) -> BeliefPath:
    """The locally optimal belief path. A problem without a solution does not raise: `feasible` and `message` say so."""
    found = Solver(nlp.programme, time_limit_s).solve()
    if not found.is_number:
        worst = "; ".join(map(sentence_of, _worst(nlp, found.w, found.rows))) or "the cost is not a number"
        return path_of(nlp, replace(found, said=f"{found.said}: {worst}"))
    return path_of(nlp, found, tuple(_held_in_part(nlp, found.w)) if found.is_feasible else ())


def unmet(nlp: Transcription, time_limit_s: float) -> list[Shortfall]:
    """What stands in the way of an infeasible problem: the fewest rows to relax, with the amounts, worst first.

    Minimises the summed violation of all rows but the dynamics ("elastic mode", Gill, Murray and Saunders, SIAM Review
    2005). Empty if the solver finds no such point or no violation.
    """
    programme = nlp.programme
    rows = programme.values(programme.start)[1]
    if np.isfinite(rows).all():
        w = Solver(_elastic(programme, rows), time_limit_s).solve().w[: len(programme.start)]
        rows = programme.values(w)[1]
        rows = np.where(nlp.rows.lower < nlp.rows.upper, rows, nlp.rows.lower)
        return _worst(nlp, w, rows)
    return _worst(nlp, programme.start, rows)


def _elastic(programme: Programme, rows: Floats) -> Programme:
    """The programme whose inequalities may be missed, from a start where they have these values."""
    lower, upper = programme.row_bounds
    loose, fixed = (np.flatnonzero(chosen).tolist() for chosen in (lower < upper, lower == upper))
    missing = np.maximum(np.maximum(lower - rows, rows - upper), 0.0)[loose]
    e, g, free = ca.MX.sym("e", len(loose)), programme.rows, np.full(len(loose), np.inf)
    return Programme(
        w=ca.vertcat(programme.w, e),
        cost=ca.sum1(e) + _ELASTIC_COST * programme.cost,
        rows=ca.vertcat(g[fixed], g[loose] + e, g[loose] - e),
        start=np.concatenate([programme.start, missing]),
        bounds=(np.append(programme.bounds[0], np.zeros(len(loose))), np.append(programme.bounds[1], free)),
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
