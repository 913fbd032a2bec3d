"""The section `learned` of a model file <-> what a model keeps of how sure learning was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from micah_plan.automaton.certainty import ActionChannel, EdgeCertainty, RowPosterior, SegmentCertainty
from micah_plan.automaton.learned import LearnedEdge, LearnedSegment
from micah_plan.documents.learned_document import (
    ActionsDocument,
    LearnedEdgeDocument,
    LearnedSegmentDocument,
    StartDocument,
)
from micah_plan.documents.located import KeyPath, Located

# Probabilities may be rounded: by the writer to 6 decimals, by a person to fewer.
_SUM_TOLERANCE = 1e-3
_SYMMETRY_TOLERANCE = 1e-6
_CHANNEL_SIZE = 5
_UNITS = ("rad", "rad", "rad", "", "s")


def learned_of(document: Sequence[LearnedEdgeDocument], located: Located) -> tuple[LearnedEdge, ...]:
    """What the section says.

    Raises:
        InputError: if probabilities, rows or sizes do not agree with each other.
    """
    return tuple(_edge(edge, located, ("learned", i)) for i, edge in enumerate(document))


def learned_data(edges: Sequence[LearnedEdge]) -> list[dict[str, Any]]:
    """The plain data of the section, which reads back as exactly these edges."""
    return [_edge_data(edge) for edge in edges]


def learned_comments(edges: Sequence[LearnedEdge]) -> dict[KeyPath, str]:
    """Remarks that make the section readable: 95 % of a start's rows, standard deviations of an action channel."""
    remarks: dict[KeyPath, str] = {}
    for i, edge in enumerate(edges):
        channel = None if edge.certainty is None else edge.certainty.channel
        if channel is not None:
            stds = np.sqrt(np.maximum(np.diag(np.array(channel.covariance)), 0.0))
            said = ", ".join(f"{std:.2g} {unit}".rstrip() for std, unit in zip(stds, _UNITS, strict=True))
            remarks["learned", i, "actions", "covariance"] = f"std {said}"
        for k, segment in enumerate(edge.segments):
            start = None if segment.certainty is None else segment.certainty.start
            if start is not None:
                first, last = start.interval()
                remarks["learned", i, "segments", k, "start", "rows"] = f"95 % within {first} to {last}"
    return remarks


def _edge(edge: LearnedEdgeDocument, located: Located, path: KeyPath) -> LearnedEdge:
    segments = tuple(_segment(one, located, (*path, "segments", k)) for k, one in enumerate(edge.segments))
    for k, counts in enumerate(edge.changepoint_counts):
        _check_sum(counts, located, (*path, "changepoint_counts", k))
    channel = None if edge.actions is None else _channel(edge.actions, located, (*path, "actions"))
    if edge.log_evidence is None:
        if edge.changepoint_counts or channel is not None:
            raise located.error(
                path, "missing key 'log_evidence'", "add it, or leave out changepoint_counts and actions"
            )
        return LearnedEdge(edge.parent, edge.child, segments)
    certainty = EdgeCertainty(edge.log_evidence, tuple(map(tuple, edge.changepoint_counts)), channel)
    return LearnedEdge(edge.parent, edge.child, segments, certainty)


def _segment(segment: LearnedSegmentDocument, located: Located, path: KeyPath) -> LearnedSegment:
    first, last = segment.rows
    if first > last:
        raise located.error((*path, "rows"), f"expected first <= last row, found {first} > {last}", "swap them")
    start = None if segment.start is None else _start(segment.start, located, (*path, "start"))
    if segment.probabilities is None:
        if start is not None:
            raise located.error(path, "missing key 'probabilities'", "add it, or leave out start")
        return LearnedSegment(segment.kind, segment.run, first, last)
    total = sum(segment.probabilities.values())
    if total > 1.0 + _SUM_TOLERANCE:
        problem = f"expected probabilities that sum to at most 1, found {total:.6g}"
        raise located.error((*path, "probabilities"), problem, "correct them")
    certainty = SegmentCertainty(start, tuple(segment.probabilities.items()))
    return LearnedSegment(segment.kind, segment.run, first, last, certainty)


def _start(start: StartDocument, located: Located, path: KeyPath) -> RowPosterior:
    if len(start.rows) != len(start.probabilities):
        problem = f"expected one probability per row, found {len(start.probabilities)} for {len(start.rows)} rows"
        raise located.error((*path, "probabilities"), problem)
    if any(a >= b for a, b in zip(start.rows[:-1], start.rows[1:], strict=True)):
        raise located.error((*path, "rows"), "expected rows in increasing order", "sort them with their probabilities")
    _check_sum(start.probabilities, located, (*path, "probabilities"))
    return RowPosterior(tuple(start.rows), tuple(start.probabilities))


def _channel(actions: ActionsDocument, located: Located, path: KeyPath) -> ActionChannel:
    rows = actions.covariance
    if len(rows) != _CHANNEL_SIZE or any(len(row) != _CHANNEL_SIZE for row in rows):
        found = f"{len(rows)} rows of {', '.join(sorted({str(len(row)) for row in rows}))}"
        raise located.error((*path, "covariance"), f"expected 5 rows of 5, found {found}")
    matrix = np.array(rows)
    if np.abs(matrix - matrix.T).max() > _SYMMETRY_TOLERANCE * np.abs(matrix).max() or (np.diag(matrix) < 0).any():
        raise located.error((*path, "covariance"), "expected a symmetric matrix with variances >= 0", "correct it")
    covariance = tuple(map(tuple, rows))
    return ActionChannel(actions.frame_rotation, actions.gain, actions.delay, covariance, actions.explained)


def _check_sum(probabilities: Sequence[float], located: Located, path: KeyPath) -> None:
    total = sum(probabilities)
    if abs(total - 1.0) > _SUM_TOLERANCE:
        raise located.error(path, f"expected probabilities that sum to 1, found {total:.6g}", "correct them")


def _edge_data(edge: LearnedEdge) -> dict[str, Any]:
    data: dict[str, Any] = {"parent": edge.parent, "child": edge.child}
    certainty = edge.certainty
    if certainty is not None:
        data["log_evidence"] = float(certainty.log_evidence)
        data["changepoint_counts"] = [list(map(float, run)) for run in certainty.changepoint_counts]
        if certainty.channel is not None:
            data["actions"] = _channel_data(certainty.channel)
    return data | {"segments": [_segment_data(segment) for segment in edge.segments]}


def _channel_data(channel: ActionChannel) -> dict[str, Any]:
    return {
        "frame_rotation": list(map(float, channel.frame_rotation)),
        "gain": float(channel.gain),
        "delay": float(channel.delay),
        "covariance": [list(map(float, row)) for row in channel.covariance],
        "explained": float(channel.explained),
    }


def _segment_data(segment: LearnedSegment) -> dict[str, Any]:
    data: dict[str, Any] = {"kind": segment.kind}
    if segment.run:
        data["run"] = int(segment.run)
    data["rows"] = [int(segment.start), int(segment.end)]
    certainty = segment.certainty
    if certainty is not None:
        data["probabilities"] = _probabilities(certainty.kinds)
        if certainty.start is not None:
            rows = list(map(int, certainty.start.rows))
            data["start"] = {"rows": rows, "probabilities": list(map(float, certainty.start.probabilities))}
    return data


def _probabilities(kinds: Sequence[tuple[str, float]]) -> Mapping[str, float]:
    return {kind: float(probability) for kind, probability in kinds}
