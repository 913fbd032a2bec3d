"""Maximum-a-posteriori segmentation by dynamic programming over a table of evidence."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Ints
from micah_plan.changepoints import LengthPrior, length_terms, most_probable_spans
from micah_plan.learning.segmenting.evidence import EvidenceTable, best_of
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack


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
        """(n,) hypothesis of each row."""
        return np.concatenate([np.full(p.end - p.start + 1, p.hypothesis) for p in self.pieces])


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
        paid: hypotheses whose parameters cost a segment nothing (they were paid for when chosen).
    """
    chosen = np.arange(len(table.rows)) if members is None else np.array(members)
    if members is None and not paid:
        best = table.best
    else:
        best = best_of(table.sums[i] if i in paid else table.charged_sums(i) for i in chosen.tolist())
    spans, log_probability = most_probable_spans(best + (length_terms(prior, len(best)) - np.log(kinds)))
    charged_sums = ~np.isin(chosen, list(paid))
    pieces = []
    for start, end in spans:
        evidence = table.sums[chosen, start, end] - charged_sums * table.cost(chosen, np.array(end - start + 1.0))
        pieces.append(Piece(start, end, int(chosen[np.argmax(evidence)]), float(best[start, end])))
    return Segmentation(tuple(pieces), log_probability)


def length_priors(track: PartTrack, settings: LearnSettings) -> list[LengthPrior]:
    """Priors of segment lengths in rows, longest first, for unknown numbers of stops.

    Where it moves once there and back, a segment lasts half of the track. Where it moves there and back many times it
    may be one segment as before, or segments may last as long as they do there, or anything between: each halving is a
    separate hypothesis. A mean in the settings is the only one.
    """
    if settings.mean_length is not None:
        means = [settings.mean_length / max(track.duration, 1e-12)]
    else:
        means = [0.5 ** (1 + i) for i in range(1 + round(float(np.log2(max(settings.sweeps or 1.0, 1.0)))))]
    return [LengthPrior(max(share * len(track), 1.0), settings.length_shape) for share in means]
