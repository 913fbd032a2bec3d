"""Free motion: what explains rows that no single joint does (two degrees of freedom, a path that deforms).

Every channel goes on as it went on average over the last steps; rotations may also stay where they were on average (a
part may slide freely without turning; one that does not slide either is at rest, which is no free motion). Errors have
one scale for positions and one for rotations. A joint foretells all but one of six channels to within noise, so it wins
wherever there is one.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.learn.joints.quaternions import conjugate, rotation_vector, times
from micah_plan.learn.segmenting.noise import NoiseModel, log_peak
from micah_plan.learn.spread import extent
from micah_plan.learn.track import PartTrack

_LOOKING_BACK = (1, 2, 3, 5)  # steps over which the velocity is averaged
_STAYING = (3, 8)  # steps over which what stays is averaged
_DOF = 8.0
_FINEST_EXTENT = 1e-3


def free_log_probability(track: PartTrack, noise: NoiseModel, trust: float) -> float:
    """ln probability of a track of free motion, to compare with that of its segments.

    Args:
        noise: as the roughness of the rows tells it; free motion is not told more exactly than that.
        trust: power of the likelihood.
    """
    path = _path(track)
    n, d = path.shape
    finest = np.sqrt(noise.left[0, -1])
    ways = [_expected(path, back) for back in _LOOKING_BACK] + [_average(path, back) for back in _STAYING]
    missed = path[1:] - np.array(ways)
    scale = np.sqrt((missed.reshape(len(ways), n - 1, d // 3, 3) ** 2).mean(axis=(1, 3)))
    scales = np.maximum(np.repeat(scale, 3, axis=1), finest)
    squares = ((missed / scales[:, None]) ** 2).reshape(len(ways), n - 1, d // 3, 3).sum(axis=3)
    sizes = np.log(scales).reshape(len(ways), d // 3, 3).sum(axis=2)
    best = -np.inf
    moving, turning = range(len(_LOOKING_BACK)), range(len(ways))
    for way in product(*[turning] * (d // 3 - 1), moving):
        chosen = sum(squares[one, :, group] for group, one in enumerate(way))
        size = sum(sizes[one, group] for group, one in enumerate(way))
        density = log_peak(d, _DOF) - 0.5 * (_DOF + d) * np.log1p(chosen / (_DOF + d)) - size
        best = max(best, float(density.sum()))
    # Where the first row is, is uniform over a cube as large as the path.
    reached = [max(extent(path[:, group : group + 3]), _FINEST_EXTENT) for group in range(0, d, 3)]
    first = 3 * float(np.log(reached).sum())
    # One scale per group is fitted, and its way of going on is chosen.
    fitted = 0.5 * (d // 3) * np.log(3.0 * n) + (d // 3) * np.log(len(ways))
    return trust * (best - first) - float(fitted)


def _path(track: PartTrack) -> Floats:
    """(n, d) rotation so far, as a sum of small rotation vectors [rad], and position [m]."""
    if track.quaternion is None:
        return track.position
    turns = rotation_vector(times(track.quaternion[1:], conjugate(track.quaternion[:-1])))
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
    return np.concatenate([turned, track.position], axis=1)


def _expected(path: Floats, back: int) -> Floats:
    """(n - 1, d) where rows after the first are expected, from the mean velocity over up to `back` steps before."""
    ends = np.arange(len(path) - 1)
    begins = np.maximum(ends - back, 0)
    taken = np.maximum(ends - begins, 1)[:, None]
    return np.asarray(path[ends] + (path[ends] - path[begins]) / taken)


def _average(path: Floats, back: int) -> Floats:
    """(n - 1, d) the mean of up to `back` rows before each row after the first."""
    sums = np.concatenate([np.zeros((1, path.shape[1])), np.cumsum(path, axis=0)])
    ends = np.arange(1, len(path))
    begins = np.maximum(ends - back, 0)
    return np.asarray((sums[ends] - sums[begins]) / (ends - begins)[:, None])
