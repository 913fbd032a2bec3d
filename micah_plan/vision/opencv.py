"""OpenCV, if it is installed."""

from __future__ import annotations

from typing import Any

from micah_plan.errors import MissingDependencyError


def opencv() -> Any:
    """The module, with one thread: a recording is the same on every machine.

    Raises:
        MissingDependencyError: if it is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise MissingDependencyError.of("vision", "videos are read with OpenCV") from None
    cv2.setNumThreads(1)
    return cv2
