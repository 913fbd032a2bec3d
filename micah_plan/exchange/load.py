"""Recordings from any file, by given or adjacent conventions; from tracks of points those of their bodies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from micah_plan.documents.conventions import conventions_beside
from micah_plan.errors import located_in
from micah_plan.recording.checks import checked_recording
from micah_plan.recording.conventions import Conventions, as_recorded
from micah_plan.recording.read import read_columns, read_recording
from micah_plan.recording.value import Recording
from micah_plan.vision.point_files import holds_points, load_points
from micah_plan.vision.track_points import track_points


def load_recording(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """`read_recording` with adjacent conventions; tool poses from logs of joints, body poses from tracks of points.

    Args:
        path: the recording; of ``door.csv`` the conventions are in ``door.conventions.yaml``.
        minimum_rows, conventions: see `read_recording`.

    Raises:
        InputError: if a file cannot be used.
    """
    meant = conventions_beside(path) if conventions is None else conventions
    recording = _loaded(path, minimum_rows, meant)
    return replace(recording, quaternion=None) if meant is not None and meant.positions_only else recording


def _loaded(path: str | Path, minimum_rows: int, meant: Conventions | None) -> Recording:
    if holds_points(path):
        return checked_recording(_of_points(path, meant or Conventions()), minimum_rows=minimum_rows)
    if meant is None or meant.robot is None or meant.tool is None:
        return read_recording(path, minimum_rows=minimum_rows, conventions=meant)
    from micah_plan.robot.joint_log import arm_of, tool_recording
    from micah_plan.robot.joint_ranges import load_joint_ranges

    arm = arm_of(meant.robot, meant.tool)
    ranges = {} if meant.joint_ranges is None else load_joint_ranges(meant.joint_ranges)
    columns, notes = read_columns(path, meant.topics)
    with located_in(path):
        recording = tool_recording(columns, arm, meant, ranges)
        return checked_recording(replace(recording, notes=(*notes, *recording.notes)), minimum_rows=minimum_rows)


def _of_points(path: str | Path, meant: Conventions) -> Recording:
    """Poses of the bodies that points belong to; the command `track` reports more."""
    tracks = load_points(path, unit=meant.length)
    with located_in(path):
        meant.refuse_stated(
            ("columns", "topics", "frame", "robot", "tool", "joint_ranges"), "tracks of points have no such thing"
        )
        found = track_points(tracks, tracks.rate_or(meant.rate))
        return as_recorded(found.recording, replace(meant, length=None, rate=None, time=None))
