"""The most probable changepoints of a stream: the MAP recursion of CHAMP with particles, and its back-tracking.

Sources: MICAH, equation for P_t and P_t^MAP; Fearnhead and Liu, JRSS B 2007. In logarithms, with segments s..t-1:
P_t(s, M) = survival(t - s - 1) L(s, t, M) p(M) P_s^MAP and
P_t^MAP = max_{s, M} β(t - s) / survival(t - s - 1) P_t(s, M).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log
from typing import Protocol

import numpy as np

from micah_plan.arrays import Floats, Ints
from micah_plan.learn.segmenting.evidence import EvidenceColumn
from micah_plan.learn.segmenting.length_prior import LengthPrior
from micah_plan.learn.segmenting.resampling import resample


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
