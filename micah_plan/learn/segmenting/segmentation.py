"""Segmenting one track: the pool of joints, the most probable changepoints and the noise, until they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.segmenting.changepoints import Segmentation
from micah_plan.learn.segmenting.coarsening import trust_in
from micah_plan.learn.segmenting.evidence import EvidenceTable, all_tabulated, tabulated
from micah_plan.learn.segmenting.length_prior import LengthPrior, length_priors
from micah_plan.learn.segmenting.noise import NoiseModel, stacked
from micah_plan.learn.segmenting.noise_fit import first_noise, noises_left
from micah_plan.learn.segmenting.pool import Hypotheses, all_refitted, pool_of, refitted, window_hypotheses
from micah_plan.learn.segmenting.segmented import Segmented, alternative, rows_of_joints
from micah_plan.learn.segmenting.selection import merged, selections, shared
from micah_plan.learn.segmenting.stops import with_rests
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

_MOST_ROUNDS = 3  # of segments, joints and noise in turn
_TIGHTENED = 2  # rounds of noise and joints
_MOST_PROPOSALS = 3  # that are settled
_GRAINS = 16  # places that are told apart when proposals are compared
_CONVERGED = 0.2  # nats


def segment_track(track: PartTrack, settings: LearnSettings, known: Segmented | None = None) -> Segmented:
    """The most probable segments of a track without outliers.

    Two noises start: a fine one (under which there may be many segments) and that which a single joint would leave
    (under which there may be one). What each proposes settles on its own, and the most probable outcome is taken.

    Args:
        known: what was found for the same poses with other actions: then its joints and noise start, alone.
    """
    priors = length_priors(track, settings)
    if known is None:
        tables = _from_two_noises(track, priors[0], settings)
    else:
        table = known.table
        tables = [(known.noise, tabulated(table.pool.hypotheses, track, known.noise, settings.rest, table.trust))]
    proposals = [one for noise, table in tables for one in _proposed(track, noise, table, priors, settings)]
    proposals = _different(proposals)[:_MOST_PROPOSALS]
    outcomes = _settled(proposals, settings)
    best = max(outcomes, key=lambda one: one.log_probability)
    held = with_rests(best, priors, settings)
    doubted = _settled(_without_a_rest(best), settings)
    outcomes += [] if held is None else _settled([held], settings)
    outcomes += [one for one in doubted if len(one.segmentation.pieces) < len(best.segmentation.pieces)]
    best = max(outcomes, key=lambda one: one.log_probability)
    others = tuple(alternative(one) for one in outcomes if one is not best)
    return replace(_beside_rivals(best, settings), others=others)


def _without_a_rest(found: Segmented) -> list[Segmented]:
    """What is left of an answer if a rest is no rest, for each of the few that the rows tell least surely."""
    pieces, table = found.segmentation.pieces, found.table
    fewer: list[tuple[float, Segmentation]] = []
    for i, piece in enumerate(pieces):
        beside = [pieces[k].hypothesis for k in (i - 1, i + 1) if 0 <= k < len(pieces)]
        joint = next((one for one in beside if table.pool.moving[one]), None)
        if joint is not None and not table.pool.moving[piece.hypothesis]:
            sure = float(np.subtract(*table.sums[[piece.hypothesis, joint], piece.start, piece.end]))
            left = merged(tuple(replace(p, hypothesis=joint) if k == i else p for k, p in enumerate(pieces)))
            fewer.append((sure, Segmentation(left, -np.inf)))
    fewer.sort(key=lambda one: one[0])
    return [replace(found, segmentation=one) for _, one in fewer[:_MOST_PROPOSALS]]


def log_probability_at_most(found: Segmented, settings: LearnSettings) -> float:
    """ln probability of the joints of an answer under the noise that explains them best, however little it wanders.

    That a tracker wanders is expected where segments are told apart, so that no wander becomes a joint. Whether there
    is any joint is asked with all scales open, as they are for free motion.
    """
    prior, best = found.prior, found.log_probability
    for _ in range(_TIGHTENED):
        noise = noises_left([(found.table.pool, found.segmentation.which)], settings, any_slow=True)
        (table,) = _tables([found], noise, settings)
        own = list(range(len(rows_of_joints(found)[0])))
        found = Segmented(found.track, noise[0], prior, shared(table, own, prior, settings), table)
        best = max(best, found.log_probability)
    return best


def best_single(found: Segmented, settings: LearnSettings) -> Segmented:
    """The whole track as one segment of the one moving joint (if there is any) that explains it best, under any wander.

    Compared under one noise, a joint that misses the rows has made that noise wide, and any kind will do.
    """
    track, prior = found.track, length_priors(found.track, settings)[0]
    n, trust = len(track), found.table.trust
    ones, noises = _singles(track, found.noise, settings, any_slow=True)
    alone = all_tabulated(ones, track, noises, settings.rest, trust)
    noise = noises[_likeliest(alone, prior, settings)]
    pool = refitted(list(settings.kinds), np.ones((len(settings.kinds), n), dtype=bool), track, noise)
    table = tabulated(pool, track, noise, settings.rest, trust)
    totals = table.sums[:, 0, -1] - table.occam
    moving = table.pool.moving
    best = int(np.argmax(np.where(moving | ~moving.any(), totals, -np.inf)))
    segmentation = shared(table, [best], prior, settings)
    return Segmented(track, noise, prior, segmentation, table)


def _from_two_noises(
    track: PartTrack, prior: LengthPrior, settings: LearnSettings
) -> list[tuple[NoiseModel, EvidenceTable]]:
    """The joints of all windows under the noise of the rows' roughness, and under that which a single joint leaves.

    The second is the noise left by the joint that is the most probable one with the noise that it leaves.
    """
    fine = first_noise(track, settings)
    trust = trust_in(fine, settings)
    pool = window_hypotheses(track, settings.kinds, fine)
    ones, noises = _singles(track, fine, settings)
    table, *alone = all_tabulated([pool, *ones], track, [fine, *noises], settings.rest, trust)
    if not alone:
        return [(fine, table)]
    single = noises[_likeliest(alone, prior, settings)]
    return [(fine, table), (single, tabulated(pool, track, single, settings.rest, trust))]


def _singles(
    track: PartTrack, noise: NoiseModel, settings: LearnSettings, any_slow: bool = False
) -> tuple[list[Hypotheses], list[NoiseModel]]:
    """A joint of every kind that all rows determine, fitted to them under a noise, and the noise that each leaves.

    Where something moves, what a rigid model leaves is motion, not noise.
    """
    kinds: list[JointKind] = [kind for kind in settings.kinds if kind != "rigid"]
    kinds = kinds or list(settings.kinds)
    whole = refitted(kinds, np.ones((len(kinds), len(track)), dtype=bool), track, noise)
    seen, every = pool_of(whole, track, noise), np.zeros(len(track), dtype=np.int64)
    noises = noises_left([(seen, every + i) for i in range(len(whole))], settings, any_slow) if len(whole) else []
    return [whole.take([i]) for i in range(len(whole))], noises


def _likeliest(alone: Sequence[EvidenceTable], prior: LengthPrior, settings: LearnSettings) -> int:
    """Which of some joints, each alone in its table, explains the whole track best."""
    return int(np.argmax([shared(one, [0], prior, settings).log_probability for one in alone]))


def _proposed(
    track: PartTrack, noise: NoiseModel, table: EvidenceTable, priors: Sequence[LengthPrior], settings: LearnSettings
) -> list[Segmented]:
    """What a table proposes under each prior of lengths."""
    # The copy ends here, and with it the evidence of all segments of all windows, which takes much memory.
    read = replace(table)
    return [Segmented(track, noise, prior, one, table) for prior in priors for one in selections(read, prior, settings)]


def _different(proposals: Sequence[Segmented]) -> list[Segmented]:
    """The best of those that cut the track at much the same places into the same kinds, best first."""
    found: dict[tuple[tuple[str, int], ...], Segmented] = {}
    for one in sorted(proposals, key=lambda p: -p.log_probability):
        names = one.table.pool.hypotheses.joints.kinds
        grain = max(len(one.track) // _GRAINS, 1)
        key = tuple((names[p.hypothesis], round(p.start / grain)) for p in one.segmentation.pieces)
        found.setdefault(key, one)
    return list(found.values())


def _settled(starts: Sequence[Segmented], settings: LearnSettings) -> list[Segmented]:
    """Alternate between segments, their joints and the noise until no probability grows."""
    best, open_ones = list(starts), dict(enumerate(starts))
    for _ in range(_MOST_ROUNDS):
        if not open_ones:
            break
        found = list(open_ones.values())
        noises = noises_left([(one.table.pool, one.segmentation.which) for one in found], settings)
        tables = _tables(found, noises, settings)
        for i, noise, table in zip(tuple(open_ones), noises, tables, strict=True):
            prior = starts[i].prior
            now = Segmented(starts[0].track, noise, prior, selections(table, prior, settings)[0], table)
            grown = now.log_probability - best[i].log_probability
            best[i], open_ones[i] = now if grown > 0 else best[i], now
            if grown <= _CONVERGED:
                del open_ones[i]
    return best


def _beside_rivals(found: Segmented, settings: LearnSettings) -> Segmented:
    """The same segments in a table where every kind of joint is fitted to the rows of each: what is said of them
    compares them with these.
    """
    (table,) = _tables([found], [found.noise], settings)
    used, _ = rows_of_joints(found)
    pieces = tuple(replace(piece, hypothesis=used.index(piece.hypothesis)) for piece in found.segmentation.pieces)
    return replace(found, table=table, segmentation=replace(found.segmentation, pieces=pieces))


def _tables(found: Sequence[Segmented], noises: Sequence[NoiseModel], settings: LearnSettings) -> list[EvidenceTable]:
    """Of each answer, under a noise: its joints, in the order of `_rows_of_joints`, and their rivals of every kind."""
    track, kinds = found[0].track, list(settings.kinds)
    in_use = [rows_of_joints(one) for one in found]
    wanted = [(kinds * len(used), np.repeat(rows, len(kinds), axis=0)) for used, rows in in_use]
    rivals = all_refitted(wanted, track, stacked(noises, [1] * len(noises)))
    pools = [
        one.table.pool.hypotheses.take(used).joined(more)
        for one, (used, _), more in zip(found, in_use, rivals, strict=True)
    ]
    return all_tabulated(pools, track, noises, settings.rest, found[0].table.trust)
