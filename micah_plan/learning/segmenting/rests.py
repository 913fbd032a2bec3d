"""Rests on a joint: the joint is learned from the other rows.

The action channel of a joint is fitted to all rows that the joint explains. If rows in which the part was pushed
against a stop are among them, the actions seem uninformative, and so the stop is not found. Here the candidate rests
are assumed, and the channel is learned from the other rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats
from micah_plan.changepoints import LengthPrior
from micah_plan.learning.segmenting.evidence import EvidenceTable, tabulated
from micah_plan.learning.segmenting.held import joint_trace, places_held
from micah_plan.learning.segmenting.motion import FEWEST_ACTED
from micah_plan.learning.segmenting.noise import NoiseModel
from micah_plan.learning.segmenting.pool import (
    Hypotheses,
    refitted_hypotheses,
)
from micah_plan.learning.segmenting.segmented import Segmented, rows_of_joints
from micah_plan.learning.segmenting.selections import prune_joints
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack

_FEWEST_ROWS = 3  # of a rest
_LENGTHS = 8  # of rests in the end
_LONGEST = 0.6  # of the rows


def with_rests(answer: Segmented, priors: Sequence[LengthPrior], settings: LearnSettings) -> Segmented | None:
    """The most probable segments with the rests on the main joint that the actions indicate.

    Existing hypotheses stay among the choices. None if the actions indicate a rest nowhere, or if no joint moves it.
    """
    table, track = answer.table, answer.track
    used, rows = rows_of_joints(answer)
    joint = max((i for i in used if table.pool.moving[i]), key=lambda i: rows[used.index(i)].sum(), default=None)
    if track.action is None or "rigid" not in settings.kinds or joint is None:
        return None
    inside = places_held(joint_trace(table.pool, joint, track.action))
    outside = rows[[used.index(joint)]] & ~inside.any(axis=0)
    if not len(inside) or outside.sum() < FEWEST_ACTED:
        return None
    pool = Hypotheses(table.pool.hypotheses.joints.take([joint]), outside)
    pool = pool.joined(refitted_hypotheses(["rigid"] * len(inside), inside, track, answer.noise))
    pool = pool.joined(table.pool.hypotheses.take([i for i in used if i != joint]))
    tried = tabulated(pool, track, answer.noise, settings.rest, table.likelihood_power)
    every = list(range(len(pool)))
    answers = [
        replace(answer, table=tried, prior=prior, segmentation=prune_joints(tried, every, prior, settings))
        for prior in priors
    ]
    return max(answers, key=lambda answer: answer.log_probability)


def final_rests(table: EvidenceTable, moves: list[int], track: PartTrack, noise: NoiseModel, rest: float) -> Floats:
    """(r, n, n) evidence of every segment (first, last row) under rigid joints fitted to some of the last rows.

    The cost of a segment's pose is subtracted.

    Args:
        moves: moving hypotheses of the table, on which the part may be held.
        rest: as in `evidence.tabulated`.
    """
    n = len(track)
    longest = max(_LONGEST * n, _FEWEST_ROWS)
    lengths = np.unique(np.geomspace(_FEWEST_ROWS, longest, _LENGTHS).round().astype(int))
    ends: NDArray[np.bool_] = np.arange(n) >= n - lengths[lengths < n, None]
    rests = refitted_hypotheses(["rigid"] * len(ends), ends, track, noise)
    pool = table.pool.hypotheses.take(moves).joined(rests)
    tried = tabulated(pool, track, noise, rest, table.likelihood_power)
    held = np.arange(len(moves), len(pool))
    cost = tried.cost(held, tried.rows[held], bool(moves))
    return np.asarray(tried.sums[held] - cost[:, None, None])
