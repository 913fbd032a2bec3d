"""Annotated frames of a video: outlines of tags, frames of parts, and 3-D strokes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.vision.opencv import opencv
from micah_plan.vision.tag_poses import Pose
from micah_plan.vision.track_tags import Footage
from micah_plan.vision.video import frames

# Bounds on a page: pictures, their longer side [px], and JPEG quality. Some 20 kB each.
_MOST_PICTURES, _LONGEST_SIDE, _QUALITY = 150, 640, 70
_NEAREST = 0.02  # m before the camera; what is nearer is not drawn
_SUBPIXEL = 4  # bits of OpenCV's drawing functions
_AXIS = 0.9  # length of a drawn axis, in sizes of the part's tag

Color = tuple[int, int, int]
"""Red, green, blue, from 0 to 255."""


@dataclass(frozen=True, eq=False)
class Stroke:
    """A line through points in the frame of the base (n, 3) [m], shown from one time to another [s]."""

    points: Floats
    color: Color
    start: float = -np.inf
    end: float = np.inf
    width: int = 2


@dataclass(frozen=True)
class Picture:
    """A video frame as JPEG, with its time in the recording [s]."""

    time: float
    jpeg: bytes


def drawn_pictures(
    footage: Footage,
    color_of: Callable[[str, float], Color],
    strokes: Sequence[Stroke] = (),
    axes: Sequence[Color] = (),
) -> tuple[Picture, ...]:
    """Frames of the video that was tracked, evenly thinned.

    Args:
        footage: of the camera; its video is read once more.
        color_of: colour of a part's tags at a time [s].
        strokes: drawn into the frames in which the base is seen.
        axes: colours of x, y and z; none: frames of parts are not drawn.
    """
    cv2 = opencv()
    wanted = set(np.unique(np.linspace(0, len(footage.times) - 1, _MOST_PICTURES).astype(int)).tolist())
    pictures = []
    for k, (_, picture) in enumerate(frames(footage.video, footage.rate)):
        if k not in wanted:
            continue
        time = float(footage.times[k])
        scale = min(1.0, _LONGEST_SIDE / max(picture.shape[:2]))
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        own = _Canvas(small if small.ndim == 3 else cv2.cvtColor(small, cv2.COLOR_GRAY2BGR), footage, k, scale)
        for stroke in strokes:
            if stroke.start <= time <= stroke.end:
                own.stroke(stroke)
        own.tags(color_of, time)
        own.axes(axes)
        is_written, code = cv2.imencode(".jpg", own.picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        if is_written:
            pictures.append(Picture(time, code.tobytes()))
    return tuple(pictures)


class _Canvas:
    """One frame that is drawn on."""

    def __init__(self, picture: object, footage: Footage, number: int, scale: float) -> None:
        self.picture = picture
        self._footage, self._number, self._scale = footage, number, scale

    def tags(self, color_of: Callable[[str, float], Color], time: float) -> None:
        for number, corners in self._footage.corners[self._number].items():
            self._line(np.vstack([corners, corners[:1]]), color_of(self._footage.layout.tags[number].part, time), 2)

    def axes(self, colors: Sequence[Color]) -> None:
        for part, poses in self._footage.poses.items():
            pose = poses[self._number]
            if pose is None:
                continue
            length = _AXIS * next(iter(self._footage.layout.of(part).values())).size
            for k, color in enumerate(colors):
                ends = np.stack([pose.position, pose.position + length * pose.turn[:, k]])
                self._draw_in_camera(ends, color, 2)

    def stroke(self, stroke: Stroke) -> None:
        base: Pose | None = self._footage.base_poses[self._number]
        if base is not None:
            self._draw_in_camera(stroke.points @ base.turn.T + base.position, stroke.color, stroke.width)

    def _draw_in_camera(self, points: Floats, color: Color, width: int) -> None:
        """Draw a line through points (k, 3) of the camera frame [m] that lie before the camera."""
        cv2, camera = opencv(), self._footage.camera
        for stretch in _runs(points[:, 2] > _NEAREST):
            if len(own := points[stretch]) > 1:
                seen = cv2.projectPoints(own, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0]
                self._line(seen[:, 0], color, width)

    def _line(self, pixels: Floats, color: Color, width: int) -> None:
        cv2 = opencv()
        moved = (np.asarray(pixels) + 0.5) * self._scale - 0.5
        if np.abs(moved).max() > 1e5:
            return
        whole = np.round(moved * 2**_SUBPIXEL).astype(np.int32)
        for tint, own in (((255, 255, 255), width + 2), (color, width)):  # a light rim, to be seen on anything
            cv2.polylines(self.picture, [whole], False, tint[::-1], own, cv2.LINE_AA, _SUBPIXEL)


def _runs(is_in: Iterable[bool]) -> list[slice]:
    """The stretches in which a condition holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.asarray(list(is_in)), [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
