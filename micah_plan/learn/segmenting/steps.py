"""Steps of a track: its rows averaged to a resolution that depends on the motion, not on the sampling rate.

What learning assumes of neighbouring rows (how fast a tracker wanders, how often a part rests, how long a segment is)
it assumes of neighbouring steps. So the same motion sampled 16 times as often gives the same segments, at the same
cost, and white noise is averaged before it is looked at. Changepoints are then found again to the row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import dist

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack, bends, extent, white_std

_BLOCKS, _FEWEST_BLOCKS = 256, 8  # in which the length of the path is measured
WINDOW_SWEEPS = 4.0  # there and back in a window; what moves more often is learned in several
MOST_SWEEPS = 16.0  # for which there are steps, where all rows are learned at once
_FINE_STRIDE = 0.02  # of the extent
_GROWTH = 1.3  # from one lag to the double, from which on it is motion (2 to 4) or wander (1.4)
_LARGEST_NOISE = 0.25  # of the extent
_FIRST_STRETCH, _MOVED = 64, 0.5  # rows; of the extent of the whole run
_CLEAR = 10.0  # times its noise, by which a part that moves is further away at some time


@dataclass(frozen=True, eq=False)
class Steps:
    """A track at the resolution at which it is segmented.

    Attributes:
        track: (m,) steps: means of the poses of a few rows; actions command the way from a step to the next one.
        first: (m + 1,) first row of every step in the track of all rows, and the number of rows.
        size: mean number of rows of a step.
        sweeps: how often the part moves there and back.
    """

    track: PartTrack
    first: Ints
    size: float
    sweeps: float

    def assumed(self, settings: LearnSettings) -> LearnSettings:
        """What is assumed of the rows, of the steps."""
        return replace(settings.of_steps(self.size), sweeps=max(self.sweeps, 1.0))


def steps_of(track: PartTrack, inlier: Booleans, settings: LearnSettings) -> Steps:
    """Average rows to about `settings.resolution` steps per there and back of the part.

    Args:
        inlier: (n,) rows that count; a step without any is part of the one before.
        settings: with the number of sweeps, if they are not to be counted here.
    """
    used = np.flatnonzero(inlier)
    sweeps = sweeps_of(track.take(used)) if settings.sweeps is None else settings.sweeps
    wanted = min(round(settings.resolution * float(np.clip(sweeps, 1.0, MOST_SWEEPS))), len(used))
    begins = np.unique(np.linspace(0, len(used), wanted, endpoint=False).astype(np.int64))
    first = np.append(used[begins], len(track))
    first[0] = 0
    return Steps(averaged(track, inlier, first), first, len(track) / len(begins), sweeps)


def averaged(track: PartTrack, inlier: Booleans, first: Ints) -> PartTrack:
    """Means of the rows that count from `first[i]` to before `first[i + 1]`; there is one in each of them.

    Actions are summed: each step's commands the way from its mean to the next one's.
    """
    used = np.flatnonzero(inlier[first[0] : first[-1]]) + first[0]
    begins = np.searchsorted(used, first[:-1])
    counts = np.diff(np.append(begins, len(used)))[:, None]

    def mean(values: Floats) -> Floats:
        return np.asarray(np.add.reduceat(values, begins, axis=0) / counts)

    quaternion = None if track.quaternion is None else mean(track.quaternion[used])
    if quaternion is not None:
        quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    action = None
    if track.action is not None:
        # Where all actions so far would have brought the part.
        reached = np.concatenate([np.zeros((1, 3)), np.cumsum(track.action, axis=0)[:-1]])
        action = np.concatenate([np.diff(mean(reached[used]), axis=0), np.zeros((1, 3))])
    middle = used[begins + (counts[:, 0] - 1) // 2]
    time = mean(track.time[used][:, None])[:, 0]
    return PartTrack(track.rows[middle], time, mean(track.position[used]), quaternion, action)


def sweeps_of(track: PartTrack) -> float:
    """Path over that of once there and back, of position or rotation, whichever is clearer.

    The most of all rows and of the stretches in which the part clearly moves: among rows of a rest, many motions would
    pass for noise.
    """
    _, sweeps, values = _clearest(track)
    whole, size = extent(values), _FIRST_STRETCH
    while size < len(values):
        for begin in range(0, len(values) - size // 2, size // 2):
            stretch = values[begin : begin + size]
            if extent(stretch) >= _MOVED * whole:
                clarity, there_and_back = _clarity_and_sweeps(stretch)
                sweeps = max(sweeps, there_and_back) if clarity >= _CLEAR else sweeps
        size *= 2
    return sweeps


def is_long(track: PartTrack, inlier: Booleans) -> bool:
    """Whether a part moves to and fro more than `WINDOW_SWEEPS` times."""
    return sweeps_of(track.take(np.flatnonzero(inlier))) > WINDOW_SWEEPS


def _clearest(track: PartTrack) -> tuple[float, float, Floats]:
    """Extent over noise, path over there and back, and rows, of position or rotation, whichever is clearer."""
    channels = [track.position]
    if track.quaternion is not None:
        channels.append(2 * track.quaternion)
    return max(((*_clarity_and_sweeps(values), values) for values in channels), key=lambda channel: channel[0])


def _clarity_and_sweeps(values: Floats) -> tuple[float, float]:
    """Extent over noise, and path over there and back, of rows (n, k)."""
    # Noise of a finer time scale than the finest steps does not matter, and looks different at every sampling rate.
    values = _block_means(values, len(values) / _BLOCKS)
    if len(values) < 4:
        return 0.0, 1.0
    whole = extent(values)
    lag, level = _noise(values, whole)
    # Noise makes a path longer than the motion: average until it is small, and go in strides that are long against it.
    fine = _FINE_STRIDE * max(whole, 1e-12)
    means = _block_means(values, min(lag * (level / fine) ** 2, len(values) / _FEWEST_BLOCKS))
    points = means.tolist()
    anchor, path = points[0], 0.0
    for point in points[1:]:
        length = dist(point, anchor)
        if length > 3 * fine:
            path, anchor = path + length, point
    return whole / max(level, 1e-12), 0.5 * path / max(extent(means), 1e-12)


def _noise(values: Floats, whole: float) -> tuple[int, float]:
    """After how many rows (n, k) their noise forgets, and its std.

    How far rows are from the middle of those `lag` before and after grows with the lag where that is motion, and where
    rows were interpolated between noisy ones; it stays where it is noise that the rows between have forgotten.
    """
    stds: list[float] = []
    lags = [2**i for i in range(16) if 4 * 2**i <= len(values)]
    for lag in lags:
        stds.append(float(np.sqrt(3) * white_std(bends(values, lag))))
        if len(stds) > 1 and stds[-1] < _GROWTH * stds[-2] and stds[-2] < _LARGEST_NOISE * whole:
            return lags[len(stds) - 2], stds[-2]
    return 1, stds[0]


def _block_means(values: Floats, size: float) -> Floats:
    """Means of neighbouring rows (n, k), about `size` of them at a time."""
    count = max(round(len(values) / max(size, 1.0)), 1)
    begins = np.unique(np.linspace(0, len(values), count, endpoint=False).astype(np.int64))
    sums = np.add.reduceat(values, begins, axis=0)
    return np.asarray(sums / np.diff(np.append(begins, len(values)))[:, None])
