"""The exact recursion for the most probable changepoints, over the evidence of all segments at once.

The same as `changepoints.most_probable` on `ExactEvidence` (a test compares them), ten times faster: which model is
best for a segment does not depend on the others, so it is chosen for all of them before the recursion begins.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from micah_plan.learn.segmenting.changepoints import Piece, Segmentation
from micah_plan.learn.segmenting.evidence import EvidenceTable
from micah_plan.learn.segmenting.length_prior import LengthPrior

Floats = NDArray[np.float64]


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
    evidence, chosen = _best_models(table, members, paid)
    n = len(evidence)
    columns = np.ascontiguousarray((evidence + _length_terms(prior, n)).T) - np.log(kinds)
    best_before, last = np.zeros(n + 1), np.zeros(n + 1, dtype=np.int64)
    for row in range(n):
        score = best_before[: row + 1] + columns[row, : row + 1]
        start = int(score.argmax())
        best_before[row + 1], last[row + 1] = score[start], start
    pieces: list[Piece] = []
    end = n
    while end > 0:
        start = int(last[end])
        pieces.append(Piece(start, end - 1, int(chosen[start, end - 1]), float(evidence[start, end - 1])))
        end = start
    return Segmentation(tuple(reversed(pieces)), float(best_before[n]))


@lru_cache(maxsize=4)
def _length_terms(prior: LengthPrior, n: int) -> Floats:
    """(n, n) ln prior of the length of a segment (first, last row); the last row leaves it open."""
    every = np.arange(1, n + 1)
    log_length, log_survival = prior.log_probability(every), prior.log_survival(every - 1)
    lengths = np.maximum(np.arange(n)[None] - np.arange(n)[:, None], 0)
    terms = log_length[lengths]
    terms[:, -1] = log_survival[lengths[:, -1]]
    return np.asarray(terms)


def _best_models(
    table: EvidenceTable, members: Sequence[int] | None, paid: Collection[int]
) -> tuple[Floats, NDArray[np.int64]]:
    """(n, n) evidence of the best hypothesis for every segment, and which it is."""
    if members is None:
        return table.charged.max(axis=2), np.argmax(table.charged, axis=2)
    some = np.array(members)
    layers = [table.sums[:, :, i] if i in paid else table.charged[:, :, i] for i in members]
    if len(layers) == 1:
        return layers[0].copy(), np.full(layers[0].shape, some[0])
    stacked = np.stack(layers)
    return stacked.max(axis=0), some[np.argmax(stacked, axis=0)]
