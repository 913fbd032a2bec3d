"""The layout of the section `learned` of a model file. What it means is built in `learned_values`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from micah_plan.automaton.joint import JointKind
from micah_plan.documents.fields import Document, Matrix, Name, Vector3

Probability = Annotated[float, Field(ge=0, le=1)]
RowNumber = Annotated[int, Field(ge=0)]
# Not strict about tuple or list (files have lists); the numbers stay strict.
Rows = Annotated[tuple[RowNumber, RowNumber], Field(strict=False)]


class StartDocument(Document):
    rows: Annotated[list[RowNumber], Field(min_length=1)] = Field(
        description="Rows at which the segment may start, in increasing order."
    )
    probabilities: Annotated[list[Probability], Field(min_length=1)] = Field(
        description="Their probabilities, which sum to 1."
    )


class LearnedSegmentDocument(Document):
    kind: JointKind = Field(description="Kind of the joint that governs it.")
    run: int = Field(default=0, description="Run that the rows belong to.")
    rows: Rows = Field(description="First and last row (inclusive), counted within the whole recording.")
    probabilities: dict[JointKind, Probability] | None = Field(
        default=None, description="Probability of every kind of joint; what they leave of 1 is that of free motion."
    )
    start: StartDocument | None = Field(default=None, description="Where it starts; absent for the first of a run.")


class ActionsDocument(Document):
    frame_rotation: Vector3 = Field(
        description="Rotation vector from the frame in which the actions were given to the base frame [rad]."
    )
    gain: float = Field(description="Displacement made per displacement recorded.")
    delay: float = Field(description="Time from the recorded action to the motion [s].")
    covariance: Matrix = Field(description="(5, 5), of frame_rotation (3), gain and delay.")
    explained: float = Field(description="Share of the variance of the part's steps that the actions explain, 0 to 1.")


class LearnedEdgeDocument(Document):
    parent: Name = Field(description="Part (or base) that the child's pose is relative to.")
    child: Name = Field(description="Part that moves.")
    log_evidence: float | None = Field(
        default=None, description="Log probability of the rows, summed over segmentations [nats]."
    )
    changepoint_counts: list[Annotated[list[Probability], Field(min_length=1)]] = Field(
        default_factory=list, description="Per run, the probabilities of 0, 1, 2, ... changepoints."
    )
    actions: ActionsDocument | None = Field(
        default=None, description="How the recorded actions moved the part; absent if they said nothing."
    )
    segments: list[LearnedSegmentDocument] = Field(description="The segments of the recording, in time order.")
