"""The most probable changepoints: the MAP recursion of CHAMP, exact or with particles, and its back-tracking.

Sources: MICAH, equation for P_t and P_t^MAP; Fearnhead and Liu, JRSS B 2007. In logarithms, with segments s..t-1:
P_t(s, M) = survival(t - s - 1) L(s, t, M) p(M) P_s^MAP and
P_t^MAP = max_{s, M} β(t - s) / survival(t - s - 1) P_t(s, M).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from micah_plan.learn.segmenting.evidence import EvidenceColumn
from micah_plan.learn.segmenting.length_prior import LengthPrior
from micah_plan.learn.segmenting.resampling import resample

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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


@dataclass(frozen=True, eq=False)
class _Choice:
    """The best last segment of the rows up to one: evidence (k,) and best hypotheses (k,) of all kinds for it."""

    start: int
    evidence: Floats
    hypothesis: Ints

    def piece(self, end: int) -> Piece:
        kind = int(np.argmax(self.evidence))
        return Piece(self.start, end, int(self.hypothesis[kind]), float(self.evidence[kind]))


def most_probable(
    stream: Stream, prior: LengthPrior, rng: np.random.Generator, particles: int | None = None
) -> Segmentation:
    """The MAP changepoints and models of the rows of a stream.

    Args:
        stream: evidence of its rows.
        prior: of segment lengths, in rows.
        rng: for resampling; unused where every start is kept.
        particles: most starts kept after a row; None: all of them, which is exact.
    """
    rows = len(stream)
    every = np.arange(1, rows + 1)
    log_length, log_survival = prior.log_probability(every), prior.log_survival(every - 1)
    best_before = np.full(rows + 1, -np.inf)  # P^MAP of a changepoint before each row
    best_before[0] = 0.0
    last: list[_Choice | None] = [None] * (rows + 1)
    for row in range(rows):
        column = stream.advance()
        end = row + 1
        joint = column.log_evidence.max(axis=1) + best_before[column.starts]
        joint -= np.log(column.log_evidence.shape[1])
        score = joint + (log_length if end < rows else log_survival)[row - column.starts]
        i = int(np.argmax(score))
        best_before[end] = score[i]
        last[end] = _Choice(int(column.starts[i]), column.log_evidence[i], column.hypothesis[i])
        if particles is not None and len(column.starts) > particles:
            # The weight of a start sums over the models of its segment.
            of_kinds = logsumexp(column.log_evidence, axis=1) - column.log_evidence.max(axis=1)
            filtering = joint + of_kinds + log_survival[row - column.starts]
            stream.keep(resample(np.exp(filtering - filtering.max()), particles, rng)[0])
    pieces: list[Piece] = []
    end = rows
    while end > 0:
        choice = last[end]
        if choice is None:
            break
        pieces.append(choice.piece(end - 1))
        end = choice.start
    return Segmentation(tuple(reversed(pieces)), float(best_before[rows]))
