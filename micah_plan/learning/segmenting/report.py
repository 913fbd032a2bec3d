"""Reported certainties of a track: number of changepoints, and kinds of joints with their probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import expit

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import JointKind
from micah_plan.learning.joints.final_fit import NO_LACK_OF_FIT, RARE_SCREW, SCREW_COST, LackOfFit
from micah_plan.learning.segmenting.posterior import ChangepointPosterior, changepoint_posterior
from micah_plan.learning.segmenting.rests import final_rests
from micah_plan.learning.segmenting.segmented import Alternative, Segmented
from micah_plan.learning.segmenting.selections import ANOTHER_JOINT
from micah_plan.learning.settings import LearnSettings

_SAME_ROWS = 0.6  # of the rows of either
# By how much a stop in the end is more probable than the recursion has it where actions do not tell: there a motion may
# be followed by any kind, and by a pause. And how many times too large the evidence is for kinds, and for rests: joints
# and noise are fitted to the rows that they are judged by. Both from simulations of short and noisy motions
# (`benchmarks overstated` varies each).
_ENDS_AT_REST = 2.7  # nats
LOG_ODDS_OVERSTATED = 6.0
# How many of the parts that leave their joint further than usual are on a mechanism of more than one axis. A hinge in
# two stages looks like one that is not ideal, of which real recordings are full.
OTHER_MECHANISM = 0.1


def posterior_of(answer: Segmented, settings: LearnSettings) -> ChangepointPosterior:
    """The posterior over segmentations; joints of the best are charged once, others per segment.

    Its joints are those of the most probable one, their rivals on the same rows, and final rests of any length.
    """
    table, pieces = answer.table, answer.segmentation.pieces
    used = sorted({piece.hypothesis for piece in pieces})
    moving = table.pool.moving
    moves = [i for i in used if moving[i]]
    index = np.arange(len(moving))
    of_kind = float(np.log(len(settings.kinds)))  # paid once, too, as in the answer
    cost: Floats = table.cost(index, table.rows, bool(moves)) + ANOTHER_JOINT * moving * bool(moves) + of_kind
    # As in the answer: for the rows that they explain, however few they were fitted to.
    explained = np.array(
        [sum(p.end - p.start + 1.0 for p in pieces if p.hypothesis == hypothesis) for hypothesis in used]
    )
    paid = float(table.cost(np.array(used), explained, bool(moves)).sum()) + of_kind * len(used)
    paid += ANOTHER_JOINT * max(len(moves) - 1, 0)
    cost[used] = 0.0
    worth = table.sums - cost[:, None, None]
    spare = ~moving
    spare[used] = False
    rests = worth[spare]
    if "rigid" in settings.kinds:
        ends = final_rests(table, moves, answer.track, answer.noise, settings.rest) - of_kind
        rests = np.concatenate([rests, ends])
    # Rests fitted to much the same rows are one rest, represented by the best of them.
    worth = np.concatenate([worth[~spare], rests.max(axis=0, keepdims=True)]) if len(rests) else worth
    rigid = np.append(~moving[~spare], True) if len(rests) else ~moving
    if not table.motion.gain[moves].any():
        worth[rigid, 1:, -1] += _ENDS_AT_REST
    # A part does not get from one rest to another without a motion.
    apart: Floats = np.where(np.eye(len(rigid)) > 0, np.inf, ANOTHER_JOINT * np.outer(rigid, rigid))
    result = changepoint_posterior(worth, apart, answer.prior, len(pieces) - 1)
    return replace(_with_rival_counts(result, answer), log_evidence=result.log_evidence - paid)


def _with_rival_counts(stated: ChangepointPosterior, answer: Segmented) -> ChangepointPosterior:
    """The posterior extended by answers with other numbers of segments, whose joints have their own rows."""
    counts, changepoint = stated.counts.copy(), stated.changepoint.copy()
    count = len(answer.segmentation.pieces)
    for pieces in {len(other_answer.kinds) for other_answer in answer.others} - {count}:
        if pieces > len(counts):
            continue
        best = max(
            (other_answer for other_answer in answer.others if len(other_answer.kinds) == pieces),
            key=lambda other_answer: other_answer.log_probability,
        )
        # Evidence that the sums over this answer's joints already contain is not counted twice.
        more = max(_odds(best, answer) * stated.counts[count - 1] - stated.counts[pieces - 1], 0.0)
        counts[pieces - 1] += more
        changepoint[1:] += more * np.diff(best.of_row)
    total = counts.sum()
    return replace(stated, counts=counts / total, changepoint=changepoint / total)


def _odds(rival: Alternative, answer: Segmented) -> float:
    """Odds of another answer against the chosen one."""
    return float(np.exp(min(rival.log_probability - answer.log_probability, 0.0) / LOG_ODDS_OVERSTATED))


def kind_probabilities(
    answer: Segmented,
    hypothesis: int,
    kinds: Sequence[JointKind],
    free: float,
    lack_of_fit: LackOfFit = NO_LACK_OF_FIT,
) -> tuple[tuple[JointKind, float], ...]:
    """Probability of every kind of joint for all rows of one joint.

    Args:
        free: log odds of free motion against all segments together [nats].
        lack_of_fit: evidence of all rows against the joint, from its last fit.
    """
    table, pieces = answer.table, answer.segmentation.pieces
    names, moving = table.pool.hypotheses.joints.kinds, table.pool.moving
    governed = np.zeros(len(answer.track), dtype=bool)
    sums = np.zeros(len(names))
    for piece in pieces:
        if piece.hypothesis == hypothesis:
            sums += table.sums[:, piece.start, piece.end]
            governed[piece.start : piece.end + 1] = True
    elsewhere = [piece.hypothesis for piece in pieces if piece.hypothesis != hypothesis]
    # A pose costs less if it lies on a joint that moves the part elsewhere, not on the one that it would replace.
    held = bool(moving[elsewhere].any())
    sums = sums - table.cost(np.arange(len(names)), np.full(len(names), float(governed.sum())), held)
    twisting = table.pool.hypotheses.joints.twisting
    # Costs of the whole segmentation: one more moving joint, or a rest next to a rest.
    beside = {b if a == hypothesis else a for a, b in pairwise([piece.hypothesis for piece in pieces])}
    another = moving & moving[elsewhere].any() & ~np.isin(np.arange(len(names)), elsewhere)
    another |= ~moving & any(not moving[neighbour] for neighbour in beside - {hypothesis})
    evidence = sums + SCREW_COST * twisting - ANOTHER_JOINT * another
    worth = evidence / LOG_ODDS_OVERSTATED - RARE_SCREW * twisting
    # Rivals are those fitted to much the same rows: others were paid for by other rows.
    used = table.pool.hypotheses.used
    shared_rows = (used & governed).sum(axis=1) / np.maximum((used | governed).sum(axis=1), 1)
    rival = shared_rows >= _SAME_ROWS
    rival[hypothesis] = True
    of_kind = [rival & (np.array(names) == kind) for kind in kinds]
    best = np.array([np.max(worth, where=members, initial=-np.inf) for members in of_kind])
    share = np.exp(best - best.max())
    index = list(kinds).index(names[hypothesis])
    # Other answers have noise of their own; under the noise of the one that was found they fare worse.
    for other_answer in answer.others:
        there = list(kinds).index(other_answer.kinds[int(np.argmax(np.bincount(other_answer.of_row[governed])))])
        if there != index:
            share[there] = max(share[there], _odds(other_answer, answer) * share[index])
    if lack_of_fit.screw_log_odds is not None:
        hinge_or_screw = [list(kinds).index("revolute"), list(kinds).index("screw")]
        advancing = float(expit(lack_of_fit.screw_log_odds - SCREW_COST))
        share[hinge_or_screw] = share[hinge_or_screw].sum() * np.array([1 - advancing, advancing])
    share = share / share.sum() / (1 + np.exp(min(free / LOG_ODDS_OVERSTATED, 700.0)))
    share = share * (1 - other_mechanism(lack_of_fit))
    return tuple((kind, float(value)) for kind, value in zip(kinds, share, strict=True))


def other_mechanism(lack_of_fit: LackOfFit) -> float:
    """Probability that a part off its joint is on a mechanism with more than one axis."""
    return 0.0 if lack_of_fit.deviation is None else OTHER_MECHANISM * lack_of_fit.deviation.probability
