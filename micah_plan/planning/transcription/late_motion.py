"""Motion lost to late transitions: only the mode before a guard makes it.

A transition happens when its guard holds, not at its planned knot. A phase that moves on beyond its guard, or comes
close to it for several steps, has changed its mode by then with some probability. Motion that the next mode would not
make is lost with that probability: a cap no longer turns with the hand that comes up, a jar is not pulled out after the
door has swung back. Its expected square, in steps, is

    sum over steps k, coordinates i of  P_k ((B - B') u_k / speed)_i²

with P_k the probability that the state is inside the guard, on average over the step, B the input matrix of the mode
and B' that of the next one. Coordinates that the next mode pins or ties lose nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from micah_plan.arrays import SMALLEST_STD, Floats
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.input_reversal import input_reversal_of
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.guess import PhaseGuess
from micah_plan.planning.transcription.packed_belief import factor_of
from micah_plan.planning.zero_time_transitions import stds_of


def lost_motion(
    automaton: HybridAutomaton, limits: Limits, guess: PhaseGuess, pattern: ca.Sparsity
) -> Callable[[ca.MX, ca.MX], ca.MX] | None:
    """(packed states, inputs) -> expected squared motion [steps²] lost in a phase to late transitions; None if none."""
    edge = None if guess.edge is None else automaton.edges[guess.edge]
    lost = None if edge is None else _lost_per_input(automaton, edge, limits.speed)
    if edge is None or lost is None:
        return None
    rows, weights = edge.guard.half_spaces, ca.DM(lost)
    n, a = automaton.n, np.array([h.a for h in rows])
    z, variances, inside = ca.SX.sym("z", n + pattern.nnz()), ca.SX.sym("v", len(rows)), ca.SX(1)
    for i, h in enumerate(rows):
        std = ca.sqrt(ca.sumsqr(ca.mtimes(factor_of(z, pattern).T, ca.DM(h.a))) + variances[i])
        inside *= 0.5 * (1.0 + ca.erf((ca.dot(ca.DM(h.a), z[:n]) - h.c) / (np.sqrt(2.0) * std)))
    probability = ca.Function("inside", [z, variances], [inside]).map(guess.steps + 1)
    variance = np.einsum("ri,kij,rj->rk", a, guess.spreads, a) + np.square(stds_of(edge))[:, None] + SMALLEST_STD**2

    def expected(states: ca.MX, inputs: ca.MX) -> ca.MX:
        at = probability(states, variance)
        return ca.sum2(0.5 * (at[:, :-1] + at[:, 1:]) * ca.sum1(ca.mtimes(weights, inputs) ** 2))

    return expected


def _lost_per_input(automaton: HybridAutomaton, edge: Edge, speed: Floats) -> Floats | None:
    """(n, m) difference of each coordinate's motion per input before and behind a guard on the state [steps].

    A boundary where inputs reverse is crossed in one known step (`automaton.input_reversal`) and loses nothing.
    """
    if edge.guard.on_input or input_reversal_of(automaton, edge) is not None:
        return None
    target = automaton.mode(edge.target)
    kept = target.free & ~np.isin(np.arange(automaton.n), [tie.coordinate for tie in target.ties])
    lost = (automaton.mode(edge.source).B - target.B) * kept[:, None] / speed[:, None]
    return lost if lost.any() else None
