"""What a model keeps of how sure learning was: the segments that it was made of, their posteriors, the action channel.

Joints keep their own covariances (`joint.ParameterCovariance`), transitions the spread of their thresholds
(`hybrid.Edge.threshold_std`); here is the rest, for people and for programs that compare models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from micah_plan.automaton.certainty import EdgeCertainty, RowPosterior, SegmentCertainty
from micah_plan.automaton.graph import KinematicEdge, KinematicGraph
from micah_plan.automaton.joint import JointKind

# Digits of a stored probability: less says nothing, more only makes files long.
_DIGITS = 6


@dataclass(frozen=True)
class LearnedSegment:
    """A stretch of rows that a model was learned from.

    Attributes:
        kind: of the joint that governs it.
        run: run that the rows belong to.
        start, end: first and last row (inclusive), counted within the whole recording.
        certainty: how sure its start and its kind are; None if that was not asked.
    """

    kind: JointKind
    run: int
    start: int
    end: int
    certainty: SegmentCertainty | None = None


@dataclass(frozen=True)
class LearnedEdge:
    """What a recording said about how one part moves relative to another.

    Attributes:
        segments: in time order.
        certainty: of the edge as a whole, without the trace; None if that was not asked.
    """

    parent: str
    child: str
    segments: tuple[LearnedSegment, ...]
    certainty: EdgeCertainty | None = None


def learned_edges(graph: KinematicGraph) -> tuple[LearnedEdge, ...]:
    """The edges of a graph that say how sure they are, with probabilities rounded to 6 decimals."""
    return tuple(_learned(edge) for edge in graph.edges if _is_told(edge))


def _is_told(edge: KinematicEdge) -> bool:
    return edge.certainty is not None or any(segment.certainty is not None for segment in edge.segments)


def _learned(edge: KinematicEdge) -> LearnedEdge:
    segments = tuple(LearnedSegment(s.joint.kind, s.run, s.start, s.end, _rounded(s.certainty)) for s in edge.segments)
    certainty = edge.certainty
    if certainty is not None:
        counts = tuple(tuple(map(_probability, run)) for run in certainty.changepoint_counts)
        certainty = replace(certainty, changepoint_counts=counts, trace=None)
    return LearnedEdge(edge.parent, edge.child, segments, certainty)


def _rounded(certainty: SegmentCertainty | None) -> SegmentCertainty | None:
    if certainty is None:
        return None
    start = certainty.start
    if start is not None:
        pairs = [(row, _probability(p)) for row, p in zip(start.rows, start.probabilities, strict=True)]
        pairs = [pair for pair in pairs if pair[1] > 0]
        start = RowPosterior(tuple(row for row, _ in pairs), tuple(p for _, p in pairs))
    return replace(certainty, start=start, kinds=tuple((kind, _probability(p)) for kind, p in certainty.kinds))


def _probability(value: float) -> float:
    """Rounded, and without what arithmetic left outside of 0 to 1."""
    return min(1.0, max(0.0, round(float(value), _DIGITS)))
