"""Solution of a transcription: its belief path, or the violated constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.planning import messages
from micah_plan.planning.findings import partly_met, sentence_of
from micah_plan.planning.nlp import Programme, Solution, Solver
from micah_plan.planning.transcription.packed_belief import unpack
from micah_plan.planning.transcription.programme import Transcription
from micah_plan.planning.transcription.rows import NEGLIGIBLE, Row, Shortfall

# Slack in steps from which a boundary counts as met only in part.
_VISIBLE_SLACK = 1e-3
# Weight of the plan's own cost where the least violation is looked for: it only makes the answer unique.
_ELASTIC_COST = 1e-5


@dataclass(frozen=True, eq=False)
class BeliefPath:
    """A transcription's result.

    Attributes:
        feasible: whether all constraints hold.
        cost: of the result, slack included.
        message: how the optimisation ended, and which boundaries hold only in part; see `violated_constraints`.
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


def solve_transcription(nlp: Transcription, time_limit_s: float) -> BeliefPath:
    """The locally optimal belief path. Infeasible problems do not raise: see `feasible` and `message`."""
    solution = Solver(nlp.programme, time_limit_s).solve()
    if not solution.is_number:
        worst = "; ".join(map(sentence_of, _worst(nlp, solution.w, solution.rows))) or messages.COST_NOT_A_NUMBER
        return path_of(nlp, replace(solution, status=f"{solution.status}: {worst}"))
    return path_of(nlp, solution, tuple(_soft_violations(nlp, solution.w)) if solution.is_feasible else ())


def violated_constraints(nlp: Transcription, time_limit_s: float) -> list[Shortfall]:
    """The violated constraints of an infeasible programme, worst first.

    Constraints on the path, and by how much each must be relaxed at all knots, if that is enough: the row is that of
    the knot where it is tightest. Otherwise the worst rows where the summed violation of all but the dynamics is least
    ("elastic mode", Gill, Murray and Saunders, SIAM Review 2005). Empty if the solver finds no such point or no
    violation.
    """
    programme, size = nlp.programme, len(nlp.programme.start)
    rows = programme.values(programme.start)[1]
    if not np.isfinite(rows).all():
        return _worst(nlp, programme.start, rows)
    asked = [i for i, row in enumerate(nlp.rows) if row.kind == "path" and row.confidence is None]
    names = list(dict.fromkeys(nlp.rows[i].name for i in asked))
    if asked:
        amounts = [names.index(nlp.rows[i].name) for i in asked]
        solution = Solver(_relaxed_programme(programme, rows, asked, amounts), time_limit_s).solve()
        values = programme.values(solution.w[:size])[1]
        missed = [
            Shortfall(nlp.rows[min((i for i in asked if nlp.rows[i].name == name), key=values.__getitem__)], amount)
            for name, amount in zip(names, solution.w[size:].tolist(), strict=True)
            if amount > NEGLIGIBLE
        ]
        if solution.is_feasible and missed:
            return sorted(missed, key=lambda shortfall: -shortfall.amount)
    is_loose = nlp.rows.lower < nlp.rows.upper
    loose = np.flatnonzero(is_loose).tolist()
    w = Solver(_relaxed_programme(programme, rows, loose, list(range(len(loose)))), time_limit_s).solve().w[:size]
    return _worst(nlp, w, np.where(is_loose, programme.values(w)[1], nlp.rows.lower))


def _relaxed_programme(programme: Programme, rows: Floats, loose: list[int], amounts: list[int]) -> Programme:
    """The programme with some rows relaxed by penalised amounts (elastic mode).

    Args:
        rows: (r,) values at the start.
        loose, amounts: indices of the rows, and of the amount of each.
    """
    lower, upper = programme.row_bounds
    fixed = np.setdiff1d(np.arange(len(lower)), loose).tolist()
    missing = np.zeros(max(amounts) + 1)
    np.maximum.at(missing, amounts, np.maximum(lower - rows, rows - upper)[loose])
    e, g, free = ca.MX.sym("e", len(missing)), programme.rows, np.full(len(loose), np.inf)
    missed, kept, soft = (ca.vec(part) for part in (e[amounts], g[fixed], g[loose]))  # a scalar's entries come as a row
    return Programme(
        w=ca.vertcat(programme.w, e),
        cost=ca.sum1(e) + _ELASTIC_COST * programme.cost,
        rows=ca.vertcat(kept, soft + missed, soft - missed),
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
    """The most violated rows for given decision variables and row values."""
    return [_shortfall(nlp, w, i, nlp.rows[i].violation(float(rows[i]))) for i in nlp.rows.worst(rows)]


def blocks_of(nlp: Transcription, values: Floats) -> list[tuple[Floats, Floats, Floats]]:
    """States, inputs and slacks of each phase as views into the decision variables."""
    shapes = [symbol.shape for phase in nlp.phases for symbol in (phase.states, phase.inputs, phase.slacks)]
    parts = np.split(values, np.cumsum([rows * columns for rows, columns in shapes])[:-1])
    blocks = [part.reshape(shape, order="F") for part, shape in zip(parts, shapes, strict=True)]
    return list(zip(blocks[::3], blocks[1::3], blocks[2::3], strict=True))


def _soft_violations(nlp: Transcription, w: Floats) -> list[Shortfall]:
    """For each boundary violated at k-sigma, the largest violation."""
    worst: dict[tuple[str, str], tuple[float, int, float]] = {}
    for phase, (_, _, slacks) in zip(nlp.phases, blocks_of(nlp, w), strict=True):
        for (number, scale), slack in zip(phase.soft, slacks.ravel().tolist(), strict=True):
            key = (nlp.rows[number].mode, nlp.rows[number].name)
            if slack > max(_VISIBLE_SLACK, worst[key][0] if key in worst else 0.0):
                worst[key] = slack, number, slack * scale
    return [_shortfall(nlp, w, number, amount) for _, number, amount in worst.values()]


def _shortfall(nlp: Transcription, w: Floats, number: int, amount: float) -> Shortfall:
    """A row as a shortfall, with its std under the belief at its knot."""
    row = nlp.rows[number]
    if row.confidence is None:
        return Shortfall(row, amount)
    others = [r for r in nlp.rows if (r.mode, r.knot) == (row.mode, row.knot) and r.kind in ("boundary", "guard")]
    widths = [width for width in (_width(row, rival) for rival in others) if width is not None]
    return Shortfall(row, amount, float(nlp.stds_at(w)[number]), min(widths, default=None))


def _width(row: Row, rival: Row) -> float | None:
    """Width of the corridor between two boundaries in the unit of the first; None if they do not face."""
    if row.half_space is None or rival.half_space is None:
        return None
    a, b = row.sign * np.array(row.half_space.a), rival.sign * np.array(rival.half_space.a)
    size, other_size = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    if size == 0.0 or other_size == 0.0:  # on inputs alone
        return None
    if not np.allclose(a / size, -b / other_size, rtol=0.0, atol=1e-9):
        return None
    return -rival.sign * rival.half_space.c / other_size * size - row.sign * row.half_space.c


def path_of(nlp: Transcription, solution: Solution, in_part: tuple[Shortfall, ...] = ()) -> BeliefPath:
    """The belief path of a solution."""
    blocks, firsts = blocks_of(nlp, solution.w), [phase.first_knot for phase in nlp.guess]
    means, factors = unpack(np.hstack([states for states, _, _ in blocks]), nlp.pattern)
    inputs, is_transition = np.zeros((len(means) - 1, nlp.problem.automaton.m)), np.zeros(len(means) - 1, dtype=bool)
    is_transition[np.array(firsts[1:], dtype=np.int64) - 1] = True
    for first, (_, steps, _) in zip(firsts, blocks, strict=True):
        inputs[first : first + steps.shape[1]] = steps.T
    return BeliefPath(
        feasible=solution.is_feasible,
        cost=solution.cost,
        message="; ".join([solution.status, *map(partly_met, in_part)]),
        is_out_of_time=solution.is_out_of_time,
        iterations=solution.iterations,
        modes=tuple(phase.mode for phase in nlp.guess for _ in range(phase.steps + 1)),
        means=means,
        factors=factors,
        inputs=inputs,
        is_transition=is_transition,
        in_part=in_part,
    )
