"""Optional import of OpenCV."""

from __future__ import annotations

from typing import Any

from micah_plan.errors import MissingDependencyError


def opencv() -> Any:
    """The module, limited to one thread for reproducible results.

    Raises:
        MissingDependencyError: if it is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise MissingDependencyError.of("vision", "videos are read with OpenCV") from None
    cv2.setNumThreads(1)
    return cv2
