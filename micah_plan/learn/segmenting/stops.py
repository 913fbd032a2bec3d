"""A part that its joint moves and that is held for a while: joints and their channel, learned from the other rows.

What the actions say of a joint is fitted to all rows that it explains. If rows at which the part was pushed against a
stop are among them, the actions seem to say little, and so the stop is not seen. Here each rest that there may be, at
the beginning, on the way or at the end, is taken for granted, and the channel learned from the rows beside it.

And the rests themselves: how many changepoints there may be depends on rests that the most probable answer lacks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.learn.segmenting.changepoints import Segmentation
from micah_plan.learn.segmenting.evidence import EvidenceTable, tabulated
from micah_plan.learn.segmenting.length_prior import LengthPrior
from micah_plan.learn.segmenting.motion import FEWEST_ACTED
from micah_plan.learn.segmenting.noise import NoiseModel
from micah_plan.learn.segmenting.pool import Hypotheses, refitted
from micah_plan.learn.segmenting.selection import shared
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

_GRAINS = 16  # places where a rest may begin or end
_FEWEST_ROWS = 3  # of a rest
# Nats that a rest may gain where joints and noise are fitted again. This saves time: with 40 answers were the same.
_SETTLING = 6.0
_LENGTHS = 8  # of rests in the end
_LONGEST = 0.6  # of the rows


def held_somewhere(
    found: Segmentation,
    table: EvidenceTable,
    track: PartTrack,
    noise: NoiseModel,
    prior: LengthPrior,
    settings: LearnSettings,
) -> list[tuple[EvidenceTable, Segmentation]]:
    """The most probable segments if the part was held in one more stretch of rows of its one moving joint.

    Args:
        found: the segments without it, under one moving joint.
        table: of the evidence that found them.
    """
    used = list(dict.fromkeys(piece.hypothesis for piece in found.pieces))
    (joint,) = (i for i in used if table.pool.moving[i])
    own = np.zeros(len(track), dtype=bool)
    for piece in found.pieces:
        own[piece.start : piece.end + 1] |= piece.hypothesis == joint
    inside = _stretches(own)
    outside = own & ~inside
    rests = refitted(["rigid"] * len(inside), inside, track, noise)
    if not len(inside) or len(rests) < len(inside):
        return []
    others = [i for i in used if i != joint]
    alike = Hypotheses(table.pool.hypotheses.joints.take([joint] * len(inside)), outside)
    pool = alike.joined(rests).joined(table.pool.hypotheses.take(others))
    tried = tabulated(pool, track, noise, settings.rest, table.trust)
    moves, held = np.split(np.arange(2 * len(inside)), 2)
    together = _worth(tried, moves, outside) + _worth(tried, held, inside)
    unheld = _worth(table, np.array([joint]), own[None])[0]
    together[together <= unheld - _SETTLING] = -np.inf
    # One on the way, one at either end: the best of each.
    where = inside[:, 0] + 2 * inside[:, -1]
    best = [int(np.argmax(np.where(where == one, together, -np.inf))) for one in range(3)]
    best = [i for i in best if np.isfinite(together[i])]
    more = list(range(2 * len(inside), len(pool)))
    return [(tried, shared(tried, [int(moves[i]), int(held[i]), *more], prior, settings)) for i in best]


def _worth(table: EvidenceTable, some: Ints, rows: Booleans) -> Floats:
    """(r,) evidence of rows (r, n) under some hypotheses (r,), less what these cost."""
    n = rows.shape[1]
    begins = rows & ~np.pad(rows, ((0, 0), (1, 0)))[:, :-1]
    since = np.arange(n) - np.maximum.accumulate(np.where(begins, np.arange(n), 0), axis=1)
    known = np.minimum(since, len(table.log_density) - 1)
    total = (table.log_density[known, np.arange(n), some[:, None]] * rows).sum(axis=1)
    return np.asarray(total - table.cost(some, rows.sum(axis=1).astype(float)))


def _stretches(own: Booleans) -> Booleans:
    """(r, n) all stretches of rows between a few cuts, of the rows (n,) that are looked at."""
    rows = np.arange(len(own))
    cuts = (len(own) * np.arange(_GRAINS + 1) / _GRAINS).round().astype(int)
    first, last = np.triu_indices(_GRAINS + 1, 1)
    # At either end, where most rests are, they are told more finely.
    fine = (first % 2 + last % 2 == 0) | (first == 0) | (last == _GRAINS)
    first, last = cuts[first[fine]], cuts[last[fine]]
    inside = np.unique((rows >= first[:, None]) & (rows < last[:, None]) & own, axis=0)
    enough = (inside.sum(axis=1) >= _FEWEST_ROWS) & ((own & ~inside).sum(axis=1) >= FEWEST_ACTED)
    return np.asarray(inside[enough])


def rests_in_the_end(
    table: EvidenceTable, moves: list[int], track: PartTrack, noise: NoiseModel, rest: float
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
    tried = tabulated(pool, track, noise, rest, table.trust)
    held = np.arange(len(moves), len(pool))
    cost = tried.cost(held, tried.rows[held], bool(moves))
    return np.asarray(tried.sums[held] - cost[:, None, None])
