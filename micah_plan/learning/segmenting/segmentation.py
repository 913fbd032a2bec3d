"""Segmentation of one track: candidate joints, changepoints and noise, iterated to consistency.

How many changepoints there may be depends on rests that the most probable answer lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from micah_plan.automaton.joint import JointKind
from micah_plan.changepoints import LengthPrior
from micah_plan.learning.segmenting.evidence import EvidenceTable, all_tabulated, tabulated
from micah_plan.learning.segmenting.likelihood_power import likelihood_power_of
from micah_plan.learning.segmenting.noise import NoiseModel, stacked
from micah_plan.learning.segmenting.noise_fit import fit_noise_to_residuals, initial_noise
from micah_plan.learning.segmenting.pieces import length_priors
from micah_plan.learning.segmenting.pool import (
    Hypotheses,
    all_refitted,
    pool_of,
    refitted_hypotheses,
    window_hypotheses,
)
from micah_plan.learning.segmenting.rests import with_rests
from micah_plan.learning.segmenting.segmented import Segmented, alternative, rows_of_joints
from micah_plan.learning.segmenting.selections import selections, shared
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack

_MOST_ROUNDS = 3  # of segments, joints and noise alternately
_MOST_PROPOSALS = 3  # that are settled
_GRAINS = 16  # digits that are compared between proposals
_CONVERGED = 0.2  # nats


def segment_track(track: PartTrack, settings: LearnSettings, start: Segmented | None = None) -> Segmented:
    """The most probable segments of a track without outliers.

    Two initial noises: a fine one (under which there may be many segments) and that which a single joint would leave
    (under which there may be one). Each converges separately, and the most probable result is taken.

    Args:
        start: result for the same poses with other actions: then its joints and noise are the only start.
    """
    priors = length_priors(track, settings)
    if start is None:
        tables = _from_two_noises(track, priors[0], settings)
    else:
        table = start.table
        tables = [
            (start.noise, tabulated(table.pool.hypotheses, track, start.noise, settings.rest, table.likelihood_power))
        ]
    proposals = [proposal for noise, table in tables for proposal in _proposals(track, noise, table, priors, settings)]
    proposals = _distinct_proposals(proposals)[:_MOST_PROPOSALS]
    outcomes = _iterated_to_consistency(proposals, settings)
    best = max(outcomes, key=lambda outcome: outcome.log_probability)
    held = with_rests(best, priors, settings)
    outcomes += [] if held is None else _iterated_to_consistency([held], settings)
    best = max(outcomes, key=lambda outcome: outcome.log_probability)
    others = tuple(alternative(outcome) for outcome in outcomes if outcome is not best)
    return replace(_with_rivals(best, settings), others=others)


def best_single(answer: Segmented, settings: LearnSettings) -> Segmented:
    """The whole track as one segment of its best moving joint (if any), under any drift.

    Compared under one noise, a joint that misses the rows has made that noise wide, and any kind will do.
    """
    track, prior = answer.track, length_priors(answer.track, settings)[0]
    n, likelihood_power = len(track), answer.table.likelihood_power
    ones, noises = _singles(track, answer.noise, settings, any_slow=True)
    alone = all_tabulated(ones, track, noises, settings.rest, likelihood_power)
    noise = noises[_likeliest_alone(alone, prior, settings)]
    pool = refitted_hypotheses(list(settings.kinds), np.ones((len(settings.kinds), n), dtype=bool), track, noise)
    table = tabulated(pool, track, noise, settings.rest, likelihood_power)
    totals = table.sums[:, 0, -1] - table.occam
    moving = table.pool.moving
    best = int(np.argmax(np.where(moving | ~moving.any(), totals, -np.inf)))
    segmentation = shared(table, [best], prior, settings)
    return Segmented(track, noise, prior, segmentation, table)


def under_noise(answer: Segmented, noise: NoiseModel, settings: LearnSettings) -> Segmented:
    """The segmentation by an answer's joints and their rivals under another noise."""
    (table,) = _tables([answer], [noise], settings)
    return Segmented(answer.track, noise, answer.prior, selections(table, answer.prior, settings)[0], table)


def _from_two_noises(
    track: PartTrack, prior: LengthPrior, settings: LearnSettings
) -> list[tuple[NoiseModel, EvidenceTable]]:
    """Joints of all windows under the noise of second differences, and under that of a single joint's residuals.

    The second is the noise left by the joint that is the most probable one with the noise that it leaves.
    """
    fine = initial_noise(track, settings)
    likelihood_power = likelihood_power_of(fine, settings)
    pool = window_hypotheses(track, settings.kinds, fine)
    ones, noises = _singles(track, fine, settings)
    table, *alone = all_tabulated([pool, *ones], track, [fine, *noises], settings.rest, likelihood_power)
    if not alone:
        return [(fine, table)]
    single = noises[_likeliest_alone(alone, prior, settings)]
    return [(fine, table), (single, tabulated(pool, track, single, settings.rest, likelihood_power))]


def _singles(
    track: PartTrack, noise: NoiseModel, settings: LearnSettings, any_slow: bool = False
) -> tuple[list[Hypotheses], list[NoiseModel]]:
    """A joint of every kind fitted to all rows under a noise, with its residual noise.

    Where something moves, the residual of a rigid model is motion, not noise.
    """
    kinds: list[JointKind] = [kind for kind in settings.kinds if kind != "rigid"]
    kinds = kinds or list(settings.kinds)
    whole = refitted_hypotheses(kinds, np.ones((len(kinds), len(track)), dtype=bool), track, noise)
    pool, every = pool_of(whole, track, noise), np.zeros(len(track), dtype=np.int64)
    noises = (
        fit_noise_to_residuals([(pool, every + i) for i in range(len(whole))], settings, any_slow) if len(whole) else []
    )
    return [whole.take([i]) for i in range(len(whole))], noises


def _likeliest_alone(alone: Sequence[EvidenceTable], prior: LengthPrior, settings: LearnSettings) -> int:
    """Index of the joint that best explains the whole track alone."""
    return int(np.argmax([shared(table, [0], prior, settings).log_probability for table in alone]))


def _proposals(
    track: PartTrack, noise: NoiseModel, table: EvidenceTable, priors: Sequence[LengthPrior], settings: LearnSettings
) -> list[Segmented]:
    """The segmentations that a table proposes under each prior of lengths."""
    # The copy ends here, and with it the evidence of all segments of all windows, which takes much memory.
    read = replace(table)
    return [
        Segmented(track, noise, prior, segmentation, table)
        for prior in priors
        for segmentation in selections(read, prior, settings)
    ]


def _distinct_proposals(proposals: Sequence[Segmented]) -> list[Segmented]:
    """The best of the proposals with about the same changepoints and kinds, best first."""
    best_of: dict[tuple[tuple[str, int], ...], Segmented] = {}
    for proposal in sorted(proposals, key=lambda p: -p.log_probability):
        names = proposal.table.pool.hypotheses.joints.kinds
        grain = max(len(proposal.track) // _GRAINS, 1)
        key = tuple((names[p.hypothesis], round(p.start / grain)) for p in proposal.segmentation.pieces)
        best_of.setdefault(key, proposal)
    return list(best_of.values())


def _iterated_to_consistency(starts: Sequence[Segmented], settings: LearnSettings) -> list[Segmented]:
    """Alternate between segments, joints and noise until the probability stops growing."""
    best, open_ones = list(starts), dict(enumerate(starts))
    for _ in range(_MOST_ROUNDS):
        if not open_ones:
            break
        answers = list(open_ones.values())
        noises = fit_noise_to_residuals(
            [(answer.table.pool, answer.segmentation.which) for answer in answers], settings
        )
        tables = _tables(answers, noises, settings)
        for i, noise, table in zip(tuple(open_ones), noises, tables, strict=True):
            prior = starts[i].prior
            now = Segmented(starts[0].track, noise, prior, selections(table, prior, settings)[0], table)
            grown = now.log_probability - best[i].log_probability
            best[i], open_ones[i] = now if grown > 0 else best[i], now
            if grown <= _CONVERGED:
                del open_ones[i]
    return best


def _with_rivals(answer: Segmented, settings: LearnSettings) -> Segmented:
    """The segments in a table with all kinds of joints fitted to each, for the comparison of kinds."""
    (table,) = _tables([answer], [answer.noise], settings)
    used, _ = rows_of_joints(answer)
    pieces = tuple(replace(piece, hypothesis=used.index(piece.hypothesis)) for piece in answer.segmentation.pieces)
    return replace(answer, table=table, segmentation=replace(answer.segmentation, pieces=pieces))


def _tables(answers: Sequence[Segmented], noises: Sequence[NoiseModel], settings: LearnSettings) -> list[EvidenceTable]:
    """Tables of each answer under a noise: its joints in the order of `rows_of_joints`, and rivals of every kind."""
    track, kinds = answers[0].track, list(settings.kinds)
    in_use = [rows_of_joints(answer) for answer in answers]
    wanted = [(kinds * len(used), np.repeat(rows, len(kinds), axis=0)) for used, rows in in_use]
    rivals = all_refitted(wanted, track, stacked(noises, [1] * len(noises)))
    pools = [
        answer.table.pool.hypotheses.take(used).joined(more)
        for answer, (used, _), more in zip(answers, in_use, rivals, strict=True)
    ]
    return all_tabulated(pools, track, noises, settings.rest, answers[0].table.likelihood_power)
