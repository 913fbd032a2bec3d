"""The hybrid Gaussian belief: a weight, mean and Cholesky factor per mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HybridBelief:
    """A mixture with one Gaussian per mode of the automaton, in the automaton's order of modes.

    Attributes:
        weights: (q,) probabilities of the modes, summing to 1.
        means: (q, n) [rad or m].
        factors: (q, n, n) lower Cholesky factors of the covariances.
    """

    weights: Floats
    means: Floats
    factors: Floats

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
