"""Segments as pages and figures show them: their colour, their name, their rows and poses.

One colour stands for one joint: a segment that returns to an earlier joint of its part gets its colour again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import Joint, radius
from micah_plan.recording.value import Recording
from micah_plan.view.palette import MISFIT, category

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

UNITS = {"rigid": "", "prismatic": "m", "revolute": "rad", "screw": "rad"}
NO_JOINT = "no single joint"

_SAME_DIRECTION = np.cos(np.radians(20.0))
_SAME_SHARE = 0.2
_SAME_PLACE_M = 0.01


@dataclass(frozen=True)
class ColoredSegment:
    """A segment with the colour that pages and figures give it, its name (the joint's kind), and its legend entry."""

    segment: Segment
    edge: KinematicEdge
    color: str
    name: str
    label: str


def colored_segments(graph: KinematicGraph | None) -> tuple[ColoredSegment, ...]:
    """All segments of a graph in order, each with the colour of its joint; what fits no joint has its own colour."""
    edges = () if graph is None else graph.edges
    found: list[ColoredSegment] = []
    joints = 0
    for edge in edges:
        earlier: list[tuple[Joint, str]] = []
        visited = [c for s in edge.segments for c in s.configuration_range]
        for segment in edge.segments:
            name: str = segment.joint.kind
            color = MISFIT
            if is_misfit(segment):
                name = NO_JOINT
            else:
                same = [shade for joint, shade in earlier if _same_joint(joint, segment.joint, float(np.ptp(visited)))]
                color = same[0] if same else category(joints)
                if not same:
                    earlier.append((segment.joint, color))
                    joints += 1
            label = f"{name}, rows {segment.start} to {segment.end}"
            label = f"{edge.child}: {label}" if len(edges) > 1 else label
            found.append(ColoredSegment(segment, edge, color, name, label))
    return tuple(found)


def is_misfit(segment: Segment) -> bool:
    """Whether no single joint explains the segment."""
    return segment.certainty is not None and segment.certainty.misfit is not None


def rows_of(recording: Recording, colored: ColoredSegment) -> Ints:
    """Rows of the recording that belong to a segment: of its part and run, from its start to its end."""
    of_run = rows_of_run(recording, colored.edge, colored.segment.run)
    return of_run[(of_run >= colored.segment.start) & (of_run <= colored.segment.end)]


def rows_of_run(recording: Recording, edge: KinematicEdge, run: int) -> Ints:
    """Rows of the recording in which the edge's part was measured in a run, in order."""
    of_run = recording.run == run
    if edge.child in recording.parts:
        of_run = of_run & (np.array(recording.part) == edge.child)
    return np.flatnonzero(of_run)


def parent_pose(recording: Recording, colored: ColoredSegment) -> RigidTransform:
    """Measured pose (single) of a joint's parent at the segment's first row; identity for the base."""
    segment = colored.segment
    return parent_poses(recording, colored.edge, segment.run, np.array([segment.start]))[0]


def parent_poses(recording: Recording, edge: KinematicEdge, run: int, rows: Ints) -> RigidTransform:
    """(k,) poses of the edge's parent in the base frame, measured closest in time to the rows (k,) of a run."""
    of_parent = np.flatnonzero((np.array(recording.part) == edge.parent) & (recording.run == run))
    if edge.parent == BASE or not len(of_parent):
        return RigidTransform.identity(len(rows))
    times, wanted = recording.time[of_parent], recording.time[rows]
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1)) % len(times)
    before = np.maximum(after - 1, 0)
    nearest = np.where(wanted - times[before] <= times[after] - wanted, before, after)
    return recording.poses()[of_parent[nearest]]


def _same_joint(a: Joint, b: Joint, span: float) -> bool:
    """Whether two joints of one part look like one; `span` is the range of its configurations [rad or m]."""
    if a.kind != b.kind:
        return False
    apart = np.subtract(b.position, a.position)
    if a.kind == "rigid":
        by_pose = float(np.linalg.norm(apart)) <= _SAME_PLACE_M
        return abs(a.held - b.held) <= _SAME_SHARE * span if span > 0 else by_pose
    if abs(float(np.dot(a.axis, b.axis))) < _SAME_DIRECTION:
        return False
    between = np.subtract(b.center, a.center)
    aside = np.linalg.norm(between - np.dot(between, a.axis) * np.array(a.axis))
    return a.kind == "prismatic" or float(aside) <= _SAME_SHARE * max(radius(a), radius(b)) + _SAME_PLACE_M
