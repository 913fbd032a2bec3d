"""The segments of a track with their joints and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Booleans, Ints
from micah_plan.automaton.joint import JointKind
from micah_plan.changepoints import LengthPrior
from micah_plan.learning.segmenting.evidence import EvidenceTable
from micah_plan.learning.segmenting.noise import NoiseModel
from micah_plan.learning.segmenting.pieces import Segmentation
from micah_plan.learning.track import PartTrack


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another answer for the same rows, under its own noise.

    Attributes:
        kinds: of the joints of its pieces, in their order.
        of_row: (n,) index into these, of the piece that each row is in.
        log_probability: as of an answer [nats].
    """

    kinds: tuple[JointKind, ...]
    of_row: Ints
    log_probability: float


@dataclass(frozen=True, eq=False)
class Segmented:
    """The most probable segments of a track with their evidence.

    Attributes:
        track: the rows that were segmented.
        noise: estimated together with the segments.
        prior: of their lengths.
        segmentation: pieces, in rows of that track; those of one hypothesis share its parameters.
        table: the evidence that decided, with its pool and step models.
        others: answers that are less probable.
    """

    track: PartTrack
    noise: NoiseModel
    prior: LengthPrior
    segmentation: Segmentation
    table: EvidenceTable
    others: tuple[Alternative, ...] = ()

    @property
    def log_probability(self) -> float:
        """Of the rows and segments, parameters of a joint counted once [nats]."""
        return self.segmentation.log_probability


def alternative(answer: Segmented) -> Alternative:
    """An answer as an alternative to another one."""
    pieces, names = answer.segmentation.pieces, answer.table.pool.hypotheses.joints.kinds
    of_row = np.repeat(np.arange(len(pieces)), [piece.end - piece.start + 1 for piece in pieces])
    return Alternative(tuple(names[piece.hypothesis] for piece in pieces), of_row, answer.log_probability)


def rows_of_joints(answer: Segmented) -> tuple[list[int], Booleans]:
    """Hypotheses in use, and the rows (u, n) that each explains."""
    pieces = answer.segmentation.pieces
    used = list(dict.fromkeys(piece.hypothesis for piece in pieces))
    rows = np.zeros((len(used), len(answer.track)), dtype=bool)
    for piece in pieces:
        rows[used.index(piece.hypothesis), piece.start : piece.end + 1] = True
    return used, rows
