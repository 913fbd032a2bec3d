"""Shared errors: errors of all rows of a recording, which averaging does not reduce.

All rows share the error of the frame that they are given in, and of the scale of their lengths: a fixed camera sees its
base the same in all frames, and a wrong focal length or tag size stretches everything. Neighbours share the error of
their pose: the effect of lens and sharpness on a tag changes slowly along its path. A fit of rows cannot detect either,
so they are given as columns, filled in the first row of each part and run: ``frame_covariance`` and ``pose_covariance``
(upper triangle of a 6 x 6 matrix, row by row) and ``scale_std``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, shown
from micah_plan.recording.value import Recording

FRAME_COLUMN, POSE_COLUMN, SCALE_COLUMN = "frame_covariance", "pose_covariance", "scale_std"
_UPPER = np.triu_indices(6)


@dataclass(frozen=True, eq=False)
class SharedError:
    """Uncertainty of a part's poses beyond the noise of single rows.

    Attributes:
        frame: (6, 6) covariance of the frame's position [m] and of a small turn of it [rad], along its own axes.
        pose: (6, 6) covariance of the shared error of neighbouring poses: position [m], rotation [rad], along these
            axes.
        scale: std of the factor that all lengths are wrong by.
    """

    frame: Floats
    pose: Floats
    scale: float = 0.0


def with_shared_errors(recording: Recording, errors: Mapping[str, SharedError]) -> Recording:
    """The recording with the columns of shared errors."""
    columns: dict[str, list[str]] = {FRAME_COLUMN: [], POSE_COLUMN: [], SCALE_COLUMN: []}
    seen = set[tuple[int, str]]()
    for run, part in zip(recording.run.tolist(), recording.part, strict=True):
        is_first = (run, part) not in seen and part in errors
        seen.add((run, part))
        texts = _texts(errors[part]) if is_first else ("", "", "")
        for column, text in zip(columns.values(), texts, strict=True):
            column.append(text)
    return replace(recording, extra={**recording.extra, **{name: tuple(column) for name, column in columns.items()}})


def _texts(error: SharedError) -> tuple[str, str, str]:
    frame, pose = (" ".join(f"{value:.4g}" for value in matrix[_UPPER]) for matrix in (error.frame, error.pose))
    return frame, pose, f"{error.scale:.4g}"


def shared_error_of(recording: Recording, part: str) -> SharedError | None:
    """The shared error of a part's rows, averaged over independent runs; None if not stated.

    Raises:
        InputError: if a column has other content.
    """
    if not {FRAME_COLUMN, POSE_COLUMN, SCALE_COLUMN} & recording.extra.keys():
        return None
    own = recording.select(part=part)
    scales = _distinct(own, SCALE_COLUMN, 1)
    scale = float(np.sqrt(np.mean(scales**2) / len(scales))) if len(scales) else 0.0
    return SharedError(_covariance(own, FRAME_COLUMN), _covariance(own, POSE_COLUMN), scale)


def _covariance(recording: Recording, column: str) -> Floats:
    """(6, 6) covariance of a column's mean over its entries; zeros without any."""
    rows, matrix = _distinct(recording, column, len(_UPPER[0])), np.zeros((6, 6))
    if len(rows):
        matrix[_UPPER] = rows.mean(axis=0) / len(rows)
    values, vectors = np.linalg.eigh(matrix + np.triu(matrix, 1).T)  # rounded numbers may be a little less than one
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _distinct(recording: Recording, column: str, count: int) -> Floats:
    """(k, count) distinct values of a column."""
    texts: Sequence[str] = tuple(dict.fromkeys(text.strip() for text in recording.extra.get(column, ())))
    rows = []
    for text in texts:
        if not text:
            continue
        try:
            numbers = [float(word) for word in text.split()]
        except ValueError:
            numbers = []
        if len(numbers) != count or not np.isfinite(numbers).all():
            expected = "21 numbers: the upper triangle of a 6 x 6 covariance" if count > 1 else "a std"
            raise InputError(
                f"expected {expected}, found {shown(text)}", where=f"column '{column}'", remedy="remove the column"
            )
        rows.append(numbers)
    return np.array(rows).reshape(-1, count)
