"""Corners of printed tags in a picture, to a twentieth of a pixel.

A detector finds the tags; then each edge is a line through the middle of its gradient, and corners are where two meet
(as AprilTag 3 refines its quads: Wang and Olson, "AprilTag 2: Efficient and robust fiducial detection", IROS 2016).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.recording.tag_layout import Family
from micah_plan.vision.opencv import opencv

Corners = dict[int, Floats]
"""(4, 2) corners [px] by number of the tag: from its top left on, clockwise as printed."""

_DICTIONARIES: dict[Family, str] = {
    "tag36h11": "DICT_APRILTAG_36h11",
    "tag25h9": "DICT_APRILTAG_25h9",
    "tag16h5": "DICT_APRILTAG_16h5",
    "aruco_4x4": "DICT_4X4_100",
    "aruco_5x5": "DICT_5X5_100",
    "aruco_6x6": "DICT_6X6_100",
    "aruco_original": "DICT_ARUCO_ORIGINAL",
}
# Places along an edge, without its ends, and the step across it [px].
_ALONG, _END, _ACROSS = 24, 0.12, 0.25
# A refined corner is never so far from the detected one [px].
_FARTHEST = 3.0


def dictionary(family: Family) -> Any:
    """OpenCV's markers of a family."""
    cv2 = opencv()
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARIES[family]))


def detector(family: Family) -> Callable[[Any], Corners]:
    """What finds the tags of a family in a grey picture (height, width) of bytes."""
    cv2 = opencv()
    finder = cv2.aruco.ArucoDetector(dictionary(family), cv2.aruco.DetectorParameters())

    def found(grey: Any) -> Corners:
        corners, numbers, _ = finder.detectMarkers(grey)
        if numbers is None:
            return {}
        pairs = zip(np.ravel(numbers).tolist(), corners, strict=True)
        return {int(number): _refined(grey, np.asarray(quad[0], dtype=float)) for number, quad in pairs}

    return found


def _refined(grey: Any, corners: Floats) -> Floats:
    cv2 = opencv()
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(edges, axis=1)
    reach = max(2.0, 0.45 * float(lengths.min()) / 8.0)  # less than half a cell
    across = np.arange(-reach, reach + 0.01, _ACROSS)
    share = np.linspace(_END, 1.0 - _END, _ALONG)
    along = edges / lengths[:, None]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    on_edge = corners[:, None] + share[None, :, None] * edges[:, None]  # (4, n, 2)
    at = on_edge[:, :, None] + across[None, None, :, None] * normal[:, None, None]
    flat = at.astype(np.float32).reshape(4 * _ALONG, len(across), 2)
    values = cv2.remap(grey, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR).astype(float).reshape(4, _ALONG, -1)
    steep = (values[:, :, 2:] - values[:, :, :-2]) ** 2
    offset = (steep * across[1:-1]).sum(axis=2) / np.maximum(steep.sum(axis=2), 1e-9)
    points = on_edge + offset[:, :, None] * normal[:, None]
    middles, normals = zip(*(_line(own) for own in points), strict=True)
    refined = np.zeros((4, 2))
    for k in range(4):
        both = np.array([normals[k - 1], normals[k]])
        if abs(np.linalg.det(both)) < 1e-3:
            return corners
        refined[k] = np.linalg.solve(both, [normals[k - 1] @ middles[k - 1], normals[k] @ middles[k]])
    return refined if np.abs(refined - corners).max() < _FARTHEST else corners


def _line(points: Floats) -> tuple[Floats, Floats]:
    """A point on, and the normal of, the line through points (n, 2), far ones counting less."""
    weight = np.ones(len(points))
    for _ in range(3):
        middle = weight @ points / weight.sum()
        normal = np.linalg.svd((points - middle) * np.sqrt(weight)[:, None])[2][1]
        away = (points - middle) @ normal
        weight = 1.0 / (1.0 + (away / max(0.1, 1.5 * float(np.median(np.abs(away))))) ** 2)
    return middle, normal
