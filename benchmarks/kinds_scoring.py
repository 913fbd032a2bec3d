"""What is right in a learned graph of a simulated recording, and how sure it said that it is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from fit_coverage import errors
from kinds_of_one_part import EdgeTruth, Simulated
from true_channel import QUANTILE, misses

from micah_plan.automaton.graph import KinematicEdge, KinematicGraph, Segment

BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995, 1.0)
SURE = 0.95
FAMILIES = ("axis", "center", "radius", "pitch", "gain", "turn", "delay")


@dataclass(frozen=True)
class Judged:
    """One recording's answer against its truth.

    Attributes:
        answer: what was learned, in words.
        kinds: whether the kinds in their order are right, and of several parts the tree.
        changepoints: whether also every changepoint is within its tolerance.
        tree: whether every part has its true parent.
        sure: probability stated for the kinds: of all segments, the lowest.
        count: probability stated for the number of changepoints in the answer; None if not stated.
        counted: whether that number is right.
        starts: per changepoint, whether its 95 % interval holds the truth; those of answers with right kinds.
        covered: the same of parameters, by family.
    """

    answer: str
    kinds: bool
    changepoints: bool
    tree: bool
    sure: float
    count: float | None
    counted: bool
    starts: tuple[bool, ...]
    covered: tuple[tuple[str, bool], ...]


def judged(graph: KinematicGraph, truth: Simulated) -> Judged:
    """Compare what was learned with what is true; a graph without edges is a crash."""
    if not graph.edges:
        return Judged("crashed", False, False, False, 0.0, None, False, (), ())
    edges = {edge.child: edge for edge in graph.edges}
    tree = all(edges[name].parent == one.parent for name, one in truth.edges.items())
    right = {name: kinds_of(edges[name].segments, one.rests) in one.answers for name, one in truth.edges.items()}
    kinds = tree and all(right.values())
    starts: list[bool] = []
    covered: list[tuple[str, bool]] = []
    near = True
    for name, one in truth.edges.items():
        edge = edges[name]
        if edge.parent == one.parent and kinds_of(edge.segments, one.rests) == one.answers[0]:
            near = near and all(_missed(edge, one))
            starts += _starts(edge, one)
            covered += _parameters(edge, one)
    counts = [_count(edge) for edge in graph.edges]
    only = next(iter(truth.edges.values()))
    return Judged(
        answer="; ".join(described(edge, len(graph.edges) > 1) for edge in graph.edges),
        kinds=kinds,
        changepoints=kinds and near,
        tree=tree,
        sure=min(probability(segment) for edge in graph.edges for segment in edge.segments),
        count=counts[0] if len(counts) == 1 else None,
        counted=len(graph.edges[0].segments) in ({len(a) for a in only.answers if a != ("none",)} or {1}),
        starts=tuple(starts),
        covered=tuple(covered),
    )


def kind_of(segment: Segment) -> str:
    """As `learn` prints it."""
    return "none" if segment.no_single_joint is not None else segment.joint.kind


def kinds_of(segments: Sequence[Segment], rests: bool) -> tuple[str, ...]:
    """Kinds in their order; without rests if these do not count, unless the part only rests."""
    kinds = tuple(kind_of(segment) for segment in segments)
    moving = tuple(kind for kind in kinds if kind != "rigid")
    return kinds if rests or not moving else moving


def probability(segment: Segment) -> float:
    """Of the kind of a segment, as `learn` states it."""
    if segment.certainty is None:
        return segment.probability
    kinds = dict(segment.certainty.kinds)
    return 1.0 - sum(kinds.values()) if segment.no_single_joint is not None else kinds.get(segment.joint.kind, 0.0)


def described(edge: KinematicEdge, with_names: bool) -> str:
    """An edge in a few words: kinds, where they begin, how sure."""
    said = ", ".join(f"{kind_of(one)} {one.start} ({probability(one):.3f})" for one in edge.segments)
    return f"{edge.parent}>{edge.child} {said}" if with_names else said


def _missed(edge: KinematicEdge, truth: EdgeTruth) -> Iterator[bool]:
    """Per changepoint, whether it is within its tolerance: a segment begins at the shared row or the one after."""
    for segment, row, tolerance in zip(edge.segments[1:], truth.changepoints, truth.tolerance, strict=False):
        yield max(row - segment.start, segment.start - row - 1, 0) <= tolerance


def _starts(edge: KinematicEdge, truth: EdgeTruth) -> Iterator[bool]:
    for segment, row in zip(edge.segments[1:], truth.changepoints, strict=False):
        if segment.certainty is not None and segment.certainty.start is not None:
            low, high = segment.certainty.start.interval()
            yield low <= row + 1 and high >= row


def _parameters(edge: KinematicEdge, truth: EdgeTruth) -> Iterator[tuple[str, bool]]:
    """Per parameter, its family and whether its interval holds the truth."""
    moving = [segment for segment in edge.segments if kind_of(segment) != "rigid"]
    joints = [joint for joint in truth.joints if joint is not None]
    done = set()
    for segment, joint in zip(moving, joints, strict=False):
        # A joint that a part returns to is one estimate.
        if segment.joint.covariance is None or segment.joint.axis in done:
            continue
        done.add(segment.joint.axis)
        for name, error, std in zip(*errors(joint, segment.joint), strict=True):
            if (family := name.partition("_")[0]) in FAMILIES:
                yield family, bool(abs(error) < QUANTILE * std)
    channel = None if edge.certainty is None else edge.certainty.channel
    if channel is not None and truth.channel is not None:
        held = misses(truth.channel, channel)
        yield from (("gain", bool(held["gain"])), ("turn", bool(held["all"])), ("delay", bool(held["delay"])))


def _count(edge: KinematicEdge) -> float | None:
    """Probability stated for the number of changepoints that the answer has; None where it says that no joint fits."""
    if edge.certainty is None or not edge.certainty.changepoint_counts or edge.segments[0].no_single_joint is not None:
        return None
    counts = edge.certainty.changepoint_counts[0]
    return counts[len(edge.segments) - 1] if len(edge.segments) <= len(counts) else 0.0


def reliability(question: str, said: Iterable[tuple[float, bool]]) -> Iterator[str]:
    """Lines of a table: of what was said with about a probability, how much was wrong."""
    stated, right = (np.array(column, dtype=float) for column in zip(*said, strict=True))
    sure = stated >= SURE
    yield f"\n{question}: said with {SURE:.0%} or more: wrong {int((1 - right[sure]).sum())} of {int(sure.sum())}"
    yield f"{'said':>15} {'mean':>7} {'right':>7} {'wrong':>7} {'of':>6}"
    for low, high in pairwise(BINS):
        inside = (stated >= low) & ((stated < high) | (high == 1.0))
        if inside.any():
            yield (
                f"{low:6.3f} to {high:5.3f} {stated[inside].mean():7.3f} {right[inside].mean():7.3f} "
                f"{int((1 - right[inside]).sum()):7} {int(inside.sum()):6}"
            )
    yield f"Brier score {np.mean((stated - right) ** 2):.4f}"
