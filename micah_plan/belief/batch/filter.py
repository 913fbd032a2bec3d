"""The hybrid filter over many roll-outs at once. Twin of `belief.filter`, compared by a test.

One roll-out's filter spends its time in the calls of NumPy rather than in arithmetic; here each call serves all of
them. Modes without weight are left out: their means and factors say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import passed_arrays
from micah_plan.automaton.thresholds import with_boundary_states
from micah_plan.belief.batch import gaussian
from micah_plan.belief.batch.crossing import Pieces, cross, whole_step, widened
from micah_plan.belief.batch.sliding import slid
from micah_plan.belief.batch.truncation import log_inside, truncate
from micah_plan.belief.filter import MOST_EVENTS, NEGLIGIBLE, guard_limits
from micah_plan.belief.hybrid_belief import HybridBelief, joint_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class BeliefBatch:
    """t hybrid beliefs over states x and uncertain boundaries.

    Attributes:
        weights: (t, q).
        joint_means: (t, q, n + b); joint_factors: (t, q, n + b, n + b) lower.
        n: number of states, which come first.
    """

    weights: Floats
    joint_means: Floats
    joint_factors: Floats
    n: int

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


def repeated(automaton: HybridAutomaton, belief: HybridBelief, count: int) -> BeliefBatch:
    """The same belief `count` times."""
    parts = (belief.weights, *joint_of(automaton, belief))
    weights, means, factors = (np.repeat(values[None], count, axis=0) for values in parts)
    return BeliefBatch(weights, means, factors, automaton.n)


def predict(automaton: HybridAutomaton, beliefs: BeliefBatch, u: Floats) -> BeliefBatch:
    """The beliefs after one step with inputs u (t, m)."""
    automaton = with_boundary_states(automaton)
    arrived: list[list[Pieces]] = [[] for _ in automaton.modes]
    remembered = np.zeros(beliefs.joint_means[:, 0].shape)
    travelling: list[tuple[Pieces, Floats]] = []
    for index in range(len(automaton.modes)):
        owner = np.flatnonzero(beliefs.weights[:, index] >= NEGLIGIBLE)
        if owner.size:
            mean, factor = beliefs.joint_means[owner, index], beliefs.joint_factors[owner, index]
            passed, name = u.copy(), automaton.modes[index].name
            passed[owner], remembered[owner] = passed_arrays(automaton.input_memories, name, mean, u[owner])
            weights = beliefs.weights[owner, index]
            travelling.append((whole_step(automaton, index, owner, weights, mean, factor, passed[owner]), passed))
    while travelling:
        pieces, passed = travelling.pop()
        onward: list[Pieces] = []
        arrived[pieces.mode] += _through_guards(automaton, pieces, passed, onward)
        travelling += [(piece, passed) for piece in onward]
    return _assembled(automaton, beliefs, arrived, remembered)


def update(automaton: HybridAutomaton, beliefs: BeliefBatch, z: Floats) -> BeliefBatch:
    """The beliefs after measuring z (t, n); columns that are not measured are NaN for all."""
    if not np.isfinite(z).any():
        return beliefs
    whole, n = with_boundary_states(automaton), automaton.n
    z = np.hstack([z, np.full((len(z), whole.n - n), np.nan)])
    means, factors = beliefs.joint_means.copy(), beliefs.joint_factors.copy()
    scores = np.full(beliefs.weights.shape, -np.inf)
    for index, mode in enumerate(whole.modes):
        owner = np.flatnonzero(beliefs.weights[:, index] > 0)
        if not owner.size:
            continue
        before = means[owner, index], factors[owner, index]
        mean, factor, score = gaussian.update(*before, z[owner], whole.sensing(mode).std_at(before[0]))
        for weights, offset in guard_limits(whole.edges_from(mode.name)):
            score = score - log_inside(*before, weights, offset) + log_inside(mean, factor, weights, offset)
            behind = mean @ weights < offset
            if behind.any():
                mean, factor = mean.copy(), factor.copy()
                mean[behind], factor[behind] = truncate(mean[behind], factor[behind], weights, offset)
        means[owner, index], factors[owner, index] = mean, factor
        scores[owner, index] = score + np.log(beliefs.weights[owner, index])
    weights = np.exp(scores - scores.max(axis=1, keepdims=True))
    return BeliefBatch(weights / weights.sum(axis=1, keepdims=True), means, factors, n)


def _through_guards(automaton: HybridAutomaton, pieces: Pieces, u: Floats, travelling: list[Pieces]) -> list[Pieces]:
    """The shares that stay in their mode to the end of the step; what leaves is put on `travelling`."""
    tired = pieces.events >= MOST_EVENTS
    ended = [pieces.where(tired)] if tired.any() else []
    pieces = pieces.where(~tired)
    pieces = slid(automaton, pieces, u[pieces.owner])
    name = automaton.modes[pieces.mode].name
    for edge in sorted(automaton.edges_from(name), key=lambda edge: edge.is_self_transition):
        if not len(pieces):
            break
        crossed, left = cross(automaton, pieces, edge, u[pieces.owner])
        crossed = crossed.where(crossed.probability >= NEGLIGIBLE)
        if len(crossed):
            travelling.append(crossed)
        pieces = left.where(left.probability >= NEGLIGIBLE)
    return [*ended, pieces] if len(pieces) else ended


def _assembled(
    automaton: HybridAutomaton, before: BeliefBatch, arrived: list[list[Pieces]], remembered: Floats
) -> BeliefBatch:
    """One Gaussian per belief and mode from its pieces; the memories' values (t, n + b) are known."""
    weights = np.zeros_like(before.weights)
    means, factors = np.zeros_like(before.joint_means), np.zeros_like(before.joint_factors)
    for index in range(len(automaton.modes)):
        if arrived[index]:
            owners, weight, mean, factor = _merged(arrived[index])
            weights[owners, index], means[owners, index], factors[owners, index] = weight, mean, factor
    for memory in automaton.input_memories:
        means[:, :, memory.coordinates] = remembered[:, None, memory.coordinates]
    return BeliefBatch(weights / weights.sum(axis=1, keepdims=True), means, factors, before.n)


def _merged(parts: list[Pieces]) -> tuple[Ints, Floats, Floats, Floats]:
    """Per owner (o,): weight, mean (o, n) and factor (o, n, n) of its pieces in one mode (moment matching)."""
    n, widest = parts[0].n, max(part.factor.shape[2] for part in parts)
    owner = np.concatenate([part.owner for part in parts])
    probability = np.concatenate([part.probability for part in parts])
    mean = np.concatenate([part.mean[:, n:] for part in parts])
    factor = np.concatenate([widened(part.factor[:, n:], widest) for part in parts])
    owners, place, counts = np.unique(owner, return_inverse=True, return_counts=True)
    weight = np.zeros(owners.size)
    np.add.at(weight, place, probability)
    share = probability / weight[place]
    center = np.zeros((owners.size, n))
    np.add.at(center, place, share[:, None] * mean)
    columns = np.concatenate([factor, (mean - center[place])[:, :, None]], axis=2) * np.sqrt(share)[:, None, None]
    # The pieces of one owner side by side: piece number r of it takes the r-th block of columns.
    order = np.argsort(place, kind="stable")
    rank = np.empty(owner.size, dtype=np.int64)
    rank[order] = np.arange(owner.size) - np.repeat(np.cumsum(counts) - counts, counts)
    blocks = np.zeros((owners.size, counts.max(), n, widest + 1))
    blocks[place, rank] = columns
    stacked = blocks.transpose(0, 2, 1, 3).reshape(owners.size, n, -1)
    return owners, weight, center, gaussian.lower_factors(stacked)
