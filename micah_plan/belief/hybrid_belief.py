"""The hybrid Gaussian belief: a weight, mean and Cholesky factor per mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.thresholds import threshold_stds

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HybridBelief:
    """A mixture with one Gaussian per mode of the automaton, in the automaton's order of modes.

    Where thresholds are uncertain the Gaussians are over states and boundaries together: what passes a boundary, or
    does not, tells where it lies. The states come first, so `means` and `factors` are their marginals.

    Attributes:
        weights: (q,) probabilities of the modes, summing to 1.
        means: (q, n) [rad or m].
        factors: (q, n, n) lower Cholesky factors of the covariances.
        shifts: (q, b) by how much the uncertain boundaries are believed to lie elsewhere, in the order of
            `thresholds.threshold_stds`; None: nothing has been learned of them.
        shift_rows: (q, b, n + b) their rows of the joint lower Cholesky factors.
    """

    weights: Floats
    means: Floats
    factors: Floats
    shifts: Floats | None = None
    shift_rows: Floats | None = None

    @property
    def mean(self) -> Floats:
        """(n,) mean of the mixture."""
        return np.asarray(self.weights @ self.means)

    @property
    def covariance(self) -> Floats:
        """(n, n) covariance of the mixture (moment matching)."""
        spread = self.means - self.mean
        within = np.einsum("q,qij,qkj->ik", self.weights, self.factors, self.factors)
        return np.asarray(within + np.einsum("q,qi,qk->ik", self.weights, spread, spread))

    @property
    def most_likely(self) -> int:
        """Index of the most probable mode (the first of equals)."""
        return int(np.argmax(self.weights))

    @property
    def shift_stds(self) -> Floats | None:
        """(q, b) stds of the shifts; None as they are."""
        return None if self.shift_rows is None else np.asarray(np.linalg.norm(self.shift_rows, axis=2))


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
