"""Constraints and costs on the path (`task.path`) as rows of a transcription, read with CasADi expressions.

A margin g(x, u) >= 0 is planned to hold with the confidence by its linearisation at the mean μ: with a = ∂g/∂x and
b = ∂g/∂u there,

    g(μ, u) >= k sqrt(||L'a||² + (a, b)' Σ (a, b)),

where Σ is the covariance of estimate and input together in closed loop: real measurements move the estimate, and the
feedback moves the input with it. As with boundaries, the mean must keep to it and k-sigma has a slack that costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from micah_plan.arrays import Floats
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.guess import PhaseGuess
from micah_plan.planning.transcription.layout import factor_of, pack
from micah_plan.symbolic.effects import CasadiOperations
from micah_plan.symbolic.square_root import SMALLEST_STD
from micah_plan.task.path import Pay, Require, path_terms
from micah_plan.task.problem import Problem


@dataclass(frozen=True, eq=False)
class PathTerms:
    """What a problem asks of every step in a mode.

    Attributes:
        requirements: (r,) name and unit.
        uncertain: numbers of the requirements that depend on state or input, and so hold with a probability only.
        function: (state, u, Σ) -> (margins (r, 1), their stds (r, 1), lengths (r, 1), cost): Σ (n + m, n + m) column by
            column, lengths of one step across each margin [its unit].
    """

    requirements: tuple[tuple[str, str], ...]
    uncertain: list[int]
    function: ca.Function


@dataclass(frozen=True, eq=False)
class PathRows:
    """The steps of a phase of which something is asked.

    Attributes:
        terms: what.
        knots: (j,) within the phase, where the steps end.
        inputs: (j,) (number of the phase, number of the input in it) of the inputs that lead there.
        covariances: ((n + m)², j) Σ of each.
        lengths: (r, j) of one step across each margin.
        slack: (u, j) of the uncertain requirements, in steps, that makes the guess feasible.
    """

    terms: PathTerms
    knots: list[int]
    inputs: list[tuple[int, int]]
    covariances: Floats
    lengths: Floats
    slack: Floats


def path_terms_of(problem: Problem, limits: Limits, mode: str, pattern: ca.Sparsity) -> PathTerms:
    """What a problem asks in a mode, over states packed with a pattern of the factor (`layout.pack`)."""
    automaton, n, m = problem.automaton, problem.automaton.n, problem.automaton.m
    state, u, covariance = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("u", m), ca.SX.sym("s", (n + m) ** 2)
    x, factor = state[:n], factor_of(state, pattern)
    std = ca.sqrt(ca.sum2(factor**2) + SMALLEST_STD**2)
    acting = [constraint for constraint in problem.constraints if constraint.acts_in(mode)]
    terms = [term for one in acting for term in path_terms(one, CasadiOperations(), automaton, x, u, std)]
    required = [term for term in terms if isinstance(term, Require)]
    margins = ca.vertcat(ca.SX(0, 1), *(ca.SX(term.margin) for term in required))
    cost = sum((term.amount for term in terms if isinstance(term, Pay)), start=ca.SX(0))
    a, b = ca.jacobian(margins, x), ca.jacobian(margins, u)
    ab = ca.horzcat(a, b)
    spread = ca.sum2(ca.mtimes(ab, ca.reshape(covariance, n + m, n + m)) * ab)
    stds = ca.sqrt(ca.sum2(ca.mtimes(a, factor) ** 2) + spread + SMALLEST_STD**2)
    lengths = ca.mtimes(ca.fabs(a), ca.DM(limits.speed)) + ca.mtimes(ca.fabs(b), ca.DM(limits.max_step))
    function = ca.Function("path", [state, u, covariance], [*map(ca.densify, (margins, stds, lengths)), cost])
    uncertain = [i for i in range(len(required)) if ab[i, :].nnz()]
    return PathTerms(tuple((term.name, term.unit) for term in required), uncertain, function)


def path_rows(
    problem: Problem, limits: Limits, guess: Sequence[PhaseGuess], pattern: ca.Sparsity
) -> list[PathRows | None]:
    """What is asked of each phase; None where that is nothing.

    A guard on the state is crossed within the step that reaches it, so that step ends behind the reset.
    """
    found: list[PathRows | None] = []
    crossing: tuple[int, int] | None = None
    for p, phase in enumerate(guess):
        inputs = {knot: (p, knot - 1) for knot in range(1, phase.steps + 1)}
        if crossing is not None:
            inputs = {0: crossing, **inputs}
        leaves = phase.edge is not None and not problem.automaton.edges[phase.edge].guard.on_input
        crossing = inputs.pop(phase.steps, None) if leaves else None
        found.append(_rows(problem, limits, guess, p, inputs, pattern) if problem.constraints and inputs else None)
    return found


def _rows(
    problem: Problem,
    limits: Limits,
    guess: Sequence[PhaseGuess],
    number: int,
    inputs: dict[int, tuple[int, int]],
    pattern: ca.Sparsity,
) -> PathRows:
    phase, knots, led = guess[number], list(inputs), list(inputs.values())
    terms = path_terms_of(problem, limits, phase.mode, pattern)
    covariances = [_covariance(guess[p], i, phase.spreads[knot], knot > 0) for knot, (p, i) in inputs.items()]
    columns = np.array(covariances).reshape(len(knots), -1).T
    states = pack(phase.means[knots], phase.factors[knots], pattern)
    given = np.array([guess[p].inputs[i] for p, i in led]).T
    margins, stds, lengths, _ = (np.array(v) for v in terms.function.map(len(knots))(states, given, columns))
    # A margin that is flat at one knot of the guess gets the length that it has at another.
    lengths = np.where(lengths > 0.0, lengths, lengths.max(axis=1, keepdims=True, initial=0.0))
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    slack = np.maximum(0.0, problem.settings.sigmas * stds - margins) / lengths
    return PathRows(terms, knots, led, columns, lengths, slack[terms.uncertain])


def _covariance(phase: PhaseGuess, number: int, spread: Floats, is_same_mode: bool) -> Floats:
    """Σ where the step of an input ends, the estimate's covariance given; behind a reset both count as independent."""
    gain, before = phase.gains[number], phase.spreads[number]
    together = phase.closed[number] @ before @ gain.T * float(is_same_mode)
    return np.block([[spread, together], [together.T, gain @ before @ gain.T]])
