"""The evidence ln L(s, t, M) of every segment, from densities of rows that no start needs to compute again.

One generative model serves all kinds: measured pose = joint at its configuration + an error with wander and tails (see
noise.py). Rigid is the joint without motion. A row's density given the rows before it in the same segment depends on
the segment's start only through how many rows there are to predict from, and beyond noise.MEMORY not at all; so the
evidence of a segment is a sum of tabled terms. A revolute joint that rests is no likelier than a rigid one.

Source: MICAH, ln L ≈ ln p(y | M, θ̂, a) - k/2 ln(t - s).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.segmenting.motion import Motion, fit_motion
from micah_plan.learn.segmenting.noise import NoiseModel, log_peak
from micah_plan.learn.segmenting.occam import held_cost, parameter_cost, parameter_count
from micah_plan.learn.segmenting.pool import Hypotheses, Pool, pool_of
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SLIP = 0.01  # probability that a row tells nothing of the next
# Power of the likelihood (Miller and Dunson, "Robust Bayesian inference via coarsening", JASA 2019): joints are not
# ideal and trackers err by more than any noise model says, so rows count for less than they claim.
TRUST = 0.5


@dataclass(frozen=True, eq=False)
class EvidenceTable:
    """Densities of rows under a pool.

    Attributes:
        pool, motion: the h hypotheses and how the part moves along them.
        log_density: (p + 1, n, h): of a row, given 0, 1, ... p rows before it.
        parameters: (h,) numbers that fix a hypothesis.
        occam: (h,) ln of how much narrower than before the parameters are after the rows they were fitted to.
        held: (h,) the same, given that a moving joint of the pool explains other rows.
        rows: (h,) how many rows they were fitted to.
    """

    pool: Pool
    motion: Motion
    log_density: Floats
    parameters: Floats
    occam: Floats
    held: Floats
    rows: Floats

    @cached_property
    def sums(self) -> Floats:
        """(n, n, h) evidence of every segment (first, last row), its joint's parameters paid for by someone else."""
        return segment_sums(self.log_density)

    @cached_property
    def charged(self) -> Floats:
        """(n, n, h) the same, less what a segment pays for a joint of its own."""
        n, h = self.log_density.shape[1:]
        costs = self.cost(np.arange(h), np.arange(1.0, n + 1)[:, None])
        lengths = np.maximum(np.arange(n)[None] - np.arange(n)[:, None], 0)
        return np.asarray(self.sums - costs[lengths])

    def cost(self, index: Ints, rows: Floats, held: bool = True) -> Floats:
        """What a segment of so many rows pays for a hypothesis' parameters."""
        n = np.maximum(rows, np.maximum(self.parameters[index], 1.0))
        return np.asarray(
            (self.held if held else self.occam)[index] + 0.5 * self.parameters[index] * np.log(n / self.rows[index])
        )


def tabulated(
    hypotheses: Hypotheses, track: PartTrack, noise: NoiseModel, use_actions: bool, rest: float
) -> EvidenceTable:
    """The densities of all rows under all hypotheses.

    Args:
        use_actions: whether motion is predicted from the actions (Act-CHAMP).
        rest: prior probability that a part on a moving joint rests in a step, where actions do not tell.
    """
    pool = pool_of(hypotheses, track, noise)
    table, scale = _across(pool, noise)
    motion = fit_motion(pool, track.action if use_actions else None, rest, scale)
    # Where on its joint a segment starts is uniform over what the recording reaches.
    table[1:] += motion.log_density.T
    table[0] -= np.log(np.maximum(np.ptp(pool.seen.configuration, axis=1), 1e-9)) * pool.moving
    # A tracker may slip: then the row is as unforeseen as the first of a segment.
    slipped = np.log(_SLIP) + table[0]
    table[1:] = np.logaddexp(np.log1p(-_SLIP) + table[1:], slipped)
    # The first row of a segment may go on where the row before was, or not.
    table[:-1, 1:] = np.logaddexp(table[:-1, 1:], table[1:, 1:]) + np.log(0.5)
    table *= TRUST
    rows = np.maximum(hypotheses.used.sum(axis=1), 1).astype(float)
    of_motion = 0.5 * motion.parameters * np.log(rows)
    cost = parameter_cost(pool, track, noise, TRUST)
    held = held_cost(cost, pool, noise, TRUST)
    counts = [parameter_count(kind, track.quaternion is not None) for kind in hypotheses.joints.kinds]
    parameters = np.array(counts, dtype=float) + motion.parameters
    return EvidenceTable(pool, motion, table, parameters, cost + of_motion, held + of_motion, rows)


def _across(pool: Pool, noise: NoiseModel) -> tuple[Floats, Floats]:
    """(p + 1, n, h) ln densities across the joints, and (h, n) how much wider than usual a row's noise is."""
    error = pool.seen.error
    d = error.shape[2]
    size = d - pool.moving[:, None]
    peak = np.where(pool.moving, log_peak(d - 1, noise.dof), log_peak(d, noise.dof))[:, None]
    log_correlation = float(np.log(np.diag(np.linalg.cholesky(noise.correlation))).sum())
    table = np.zeros((len(noise.left), error.shape[1], len(error)))
    squares = np.zeros(error.shape[:2])
    for order, left in enumerate(noise.left):
        squares = (noise.whitened(error, order) ** 2).sum(axis=2)
        # The direction of motion is not counted here.
        scaled = (pool.seen.direction / np.sqrt(left)) @ noise.decorrelation.T
        information = np.where(pool.moving[:, None], (scaled**2).sum(axis=2), 1.0)
        hidden = -0.5 * np.log(np.maximum(information, 1e-12))
        tails = -0.5 * (noise.dof + size) * np.log1p(squares / (noise.dof + size))
        table[order] = (peak + tails - 0.5 * np.log(left).sum() - log_correlation + hidden).T
    # Given how far off a row is across the joint, Student's distribution is as much wider along it.
    return table, 1 + (squares - size) / (noise.dof + size)


@dataclass(frozen=True, eq=False)
class EvidenceColumn:
    """Evidence of all open segments up to one row.

    Attributes:
        starts: (m,) first rows of the segments.
        log_evidence: (m, k) for each candidate kind; -inf where no hypothesis of that kind exists.
        hypothesis: (m, k) index of the best hypothesis of that kind.
    """

    starts: Ints
    log_evidence: Floats
    hypothesis: Ints


class ExactEvidence:
    """Evidence of all segments of a track, given out row by row as a stream's is: the reference for both recursions.

    Args:
        table: densities; every segment pays for the parameters of its joint.
        kinds: candidate kinds, in the order of the evidence's columns.
    """

    def __init__(self, table: EvidenceTable, kinds: tuple[JointKind, ...]) -> None:
        names = table.pool.hypotheses.joints.kinds
        members = [np.flatnonzero([name == kind for name in names]) for kind in kinds]
        n = len(table.charged)
        self._best = np.full((n, n, len(kinds)), -np.inf)
        self._which = np.zeros((n, n, len(kinds)), dtype=np.int64)
        for column, of_kind in enumerate(members):
            if len(of_kind):
                evidence = table.charged[:, :, of_kind]
                self._best[:, :, column] = evidence.max(axis=2)
                self._which[:, :, column] = of_kind[np.argmax(evidence, axis=2)]
        self.starts: Ints = np.zeros(0, dtype=np.int64)
        self.row = -1

    def __len__(self) -> int:
        return len(self._best)

    def advance(self) -> EvidenceColumn:
        """Open a segment at the next row and take that row into all open segments."""
        self.row += 1
        self.starts = np.append(self.starts, self.row)
        return EvidenceColumn(self.starts, self._best[self.starts, self.row], self._which[self.starts, self.row])

    def keep(self, index: Ints) -> None:
        """Go on with these of the open segments only (indices into the last column)."""
        self.starts = self.starts[index]


def segment_sums(log_density: Floats) -> Floats:
    """(n, n, h) evidence of rows s to t (s <= t) under every hypothesis, from densities (p + 1, n, h).

    The first p rows of a segment have their own densities; those after them are differences of one running sum.
    """
    p, n, h = len(log_density) - 1, log_density.shape[1], log_density.shape[2]
    running = np.concatenate([np.zeros((1, h)), np.cumsum(log_density[p], axis=0)])
    # Of the row s + k with k rows known before it; 0 beyond the end.
    begin = np.zeros((n, p + 1, h))
    for k in range(min(p, n)):
        begin[: n - k, k + 1] = log_density[k, k:]
    begin = np.cumsum(begin, axis=1)
    s, t = np.arange(n)[:, None], np.arange(n)[None]
    known = np.minimum(s + p, n)
    later = running[np.maximum(t + 1, known)] - running[known]
    return np.asarray(begin[s, np.clip(t - s + 1, 0, p)] + later)
