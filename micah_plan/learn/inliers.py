"""Isolated outliers of a track, found before anything is fitted: a tracker that jumps and comes back (Hampel)."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Booleans, Floats
from micah_plan.learn.track import PartTrack

_STDS = 7.0  # medians of the distance to neighbours, from which a row is an outlier
_FLOORS = (0.03, 0.3)  # m, rad; no row so close to its neighbours is an outlier
_NEIGHBOURS = 7  # rows, around each


def find_inliers(track: PartTrack) -> Booleans:
    """(n,) rows that are not far from the middle one of their neighbours, measured in such distances (Hampel)."""
    distances = [np.linalg.norm(track.position - _middle_ones(track.position), axis=1)]
    if track.quaternion is not None:
        apart = Rotation.from_quat(track.quaternion) * Rotation.from_quat(_middle_ones(track.quaternion)).inv()
        distances.append(np.asarray(apart.magnitude()))
    outlying = np.zeros(len(track), dtype=bool)
    for distance, floor in zip(distances, _FLOORS, strict=False):
        outlying |= distance > max(_STDS * float(np.median(distance)), floor)
    return ~outlying if outlying.mean() < 0.4 else np.ones(len(track), dtype=bool)


def _middle_ones(values: Floats) -> Floats:
    """Of every row (n, k) the one among its neighbours that is closest to all of them: a median in no axes."""
    half = _NEIGHBOURS // 2
    # Mirrored at the ends: repeated, the first row would be the median of its own neighbourhood.
    near = sliding_window_view(np.pad(values, ((half, half), (0, 0)), mode="reflect"), _NEIGHBOURS, axis=0)
    apart = np.sqrt(((near[..., :, None] - near[..., None, :]) ** 2).sum(axis=1)).sum(axis=2)
    return np.asarray(near[np.arange(len(values)), :, apart.argmin(axis=1)])
