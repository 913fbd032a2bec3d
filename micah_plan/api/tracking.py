"""`track`: from a video with printed tags, or from tracks of points, to a recording."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from micah_plan.api.inputs import Measured, located, recording_of
from micah_plan.api.result import RecordedResult
from micah_plan.arrays import Floats
from micah_plan.automaton.graph import KinematicGraph
from micah_plan.documents.tags import load_tags
from micah_plan.errors import located_in
from micah_plan.quantities import plain, quantity
from micah_plan.recording.beside import ClockOffset, with_commands_beside
from micah_plan.recording.conventions import LENGTHS
from micah_plan.recording.messages import clock_offset
from micah_plan.recording.tag_layout import TagLayout
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress, Table
from micah_plan.vision.camera import Camera, load_camera
from micah_plan.vision.point_files import Axes, PointTracks, check_unit, load_points
from micah_plan.vision.track_points import TrackedPoints, track_points
from micah_plan.vision.track_tags import Tracked, track_tags


@dataclass(frozen=True, eq=False, repr=False)
class _Tracking(RecordedResult):
    """Poses that a camera shows, with the track as figure and page.

    Attributes:
        tracked: the result.
    """

    tracked: Tracked | TrackedPoints

    @property
    def recording(self) -> Recording:
        """The poses, one row for each part and frame; give it to `learn`."""
        return self.tracked.recording

    @property
    def success(self) -> bool:
        return True

    @property
    def outcome(self) -> str:
        return "tracked"

    @property
    def reason(self) -> str:
        return ""

    @property
    def warnings(self) -> tuple[str, ...]:
        return self.tracked.notes

    def _learned(self) -> KinematicGraph | None:
        """The joints that the poses show; None where they are too few."""
        from micah_plan.learning.learn import learn_graph
        from micah_plan.learning.settings import FEWEST_ROWS

        is_enough = all(len(self.recording.select(part=part)) >= FEWEST_ROWS for part in self.recording.parts)
        return learn_graph(self.recording) if is_enough else None


@dataclass(frozen=True, eq=False, repr=False)
class TrackResult(_Tracking):
    """Poses of parts that a video shows.

    Attributes:
        clock: how the robot's clock stands to the video's; None without commands.
    """

    tracked: Tracked
    clock: ClockOffset | None = None

    @property
    def title(self) -> str:
        return "Tracked parts"

    def page(self, title: str = "") -> str:
        """Frames of the video with detected tags, beside the tracks and learned joints.

        Raises:
            InputError: if the video is no longer there.
        """
        from micah_plan.view.tracked_page import tracked_page

        return tracked_page(self.tracked, self._learned(), title=title or self.title)

    def report(self) -> list[str | Table]:
        found = self.tracked
        camera = "the camera stood still" if found.is_fixed else "the camera moved"
        rows = tuple(
            (part, f"{found.rows_of(part)} of {found.frames}", quantity(place, "m"), quantity(turn, "rad"))
            for part, (place, turn) in found.stds.items()
        )
        return [
            f"{found.frames} frames, {camera}, corners of tags known to {plain(found.noise, 2)} px",
            Table((f"part beside {self.tracked.base}", "frames", "position ±", "turn ±"), rows, numeric=(1, 2, 3)),
        ]

    def json(self) -> dict[str, Any]:
        found = self.tracked
        parts = {
            part: {"frames": found.rows_of(part), "position_std": place, "turn_std": turn}
            for part, (place, turn) in found.stds.items()
        }
        return {
            "outcome": self.outcome,
            "base": self.tracked.base,
            "frames": found.frames,
            "camera_is_fixed": found.is_fixed,
            "corner_std_px": found.noise,
            "focal_length_px": float(found.camera.matrix[0, 0]),
            "focal_length_std_px": float(found.camera.matrix[0, 0] * found.camera.uncertainty),
            "parts": parts,
            "clock_offset": None if self.clock is None else asdict(self.clock),
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True, eq=False, repr=False)
class PointsResult(_Tracking):
    """Bodies that tracked points are on."""

    tracked: TrackedPoints

    @property
    def title(self) -> str:
        return "Tracked bodies"

    def page(self, title: str = "") -> str:
        """The points in the colours of their bodies, moving with them, beside the learned joints."""
        from micah_plan.view.recording_page import recording_page

        graph, points = self._learned(), self.tracked.places()
        return recording_page(self.recording, graph, title=title or self.title, points=points)

    def report(self) -> list[str | Table]:
        found, rows = self.tracked, []
        for name, body in zip(found.names, found.bodies, strict=True):
            spread = found.stds.get(name)
            precise = ("", "") if spread is None else (quantity(spread[0], "m"), quantity(spread[1], "rad"))
            rows.append((name, str(len(body.points)), f"{int(body.is_seen.sum())} of {found.frames}", *precise))
        columns = ("body", "points", "frames", "position ±", "turn ±")
        noise = f"{len(found.body)} points, known to {quantity(found.noise, 'm', digits=2)}"
        return [noise, Table(columns, tuple(rows), numeric=(1, 2, 3, 4))]

    def json(self) -> dict[str, Any]:
        found = self.tracked
        bodies = {
            name: {
                "points": body.points.tolist(),
                "frames": int(body.is_seen.sum()),
                "position_std": found.stds[name][0] if name in found.stds else None,
                "turn_std": found.stds[name][1] if name in found.stds else None,
            }
            for name, body in zip(found.names, found.bodies, strict=True)
        }
        return {
            "outcome": self.outcome,
            "frames": found.frames,
            "noise": found.noise,
            "bodies": bodies,
            "warnings": list(self.warnings),
        }


def track_bodies(
    tracks: str | Path | Floats,
    *,
    rate: float | None = None,
    axes: Axes | None = None,
    units: str | None = None,
    camera: str | Path | Camera | None = None,
) -> PointsResult:
    """The bodies that tracked points are on, and their poses as a recording.

    Args:
        tracks: NPZ, TRC, C3D or table of markers, or array (points, frames, 3), NaN where a point is not seen.
        rate: frames per second; None: from the file.
        axes: order of the first two axes of a file's array; None: the one along which points move less is of frames.
        units: of lengths; None: from the file, else m.
        camera: of tracks in pixels with depths, where the file does not hold its intrinsics.

    Raises:
        InputError: if the file cannot be used, or no body moves.
        MissingDependencyError: for C3D without ezc3d.
    """
    unit = None if units is None else check_unit(units)
    if isinstance(tracks, np.ndarray):
        found = PointTracks(np.asarray(tracks, dtype=np.float64) * LENGTHS[unit or "m"])
        return PointsResult(track_points(found, found.rate_or(rate)))
    lens = load_camera(camera) if isinstance(camera, str | Path) else camera
    found = load_points(tracks, axes=axes, unit=unit, camera=lens)
    with located_in(tracks):
        return PointsResult(track_points(found, found.rate_or(rate)))


def track(
    video: str | Path,
    tags: str | Path | TagLayout,
    *,
    camera: str | Path | Camera | None = None,
    base: str | None = None,
    rate: float | None = None,
    actions: Measured | None = None,
    offset: float | None = None,
    progress: Progress | None = None,
) -> TrackResult:
    """The poses of parts with printed tags in a video, as a recording.

    Args:
        video: file that OpenCV decodes, or folder of pictures with ``stamps.txt``.
        tags: which tags are on which part, a file (YAML) or value.
        camera: file or value; None: its focal length is found from the tags.
        base: part in whose frame poses are; default: the one called base, else the first.
        rate: frames per second, in place of the video's own.
        actions: a recording of the commands to a robot at that time, in any frame.
        offset: time of the actions minus time of the video [s]; None: found from the motion.

    Raises:
        InputError: if a file cannot be used, no part is seen together with the base, or none moves as commanded.
        MissingDependencyError: without OpenCV (extra ``vision``).
    """
    layout = tags if isinstance(tags, TagLayout) else load_tags(tags)
    lens = camera if isinstance(camera, Camera) or camera is None else load_camera(camera)
    commands = None if actions is None else recording_of(actions)
    found = track_tags(video, layout, lens, base=base, rate=rate, progress=progress)
    if commands is None:
        return TrackResult(found)
    with located(actions):
        recording, clock = with_commands_beside(found.recording, commands, offset)
    notes = (*found.notes, clock_offset(clock.part, clock.seconds, clock.std, clock.correlation))
    return TrackResult(replace(found, recording=replace(recording, notes=notes), notes=notes), clock)
