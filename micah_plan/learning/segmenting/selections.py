"""Selection of segments where a joint's parameters are charged once, regardless of returns to it.

The recursion over changepoints charges every segment for its own joint. Here a few joints are chosen first, at a cost,
and the recursion runs with them alone: joints are dropped while that increases the evidence, and one joint with rests
is always tried.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import log

import numpy as np

from micah_plan.changepoints import LengthPrior, length_terms, reached
from micah_plan.learning.segmenting.evidence import EvidenceTable
from micah_plan.learning.segmenting.pieces import Piece, Segmentation, best_segmentation
from micah_plan.learning.settings import LearnSettings

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
        resting = best_segmentation(table, prior, len(settings.kinds), members, {joint})
        used = sorted({piece.hypothesis for piece in resting.pieces})
        candidates += [under(joint), under(*used)]
    unique = {
        tuple((p.start, names[p.hypothesis], p.hypothesis) for p in candidate.pieces): candidate
        for candidate in candidates
    }
    return sorted(unique.values(), key=lambda candidate: -candidate.log_probability)


def shared(table: EvidenceTable, members: list[int], prior: LengthPrior, settings: LearnSettings) -> Segmentation:
    """The most probable segments of a few joints charged once, with their probability over all places.

    So is the choice of their kinds: a part that returns to a joint returns to one of those of the result.
    """
    segmentation = best_segmentation(table, prior, 1, members, members)
    return _charged_once(segmentation.pieces, table, prior, settings)


def _charged_once(
    pieces: tuple[Piece, ...], table: EvidenceTable, prior: LengthPrior, settings: LearnSettings
) -> Segmentation:
    """A segmentation in which each joint's parameters are charged once."""
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
    return Segmentation(pieces, _summed_over_changepoints(pieces, table, prior) - float(cost))


def _summed_over_changepoints(pieces: Sequence[Piece], table: EvidenceTable, prior: LengthPrior) -> float:
    """Log probability of the rows under an order of joints, summed over the changepoints."""
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


def prune_joints(table: EvidenceTable, members: list[int], prior: LengthPrior, settings: LearnSettings) -> Segmentation:
    """Segments of some joints, from which joints are dropped while that increases the evidence."""
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
