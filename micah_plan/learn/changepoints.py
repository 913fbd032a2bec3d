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

from micah_plan.learn.evidence import EvidenceColumn
from micah_plan.learn.length_prior import LengthPrior
from micah_plan.learn.resampling import resample

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Stream(Protocol):
    """What the recursion needs: evidence columns row by row, and forgetting of starts."""

    def advance(self) -> EvidenceColumn: ...

    def keep(self, index: Ints) -> None: ...


@dataclass(frozen=True)
class Piece:
    """A segment of the most probable path.

    Attributes:
        start, end: first and last row (inclusive), within the track.
        kind: index of its model among the candidate kinds.
        hypothesis: index of its joint in the pool; -1 for rigid.
        log_evidence: of that model.
        probability: of that model among the candidates for these rows.
    """

    start: int
    end: int
    kind: int
    hypothesis: int
    log_evidence: float
    probability: float


@dataclass(frozen=True)
class Segmentation:
    """The most probable segments and the log of their joint probability with the rows."""

    pieces: tuple[Piece, ...]
    log_probability: float


def most_probable(
    stream: Stream, rows: int, prior: LengthPrior, rng: np.random.Generator, particles: int | None = None
) -> Segmentation:
    """The MAP changepoints and models of the rows of a stream.

    Args:
        stream: evidence of its `rows` rows.
        prior: of segment lengths, in rows.
        rng: for resampling; unused where every start is kept.
        particles: most starts kept after a row; None: all of them, which is exact.
    """
    best_before = np.full(rows + 1, -np.inf)  # P^MAP of a changepoint before each row
    best_before[0] = 0.0
    last: list[Piece | None] = [None] * (rows + 1)
    for row in range(rows):
        column = stream.advance()
        end = row + 1
        lengths = end - column.starts
        kinds = column.log_evidence.shape[1]
        joint = column.log_evidence - np.log(kinds) + best_before[column.starts][:, None]
        if end < rows:
            score = joint + prior.log_probability(lengths)[:, None]
        else:
            score = joint + prior.log_survival(lengths - 1)[:, None]
        i, k = (int(v) for v in np.unravel_index(int(np.argmax(score)), score.shape))
        best_before[end] = score[i, k]
        last[end] = _piece(column, i, k, row)
        if particles is not None and len(column.starts) > particles:
            filtering = logsumexp(joint + prior.log_survival(lengths - 1)[:, None], axis=1)
            weights = np.exp(filtering - filtering.max())
            stream.keep(resample(weights, particles, rng)[0])
    pieces: list[Piece] = []
    end = rows
    while end > 0:
        piece = last[end]
        if piece is None:
            break
        pieces.append(piece)
        end = piece.start
    return Segmentation(tuple(reversed(pieces)), float(best_before[rows]))


def _piece(column: EvidenceColumn, i: int, k: int, row: int) -> Piece:
    evidence = column.log_evidence[i]
    return Piece(
        start=int(column.starts[i]),
        end=row,
        kind=k,
        hypothesis=int(column.hypothesis[i, k]),
        log_evidence=float(evidence[k]),
        probability=float(np.exp(evidence[k] - logsumexp(evidence))),
    )
