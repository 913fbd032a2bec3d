"""Neighbouring segments of one joint are one segment: "the same parameters again" against "new parameters".

How fast and which way a part moves belongs to the demonstration, not to its joint, yet a change of speed makes two
models of the steps better than one. So neighbours are compared by the evidence of their poses across the joint alone,
where the motion along it has no say; if one joint for both explains that as well, they are one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.changepoints import Piece, Segmentation
from micah_plan.learn.evidence import EvidenceStream

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Stretch = tuple[int, int]
Evidence = dict[Stretch, tuple[Floats, Ints]]


def merged(
    segmentation: Segmentation, kinds: tuple[JointKind, ...], evidence: Callable[[bool], EvidenceStream]
) -> Segmentation:
    """The segmentation with neighbours on one joint joined.

    Args:
        segmentation: the most probable pieces.
        kinds: candidate joints, in the order of the evidence's columns.
        evidence: opens a stream of evidence with (true) or without (false) the motion along the joints.
    """
    pieces = list(segmentation.pieces)
    moving = np.array([kind != "rigid" for kind in kinds])
    if not any(moving[a.kind] and moving[b.kind] for a, b in pairwise(pieces)):
        return segmentation
    stretches = {(a.start, b.end) for i, a in enumerate(pieces) for b in pieces[i:]}
    across = evidence_of(evidence(False), stretches)
    groups = [[piece] for piece in pieces]
    while True:
        gains = [_gain(a, b, across, moving) for a, b in pairwise(groups)]
        if not gains or max(gains) < 0.0:
            break
        i = int(np.argmax(gains))
        groups[i : i + 2] = [groups[i] + groups[i + 1]]
    if len(groups) == len(pieces):
        return segmentation
    spans = [(group[0].start, group[-1].end) for group in groups]
    whole = evidence_of(evidence(True), set(spans))
    joined = (
        group[0] if len(group) == 1 else _piece(span, *whole[span], moving)
        for group, span in zip(groups, spans, strict=True)
    )
    return replace(segmentation, pieces=tuple(joined))


def evidence_of(stream: EvidenceStream, stretches: set[Stretch]) -> Evidence:
    """ln L (k,) and best hypothesis (k,) per kind of each stretch of rows (first, last)."""
    found: Evidence = {}
    last = {start: max(end for first, end in stretches if first == start) for start, _ in stretches}
    for row in range(max(end for _, end in stretches) + 1):
        column = stream.advance()
        for i, start in enumerate(column.starts):
            if (int(start), row) in stretches:
                found[int(start), row] = column.log_evidence[i], column.hypothesis[i]
        stream.keep(np.flatnonzero([last.get(int(start), -1) > row for start in column.starts]))
    return found


def _gain(first: list[Piece], second: list[Piece], across: Evidence, moving: NDArray[np.bool_]) -> float:
    """ln of how much better one joint explains both groups; -inf next to a rigid piece."""
    if not all(moving[group[0].kind] for group in (first, second)):
        return -np.inf
    one = across[first[0].start, second[-1].end][0][moving].max()
    two = sum(across[group[0].start, group[-1].end][0][moving].max() for group in (first, second))
    return float(one - two)


def _piece(span: Stretch, evidence: Floats, hypothesis: Ints, moving: NDArray[np.bool_]) -> Piece:
    kind = int(np.argmax(np.where(moving, evidence, -np.inf)))
    probability = float(np.exp(evidence[kind] - logsumexp(evidence)))
    return Piece(*span, kind, int(hypothesis[kind]), float(evidence[kind]), probability)
