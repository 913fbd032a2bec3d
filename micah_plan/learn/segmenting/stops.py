"""A part that its joint moves and that is stopped in the end: joints and their channel, learned from the rows before.

What the actions say of a joint is fitted to all rows that it explains. If rows at which the part was pushed against a
stop are among them, the actions seem to say little, and so the stop is not seen. Here each stop that there may be is
taken for granted, and the channel learned from the rows before it.

And the rests themselves: how many changepoints there may be depends on rests that the most probable answer lacks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats
from micah_plan.learn.segmenting.changepoints import Segmentation
from micah_plan.learn.segmenting.evidence import EvidenceTable, tabulated
from micah_plan.learn.segmenting.length_prior import LengthPrior
from micah_plan.learn.segmenting.noise import NoiseModel
from micah_plan.learn.segmenting.pool import Hypotheses, refitted
from micah_plan.learn.segmenting.selection import shared
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

_GRAINS = 16
_EARLIEST = 5  # of the grains
_TRIED = 2
_FEWEST_ROWS = 3
_LENGTHS = 8
_LONGEST = 0.6  # of the rows


def stopped_in_the_end(
    table: EvidenceTable,
    joint: int,
    track: PartTrack,
    noise: NoiseModel,
    prior: LengthPrior,
    settings: LearnSettings,
) -> tuple[EvidenceTable, Segmentation] | None:
    """The most probable segments if the part rests in the end, held, after one joint moved it; None of very few rows.

    Args:
        table: of the evidence that found no stop.
        joint: the moving hypothesis that explains all rows there.
    """
    n = len(track)
    rows = np.arange(n)
    cuts = np.unique([round(n * grain / _GRAINS) for grain in range(_EARLIEST, _GRAINS)])
    cuts = cuts[(cuts >= _FEWEST_ROWS) & (cuts <= n - _FEWEST_ROWS)]
    if not len(cuts):
        return None
    before: NDArray[np.bool_] = rows < cuts[:, None]
    joints = table.pool.hypotheses.joints.take([joint] * len(cuts))
    rests = refitted(["rigid"] * len(cuts), ~before, track, noise)
    tried = tabulated(Hypotheses(joints, before).joined(rests), track, noise, True, settings.rest, table.trust)
    moves = np.arange(len(cuts))
    held = moves + len(cuts)
    total = tried.sums[moves, 0, cuts - 1] + tried.sums[held, cuts, n - 1]
    total = total - tried.cost(moves, cuts.astype(float)) - tried.cost(held, (n - cuts).astype(float))
    best = np.argsort(-total, kind="stable")[:_TRIED]
    found = [shared(tried, [int(moves[i]), int(held[i])], prior, settings) for i in best]
    return tried, max(found, key=lambda one: one.log_probability)


def rests_in_the_end(
    table: EvidenceTable, moves: list[int], track: PartTrack, noise: NoiseModel, use_actions: bool, rest: float
) -> Floats:
    """(r, n, n) evidence of every segment (first, last row) under rigid joints fitted to some of the last rows.

    What a segment pays for its pose is taken off.

    Args:
        moves: moving hypotheses of the table, on which the part may be held.
        rest: as in `evidence.tabulated`.
    """
    n = len(track)
    longest = max(_LONGEST * n, _FEWEST_ROWS)
    lengths = np.unique(np.geomspace(_FEWEST_ROWS, longest, _LENGTHS).round().astype(int))
    ends: NDArray[np.bool_] = np.arange(n) >= n - lengths[lengths < n, None]
    rests = refitted(["rigid"] * len(ends), ends, track, noise)
    pool = table.pool.hypotheses.take(moves).joined(rests)
    tried = tabulated(pool, track, noise, use_actions, rest, table.trust)
    held = np.arange(len(moves), len(pool))
    cost = tried.cost(held, tried.rows[held], bool(moves))
    return np.asarray(tried.sums[held] - cost[:, None, None])
