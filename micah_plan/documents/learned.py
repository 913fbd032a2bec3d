"""How sure learning was: the entries `learned` of a model file."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from micah_plan.automaton.certainty import (
    ActionChannel,
    EdgeCertainty,
    LearnedEdge,
    LearnedSegment,
    RowPosterior,
    SegmentCertainty,
)
from micah_plan.automaton.joint import JointKind
from micah_plan.documents.joint import check_size, standard_deviations
from micah_plan.documents.layout import Count, Document, Listed, Matrix, Name, Probability, Vector3, doc, plain
from micah_plan.documents.located import KeyPath, Located

# Probabilities may be rounded: by the writer to 6 decimals, by a person to fewer.
_SUM_TOLERANCE = 1e-3
_SYMMETRY_TOLERANCE = 1e-6
_CHANNEL_SIZE = 5
_UNITS = ("rad", "rad", "rad", "", "s")
Probabilities = Annotated[tuple[Probability, ...], Listed(1)]


class StartDocument(Document):
    rows: Annotated[tuple[Count, ...], Listed(1)] = doc("Rows at which the segment may start, in increasing order.")
    probabilities: Probabilities = doc("Their probabilities, which sum to 1.")


class LearnedSegmentDocument(Document):
    kind: JointKind = doc("Kind of the joint that governs it.")
    run: int = doc("Run that the rows belong to.", 0)
    rows: Annotated[tuple[Count, Count], Field(strict=False)] = doc(
        "First and last row (inclusive), counted within the whole recording."
    )
    probabilities: dict[JointKind, Probability] | None = doc(
        "Probability of every kind of joint; what they leave of 1 is that of free motion.", None
    )
    start: StartDocument | None = doc("Where it starts; absent for the first of a run.", None)


class ActionsDocument(Document):
    frame_rotation: Vector3 = doc(
        "Rotation vector from the frame in which the actions were given to the base frame [rad]."
    )
    gain: float = doc("Displacement made per displacement recorded.")
    delay: float = doc("Time from the recorded action to the motion [s].")
    covariance: Matrix = doc("(5, 5), of frame_rotation (3), gain and delay.")
    explained: float = doc("Share of the variance of the part's steps that the actions explain, 0 to 1.")


class LearnedEdgeDocument(Document):
    parent: Name = doc("Part (or base) that the child's pose is relative to.")
    child: Name = doc("Part that moves.")
    log_evidence: float | None = doc("Log probability of the rows, summed over segmentations [nats].", None)
    changepoint_counts: Annotated[tuple[Probabilities, ...], Listed()] = doc(
        "Per run, the probabilities of 0, 1, 2, ... changepoints.", tuple
    )
    actions: ActionsDocument | None = doc("How the recorded actions moved the part; absent if they said nothing.", None)
    segments: list[LearnedSegmentDocument] = doc("The segments of the recording, in time order.")


def learned_of(document: LearnedEdgeDocument, located: Located) -> LearnedEdge:
    """What an entry says of one edge of the kinematic graph.

    Raises:
        InputError: if probabilities, rows or sizes do not agree with each other.
    """
    segments = tuple(_segment_of(one, located.at("segments", k)) for k, one in enumerate(document.segments))
    for k, counts in enumerate(document.changepoint_counts):
        _check_sum(counts, located.at("changepoint_counts", k))
    channel = None if document.actions is None else _channel_of(document.actions, located.at("actions"))
    if document.log_evidence is None:
        if document.changepoint_counts or channel is not None:
            raise located.error("missing key 'log_evidence'", "add it, or leave out changepoint_counts and actions")
        return LearnedEdge(document.parent, document.child, segments)
    certainty = EdgeCertainty(document.log_evidence, document.changepoint_counts, channel)
    return LearnedEdge(document.parent, document.child, segments, certainty)


def learned_data(edge: LearnedEdge) -> dict[str, Any]:
    """The entry of an edge, which `learned_of` reads back."""
    segments = [_segment_data(segment) for segment in edge.segments]
    data: dict[str, Any] = {"parent": edge.parent, "child": edge.child, "segments": segments}
    if edge.certainty is not None:
        data |= {**vars(edge.certainty), "actions": edge.certainty.channel}
    return plain(LearnedEdgeDocument, data, keep={"changepoint_counts"})


def learned_remarks(edge: LearnedEdge) -> dict[KeyPath, str]:
    """Remarks for people by key path: 95 % of a start's rows, standard deviations of an action channel."""
    remarks: dict[KeyPath, str] = {}
    channel = None if edge.certainty is None else edge.certainty.channel
    if channel is not None:
        stds = zip(standard_deviations(channel.covariance), _UNITS, strict=True)
        remarks["actions", "covariance"] = "std " + ", ".join(f"{std:.2g} {unit}".rstrip() for std, unit in stds)
    for k, segment in enumerate(edge.segments):
        start = None if segment.certainty is None else segment.certainty.start
        if start is not None:
            first, last = start.interval()
            remarks["segments", k, "start", "rows"] = f"95 % within {first} to {last}"
    return remarks


def _segment_of(document: LearnedSegmentDocument, located: Located) -> LearnedSegment:
    first, last = document.rows
    if first > last:
        raise located.at("rows").error(f"expected first <= last row, found {first} > {last}", "swap them")
    start = None if document.start is None else _start_of(document.start, located.at("start"))
    if document.probabilities is None:
        if start is not None:
            raise located.error("missing key 'probabilities'", "add it, or leave out start")
        return LearnedSegment(document.kind, document.run, first, last)
    total = sum(document.probabilities.values())
    if total > 1.0 + _SUM_TOLERANCE:
        problem = f"expected probabilities that sum to at most 1, found {total:.6g}"
        raise located.at("probabilities").error(problem, "correct them")
    certainty = SegmentCertainty(start, tuple(document.probabilities.items()))
    return LearnedSegment(document.kind, document.run, first, last, certainty)


def _segment_data(segment: LearnedSegment) -> dict[str, Any]:
    data: dict[str, Any] = {"kind": segment.kind, "run": segment.run, "rows": (segment.start, segment.end)}
    if segment.certainty is not None:
        data |= {"probabilities": dict(segment.certainty.kinds), "start": segment.certainty.start}
    return plain(LearnedSegmentDocument, data)


def _start_of(document: StartDocument, located: Located) -> RowPosterior:
    rows, probabilities = document.rows, document.probabilities
    if len(rows) != len(probabilities):
        problem = f"expected one probability per row, found {len(probabilities)} for {len(rows)} rows"
        raise located.at("probabilities").error(problem)
    if any(a >= b for a, b in pairwise(rows)):
        raise located.at("rows").error("expected rows in increasing order", "sort them with their probabilities")
    _check_sum(probabilities, located.at("probabilities"))
    return RowPosterior(rows, probabilities)


def _channel_of(document: ActionsDocument, located: Located) -> ActionChannel:
    located = located.at("covariance")
    check_size(document.covariance, _CHANNEL_SIZE, _CHANNEL_SIZE, located)
    matrix = np.array(document.covariance)
    if np.abs(matrix - matrix.T).max() > _SYMMETRY_TOLERANCE * np.abs(matrix).max() or (np.diag(matrix) < 0).any():
        raise located.error("expected a symmetric matrix with variances >= 0", "correct it")
    return ActionChannel(**dict(document))


def _check_sum(probabilities: Sequence[float], located: Located) -> None:
    total = sum(probabilities)
    if abs(total - 1.0) > _SUM_TOLERANCE:
        raise located.error(f"expected probabilities that sum to 1, found {total:.6g}", "correct them")
