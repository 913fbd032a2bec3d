"""Rows of one part relative to another, from which their edge is learned.

Source: MICAH, section IV-A: Δ_ij = x_i ⊖ x_j is all that matters for the edge between i and j.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Slerp

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.certainty import EdgeCertainty, SegmentCertainty
from micah_plan.automaton.graph import BASE, KinematicEdge, Segment
from micah_plan.errors import InputError, shown
from micah_plan.learning.settings import FEWEST_ROWS
from micah_plan.recording.value import Recording

_LONGEST_GAP = 4.0  # median intervals; across a longer one linear interpolation of the parent is meaningless


@dataclass(frozen=True, eq=False)
class RelativeRows:
    """A part in the frame of its parent (k rows).

    Attributes:
        parent: name of the part whose frame it is, or the base.
        recording: rows of the child alone; poses, actions and forces in the parent's frame.
        rows: (k,) their indices within the whole recording.
        frames: (k,) poses of the parent in the base frame at the times of the rows.
    """

    parent: str
    recording: Recording
    rows: Ints
    frames: RigidTransform

    def __len__(self) -> int:
        return len(self.rows)


def relative_rows(
    recording: Recording, parent: str, child: str, poses: RigidTransform | None = None
) -> RelativeRows | None:
    """The rows of `child` relative to `parent`, at the child's own times.

    Parts have rows of their own, whose times may differ and of which some may be missing. The parent's pose is
    interpolated to the child's times (positions linearly, orientations along the shortest rotation) and never
    extrapolated: rows of the child before the first and after the last of the parent, or within a long gap of it, are
    left out, and so are runs in which fewer than FEWEST_ROWS remain.

    Args:
        parent: another part, or the base, to which the recorded poses are relative already.
        poses: (n,) poses to use for the parent's rows instead of the measured ones; indexed as the whole recording.

    Returns:
        None if no run has enough common rows.

    Raises:
        InputError: a name that is not of a part, or orientation was not measured, so that no part has a frame.
    """
    for name in (parent, child):
        if name not in recording.parts and not (name == BASE == parent):
            raise InputError(f"unknown part {shown(name)}", remedy=f"choose one of {', '.join(recording.parts)}")
    own = _rows_of(recording, child)
    if parent == BASE:
        return RelativeRows(BASE, recording.rows(own), own, RigidTransform.identity(len(own)))
    if recording.quaternion is None:
        raise InputError(
            f"part {shown(child)} cannot be seen from {shown(parent)}, whose orientation was not measured",
            where="columns qx, qy, qz, qw",
            remedy="record the orientation of every part that others may be attached to",
        )
    measured = recording.poses() if poses is None else poses
    parent_rows = _rows_of(recording, parent)
    pieces = []
    for run in recording.runs:
        mine, theirs = own[recording.run[own] == run], parent_rows[recording.run[parent_rows] == run]
        mine = mine[_covered(recording.time[mine], recording.time[theirs])]
        if len(mine) >= FEWEST_ROWS:
            frames = _interpolated(recording.time[theirs], measured[theirs], recording.time[mine])
            pieces.append((_seen_from(frames, recording.rows(mine)), mine, frames))
    if not pieces:
        return None
    rows = np.concatenate([mine for _, mine, _ in pieces])
    frames = RigidTransform.concatenate([frames for _, _, frames in pieces])
    return RelativeRows(parent, _joined([part for part, _, _ in pieces]), rows, frames)


def relative_to(recording: Recording, base: str) -> Recording:
    """The parts of an object relative to its tracked moving base, such as a door on a cart.

    Args:
        base: the part that the poses are given in afterwards; its rows are left out.

    Returns:
        the rows of the other parts, in their order, while the base was tracked; poses, actions and forces in its frame.

    Raises:
        InputError: no such part, no other part, no measured orientation, or a part that was never tracked together with
            it.
    """
    children = [name for name in recording.parts if name != base]
    if not children:
        problem = f"the only part {shown(base)} is the base, so there is nothing to learn"
        raise InputError(problem, where="column 'part'", remedy="record the parts that move on it too")
    relative: list[RelativeRows] = []
    for child in children:
        rows = relative_rows(recording, base, child)
        if rows is None:
            raise InputError(
                f"parts {shown(base)} and {shown(child)} have no run with {FEWEST_ROWS} rows in common",
                where="column 'part'",
                remedy=f"record both at the same times, or leave the rows of {shown(child)} out",
            )
        relative.append(rows)
    order = np.argsort(np.concatenate([piece.rows for piece in relative]), kind="stable")
    return _joined([piece.recording for piece in relative]).rows(order)


def in_whole_recording(edge: KinematicEdge, relative: RelativeRows, child: str) -> KinematicEdge:
    """An edge learned from relative rows, renumbered for the whole recording with its parent named."""
    rows = relative.rows.tolist()
    return KinematicEdge(
        relative.parent,
        child,
        tuple(_segment_in(segment, rows) for segment in edge.segments),
        _edge_certainty_in(edge.certainty, rows),
    )


def displacements_within(frames: RigidTransform, position: Floats, action: Floats) -> Floats:
    """Commanded displacements of points relative to a frame that moves too.

    The command of the point relative to the frame is not the action alone: the frame carries the point along. So the
    point's place in this row's frame is subtracted from its commanded place in the next row's frame (MICAH, section
    IV-A: the intended displacement of the relative transform). A knob that moves along with its door has no command
    relative to the door.

    Args:
        frames: (n,) poses of the frame in the base frame, in the rows' order in time.
        position: (n, 3) the points, base frame [m].
        action: (n, 3) commanded displacements from each row to the next, base frame [m]; NaN where there is none.

    Returns:
        (n, 3) displacements in the frame [m]; NaN where there was no action and in the last row, which has no next.
    """
    relative = np.full((len(position), 3), np.nan)
    if len(position) > 1:
        asked = position[:-1] + action[:-1]
        relative[:-1] = frames[1:].inv().apply(asked) - frames[:-1].inv().apply(position[:-1].copy())
    return relative


def _rows_of(recording: Recording, part: str) -> Ints:
    """(k,) rows of a part."""
    return np.flatnonzero(np.array([name == part for name in recording.part], dtype=bool))


def _covered(time: Floats, others: Floats) -> NDArray[np.bool_]:
    """Times that lie between two close times of others, or on one."""
    if len(others) < 2:
        return np.zeros(len(time), dtype=bool)
    intervals = np.diff(others)
    after = np.clip(np.searchsorted(others, time), 1, len(others) - 1)
    short = intervals[after - 1] <= _LONGEST_GAP * np.median(intervals)
    return np.asarray((time >= others[0]) & (time <= others[-1]) & (short | np.isin(time, others)))


def _interpolated(time: Floats, poses: RigidTransform, at: Floats) -> RigidTransform:
    position = np.stack([np.interp(at, time, axis) for axis in poses.translation.T], axis=1)
    return RigidTransform.from_components(position, Slerp(time, poses.rotation)(at))


def _seen_from(frames: RigidTransform, child: Recording) -> Recording:
    """Rows of one part in one run, in the frames of another at the same times."""
    relative_poses = frames.inv() * child.poses()
    turned = frames.rotation.inv()
    return replace(
        child,
        position=relative_poses.translation,
        quaternion=relative_poses.rotation.as_quat(),
        action=None if child.action is None else displacements_within(frames, child.position, child.action),
        force=None if child.force is None else turned.apply(child.force.copy()),
    )


def _joined(pieces: Sequence[Recording]) -> Recording:
    """The rows of several recordings with the same columns, one after the other."""
    first = pieces[0]

    def column(name: str) -> Any:
        arrays = [getattr(piece, name) for piece in pieces]
        return None if arrays[0] is None else np.concatenate(arrays)

    names = ("time", "position", "quaternion", "action", "force", "run")
    return replace(
        first,
        **{name: column(name) for name in names},
        part=tuple(name for piece in pieces for name in piece.part),
        extra={name: tuple(value for piece in pieces for value in piece.extra[name]) for name in first.extra},
    )


def _segment_in(segment: Segment, rows: list[int]) -> Segment:
    certainty = segment.certainty
    return replace(
        segment,
        start=rows[segment.start],
        end=rows[segment.end],
        certainty=None if certainty is None else _certainty_in(certainty, rows),
    )


def _certainty_in(certainty: SegmentCertainty, rows: list[int]) -> SegmentCertainty:
    if certainty.start is None:
        return certainty
    return replace(certainty, start=replace(certainty.start, rows=tuple(rows[row] for row in certainty.start.rows)))


def _edge_certainty_in(certainty: EdgeCertainty | None, rows: list[int]) -> EdgeCertainty | None:
    if certainty is None or certainty.trace is None:
        return certainty
    return replace(certainty, trace=replace(certainty.trace, rows=tuple(rows[row] for row in certainty.trace.rows)))
