"""The most probable changepoints of a stream: the MAP recursion of CHAMP with particles, and its back-tracking.

Sources: MICAH, equation for P_t and P_t^MAP; Fearnhead and Liu, JRSS B 2007. In logarithms, with segments s..t-1:
P_t(s, M) = survival(t - s - 1) L(s, t, M) p(M) P_s^MAP and
P_t^MAP = max_{s, M} β(t - s) / survival(t - s - 1) P_t(s, M).

The exact recursion for the most probable changepoints, over the evidence of all segments at once.

The same as `changepoints.most_probable` where every start is kept (a test compares them), ten times faster: which model
is best for a segment does not depend on the others, so it is chosen for all of them before the recursion begins.

The length prior β of a segment and its cumulative B: a discretised gamma distribution over rows, normalised.

Source: MICAH, equation for p(τ_{i+1} = t | τ_i = j) = β(t - j); the open last segment uses the survival 1 - B.

Stratified optimal resampling of weighted particles.

Source: Fearnhead and Liu, "On-line inference for multiple changepoint problems", JRSS B 2007, section 3.2, algorithm
SOR: heavy particles are kept as they are, light ones are resampled with stratification and share one weight, so that
every expected weight is preserved and the Kolmogorov-Smirnov distance is small.

Evidence of the open segments of a few hypotheses, row by row: what the recursion with particles needs.

Memory is (live starts × hypotheses) and a row costs as much, where the exact recursion holds all (n, n) segments.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import log
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc, gammaincc

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.joint import JointKind
from micah_plan.errors import InputError
from micah_plan.learn.segmenting.evidence import EvidenceColumn, EvidenceTable
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack


class Stream(Protocol):
    """What the recursion needs: evidence columns row by row, and forgetting of starts."""

    def __len__(self) -> int: ...

    def advance(self) -> EvidenceColumn: ...

    def keep(self, index: Ints) -> None: ...


@dataclass(frozen=True)
class Piece:
    """A segment of the most probable path.

    Attributes:
        start, end: first and last row (inclusive), within the track.
        hypothesis: index of its joint in the pool.
        log_evidence: of that model.
    """

    start: int
    end: int
    hypothesis: int
    log_evidence: float


@dataclass(frozen=True)
class Segmentation:
    """The most probable segments and the log of their joint probability with the rows."""

    pieces: tuple[Piece, ...]
    log_probability: float

    @property
    def which(self) -> Ints:
        """(n,) the hypothesis that explains each row."""
        return np.concatenate([np.full(p.end - p.start + 1, p.hypothesis) for p in self.pieces])


@dataclass(frozen=True, eq=False)
class _Link:
    """The best last segment of the rows up to its end, and the link of the rows before it.

    A link lives as long as a start that it leads to.
    """

    piece: Piece
    before: _Link | None


class MapRecursion:
    """P_t^MAP over the rows of a stream, of which it keeps what its live starts need: as many numbers as particles.

    Args:
        stream: evidence of the rows.
        prior: of segment lengths, in rows.
        rng: for resampling; unused where every start is kept.
        particles: most starts kept after a row; None: all of them, which is exact.
    """

    def __init__(
        self, stream: Stream, prior: LengthPrior, rng: np.random.Generator, particles: int | None = None
    ) -> None:
        self._stream, self._prior, self._rng, self._particles = stream, prior, rng, particles
        self._log_length, self._log_survival = np.zeros(0), np.zeros(0)
        self._best_before = np.zeros(0)  # P^MAP of a changepoint before each live start
        self._links: list[_Link | None] = []
        self._closed = 0.0
        self._last: _Link | None = None
        self._open: tuple[EvidenceColumn, Floats, list[_Link | None]] | None = None
        self._row = -1

    def advance(self) -> None:
        """Take the next row in."""
        self._row += 1
        column = self._stream.advance()
        self._best_before = np.concatenate([self._best_before, [self._closed]])
        self._links.append(self._last)
        self._extend_prior(self._row - int(column.starts[0]) + 1)
        best = column.log_evidence.max(axis=1)
        joint = best + self._best_before - log(column.log_evidence.shape[1])
        self._open = column, joint, self._links
        self._last, self._closed = self._best(*self._open, self._log_length)
        if self._particles is not None and len(column.starts) > self._particles:
            # The weight of a start sums over the models of its segment.
            of_kinds = np.logaddexp.reduce(column.log_evidence, axis=1) - log(column.log_evidence.shape[1])
            filtering = of_kinds + self._best_before + self._log_survival[self._row - column.starts]
            kept = resample(np.exp(filtering - filtering.max()), self._particles, self._rng)[0]
            self._stream.keep(kept)
            self._best_before = self._best_before[kept]
            self._links = [self._links[i] for i in kept.tolist()]

    def segmentation(self) -> Segmentation:
        """The most probable segments of the rows so far; the last one is open."""
        if self._open is None:
            return Segmentation((), 0.0)
        link, score = self._best(*self._open, self._log_survival)
        pieces: list[Piece] = []
        at: _Link | None = link
        while at is not None:
            pieces.append(at.piece)
            at = at.before
        return Segmentation(tuple(reversed(pieces)), score)

    def _best(
        self, column: EvidenceColumn, joint: Floats, links: list[_Link | None], log_prior: Floats
    ) -> tuple[_Link, float]:
        score = joint + log_prior[self._row - column.starts]
        i = int(np.argmax(score))
        evidence = column.log_evidence[i]
        kind = int(np.argmax(evidence))
        piece = Piece(int(column.starts[i]), self._row, column.hypothesis(i, kind), float(evidence[kind]))
        return _Link(piece, links[i]), float(score[i])

    def _extend_prior(self, longest: int) -> None:
        """Tables for segments of 1, 2, ... rows, doubled when a segment outgrows them."""
        if longest > len(self._log_length):
            every = np.arange(1, max(2 * longest, 64) + 1)
            self._log_length = self._prior.log_probability(every)
            self._log_survival = self._prior.log_survival(every - 1)


def most_probable(
    stream: Stream, prior: LengthPrior, rng: np.random.Generator, particles: int | None = None
) -> Segmentation:
    """The MAP changepoints and models of the rows of a stream; arguments as in `MapRecursion`."""
    recursion = MapRecursion(stream, prior, rng, particles)
    for _ in range(len(stream)):
        recursion.advance()
    return recursion.segmentation()


def best_segmentation(
    table: EvidenceTable,
    prior: LengthPrior,
    kinds: int,
    members: Sequence[int] | None = None,
    paid: Collection[int] = (),
) -> Segmentation:
    """The MAP changepoints and models of the rows of a table.

    Args:
        prior: of segment lengths.
        kinds: number of candidate kinds, equally probable.
        members: hypotheses to choose among; None: all.
        paid: those whose parameters cost a segment nothing (whoever chose them pays).
    """
    models = _Models(table, members, paid)
    n = table.log_density.shape[1]
    worth = models.best + (length_terms(prior, n) - np.log(kinds))
    best_before = reached(worth)
    last = np.append(0, (worth + best_before[:-1, None]).argmax(axis=0))
    pieces: list[Piece] = []
    end = n
    while end > 0:
        start = int(last[end])
        pieces.append(Piece(start, end - 1, models.which(start, end - 1), float(models.best[start, end - 1])))
        end = start
    return Segmentation(tuple(reversed(pieces)), float(best_before[n]))


def reached(worth: Floats) -> Floats:
    """(n + 1,) ln probability of the rows before each under their best segments (n, n), whatever follows what."""
    columns = np.ascontiguousarray(worth.T)
    best = np.zeros(len(columns) + 1)
    for row, column in enumerate(columns):
        best[row + 1] = (best[: row + 1] + column[: row + 1]).max()
    return best


@lru_cache(maxsize=4)
def length_terms(prior: LengthPrior, n: int) -> Floats:
    """(n, n) ln prior of the length of a segment (first, last row); the last row leaves it open."""
    every = np.arange(1, n + 1)
    log_length, log_survival = prior.log_probability(every), prior.log_survival(every - 1)
    lengths = np.maximum(np.arange(n)[None] - np.arange(n)[:, None], 0)
    terms = log_length[lengths]
    terms[:, -1] = log_survival[lengths[:, -1]]
    terms[np.tril_indices(n, -1)] = -np.inf
    return np.asarray(terms)


class _Models:
    """The best of some hypotheses for every segment.

    Attributes:
        best: (n, n) its evidence, by first and last row.
    """

    def __init__(self, table: EvidenceTable, members: Sequence[int] | None, paid: Collection[int]) -> None:
        self._table = table
        self._members = np.arange(len(table.rows)) if members is None else np.array(members)
        self._charged = ~np.isin(self._members, list(paid))
        if members is None and not paid:
            self.best: Floats = table.best
            return
        first, *others = [table.sums[i] if i in paid else table.charged(i) for i in self._members.tolist()]
        self.best = first.copy() if others else first
        for layer in others:
            np.maximum(self.best, layer, out=self.best)

    def which(self, start: int, end: int) -> int:
        """The hypothesis that is best for one segment."""
        of_segment = self._table.sums[self._members, start, end]
        of_segment -= self._charged * self._table.cost(self._members, np.array(end - start + 1.0))
        return int(self._members[np.argmax(of_segment)])


_SMALLEST = 1e-300


def length_priors(track: PartTrack, settings: LearnSettings) -> list[LengthPrior]:
    """Priors of the lengths of a track's segments, in its rows, the longest first: how often a part stops is unknown.

    Where it moves once there and back, a segment lasts half of the track. Where it moves there and back many times it
    may be one segment as before, or segments may last as long as they do there, or anything between: each halving is a
    hypothesis of its own. A mean that was set is the only one.
    """
    if settings.mean_length is not None:
        means = [settings.mean_length / max(track.duration, 1e-12)]
    else:
        means = [0.5 ** (1 + i) for i in range(1 + round(float(np.log2(max(settings.sweeps or 1.0, 1.0)))))]
    return [LengthPrior(max(share * len(track), 1.0), settings.length_shape) for share in means]


@dataclass(frozen=True)
class LengthPrior:
    """β(n) = G(n) - G(n - 1) for n = 1, 2, ... rows, with G the gamma distribution of a mean [rows] and a shape."""

    mean: float
    shape: float

    def __post_init__(self) -> None:
        if not (self.mean > 0 and self.shape > 0):
            raise InputError(f"a length prior needs a positive mean and shape. Got {self}")

    def log_probability(self, length: ArrayLike) -> Floats:
        """ln β(n): probability that a segment has exactly n rows (n >= 1)."""
        n = np.asarray(length, dtype=float)
        rate = self.shape / self.mean
        lower, upper = gammaincc(self.shape, (n - 1) * rate), gammaincc(self.shape, n * rate)
        from_start = gammainc(self.shape, n * rate) - gammainc(self.shape, (n - 1) * rate)
        # Differences of the small tail keep their digits: below the median the cdf is small, above it the survival.
        return np.asarray(np.log(np.maximum(np.where(lower > 0.5, from_start, lower - upper), _SMALLEST)))

    def log_survival(self, length: ArrayLike) -> Floats:
        """ln (1 - B(n)): probability that a segment has more than n rows (n >= 0)."""
        n = np.asarray(length, dtype=float)
        return np.asarray(np.log(np.maximum(gammaincc(self.shape, n * self.shape / self.mean), _SMALLEST)))


def resample(weights: Floats, count: int, rng: np.random.Generator) -> tuple[Ints, Floats]:
    """At most `count` of the particles, in their order.

    Args:
        weights: (m,) non-negative, not all zero.
        count: particles to keep.

    Returns:
        their indices and new weights, with E[new weight of particle i] = weights[i] / sum(weights).
    """
    total = float(weights.sum())
    if count < 1 or not np.isfinite(total) or total <= 0 or (weights < 0).any():
        raise InputError("resampling needs weights >= 0 with a positive sum, and a count >= 1")
    normalised = weights / total
    if np.count_nonzero(normalised) <= count:
        kept = np.flatnonzero(normalised)
        return kept, normalised[kept]
    threshold = _threshold(normalised, count)
    heavy = normalised >= threshold
    light = np.flatnonzero(~heavy)
    places = count - int(heavy.sum())
    chosen = light[:0]
    if places > 0:
        # Strata of width `threshold` along the cumulative weight of the light particles, one uniform offset for all.
        cumulated = np.cumsum(normalised[light]) / threshold
        marks = rng.uniform() + np.arange(places)
        picked = np.searchsorted(cumulated, marks, side="right")
        chosen = light[np.minimum(picked, len(light) - 1)]
    kept = np.sort(np.concatenate([np.flatnonzero(heavy), chosen]))
    return kept, np.where(heavy[kept], normalised[kept], threshold)


def _threshold(weights: Floats, count: int) -> float:
    """The α with sum(min(1, w / α)) = count."""
    ordered = np.sort(weights).tolist()
    below, free = 0.0, count - len(ordered)
    # If only those up to the i-th are light, α = (their sum) / (places left to them); it fits if it separates.
    for weight, above in zip(ordered, [*ordered[1:], np.inf], strict=True):
        below, free = below + weight, free + 1
        if free > 0 and weight * (1 - 1e-12) <= below / free <= above * (1 + 1e-12):
            break
    return below / free


class RunningEvidence:
    """Sums of densities since each live start.

    Args:
        table: densities.
        kinds: candidate kinds, in the order of the evidence's columns.
        members: hypotheses to choose among.
        paid: those whose parameters cost a segment nothing (whoever chose them pays).
    """

    def __init__(
        self, table: EvidenceTable, kinds: tuple[JointKind, ...], members: Sequence[int], paid: Collection[int] = ()
    ) -> None:
        names = table.pool.hypotheses.joints.kinds
        of_kind = [[i for i in members if names[i] == kind] for kind in kinds]
        self._members = np.array([i for one in of_kind for i in one], dtype=np.int64)
        ends = np.cumsum([len(one) for one in of_kind])
        self._of_kind = [slice(end - len(one), end) for one, end in zip(of_kind, ends, strict=True)]
        # Rows by rows known before them; what those of a young segment differ by from the others.
        density = table.log_density[:, :, self._members]
        self._density, self._young = np.ascontiguousarray(density[-1]), density[:-1] - density[-1]
        self._cost: Floats | None = None
        if not set(members) <= set(paid):
            lengths = np.arange(1.0, len(self) + 1)[:, None]
            self._cost = np.where(np.isin(self._members, list(paid)), 0.0, table.cost(self._members, lengths)).T
        self._sums = np.zeros((len(self._members), 0))
        self.starts: Ints = np.zeros(0, dtype=np.int64)
        self.row = -1

    def __len__(self) -> int:
        return len(self._density)

    def advance(self) -> EvidenceColumn:
        """Open a segment at the next row and take that row into all open segments."""
        self.row += 1
        self.starts = np.concatenate([self.starts, [self.row]])
        live = len(self.starts)
        density = self._density[self.row][:, None]
        sums = np.empty((len(self._members), live))
        np.add(self._sums, density, out=sums[:, :-1])
        sums[:, -1:] = density
        young = self.starts[max(live - len(self._young), 0) :]
        young = young[young > self.row - len(self._young)]
        if len(young):
            sums[:, live - len(young) :] += self._young[self.row - young, self.row].T
        self._sums = sums
        total = sums if self._cost is None else sums - self._cost.take(self.row - self.starts, axis=1)
        best = np.full((len(self._of_kind), live), -np.inf)
        for row, of_kind in zip(best, self._of_kind, strict=True):
            if of_kind.start < of_kind.stop:
                total[of_kind].max(axis=0, out=row)

        def hypothesis(i: int, kind: int) -> int:
            own = self._of_kind[kind]
            return int(self._members[own.start + int(total[own, i].argmax())])

        return EvidenceColumn(self.starts, best.T, hypothesis)

    def keep(self, index: Ints) -> None:
        """Go on with these of the open segments only (indices into the last column)."""
        self.starts, self._sums = self.starts[index], self._sums[:, index]
