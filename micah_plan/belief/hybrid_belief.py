"""Hybrid Gaussian beliefs, one and many: per mode a weight, a mean and a Cholesky factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats, Ints


@dataclass(frozen=True, eq=False)
class BeliefBatch:
    """t hybrid beliefs of one automaton. A mode without weight has no Gaussian: its numbers are meaningless.

    Where thresholds are uncertain the Gaussians are over states and boundaries together: a state that passes a
    boundary, or does not, is information about it. The states x come first.

    Attributes:
        weights: (t, q) probabilities of the modes, in the automaton's order; they sum to 1.
        joint_means: (t, q, n + b) [rad or m]; joint_factors: (t, q, n + b, n + b) lower Cholesky factors.
        n: number of states.
    """

    weights: Floats
    joint_means: Floats
    joint_factors: Floats
    n: int

    @staticmethod
    def of(weights: Floats, means: Floats, factors: Floats, n: int) -> BeliefBatch:
        """From weights (q, t) and arrays reshaped to (n + b, q, t) and (n + b, n + b, q, t): see `side_by_side`."""
        size, shape = len(means), weights.shape
        joint_means, joint_factors = means.reshape(size, *shape), factors.reshape(size, size, *shape)
        return BeliefBatch(weights.T, joint_means.transpose(2, 1, 0), joint_factors.transpose(3, 2, 0, 1), n)

    def side_by_side(self) -> tuple[Floats, Floats, Floats]:
        """Weights (q, t), means (n + b, q, t) and factors (n + b, n + b, q, t): the belief's number last."""
        return self.weights.T, self.joint_means.transpose(2, 1, 0), self.joint_factors.transpose(2, 3, 1, 0)

    def alone(self, number: int) -> HybridBelief:
        """A single belief, all of whose modes must have a Gaussian; read-only."""
        n = self.n
        weights, means, factors = self.weights[number], self.joint_means[number], self.joint_factors[number]
        parts = [weights, means[:, :n], factors[:, :n, :n]]
        if means.shape[1] > n:
            parts += [means[:, n:], factors[:, n:]]
        for array in parts:
            array.setflags(write=False)
        return HybridBelief(*parts)

    def where(self, chosen: Sequence[int]) -> BeliefBatch:
        """The beliefs with these numbers."""
        beliefs = list(chosen)
        return BeliefBatch(self.weights[beliefs], self.joint_means[beliefs], self.joint_factors[beliefs], self.n)

    @property
    def means(self) -> Floats:
        """(t, q, n) of the states."""
        return self.joint_means[:, :, : self.n]

    @property
    def factors(self) -> Floats:
        """(t, q, n, n) of the states."""
        return self.joint_factors[:, :, : self.n, : self.n]

    @property
    def most_likely(self) -> Ints:
        """(t,) index of the most probable mode (the first of equals)."""
        return np.asarray(np.argmax(self.weights, axis=1))


@dataclass(frozen=True, eq=False)
class HybridBelief:
    """A mixture with one Gaussian per mode of the automaton, in the automaton's order of modes.

    A mode without weight has the mixture's Gaussian put at its pins: the belief if it were entered.

    Attributes:
        weights: (q,) probabilities of the modes, summing to 1.
        means: (q, n) [rad or m].
        factors: (q, n, n) lower Cholesky factors of the covariances.
        shifts: (q, b) estimated displacements of the uncertain boundaries, in the order of `thresholds.threshold_stds`;
            None: no estimate yet.
        shift_rows: (q, b, n + b) their rows of the joint lower Cholesky factors.
        was_reinitialised: whether it was lost and began anew from the last measurement, see `filter`.
    """

    weights: Floats
    means: Floats
    factors: Floats
    shifts: Floats | None = None
    shift_rows: Floats | None = None
    was_reinitialised: bool = False

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


def batch_of(beliefs: Sequence[HybridBelief], stds: Floats) -> BeliefBatch:
    """Single beliefs as a batch; boundaries without estimates keep the model's stds.

    Args:
        stds: (b,) of the uncertain boundaries in the model.
    """
    joint = (
        [_joint(belief, stds) for belief in beliefs]
        if stds.size
        else [(belief.means, belief.factors) for belief in beliefs]
    )
    means, factors = (np.array(values) for values in zip(*joint, strict=True))
    return BeliefBatch(np.array([belief.weights for belief in beliefs]), means, factors, means.shape[2] - stds.size)


def _joint(belief: HybridBelief, stds: Floats) -> tuple[Floats, Floats]:
    """(q, n + b) means and (q, n + b, n + b) factors over states and boundaries."""
    (q, n), b = belief.means.shape, stds.size
    means, factors = np.zeros((q, n + b)), np.zeros((q, n + b, n + b))
    means[:, :n], factors[:, :n, :n] = belief.means, belief.factors
    if belief.shifts is None or belief.shift_rows is None:
        factors[:, n:, n:] = np.diag(stds)
    else:
        means[:, n:], factors[:, n:] = belief.shifts, belief.shift_rows
    return means, factors
