"""Posteriors over changepoints and models, the action channel, and where no joint fits.

Joints have their own covariances (`joint.ParameterCovariance`), transitions the std of their thresholds
(`hybrid.Edge.threshold_std`); here is the rest, and the part of it that a model keeps (`LearnedEdge`).

Sources: Fearnhead and Liu, JRSS B 2007 (posterior over changepoints); MICAH, section IV-A (actions).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from micah_plan.automaton import messages
from micah_plan.automaton.joint import JointKind, Vector3
from micah_plan.message import Message
from micah_plan.recording.commands import Meaning

LOW_PROBABILITY = 0.6  # less sure answers are worth a warning where they are used
CHANNEL_NAMES = ("frame_rotation_1", "frame_rotation_2", "frame_rotation_3", "gain", "delay")


@dataclass(frozen=True)
class RowPosterior:
    """Posterior over the row at which a segment starts, given how many segments there are.

    Attributes:
        rows: (k,) rows of the recording, increasing; all that matter.
        probabilities: (k,) theirs; they sum to 1.
    """

    rows: tuple[int, ...]
    probabilities: tuple[float, ...]

    def interval(self, probability: float = 0.95) -> tuple[int, int]:
        """The narrowest range of rows (both inclusive) that holds at least this probability."""
        total, best, first = 0.0, (self.rows[0], self.rows[-1]), 0
        for last, row in enumerate(self.rows):
            total += self.probabilities[last]
            while total - self.probabilities[first] >= probability:
                total -= self.probabilities[first]
                first += 1
            if total >= probability and row - self.rows[first] < best[1] - best[0]:
                best = (self.rows[first], row)
        return best


@dataclass(frozen=True)
class NoSingleJoint:
    """Errors of the best single joint on rows that none explains.

    Attributes:
        position, rotation: root mean square distance of the rows from the joint [m, rad]; None if not measured.
        position_noise, rotation_noise: errors from the measurement alone [m, rad].
        log_odds: of free motion against the best joint [nats].
    """

    position: float
    rotation: float | None
    position_noise: float
    rotation_noise: float | None
    log_odds: float


@dataclass(frozen=True)
class Deviation:
    """Distance of a part from its joint: smooth, and repeatable at the same configuration.

    Attributes:
        position, rotation: typical size in one direction [m, rad]; rotation is 0 where it was not measured.
        probability: that it exceeds the usual deviation of real joints and trackers.
    """

    position: float
    rotation: float
    probability: float


@dataclass(frozen=True)
class ActionChannel:
    """Map from a recorded action a to its command: gain · R(frame_rotation) a, `delay` later.

    For actions that lead to places, a is the displacement from one commanded place to the next.

    Attributes:
        frame_rotation: rotation vector from the frame in which the actions were given to the base frame [rad].
        gain: displacement made per displacement recorded.
        delay: time from the recorded action to the motion [s]; negative if the motion comes first.
        covariance: (5, 5) of CHANNEL_NAMES, in the units above; a rotation's is that of a small rotation of the base
            frame after it. What the recording does not determine (a rotation about the joint's direction of motion)
            keeps its prior spread.
        explained: share of the variance of the part's steps that the actions explain, 0 to 1.
        commands: the assumed meaning of the actions.
    """

    frame_rotation: Vector3
    gain: float
    delay: float
    covariance: tuple[tuple[float, ...], ...]
    explained: float
    commands: Meaning = "displacement"


@dataclass(frozen=True)
class EvidenceTrace:
    """Evidence over time, for display.

    Attributes:
        rows: (n,) rows of the recording.
        models: names of the m models (``"revolute"``, ``"rigid"``, ``"rigid_2"``, ``"free"``).
        log_density: (n, m) of each row under each model, given the rows before [nats].
        changepoint: (n,) posterior probability that a segment starts at the row.
    """

    rows: tuple[int, ...]
    models: tuple[str, ...]
    log_density: tuple[tuple[float, ...], ...]
    changepoint: tuple[float, ...]


@dataclass(frozen=True)
class EdgeCertainty:
    """Certainty of an edge beyond its most probable segments.

    Attributes:
        log_evidence: ln probability of the edge's rows, summed over segmentations of all runs [nats].
        changepoint_counts: per run, probabilities of 0, 1, 2, ... changepoints; each sums to 1.
        channel: how the recorded actions move the part; None if there are none, or they do not explain it.
        trace: evidence over time; not saved with a model.
    """

    log_evidence: float
    changepoint_counts: tuple[tuple[float, ...], ...]
    channel: ActionChannel | None = None
    trace: EvidenceTrace | None = None


@dataclass(frozen=True)
class SegmentCertainty:
    """Certainty of one segment.

    Attributes:
        start: where it starts; None for the first of a run.
        kinds: probability of every kind of joint for the segment's rows; they sum to 1 minus that of no single joint:
            free motion, or a mechanism of more than one axis.
        no_single_joint: why no single joint explains the rows; None if the segment's joint does.
        deviation: of the segment's joint; None where it does not move, or the rows are too few. Not saved with a model.
    """

    start: RowPosterior | None
    kinds: tuple[tuple[JointKind, float], ...]
    no_single_joint: NoSingleJoint | None = None
    deviation: Deviation | None = None


@dataclass(frozen=True)
class LearnedSegment:
    """A stretch of rows that a model was learned from.

    Attributes:
        kind: of the joint that governs it.
        run: run that the rows belong to.
        start, end: first and last row (inclusive), counted within the whole recording.
        certainty: how sure its start and its kind are; None if not estimated.
    """

    kind: JointKind
    run: int
    start: int
    end: int
    certainty: SegmentCertainty | None = None


@dataclass(frozen=True)
class LearnedEdge:
    """The learned segments of how one part moves relative to another.

    Attributes:
        segments: in time order.
        certainty: of the edge as a whole, without the trace; None if not estimated.
    """

    parent: str
    child: str
    segments: tuple[LearnedSegment, ...]
    certainty: EdgeCertainty | None = None


def low_probability_warnings(learned: Iterable[LearnedEdge]) -> tuple[str, ...]:
    """One line for each learned answer below the probability `LOW_PROBABILITY` that a model depends on."""
    return tuple(line for edge in learned for line in (*_improbable_kinds(edge), *_improbable_counts(edge)))


def _improbable_kinds(edge: LearnedEdge) -> list[Message]:
    lines = []
    for segment in edge.segments:
        kinds = {} if segment.certainty is None else dict(segment.certainty.kinds)
        probability = kinds.pop(segment.kind, 1.0)
        if probability < LOW_PROBABILITY and kinds:
            likeliest = max(kinds, key=lambda kind: kinds[kind])
            rows, other = (segment.start, segment.end), (likeliest, kinds[likeliest])
            parts = edge.child, edge.parent
            lines.append(messages.kind_uncertain(parts, segment.kind, rows, probability, other))
    return lines


def _improbable_counts(edge: LearnedEdge) -> list[Message]:
    lines = []
    counted = () if edge.certainty is None else edge.certainty.changepoint_counts
    runs = dict.fromkeys(segment.run for segment in edge.segments)
    for run, counts in zip(runs, counted, strict=False):
        changes = sum(segment.run == run for segment in edge.segments) - 1
        probability = counts[changes] if changes < len(counts) else 0.0
        if probability < LOW_PROBABILITY:
            likelier = max(enumerate(counts), key=lambda pair: pair[1])
            parts = edge.child, edge.parent
            lines.append(messages.change_count_uncertain(parts, run, changes, probability, likelier))
    return lines
