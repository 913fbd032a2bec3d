"""The extended kinematic graph: edges between parts, each with the segments of joints that govern it.

Source: MICAH, section IV-A, the set of tuples (τ^(k-1), τ^k, M^k, θ^k) per edge and its configurational changepoints.
"""

from __future__ import annotations

from dataclasses import dataclass

from micah_plan.automaton.certainty import EdgeCertainty, NoSingleJoint, SegmentCertainty
from micah_plan.automaton.joint import Joint

BASE = "base"


@dataclass(frozen=True)
class Segment:
    """A stretch of rows governed by one joint.

    Attributes:
        joint: the fitted joint. The joints of one edge share one continuous configuration coordinate: their origins
            are chosen so that configurations agree at the changepoints, and it is 0 at the edge's first row and grows
            in the direction in which the object moved.
        run: run that the rows belong to.
        start, end: first and last row (inclusive), counted within the whole recording.
        configuration_start, configuration_end: configuration at these rows [rad or m].
        configuration_range: (smallest, largest) configuration within the segment.
        process_std: std of the configuration's step that the model leaves unexplained [rad or m, per step].
        observation_std: std of one pose measurement expressed as configuration [rad or m].
        log_evidence: of the chosen model for these rows [nats].
        probability: posterior probability of the joint kind among the candidates for these rows.
        certainty: how sure its start and its kind are; None if not estimated.
    """

    joint: Joint
    run: int
    start: int
    end: int
    configuration_start: float
    configuration_end: float
    configuration_range: tuple[float, float]
    process_std: float
    observation_std: float
    log_evidence: float
    probability: float
    certainty: SegmentCertainty | None = None

    @property
    def no_single_joint(self) -> NoSingleJoint | None:
        """Why no single joint explains the rows; None if one does."""
        return None if self.certainty is None else self.certainty.no_single_joint


@dataclass(frozen=True)
class KinematicEdge:
    """How one part moves relative to another: its segments in time order, with their certainty."""

    parent: str
    child: str
    segments: tuple[Segment, ...]
    certainty: EdgeCertainty | None = None

    @property
    def changepoints(self) -> tuple[int, ...]:
        """First row of every segment but the first."""
        return tuple(segment.start for segment in self.segments[1:])


@dataclass(frozen=True)
class KinematicGraph:
    """A tree of parts.

    Attributes:
        edges: ordered parents first.
        probability: of this tree among all trees of the same parts; None of one part, or if not estimated.
    """

    edges: tuple[KinematicEdge, ...]
    probability: float | None = None
