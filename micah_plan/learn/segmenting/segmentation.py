"""Segmenting one track: the pool of joints, the most probable changepoints and the noise, until they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.joint import JointKind
from micah_plan.learn.segmenting.changepoints import Piece, Segmentation
from micah_plan.learn.segmenting.coarsening import trust_in
from micah_plan.learn.segmenting.evidence import EvidenceTable, all_tabulated, tabulated
from micah_plan.learn.segmenting.length_prior import LengthPrior
from micah_plan.learn.segmenting.noise import NoiseModel, stacked
from micah_plan.learn.segmenting.noise_fit import first_noise, noises_left
from micah_plan.learn.segmenting.occam import RARE_SCREW, SCREW_CHOSEN
from micah_plan.learn.segmenting.pool import all_refitted, pool_of, refitted, window_hypotheses
from micah_plan.learn.segmenting.posterior import ChangepointPosterior, changepoint_posterior
from micah_plan.learn.segmenting.selection import ANOTHER_JOINT, selections, shared
from micah_plan.learn.segmenting.stops import rests_in_the_end, stopped_in_the_end
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

_MOST_ROUNDS = 3
_MOST_PROPOSALS = 3
_GRAINS = 16  # places that are told apart when proposals are compared
_CONVERGED = 0.2  # nats
_SAME_ROWS = 0.6  # of the rows of either
# By how much a stop in the end is more probable than the recursion has it where actions do not tell: there a motion may
# be followed by any kind, and by a pause. And how many times too large the evidence for kinds is: joints and noise are
# fitted to the rows that they are judged by. Both from simulations of short and noisy motions (reliability.py).
_ENDS_AT_REST = 2.7  # nats
LOG_ODDS_OVERSTATED = 6.0


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


def segment_track(
    track: PartTrack, settings: LearnSettings, use_actions: bool, known: Segmented | None = None
) -> Segmented:
    """The most probable segments of a track without outliers.

    Two noises start: a fine one (under which there may be many segments) and that which a single joint would leave
    (under which there may be one). What each proposes settles on its own, and the most probable outcome is taken.

    Args:
        use_actions: whether motion is predicted from the actions (Act-CHAMP).
        known: what was found for the same poses with other actions: then its joints and noise start, alone.
    """
    prior = _prior(track, settings)
    if known is None:
        tables = _from_two_noises(track, prior, settings, use_actions)
    else:
        table = known.table
        tables = [
            (known.noise, tabulated(table.pool.hypotheses, track, known.noise, use_actions, settings.rest, table.trust))
        ]
    proposals = [
        Segmented(track, noise, one, table) for noise, table in tables for one in selections(table, prior, settings)
    ]
    proposals = _different(proposals)[:_MOST_PROPOSALS]
    settled = _settled(proposals, prior, settings, use_actions)
    best = max(settled, key=lambda one: one.log_probability)
    if use_actions and track.action is not None and "rigid" in settings.kinds:
        best = _unless_stopped(best, prior, settings)
    return _beside_rivals(best, settings, use_actions)


def _unless_stopped(found: Segmented, prior: LengthPrior, settings: LearnSettings) -> Segmented:
    """The same; or, if one moving joint explains all rows and a stop in the end is more probable, that."""
    used = list({piece.hypothesis for piece in found.segmentation.pieces})
    if len(used) > 1 or not found.table.pool.moving[used[0]]:
        return found
    stopped = stopped_in_the_end(found.table, used[0], found.track, found.noise, prior, settings)
    if stopped is None:
        return found
    table, segmentation = stopped
    rivals = _settled([replace(found, table=table, segmentation=segmentation)], prior, settings, True)
    return max([found, *rivals], key=lambda one: one.log_probability)


def best_single(found: Segmented, settings: LearnSettings, use_actions: bool) -> Segmented:
    """The whole track as one segment of the one moving joint (if there is any) that explains it best."""
    n = len(found.track)
    pool = refitted(list(settings.kinds), np.ones((len(settings.kinds), n), dtype=bool), found.track, found.noise)
    table = tabulated(pool, found.track, found.noise, use_actions, settings.rest, found.table.trust)
    totals = table.sums[:, 0, -1] - table.occam
    moving = table.pool.moving
    best = int(np.argmax(np.where(moving | ~moving.any(), totals, -np.inf)))
    whole = Segmentation((Piece(0, n - 1, best, float(totals[best])),), float(totals[best]))
    return replace(found, table=table, segmentation=whole)


def _from_two_noises(
    track: PartTrack, prior: LengthPrior, settings: LearnSettings, use_actions: bool
) -> list[tuple[NoiseModel, EvidenceTable]]:
    """The joints of all windows under the noise of the rows' roughness, and under that which a single joint leaves.

    The second is the noise left by the joint that is the most probable one with the noise that it leaves.
    """
    fine = first_noise(track, settings)
    trust = trust_in(fine, settings)
    pool = window_hypotheses(track, settings.kinds, fine)
    # Where something moves, what a rigid model leaves is motion, not noise.
    kinds: list[JointKind] = [kind for kind in settings.kinds if kind != "rigid"]
    kinds = kinds or list(settings.kinds)
    whole = refitted(kinds, np.ones((len(kinds), len(track)), dtype=bool), track, fine)
    noises, ones = [], [whole.take([i]) for i in range(len(whole))]
    if ones:
        seen, every = pool_of(whole, track, fine), np.zeros(len(track), dtype=np.int64)
        noises = noises_left([(seen, every + i) for i in range(len(whole))], settings)
    table, *alone = all_tabulated([pool, *ones], track, [fine, *noises], use_actions, settings.rest, trust)
    if not alone:
        return [(fine, table)]
    totals = [shared(one, [0], prior, settings).log_probability for one in alone]
    single = noises[int(np.argmax(totals))]
    return [(fine, table), (single, tabulated(pool, track, single, use_actions, settings.rest, trust))]


def _different(proposals: Sequence[Segmented]) -> list[Segmented]:
    """The best of those that cut the track at much the same places into the same kinds, best first."""
    found: dict[tuple[tuple[str, int], ...], Segmented] = {}
    for one in sorted(proposals, key=lambda p: -p.log_probability):
        names = one.table.pool.hypotheses.joints.kinds
        grain = max(len(one.track) // _GRAINS, 1)
        key = tuple((names[p.hypothesis], round(p.start / grain)) for p in one.segmentation.pieces)
        found.setdefault(key, one)
    return list(found.values())


def _settled(
    starts: Sequence[Segmented], prior: LengthPrior, settings: LearnSettings, use_actions: bool
) -> list[Segmented]:
    """Alternate between segments, their joints and the noise until no probability grows."""
    best, open_ones = list(starts), dict(enumerate(starts))
    for _ in range(_MOST_ROUNDS):
        if not open_ones:
            break
        found = list(open_ones.values())
        noises = noises_left([(one.table.pool, one.segmentation.which) for one in found], settings)
        tables = _tables(found, noises, settings, use_actions)
        for i, noise, table in zip(tuple(open_ones), noises, tables, strict=True):
            now = Segmented(starts[0].track, noise, selections(table, prior, settings)[0], table)
            grown = now.log_probability - best[i].log_probability
            best[i], open_ones[i] = now if grown > 0 else best[i], now
            if grown <= _CONVERGED:
                del open_ones[i]
    return best


def _beside_rivals(found: Segmented, settings: LearnSettings, use_actions: bool) -> Segmented:
    """The same segments in a table where every kind of joint is fitted to the rows of each: what is said of them
    compares them with these.
    """
    (table,) = _tables([found], [found.noise], settings, use_actions)
    used, _ = _rows_of_joints(found)
    pieces = tuple(replace(piece, hypothesis=used.index(piece.hypothesis)) for piece in found.segmentation.pieces)
    return replace(found, table=table, segmentation=replace(found.segmentation, pieces=pieces))


def _tables(
    found: Sequence[Segmented], noises: Sequence[NoiseModel], settings: LearnSettings, use_actions: bool
) -> list[EvidenceTable]:
    """Of each answer, under a noise: its joints, in the order of `_rows_of_joints`, and their rivals of every kind."""
    track, kinds = found[0].track, list(settings.kinds)
    in_use = [_rows_of_joints(one) for one in found]
    wanted = [(kinds * len(used), np.repeat(rows, len(kinds), axis=0)) for used, rows in in_use]
    rivals = all_refitted(wanted, track, stacked(noises, [1] * len(noises)))
    pools = [
        one.table.pool.hypotheses.take(used).joined(more)
        for one, (used, _), more in zip(found, in_use, rivals, strict=True)
    ]
    return all_tabulated(pools, track, noises, use_actions, settings.rest, found[0].table.trust)


def _rows_of_joints(found: Segmented) -> tuple[list[int], Booleans]:
    """Hypotheses in use, and the rows (u, n) that each explains."""
    pieces = found.segmentation.pieces
    used = list(dict.fromkeys(piece.hypothesis for piece in pieces))
    rows = np.zeros((len(used), len(found.track)), dtype=bool)
    for piece in pieces:
        rows[used.index(piece.hypothesis), piece.start : piece.end + 1] = True
    return used, rows


def posterior_of(found: Segmented, settings: LearnSettings, use_actions: bool) -> ChangepointPosterior:
    """The posterior over segmentations; joints of the most probable one are paid for once, others by each segment.

    Its joints are those of the most probable one, their rivals on the same rows, and rests in the end of any length.
    """
    table, pieces = found.table, found.segmentation.pieces
    used = sorted({piece.hypothesis for piece in pieces})
    moving = table.pool.moving
    moves = [i for i in used if moving[i]]
    index = np.arange(len(moving))
    cost: Floats = table.cost(index, table.rows, bool(moves)) + ANOTHER_JOINT * moving * bool(moves)
    paid = float(cost[used].sum()) - ANOTHER_JOINT * bool(moves)
    cost[used] = 0.0
    worth = table.sums - cost[:, None, None]
    spare = ~moving
    spare[used] = False
    rests = worth[spare]
    if "rigid" in settings.kinds:
        ends = rests_in_the_end(table, moves, found.track, found.noise, use_actions, settings.rest)
        rests = np.concatenate([rests, ends])
    # Rests fitted to much the same rows are one rest, told by the best of them.
    worth = np.concatenate([worth[~spare], rests.max(axis=0, keepdims=True)]) if len(rests) else worth
    rigid = np.append(~moving[~spare], True) if len(rests) else ~moving
    if not table.motion.gain[moves].any():
        worth[rigid, 1:, -1] += _ENDS_AT_REST
    # A part does not get from one rest to another without a motion.
    apart: Floats = np.where(np.eye(len(rigid)) > 0, np.inf, ANOTHER_JOINT * np.outer(rigid, rigid))
    prior = _prior(found.track, settings)
    result = changepoint_posterior(worth, apart, prior, len(settings.kinds), len(pieces) - 1)
    return replace(result, log_evidence=result.log_evidence - paid)


def kind_probabilities(
    found: Segmented, hypothesis: int, kinds: Sequence[JointKind], free: float
) -> tuple[tuple[JointKind, float], ...]:
    """Probability of every kind of joint for all rows of one joint.

    Args:
        free: log odds of free motion against all segments together [nats].
    """
    table, pieces = found.table, found.segmentation.pieces
    names, moving = table.pool.hypotheses.joints.kinds, table.pool.moving
    governed = np.zeros(len(found.track), dtype=bool)
    sums = np.zeros(len(names))
    for piece in pieces:
        if piece.hypothesis == hypothesis:
            known = np.minimum(np.arange(piece.end - piece.start + 1), len(table.log_density) - 1)
            sums += table.log_density[known, np.arange(piece.start, piece.end + 1)].sum(axis=0)
            governed[piece.start : piece.end + 1] = True
    elsewhere = [piece.hypothesis for piece in pieces if piece.hypothesis != hypothesis]
    # A pose costs less if it lies on a joint that moves the part elsewhere, not on the one that it would stand for.
    held = bool(moving[elsewhere].any())
    sums = sums - table.cost(np.arange(len(names)), np.full(len(names), float(governed.sum())), held)
    twisting = table.pool.hypotheses.joints.twisting
    evidence = (sums + SCREW_CHOSEN * twisting) / LOG_ODDS_OVERSTATED
    # What the whole segmentation would pay for: one more moving joint, or a rest beside a rest.
    beside = {b if a == hypothesis else a for a, b in pairwise([piece.hypothesis for piece in pieces])}
    another = moving & moving[elsewhere].any() & ~np.isin(np.arange(len(names)), elsewhere)
    another |= ~moving & any(not moving[one] for one in beside - {hypothesis})
    worth = evidence - RARE_SCREW * twisting - ANOTHER_JOINT * another
    # Rivals are those fitted to much the same rows: others were paid for by other rows.
    used = table.pool.hypotheses.used
    shared_rows = (used & governed).sum(axis=1) / np.maximum((used | governed).sum(axis=1), 1)
    rival = shared_rows >= _SAME_ROWS
    rival[hypothesis] = True
    of_kind = [rival & (np.array(names) == kind) for kind in kinds]
    best = np.array([np.max(worth, where=some, initial=-np.inf) for some in of_kind])
    share = np.exp(best - best.max())
    share = share / share.sum() / (1 + np.exp(min(free, 700.0)))
    return tuple((kind, float(value)) for kind, value in zip(kinds, share, strict=True))


def _prior(track: PartTrack, settings: LearnSettings) -> LengthPrior:
    """The length prior in rows."""
    share = 0.5 if settings.mean_length is None else settings.mean_length / max(track.duration, 1e-12)
    return LengthPrior(max(share * len(track), 1.0), settings.length_shape)
