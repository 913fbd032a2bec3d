"""The entries `learned` of a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any

from pydantic import Field

from micah_plan.automaton.certainty import (
    CHANNEL_NAMES,
    ActionChannel,
    EdgeCertainty,
    LearnedEdge,
    LearnedSegment,
    RowPosterior,
    SegmentCertainty,
)
from micah_plan.automaton.joint import JointKind
from micah_plan.documents.fields import (
    ITEMS,
    Count,
    Listed,
    Matrix,
    Name,
    Place,
    Probability,
    Vector3,
    check_covariance,
)
from micah_plan.documents.joint import check_size, standard_deviations
from micah_plan.documents.layout import Document, Scope, doc
from micah_plan.documents.located import KeyPath, Located
from micah_plan.recording.commands import Meaning

# Probabilities may be rounded: by the writer to 6 decimals, by a person to fewer.
_SUM_TOLERANCE = 1e-3
_UNITS = ("rad", "rad", "rad", "", "s")
Probabilities = Annotated[tuple[Probability, ...], Listed(1)]


class RowPosteriorDocument(Document):
    makes = RowPosterior

    rows: Annotated[tuple[Count, ...], Listed(1)] = doc("Rows at which the segment may start, in increasing order.")
    probabilities: Probabilities = doc("Their probabilities, which sum to 1.")

    def check(self, at: Located) -> None:
        rows, probabilities = self.rows, self.probabilities
        if len(rows) != len(probabilities):
            problem = f"expected one probability per row, found {len(probabilities)} for {len(rows)} rows"
            raise at.at("probabilities").error(problem)
        if any(a >= b for a, b in pairwise(rows)):
            raise at.at("rows").error("expected rows in increasing order", "sort them with their probabilities")
        _check_sum(probabilities, at.at("probabilities"))


class LearnedSegmentDocument(Document):
    kind: JointKind = doc("Kind of the joint that governs it.")
    run: int = doc("Run that the rows belong to.", 0)
    rows: Annotated[tuple[Count, Count], Field(strict=False)] = doc(
        "First and last row (inclusive), counted within the whole recording."
    )
    probabilities: Annotated[dict[JointKind, Probability], ITEMS] | None = doc(
        "Probability of every kind of joint; the rest to 1 is that of no single joint.", None
    )
    start: RowPosteriorDocument | None = doc("Where it starts; absent for the first of a run.", None)

    def check(self, at: Located) -> None:
        first, last = self.rows
        if first > last:
            raise at.at("rows").error(f"expected first <= last row, found {first} > {last}", "swap them")
        if self.probabilities is None and self.start is not None:
            raise at.error("missing key 'probabilities'", "add it, or leave out start")
        total = sum((self.probabilities or {}).values())
        if total > 1.0 + _SUM_TOLERANCE:
            problem = f"expected probabilities that sum to at most 1, found {total:.6g}"
            raise at.at("probabilities").error(problem, "correct them")

    def read(self, at: Located, scope: Scope) -> LearnedSegment:
        values = self.meanings(at, scope)
        kinds = values["probabilities"]
        certainty = None if kinds is None else SegmentCertainty(values["start"], kinds)
        return LearnedSegment(self.kind, self.run, *self.rows, certainty)

    @classmethod
    def written(cls, value: LearnedSegment, scope: Scope) -> Mapping[str, Any]:
        sure = value.certainty
        certainty = {} if sure is None else {"probabilities": sure.kinds, "start": sure.start}
        return {"kind": value.kind, "run": value.run, "rows": (value.start, value.end), **certainty}


class ActionsDocument(Document):
    makes = ActionChannel

    frame_rotation: Vector3 = doc(
        "Rotation vector from the frame in which the actions were given to the base frame [rad]."
    )
    gain: Place = doc("Displacement made per displacement recorded.")
    delay: Place = doc("Time from the recorded action to the motion [s].")
    covariance: Matrix = doc("(5, 5), of frame_rotation (3), gain and delay.")
    explained: Probability = doc("Share of the variance of the part's steps that the actions explain, 0 to 1.")
    commands: Meaning = doc("What the actions were taken for: ways to go, or places to get to.", "displacement")

    def check(self, at: Located) -> None:
        at = at.at("covariance")
        check_size(self.covariance, len(CHANNEL_NAMES), len(CHANNEL_NAMES), at)
        check_covariance(self.covariance, at)


class LearnedEdgeDocument(Document):
    always_written = ("changepoint_counts",)

    parent: Name = doc("Part (or base) that the child's pose is relative to.")
    child: Name = doc("Part that moves.")
    log_evidence: float | None = doc("Log probability of the rows, summed over segmentations [nats].", None)
    changepoint_counts: Annotated[tuple[Probabilities, ...], Listed()] = doc(
        "Per run, the probabilities of 0, 1, 2, ... changepoints.", tuple
    )
    actions: ActionsDocument | None = doc(
        "How the recorded actions moved the part; absent if they explain nothing.", None
    )
    segments: list[LearnedSegmentDocument] = doc("The segments of the recording, in time order.")

    def check(self, at: Located) -> None:
        for k, counts in enumerate(self.changepoint_counts):
            _check_sum(counts, at.at("changepoint_counts", k))
        if self.log_evidence is None and (self.changepoint_counts or self.actions is not None):
            raise at.error("missing key 'log_evidence'", "add it, or leave out changepoint_counts and actions")

    def read(self, at: Located, scope: Scope) -> LearnedEdge:
        values = self.meanings(at, scope)
        certainty = None
        if self.log_evidence is not None:
            certainty = EdgeCertainty(self.log_evidence, self.changepoint_counts, values["actions"])
        return LearnedEdge(self.parent, self.child, values["segments"], certainty)

    @classmethod
    def written(cls, value: LearnedEdge, scope: Scope) -> Mapping[str, Any]:
        sure = value.certainty
        return {**vars(value), **({} if sure is None else {**vars(sure), "actions": sure.channel})}


def learned_remarks(edge: LearnedEdge) -> dict[KeyPath, str]:
    """Comments by key path: 95 % intervals of starts, standard deviations of an action channel."""
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


def _check_sum(probabilities: Sequence[float], located: Located) -> None:
    total = sum(probabilities)
    if abs(total - 1.0) > _SUM_TOLERANCE:
        raise located.error(f"expected probabilities that sum to 1, found {total:.6g}", "correct them")
