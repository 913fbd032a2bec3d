"""The hybrid Gaussian filter, one mode and one guard after the other: what the package's is compared with.

Plain and slow: one EKF per mode, guards that move probability from mode to mode, moment matching; splits by quadrature.

Sources: Jain and Niekum, "Efficient hierarchical robot motion planning under uncertainty and hybrid dynamics", CoRL
2018; Blom and Bar-Shalom, "The interacting multiple model algorithm", 1988, for the mixing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scalar_belief import scalar_gaussian as gaussian
from scalar_belief.scalar_crossing import Piece, cross, whole_step
from scalar_belief.scalar_sliding import slid
from scalar_belief.scalar_truncation import mixed, truncate

from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.input_memory import passed_arrays
from micah_plan.automaton.lifted import threshold_stds, with_boundary_states
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.errors import InputError

Floats = NDArray[np.float64]

# A share of the belief below this is dropped.
NEGLIGIBLE = 1e-10
# Transitions that a share of the belief may take within one step.
MOST_EVENTS = 16


def joint_of(automaton: HybridAutomaton, belief: HybridBelief) -> tuple[Floats, Floats]:
    """(q, n + b) means and (q, n + b, n + b) factors over states and boundaries; unlearned ones as in the model."""
    stds = threshold_stds(automaton)
    if not stds.size:
        return belief.means, belief.factors
    q, n = belief.means.shape
    shifts, rows = belief.shifts, belief.shift_rows
    if shifts is None or rows is None:
        shifts = np.zeros((q, stds.size))
        rows = np.repeat(np.hstack([np.zeros((stds.size, n)), np.diag(stds)])[None], q, axis=0)
    upper = np.concatenate([belief.factors, np.zeros((q, n, stds.size))], axis=2)
    return np.hstack([belief.means, shifts]), np.concatenate([upper, rows], axis=1)


def belief_of(weights: Floats, means: Floats, factors: Floats, n: int) -> HybridBelief:
    """A belief, not to be written to, from its weights and the joint means and factors, of whose states n are x."""
    parts = [weights, means[:, :n], factors[:, :n, :n]]
    if means.shape[1] > n:
        parts += [means[:, n:], factors[:, n:]]
    owned = [np.array(part) for part in parts]
    for array in owned:
        array.setflags(write=False)
    return HybridBelief(*owned)


def initial_belief(automaton: HybridAutomaton, mean: ArrayLike, std: ArrayLike, mode: str) -> HybridBelief:
    """The belief at the start, all of it in one mode, whose pins are information: mean (n,), std (n,) [rad or m]."""
    center, factor, n = np.array(mean, dtype=float), np.diag(np.array(std, dtype=float)), automaton.n
    whole, stds = with_boundary_states(automaton), threshold_stds(automaton)
    center = np.concatenate([center, np.zeros(stds.size)])
    factor = np.block([[factor, np.zeros((n, stds.size))], [np.zeros((stds.size, n)), np.diag(stds)]])
    held = gaussian.condition_on_pins(center, factor, whole.mode(mode).pins)
    ends = np.tile(held[0], 2), np.tile(held[1], (2, 1))
    return _assembled(whole, n, [Piece(mode, 1.0, *ends, 0.0, np.zeros(whole.n), np.full(whole.n, np.nan))])


def predict(automaton: HybridAutomaton, belief: HybridBelief, u: ArrayLike) -> HybridBelief:
    """The belief after one step with input u (m,): flow, process noise, guards, resets, clamps and pins."""
    applied = np.asarray(u, dtype=float)
    if applied.shape != (automaton.m,):
        raise InputError(f"an input must have shape ({automaton.m},). Got {applied.shape}")
    arrived: list[Piece] = []
    remembered: Floats | None = None
    whole, (means, factors) = with_boundary_states(automaton), joint_of(automaton, belief)
    for index, mode in enumerate(whole.modes):
        weight = float(belief.weights[index])
        if weight < NEGLIGIBLE:
            continue
        passed, remembered = passed_arrays(whole.input_memories, mode.name, means[index], applied)
        travelling = [whole_step(whole, mode.name, weight, means[index], factors[index], passed)]
        while travelling:
            arrived += _through_guards(whole, travelling.pop(), passed, travelling)
    return _assembled(whole, automaton.n, arrived, remembered)


def update(automaton: HybridAutomaton, belief: HybridBelief, z: ArrayLike) -> HybridBelief:
    """The belief after measuring z (n,), NaN where there is no measurement.

    Each mode measures as `HybridAutomaton.sensing` says, where its mean is. Mode weights move by the likelihood. A
    mode's state lies outside the guards that leave it, else it would have left: the mean is brought back if the
    measurement drew it behind one, and the likelihood counts only the part outside.
    """
    measured = np.asarray(z, dtype=float)
    if measured.shape != (automaton.n,):
        raise InputError(f"a measurement must have shape ({automaton.n},). Got {measured.shape}")
    if not np.isfinite(measured).any():
        return belief
    whole, (means, factors) = with_boundary_states(automaton), joint_of(automaton, belief)
    means, factors = means.copy(), factors.copy()
    measured = np.concatenate([measured, np.full(whole.n - automaton.n, np.nan)])
    scores = np.full(len(automaton.modes), -np.inf)
    for index, mode in enumerate(whole.modes):
        before = means[index].copy(), factors[index].copy()
        mean, factor, score = gaussian.update(*before, measured, whole.sensing(mode).std_at(before[0]))
        for weights, offset in guard_limits(whole.edges_from(mode.name)):
            score -= truncate(*before, weights, offset)[0]
            outside, inward, narrowed = truncate(mean, factor, weights, offset)
            score += outside
            if weights @ mean < offset:
                mean, factor = inward, narrowed
        means[index], factors[index] = mean, factor
        if belief.weights[index] > 0:
            scores[index] = score + np.log(belief.weights[index])
    weights = np.exp(scores - scores.max())
    return belief_of(weights / weights.sum(), means, factors, automaton.n)


def _through_guards(automaton: HybridAutomaton, piece: Piece, u: Floats, travelling: list[Piece]) -> list[Piece]:
    """The share of a piece that stays in its mode to the end of the step; what leaves is put on `travelling`."""
    if piece.events >= MOST_EVENTS:
        return [piece]
    piece = slid(automaton, piece, u) if piece.events else piece
    for edge in sorted(automaton.edges_from(piece.mode), key=lambda edge: edge.is_self_transition):
        crossed, left = cross(automaton, piece, edge, u)
        if crossed is not None and crossed.probability >= NEGLIGIBLE:
            travelling.append(crossed)
        if left is None or left.probability < NEGLIGIBLE:
            return []
        piece = left
    return [piece]


def guard_limits(edges: Sequence[Edge]) -> list[tuple[Floats, float]]:
    """The guards of one half-space on the state alone, turned round: weights @ x >= offset is outside the guard."""
    single = [edge.guard.half_spaces[0] for edge in edges if len(edge.guard.half_spaces) == 1]
    return [(-np.array(h.a), -h.c) for h in single if h.on_state and not h.on_input]


def _assembled(
    automaton: HybridAutomaton, n: int, pieces: list[Piece], remembered: Floats | None = None
) -> HybridBelief:
    """One Gaussian per mode from its pieces; a mode without any gets the mixture's, held at its pins.

    Args:
        automaton: over states and boundaries, of which the first n are states.
        remembered: state with the memories' next values, which are known and the same in all modes.
    """
    weights = np.zeros(len(automaton.modes))
    gaussians: dict[str, tuple[Floats, Floats]] = {}
    for index, mode in enumerate(automaton.modes):
        own = [piece for piece in pieces if piece.mode == mode.name]
        if own:
            weights[index] = sum(piece.probability for piece in own)
            gaussians[mode.name] = _merged(own)
    overall = _merged(pieces)
    for mode in automaton.modes:
        if mode.name not in gaussians:
            gaussians[mode.name] = gaussian.replaced_at_pins(*overall, mode.pins)
    ordered = [gaussians[mode.name] for mode in automaton.modes]
    means, factors = (np.stack([pair[i] for pair in ordered]) for i in (0, 1))
    if remembered is not None:
        for memory in automaton.input_memories:
            means[:, memory.coordinates] = remembered[memory.coordinates]
    return belief_of(weights / weights.sum(), means, factors, n)


def _merged(pieces: list[Piece]) -> tuple[Floats, Floats]:
    ends = [piece.end() for piece in pieces]
    return mixed([piece.probability for piece in pieces], np.stack([e[0] for e in ends]), [e[1] for e in ends])
