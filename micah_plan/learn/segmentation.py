"""Segmenting one track: the pool of joints, the most probable changepoints and the noise, until they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.changepoints import Piece, Segmentation, most_probable
from micah_plan.learn.evidence import EvidenceTable, ExactEvidence, tabulated
from micah_plan.learn.length_prior import LengthPrior
from micah_plan.learn.noise import NoiseModel
from micah_plan.learn.noise_fit import first_noise, misses, refitted_noise
from micah_plan.learn.pool import Hypotheses, refitted, window_hypotheses
from micah_plan.learn.posterior import ChangepointPosterior, changepoint_posterior
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

_MOST_ROUNDS = 3
_FEWEST_ROWS = 4
_MOST_STRETCHES = 6
_ANOTHER_JOINT = 10.0  # nats: most parts have one moving joint; another one needs decisive evidence


@dataclass(frozen=True, eq=False)
class Segmented:
    """The most probable segments of a track and what they refer to.

    Attributes:
        track: the rows that were segmented.
        noise: estimated together with the segments.
        segmentation: pieces, in rows of that track; those of one hypothesis share its parameters.
        table: the evidence that decided, with its pool and step models.
        log_probability: of the rows and segments, parameters of a joint counted once.
    """

    track: PartTrack
    noise: NoiseModel
    segmentation: Segmentation
    table: EvidenceTable
    log_probability: float

    def best_single(self) -> Piece:
        """The whole track as one segment of the one joint that explains it best."""
        last = len(self.track) - 1
        totals = self.table.log_density[-1].sum(axis=0) - self.table.occam
        best = int(
            np.argmax(np.where(self.table.pool.moving, totals, -np.inf if self.table.pool.moving.any() else totals))
        )
        return Piece(0, last, 0, best, float(totals[best]), 1.0)


def segment_track(track: PartTrack, settings: LearnSettings, use_actions: bool, rng: np.random.Generator) -> Segmented:
    """The most probable segments of a track without outliers.

    Two explanations start: fine noise (which may find many segments) and the noise that a single joint would leave
    (which may find one). Each settles on its own, and the more probable one is taken.
    """
    fine = first_noise(track, settings)
    windows = window_hypotheses(track, settings.kinds, fine)
    starts = [fine]
    single = _single(track, fine, settings, use_actions)
    if single is not None:
        starts.insert(0, single)
    settled = [_settled(windows, track, noise, settings, use_actions, rng) for noise in starts]
    return _with_rivals(max(settled, key=lambda one: one.log_probability), settings, use_actions)


def _single(track: PartTrack, noise: NoiseModel, settings: LearnSettings, use_actions: bool) -> NoiseModel | None:
    """The noise that the single joint leaves which is the most probable one with the noise that it leaves."""
    # Where something moves, what a rigid model leaves is motion, not noise.
    kinds: list[JointKind] = [kind for kind in settings.kinds if kind != "rigid"]
    kinds = kinds or list(settings.kinds)
    whole = refitted(kinds, np.ones((len(kinds), len(track)), dtype=bool), track, noise)
    best: tuple[float, NoiseModel] | None = None
    for i in range(len(whole)):
        one = whole.take([i])
        table = tabulated(one, track, noise, use_actions, settings.rest)
        left = refitted_noise(*misses(table.pool, np.zeros(len(track), dtype=np.int64)), settings)
        table = tabulated(one, track, left, use_actions, settings.rest)
        total, _ = _shared(table, [0], track, settings, np.random.default_rng(0))
        if best is None or total > best[0]:
            best = total, left
    return None if best is None else best[1]


def _settled(
    windows: Hypotheses,
    track: PartTrack,
    noise: NoiseModel,
    settings: LearnSettings,
    use_actions: bool,
    rng: np.random.Generator,
) -> Segmented:
    """Alternate between segments, their joints and the noise until the probability does not grow."""
    best: Segmented | None = None
    pool = windows
    for _ in range(_MOST_ROUNDS):
        table = tabulated(pool, track, noise, use_actions, settings.rest)
        evidence = ExactEvidence(table, settings.kinds)
        apart = most_probable(evidence, len(track), _prior(track, settings), rng, settings.particles)
        total, segmentation = _selected(table, apart, track, settings, rng)
        found = Segmented(track, noise, segmentation, table, total)
        if best is not None and found.log_probability <= best.log_probability + 1e-3:
            break
        best = found
        used = sorted({piece.hypothesis for piece in segmentation.pieces})
        noise = _left(segmentation.pieces, table, settings)
        kinds, rows = _stretches(segmentation, apart, len(track), settings.kinds)
        pool = table.pool.hypotheses.take(used).joined(refitted(kinds, rows, track, noise))
    if best is None:
        raise RuntimeError("no round was made")
    return best


def _stretches(
    segmentation: Segmentation, apart: Segmentation, n: int, kinds: Sequence[JointKind]
) -> tuple[list[JointKind], Bools]:
    """Rows to fit next, with every kind: all rows of each joint found, its pieces, and unions of neighbours."""
    rows: dict[tuple[int, ...], None] = {}
    by_joint: dict[int, list[int]] = {}
    for piece in segmentation.pieces:
        by_joint.setdefault(piece.hypothesis, []).extend(range(piece.start, piece.end + 1))
    for members in by_joint.values():
        rows[tuple(members)] = None
    for pieces in (segmentation.pieces, apart.pieces):
        for reach in (0, 1, 2):
            for a, b in zip(pieces, pieces[reach:], strict=False):
                rows[tuple(range(a.start, b.end + 1))] = None
    stretches = [stretch for stretch in rows if len(stretch) >= _FEWEST_ROWS][:_MOST_STRETCHES]
    used = np.zeros((len(stretches), n), dtype=bool)
    for i, stretch in enumerate(stretches):
        used[i, list(stretch)] = True
    return [kind for _ in stretches for kind in kinds], np.repeat(used, len(kinds), axis=0)


def _selected(
    table: EvidenceTable, apart: Segmentation, track: PartTrack, settings: LearnSettings, rng: np.random.Generator
) -> tuple[float, Segmentation]:
    """Segments whose joints are counted once however often they return: joints are dropped while that pays."""
    members = sorted({piece.hypothesis for piece in apart.pieces})
    best = _shared(table, members, track, settings, rng)
    while len(members) > 1:
        fewer = [[m for m in members if m != dropped] for dropped in members]
        tried = [_shared(table, some, track, settings, rng) for some in fewer]
        i = max(range(len(tried)), key=lambda k: tried[k][0])
        if tried[i][0] <= best[0]:
            break
        members, best = fewer[i], tried[i]
    for single in _promising(table):
        tried_single = _shared(table, [single], track, settings, rng)
        if tried_single[0] > best[0]:
            best = tried_single
    return best


def _promising(table: EvidenceTable) -> list[int]:
    """Hypotheses that explain all rows best, three of them."""
    order = len(table.log_density) - 1
    totals = table.log_density[order, order:].sum(axis=0) - table.occam
    return [int(i) for i in np.argsort(-totals)[:3]]


def _shared(
    table: EvidenceTable, members: list[int], track: PartTrack, settings: LearnSettings, rng: np.random.Generator
) -> tuple[float, Segmentation]:
    """The most probable segments under few joints, whose parameters are paid once."""
    evidence = ExactEvidence(table, settings.kinds, members, charged=False)
    found = most_probable(evidence, len(track), _prior(track, settings), rng, settings.particles)
    used: dict[int, int] = {}
    for piece in found.pieces:
        used[piece.hypothesis] = used.get(piece.hypothesis, 0) + piece.end - piece.start + 1
    moving = sum(bool(table.pool.moving[i]) for i in used)
    cost = table.cost(np.array(list(used)), np.array(list(used.values()), dtype=float), moving > 0).sum()
    # A part does not get from one rest to another without a motion.
    rigid = [not table.pool.moving[piece.hypothesis] for piece in found.pieces]
    jumps = sum(a and b for a, b in pairwise(rigid))
    cost += (max(moving - 1, 0) + jumps) * _ANOTHER_JOINT
    return found.log_probability - float(cost), _merged(found)


def _with_rivals(found: Segmented, settings: LearnSettings, use_actions: bool) -> Segmented:
    """The same segments, in a pool that holds their joints and, of every kind, the best rivals on the same rows."""
    used = list(dict.fromkeys(piece.hypothesis for piece in found.segmentation.pieces))
    rows = np.zeros((len(used) + 1, len(found.track)), dtype=bool)
    rows[-1] = True
    for piece in found.segmentation.pieces:
        rows[used.index(piece.hypothesis), piece.start : piece.end + 1] = True
    kinds = [kind for _ in rows for kind in settings.kinds]
    rivals = refitted(kinds, np.repeat(rows, len(settings.kinds), axis=0), found.track, found.noise)
    pool = found.table.pool.hypotheses.take(used).joined(rivals)
    table = tabulated(pool, found.track, found.noise, use_actions, settings.rest)
    pieces = tuple(replace(piece, hypothesis=used.index(piece.hypothesis)) for piece in found.segmentation.pieces)
    return replace(found, table=table, segmentation=replace(found.segmentation, pieces=pieces))


def posterior_of(found: Segmented, settings: LearnSettings) -> ChangepointPosterior:
    """The posterior over segmentations; joints of the most probable one are paid for once, others by each segment."""
    table, pieces = found.table, found.segmentation.pieces
    used = sorted({piece.hypothesis for piece in pieces})
    moving = table.pool.moving
    index = np.arange(len(moving))
    cost: Floats = table.cost(index, table.rows, bool(moving[used].any())) + _ANOTHER_JOINT * moving
    paid = float(cost[used].sum()) - _ANOTHER_JOINT * bool(moving[used].any())
    cost[used] = 0.0
    # A part does not get from one rest to another without a motion.
    apart: Floats = np.where(np.eye(len(moving)) > 0, np.inf, _ANOTHER_JOINT * np.outer(~moving, ~moving))
    prior = _prior(found.track, settings)
    result = changepoint_posterior(table, cost, apart, prior, len(settings.kinds), len(pieces) - 1)
    return replace(result, log_evidence=result.log_evidence - paid)


def kind_probabilities(
    found: Segmented, hypothesis: int, kinds: Sequence[JointKind], free: float
) -> tuple[tuple[JointKind, float], ...]:
    """Probability of every kind of joint for all rows of one joint.

    Args:
        free: log odds of free motion against all segments together [nats].
    """
    table = found.table
    names = table.pool.hypotheses.joints.kinds
    sums = np.zeros(len(names))
    rows = 0
    for piece in found.segmentation.pieces:
        if piece.hypothesis == hypothesis:
            known = np.minimum(np.arange(piece.end - piece.start + 1), len(table.log_density) - 1)
            sums += table.log_density[known, np.arange(piece.start, piece.end + 1)].sum(axis=0)
            rows += len(known)
    held = bool(table.pool.moving[[piece.hypothesis for piece in found.segmentation.pieces]].any())
    sums = sums - table.cost(np.arange(len(names)), np.full(len(names), float(rows)), held)
    best = np.array([max((sums[i] for i, name in enumerate(names) if name == kind), default=-np.inf) for kind in kinds])
    share = np.exp(best - best.max())
    share = share / share.sum() / (1 + np.exp(min(free, 700.0)))
    return tuple((kind, float(value)) for kind, value in zip(kinds, share, strict=True))


def _merged(found: Segmentation) -> Segmentation:
    """The same with neighbouring pieces of one hypothesis as one: a tracker that slips is no changepoint."""
    pieces: list[Piece] = []
    for piece in found.pieces:
        if pieces and pieces[-1].hypothesis == piece.hypothesis:
            before = pieces.pop()
            evidence = before.log_evidence + piece.log_evidence
            piece = replace(piece, start=before.start, log_evidence=evidence)
        pieces.append(piece)
    return Segmentation(tuple(pieces), found.log_probability)


def _left(pieces: Sequence[Piece], table: EvidenceTable, settings: LearnSettings) -> NoiseModel:
    """The noise that the joints of pieces leave."""
    which = np.concatenate([np.full(p.end - p.start + 1, p.hypothesis) for p in pieces])
    return refitted_noise(*misses(table.pool, which), settings)


def _prior(track: PartTrack, settings: LearnSettings) -> LengthPrior:
    """The length prior in rows."""
    share = 0.5 if settings.mean_length is None else settings.mean_length / max(track.duration, 1e-12)
    return LengthPrior(max(share * len(track), 1.0), settings.length_shape)
