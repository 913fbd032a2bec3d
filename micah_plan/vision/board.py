"""The intrinsics of a camera from a video of a ChArUco board.

Source: Zhang, "A flexible new technique for camera calibration", PAMI 2000; Garrido-Jurado et al., Pattern Recognition
2014 (markers on a chessboard, so that a part of it suffices).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from micah_plan.errors import InputError, shown
from micah_plan.quantities import count
from micah_plan.recording.conventions import LENGTHS
from micah_plan.vision.camera import Camera
from micah_plan.vision.corners import dictionary
from micah_plan.vision.opencv import opencv
from micah_plan.vision.video import grey_frames

_BOARD = re.compile(r"(\d+)x(\d+),([\d.]+)(mm|cm|m),([\d.]+)(mm|cm|m)")
# Corners that a view needs, views that are used, and the fewest.
_CORNERS, _VIEWS, _FEWEST = 8, 40, 5


@dataclass(frozen=True)
class Board:
    """A ChArUco board: squares along and across, edges of squares and of markers [m]; markers are of aruco_5x5."""

    along: int
    across: int
    square: float
    marker: float


def board_of(text: str) -> Board:
    """The board of a description such as ``9x6,30mm,22mm``: squares, edge of a square, edge of a marker.

    Raises:
        InputError: if it defines none.
    """
    found = _BOARD.fullmatch(text.replace(" ", ""))
    if found is not None:
        along, across, square, unit, marker, other = found.groups()
        try:
            sizes = float(square) * LENGTHS[unit], float(marker) * LENGTHS[other]
        except ValueError:
            sizes = (0.0, 0.0)
        if 3 <= int(along) <= 50 and 3 <= int(across) <= 50 and 0.0 < sizes[1] < sizes[0]:
            return Board(int(along), int(across), *sizes)
    problem = f"expected squares along x across, the edge of a square and that of a marker, found {shown(text)}"
    raise InputError(problem, source="--board", remedy="e.g. --board 9x6,30mm,22mm")


def camera_of_board(video: str | Path, board: Board) -> tuple[Camera, float, int]:
    """(camera, root mean square residual of corners [px], number of views).

    Raises:
        InputError: if too few frames show enough of the board.
    """
    cv2 = opencv()
    markers = dictionary("aruco_5x5")
    charuco = cv2.aruco.CharucoBoard((board.along, board.across), board.square, board.marker, markers)
    find, views, size, frames = cv2.aruco.CharucoDetector(charuco), [], (0, 0), 0
    for _, grey in grey_frames(video, 30.0):
        size, frames = (int(grey.shape[1]), int(grey.shape[0])), frames + 1
        corners, numbers, _, _ = find.detectBoard(grey)
        if numbers is not None and len(numbers) >= _CORNERS:
            points, pixels = charuco.matchImagePoints(corners, numbers)
            views.append((points, pixels))
    if len(views) < _FEWEST:
        problem = f"the board is seen in {len(views)} of {count(frames, 'frame')}, {_FEWEST} are needed"
        remedy = "check --board, and film it from many sides, over the whole picture, without blur"
        raise InputError(problem, source=video, remedy=remedy)
    used = [views[k] for k in np.unique(np.linspace(0, len(views) - 1, _VIEWS).astype(int))]
    points, pixels = zip(*used, strict=True)
    rms, matrix, distortion, _, _, stds, _, _ = cv2.calibrateCameraExtended(points, pixels, size, None, None)
    share = float(np.max(stds[:2, 0]) / matrix[0, 0])
    return Camera(np.asarray(matrix), np.ravel(distortion)[:5], size, share), float(rms), len(used)


def camera_text(camera: Camera) -> str:
    """A camera as ROS writes it (camera_info, YAML)."""
    width, height = camera.size or (0, 0)
    matrix = ", ".join(f"{value:.9g}" for value in camera.matrix.ravel())
    distortion = ", ".join(f"{value:.9g}" for value in camera.distortion)
    return (
        f"image_width: {width}\nimage_height: {height}\ncamera_name: camera\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{matrix}]\n"
        f"distortion_model: plumb_bob\n"
        f"distortion_coefficients:\n  rows: 1\n  cols: {len(camera.distortion)}\n  data: [{distortion}]\n"
    )
