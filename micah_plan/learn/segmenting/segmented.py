"""An answer: the segments of a track, the joints that they refer to, and the noise under which they were found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Booleans
from micah_plan.learn.segmenting.changepoints import Segmentation
from micah_plan.learn.segmenting.evidence import EvidenceTable
from micah_plan.learn.segmenting.length_prior import LengthPrior
from micah_plan.learn.segmenting.noise import NoiseModel
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack


@dataclass(frozen=True, eq=False)
class Segmented:
    """The most probable segments of a track and what they refer to.

    Attributes:
        track: the rows that were segmented.
        noise: estimated together with the segments.
        segmentation: pieces, in rows of that track; those of one hypothesis share its parameters.
        table: the evidence that decided, with its pool and step models.
    """

    track: PartTrack
    noise: NoiseModel
    segmentation: Segmentation
    table: EvidenceTable

    @property
    def log_probability(self) -> float:
        """Of the rows and segments, parameters of a joint counted once [nats]."""
        return self.segmentation.log_probability


def rows_of_joints(found: Segmented) -> tuple[list[int], Booleans]:
    """Hypotheses in use, and the rows (u, n) that each explains."""
    pieces = found.segmentation.pieces
    used = list(dict.fromkeys(piece.hypothesis for piece in pieces))
    rows = np.zeros((len(used), len(found.track)), dtype=bool)
    for piece in pieces:
        rows[used.index(piece.hypothesis), piece.start : piece.end + 1] = True
    return used, rows


def prior_of_lengths(track: PartTrack, settings: LearnSettings) -> LengthPrior:
    """The length prior in rows."""
    share = 0.5 if settings.mean_length is None else settings.mean_length / max(track.duration, 1e-12)
    return LengthPrior(max(share * len(track), 1.0), settings.length_shape)
