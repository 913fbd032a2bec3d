"""Printed tags in images: detection by OpenCV, refined by `alignment`."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.recording.tag_layout import Family
from micah_plan.vision.alignment import aligned_corners, pattern_of
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


def dictionary(family: Family) -> Any:
    """OpenCV's markers of a family."""
    cv2 = opencv()
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARIES[family]))


def detector(family: Family) -> Callable[[Any], Corners]:
    """A detector of a family's tags in a grey image (height, width) of bytes."""
    cv2 = opencv()
    markers = dictionary(family)
    finder = cv2.aruco.ArucoDetector(markers, cv2.aruco.DetectorParameters())
    pattern = lru_cache(maxsize=None)(partial(pattern_of, markers))

    def found(grey: Any) -> Corners:
        corners, numbers, _ = finder.detectMarkers(grey)
        if numbers is None:
            return {}
        pairs = zip(np.ravel(numbers).tolist(), corners, strict=True)
        quads = {
            int(number): aligned_corners(grey, np.asarray(quad[0], dtype=float), pattern(number))
            for number, quad in pairs
        }
        return {number: quad for number, quad in quads.items() if quad is not None}

    return found
