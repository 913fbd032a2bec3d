"""Packed beliefs: the mean, then the structurally nonzero entries of the factor.

Coordinates that start independent and that no reset mixes stay independent, so most factors are far from full: with 12
drawers a knot has 24 numbers, not 90.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

import casadi as ca
import numpy as np

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.symbolic.compiled import compiled_edge, compiled_mode

Expression = TypeVar("Expression", ca.MX, ca.SX)


def factor_pattern(
    automaton: HybridAutomaton, start: Floats, modes: Iterable[str], edges: Iterable[int]
) -> ca.Sparsity:
    """The lower triangular sparsity of a start's factor (n, n) propagated through modes and edges."""
    n, m = automaton.n, automaton.m
    maps = [compiled_mode(automaton, name).belief_step for name in dict.fromkeys(modes)]
    maps += [compiled_edge(automaton, index).belief_reset for index in dict.fromkeys(edges)]
    mean, u = ca.SX.sym("x", n), ca.SX.sym("u", m)
    uncertain = np.ones(n)
    for memory in automaton.input_memories:
        uncertain[memory.coordinates] = 0.0
    pattern = ca.sparsify(ca.DM(np.diag(uncertain) + np.abs(np.tril(start)))).sparsity()
    for _ in range(n * n):
        grown = pattern
        for function in maps:
            after = function.call([mean, ca.SX.sym("L", pattern), u])[1]
            grown = grown.unite(ca.sparsify(ca.tril(after)).sparsity())
        if grown == pattern:
            break
        pattern = grown
    return pattern


def pattern_entries(pattern: ca.Sparsity) -> tuple[Ints, Ints]:
    """Rows and columns of a pattern's entries in CasADi's (column-major) order."""
    rows, columns = pattern.get_triplet()
    return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)


def pack(means: Floats, factors: Floats, pattern: ca.Sparsity) -> Floats:
    """(n + l, K) states of the transcription from means (K, n) and factors (K, n, n)."""
    row, column = pattern_entries(pattern)
    return np.asarray(np.hstack([means, factors[:, row, column]]).T)


def unpack(states: Floats, pattern: ca.Sparsity) -> tuple[Floats, Floats]:
    """Means (K, n) and factors (K, n, n) from states (n + l, K)."""
    (row, column), n = pattern_entries(pattern), pattern.rows()
    factors = np.zeros((states.shape[1], n, n))
    factors[:, row, column] = states[n:].T
    return np.ascontiguousarray(states[:n].T), factors


def factor_of(state: Expression, pattern: ca.Sparsity) -> Expression:
    """The (n, n) lower factor in a packed state (n + l, 1)."""
    return type(state)(pattern, state[pattern.rows() :])


def packed(pair: Sequence[Expression], pattern: ca.Sparsity) -> Expression:
    """The packed state (n + l, 1) of a mean and a factor."""
    return ca.vertcat(pair[0], ca.vec(ca.project(pair[1], pattern).nz[:]))
