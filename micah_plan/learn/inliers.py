"""Isolated outliers of a track, found before anything is fitted: a tracker that jumps and comes back (Hampel)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_STDS = 7.0
_FLOORS = (0.03, 0.3)  # m, rad; no row so close to its neighbours is an outlier
_NEIGHBOURS = 7


def find_inliers(track: PartTrack) -> Bools:
    """(n,) rows that are not far from the running median of their neighbours, measured in such distances (Hampel)."""
    distances = [np.linalg.norm(track.position - _running_median(track.position), axis=1)]
    if track.quaternion is not None:
        middle = _running_median(track.quaternion)
        lengths = np.linalg.norm(middle, axis=1)
        middle = np.where(lengths[:, None] > 0.1, middle, track.quaternion)
        apart = Rotation.from_quat(track.quaternion) * Rotation.from_quat(middle).inv()
        distances.append(np.asarray(apart.magnitude()))
    outlying = np.zeros(len(track), dtype=bool)
    for distance, floor in zip(distances, _FLOORS, strict=False):
        outlying |= distance > max(_STDS * float(np.median(distance)), floor)
    return ~outlying if outlying.mean() < 0.4 else np.ones(len(track), dtype=bool)


def _running_median(values: Floats) -> Floats:
    # Mirrored at the ends: repeated, the first row would be the median of its own neighbourhood.
    return np.asarray(median_filter(values, size=(_NEIGHBOURS, 1), mode="mirror"))
