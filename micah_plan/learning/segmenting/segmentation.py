"""Segmenting one track: the pool of joints, the most probable changepoints and the noise, until they agree.

**The answer.** The segments of a track, the joints that they refer to, and the noise under which they were found.

**The choice of segments** from a table of evidence when a joint is paid for once, however often a part returns to it.

The recursion over changepoints lets every segment pay for its own joint. Here a few joints are chosen first, at a cost,
and the recursion runs with them alone: joints are dropped while that pays, and one joint with rests is always tried.

**Rests.** Of a part that its joint moves and that is held for a while: joints and their channel, learned from the other
rows.

What the actions say of a joint is fitted to all rows that it explains. If rows at which the part was pushed against a
stop are among them, the actions seem to say little, and so the stop is not seen. Here the rests that there may be are
taken for granted, and the channel is learned from the rows beside them.

**The number of changepoints.** How many there may be depends on rests that the most probable answer lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from math import log

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.joint import JointKind
from micah_plan.changepoints import LengthPrior, length_terms, reached
from micah_plan.learning.segmenting.evidence import EvidenceTable, all_tabulated, tabulated
from micah_plan.learning.segmenting.held import along_joint, places_held
from micah_plan.learning.segmenting.motion import FEWEST_ACTED
from micah_plan.learning.segmenting.noise import NoiseModel, likelihood_power_of, stacked
from micah_plan.learning.segmenting.noise_fit import fit_noise_to_residuals, initial_noise
from micah_plan.learning.segmenting.pieces import Piece, Segmentation, best_segmentation, length_priors
from micah_plan.learning.segmenting.pool import (
    Hypotheses,
    all_refitted,
    pool_of,
    refitted_hypotheses,
    window_hypotheses,
)
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack

_MOST_ROUNDS = 3  # of segments, joints and noise in turn
_MOST_PROPOSALS = 3  # that are settled
_GRAINS = 16  # places that are told apart when proposals are compared
_CONVERGED = 0.2  # nats


def segment_track(track: PartTrack, settings: LearnSettings, start: Segmented | None = None) -> Segmented:
    """The most probable segments of a track without outliers.

    Two noises start: a fine one (under which there may be many segments) and that which a single joint would leave
    (under which there may be one). What each proposes settles on its own, and the most probable outcome is taken.

    Args:
        start: what was found for the same poses with other actions: then its joints and noise start, alone.
    """
    priors = length_priors(track, settings)
    if start is None:
        tables = _from_two_noises(track, priors[0], settings)
    else:
        table = start.table
        tables = [
            (start.noise, tabulated(table.pool.hypotheses, track, start.noise, settings.rest, table.likelihood_power))
        ]
    proposals = [proposal for noise, table in tables for proposal in _proposed(track, noise, table, priors, settings)]
    proposals = _different(proposals)[:_MOST_PROPOSALS]
    outcomes = _settled(proposals, settings)
    best = max(outcomes, key=lambda outcome: outcome.log_probability)
    held = with_rests(best, priors, settings)
    outcomes += [] if held is None else _settled([held], settings)
    best = max(outcomes, key=lambda outcome: outcome.log_probability)
    others = tuple(alternative(outcome) for outcome in outcomes if outcome is not best)
    return replace(_beside_rivals(best, settings), others=others)


def best_single(answer: Segmented, settings: LearnSettings) -> Segmented:
    """The whole track as one segment of the one moving joint (if there is any) that explains it best, under any wander.

    Compared under one noise, a joint that misses the rows has made that noise wide, and any kind will do.
    """
    track, prior = answer.track, length_priors(answer.track, settings)[0]
    n, likelihood_power = len(track), answer.table.likelihood_power
    ones, noises = _singles(track, answer.noise, settings, any_slow=True)
    alone = all_tabulated(ones, track, noises, settings.rest, likelihood_power)
    noise = noises[_likeliest(alone, prior, settings)]
    pool = refitted_hypotheses(list(settings.kinds), np.ones((len(settings.kinds), n), dtype=bool), track, noise)
    table = tabulated(pool, track, noise, settings.rest, likelihood_power)
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
    fine = initial_noise(track, settings)
    likelihood_power = likelihood_power_of(fine, settings)
    pool = window_hypotheses(track, settings.kinds, fine)
    ones, noises = _singles(track, fine, settings)
    table, *alone = all_tabulated([pool, *ones], track, [fine, *noises], settings.rest, likelihood_power)
    if not alone:
        return [(fine, table)]
    single = noises[_likeliest(alone, prior, settings)]
    return [(fine, table), (single, tabulated(pool, track, single, settings.rest, likelihood_power))]


def _singles(
    track: PartTrack, noise: NoiseModel, settings: LearnSettings, any_slow: bool = False
) -> tuple[list[Hypotheses], list[NoiseModel]]:
    """A joint of every kind that all rows determine, fitted to them under a noise, and the noise that each leaves.

    Where something moves, what a rigid model leaves is motion, not noise.
    """
    kinds: list[JointKind] = [kind for kind in settings.kinds if kind != "rigid"]
    kinds = kinds or list(settings.kinds)
    whole = refitted_hypotheses(kinds, np.ones((len(kinds), len(track)), dtype=bool), track, noise)
    pool, every = pool_of(whole, track, noise), np.zeros(len(track), dtype=np.int64)
    noises = (
        fit_noise_to_residuals([(pool, every + i) for i in range(len(whole))], settings, any_slow) if len(whole) else []
    )
    return [whole.take([i]) for i in range(len(whole))], noises


def _likeliest(alone: Sequence[EvidenceTable], prior: LengthPrior, settings: LearnSettings) -> int:
    """Which of some joints, each alone in its table, explains the whole track best."""
    return int(np.argmax([shared(table, [0], prior, settings).log_probability for table in alone]))


def _proposed(
    track: PartTrack, noise: NoiseModel, table: EvidenceTable, priors: Sequence[LengthPrior], settings: LearnSettings
) -> list[Segmented]:
    """What a table proposes under each prior of lengths."""
    # The copy ends here, and with it the evidence of all segments of all windows, which takes much memory.
    read = replace(table)
    return [
        Segmented(track, noise, prior, segmentation, table)
        for prior in priors
        for segmentation in selections(read, prior, settings)
    ]


def _different(proposals: Sequence[Segmented]) -> list[Segmented]:
    """The best of those that cut the track at much the same places into the same kinds, best first."""
    best_of: dict[tuple[tuple[str, int], ...], Segmented] = {}
    for proposal in sorted(proposals, key=lambda p: -p.log_probability):
        names = proposal.table.pool.hypotheses.joints.kinds
        grain = max(len(proposal.track) // _GRAINS, 1)
        key = tuple((names[p.hypothesis], round(p.start / grain)) for p in proposal.segmentation.pieces)
        best_of.setdefault(key, proposal)
    return list(best_of.values())


def _settled(starts: Sequence[Segmented], settings: LearnSettings) -> list[Segmented]:
    """Alternate between segments, their joints and the noise until no probability grows."""
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


def _beside_rivals(answer: Segmented, settings: LearnSettings) -> Segmented:
    """The same segments in a table where every kind of joint is fitted to the rows of each: what is said of them
    compares them with these.
    """
    (table,) = _tables([answer], [answer.noise], settings)
    used, _ = rows_of_joints(answer)
    pieces = tuple(replace(piece, hypothesis=used.index(piece.hypothesis)) for piece in answer.segmentation.pieces)
    return replace(answer, table=table, segmentation=replace(answer.segmentation, pieces=pieces))


def _tables(answers: Sequence[Segmented], noises: Sequence[NoiseModel], settings: LearnSettings) -> list[EvidenceTable]:
    """Of each answer, under a noise: its joints, in the order of `_rows_of_joints`, and their rivals of every kind."""
    track, kinds = answers[0].track, list(settings.kinds)
    in_use = [rows_of_joints(answer) for answer in answers]
    wanted = [(kinds * len(used), np.repeat(rows, len(kinds), axis=0)) for used, rows in in_use]
    rivals = all_refitted(wanted, track, stacked(noises, [1] * len(noises)))
    pools = [
        answer.table.pool.hypotheses.take(used).joined(more)
        for answer, (used, _), more in zip(answers, in_use, rivals, strict=True)
    ]
    return all_tabulated(pools, track, noises, settings.rest, answers[0].table.likelihood_power)


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another answer for the same rows, under the noise that it leaves itself.

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
    """The most probable segments of a track and what they refer to.

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


ANOTHER_JOINT = 15.0  # nats: most parts have one moving joint; another one needs decisive evidence
_PROMISING = 3  # joints that are tried with rests


def selections(table: EvidenceTable, prior: LengthPrior, settings: LearnSettings) -> list[Segmentation]:
    """Segmentations that may be the most probable one, each with its log probability, the best first."""
    apart = best_segmentation(table, prior, len(settings.kinds))

    @cache
    def under(*members: int) -> Segmentation:
        return shared(table, list(members), prior, settings)

    candidates = [_fewest(sorted({piece.hypothesis for piece in apart.pieces}), under)]
    moving, names = table.pool.moving, table.pool.hypotheses.joints.kinds
    rests = [int(i) for i in np.flatnonzero(~moving)] if "rigid" in settings.kinds else []
    for joint in _promising(table):
        members = [joint, *(i for i in rests if i != joint)]
        with_rests = best_segmentation(table, prior, len(settings.kinds), members, {joint})
        used = sorted({piece.hypothesis for piece in with_rests.pieces})
        candidates += [under(joint), under(*used)]
    unique = {
        tuple((p.start, names[p.hypothesis], p.hypothesis) for p in candidate.pieces): candidate
        for candidate in candidates
    }
    return sorted(unique.values(), key=lambda candidate: -candidate.log_probability)


def shared(table: EvidenceTable, members: list[int], prior: LengthPrior, settings: LearnSettings) -> Segmentation:
    """The most probable segments under few joints, which are paid once, and how probable they are at any places.

    So is the choice of their kinds: a part that returns to a joint returns to one of those of the answer.
    """
    segmentation = best_segmentation(table, prior, 1, members, members)
    return _paid_once(segmentation.pieces, table, prior, settings)


def _paid_once(
    pieces: tuple[Piece, ...], table: EvidenceTable, prior: LengthPrior, settings: LearnSettings
) -> Segmentation:
    """Segments of few joints, less what these cost."""
    used: dict[int, int] = {}
    for piece in pieces:
        used[piece.hypothesis] = used.get(piece.hypothesis, 0) + piece.end - piece.start + 1
    moving = sum(bool(table.pool.moving[i]) for i in used)
    cost = table.cost(np.array(list(used)), np.array(list(used.values()), dtype=float), moving > 0).sum()
    # A part does not get from one rest to another without a motion.
    rigid = [not table.pool.moving[piece.hypothesis] for piece in pieces]
    jumps = sum(a and b for a, b in pairwise(rigid))
    cost += (max(moving - 1, 0) + jumps) * ANOTHER_JOINT + len(used) * np.log(len(settings.kinds))
    pieces = merged(pieces)
    return Segmentation(pieces, _over_places(pieces, table, prior) - float(cost))


def _over_places(pieces: Sequence[Piece], table: EvidenceTable, prior: LengthPrior) -> float:
    """Ln probability of the rows under joints in an order, wherever one takes over from the one before."""
    used = sorted({piece.hypothesis for piece in pieces})
    worth = table.sums[used] + length_terms(prior, len(table.sums[0]))
    # Relative to the best segments before a row: sums are products of matrices then.
    best_before = reached(worth.max(axis=0))
    chances = np.exp(worth + (best_before[:-1, None] - best_before[1:]))
    begun = np.zeros(worth.shape[1])
    begun[0] = 1.0
    for piece in pieces[:-1]:
        # No row is the last of one segment but where another begins; the last row ends the last one.
        begun[1:] = (begun @ chances[used.index(piece.hypothesis)])[:-1]
        begun[0] = 0.0
    share = float(begun @ chances[used.index(pieces[-1].hypothesis), :, -1])
    return float(best_before[-1] + log(share)) if share > 0 else -np.inf


def few(table: EvidenceTable, members: list[int], prior: LengthPrior, settings: LearnSettings) -> Segmentation:
    """Segments of some joints, of which some are dropped while that pays."""
    return _fewest(members, lambda *pieces: shared(table, list(pieces), prior, settings))


def _fewest(members: list[int], under: Callable[..., Segmentation]) -> Segmentation:
    best = under(*members)
    while len(members) > 1:
        fewer = [[m for m in members if m != dropped] for dropped in members]
        tried = [under(*subset) for subset in fewer]
        i = max(range(len(tried)), key=lambda k: tried[k].log_probability)
        if tried[i].log_probability <= best.log_probability:
            break
        members, best = fewer[i], tried[i]
    return best


def _promising(table: EvidenceTable) -> list[int]:
    """Hypotheses that explain all rows best."""
    order = len(table.log_density) - 1
    totals = table.log_density[order, order:].sum(axis=0) - table.occam
    return [int(i) for i in np.argsort(-totals, kind="stable")[:_PROMISING]]


def merged(pieces: tuple[Piece, ...]) -> tuple[Piece, ...]:
    """Neighbouring pieces of one hypothesis as one: a tracker that slips is no changepoint."""
    joined: list[Piece] = []
    for piece in pieces:
        if joined and joined[-1].hypothesis == piece.hypothesis:
            before = joined.pop()
            piece = replace(piece, start=before.start, log_evidence=before.log_evidence + piece.log_evidence)
        joined.append(piece)
    return tuple(joined)


_FEWEST_ROWS = 3  # of a rest
_LENGTHS = 8  # of rests in the end
_LONGEST = 0.6  # of the rows


def with_rests(answer: Segmented, priors: Sequence[LengthPrior], settings: LearnSettings) -> Segmented | None:
    """The most probable segments if the part was held wherever the actions say that it was, on its main joint.

    What there is already stays among what is chosen from. None if the actions say so nowhere, or if no joint moves it.
    """
    table, track = answer.table, answer.track
    used, rows = rows_of_joints(answer)
    joint = max((i for i in used if table.pool.moving[i]), key=lambda i: rows[used.index(i)].sum(), default=None)
    if track.action is None or "rigid" not in settings.kinds or joint is None:
        return None
    inside = places_held(along_joint(table.pool, joint, track.action))
    outside = rows[[used.index(joint)]] & ~inside.any(axis=0)
    if not len(inside) or outside.sum() < FEWEST_ACTED:
        return None
    pool = Hypotheses(table.pool.hypotheses.joints.take([joint]), outside)
    pool = pool.joined(refitted_hypotheses(["rigid"] * len(inside), inside, track, answer.noise))
    pool = pool.joined(table.pool.hypotheses.take([i for i in used if i != joint]))
    tried = tabulated(pool, track, answer.noise, settings.rest, table.likelihood_power)
    every = list(range(len(pool)))
    answers = [
        replace(answer, table=tried, prior=prior, segmentation=few(tried, every, prior, settings)) for prior in priors
    ]
    return max(answers, key=lambda answer: answer.log_probability)


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
    rests = refitted_hypotheses(["rigid"] * len(ends), ends, track, noise)
    pool = table.pool.hypotheses.take(moves).joined(rests)
    tried = tabulated(pool, track, noise, rest, table.likelihood_power)
    held = np.arange(len(moves), len(pool))
    cost = tried.cost(held, tried.rows[held], bool(moves))
    return np.asarray(tried.sums[held] - cost[:, None, None])
