"""Frames of a video, or of a folder of pictures, with the time of each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from micah_plan.errors import InputError
from micah_plan.vision.opencv import opencv

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
STAMPS = "stamps.txt"
"""File in a folder of pictures with the time of each [s], one a line, in the order of their names."""
# Bounds on what is read: a day at 30 Hz, and pictures of 100 megapixels.
_MOST_FRAMES, _MOST_PIXELS = 2_600_000, 100_000_000


def grey_frames(path: str | Path, rate: float | None = None) -> Iterator[tuple[float, Any]]:
    """`frames` in grey."""
    cv2 = opencv()
    for time, picture in frames(path, rate):
        yield time, cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture


def frames(path: str | Path, rate: float | None = None) -> Iterator[tuple[float, Any]]:
    """(time [s], picture in grey or blue, green, red) of every frame, one after the other.

    Args:
        rate: frames per second, in place of the file's own.

    Raises:
        InputError: if it is no video and no folder of pictures, or holds no frame.
    """
    if not Path(path).exists():
        raise InputError("does not exist", source=path, remedy="check the path")
    read = _of_folder(Path(path), rate) if Path(path).is_dir() else _of_video(path, rate)
    is_empty = True
    for k, frame in enumerate(read):
        if k >= _MOST_FRAMES:
            raise InputError(f"expected at most {_MOST_FRAMES} frames", source=path, remedy="cut the video")
        is_empty = False
        yield frame
    if is_empty:
        remedy = "give a video that OpenCV decodes (mp4, avi, mkv, webm), or a folder of pictures"
        raise InputError("expected a video, found no frame", source=path, remedy=remedy)


def _of_video(path: str | Path, rate: float | None) -> Iterator[tuple[float, Any]]:
    cv2 = opencv()
    capture = cv2.VideoCapture(str(path))
    try:
        period = 1.0 / (rate or capture.get(cv2.CAP_PROP_FPS) or 30.0)
        count, last = 0, -np.inf
        while True:
            # The stamp of the frame that is read next; where files have none, frames follow at their rate.
            stamp = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            is_read, picture = capture.read()
            if not is_read:
                return
            time = count * period if rate is not None or not stamp > last else stamp
            last = max(time, last)
            count += 1
            yield time, picture
    finally:
        capture.release()


def _of_folder(folder: Path, rate: float | None) -> Iterator[tuple[float, Any]]:
    cv2 = opencv()
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in _PICTURES)
    stamps = folder / STAMPS
    if rate is not None:
        times = np.arange(len(files)) / rate
    elif stamps.is_file():
        times = _stamps(stamps, len(files))
    elif files:
        raise InputError(
            "when its pictures were taken is not known", source=folder, remedy=f"add {STAMPS} or give --rate"
        )
    for file, time in zip(files, times if files else (), strict=True):
        picture = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if picture is None or picture.size > 3 * _MOST_PIXELS:
            raise InputError("expected a picture", source=file, remedy="leave it out of the folder")
        yield float(time), picture


def _stamps(path: Path, count: int) -> Any:
    """(count,) increasing times of pictures from stamps.txt [s]."""
    lines = path.read_text(encoding="utf-8", errors="replace").split()
    try:
        times = np.array([float(line) for line in lines])
    except ValueError:
        times = np.full(1, np.nan)
    if len(times) != count or not np.isfinite(times).all() or np.any(np.diff(times) <= 0.0):
        problem = f"expected {count} increasing times [s], one for each picture, found {len(lines)} lines"
        raise InputError(problem, source=path, remedy="write one number a line, in the order of the pictures' names")
    return times
