"""Steps: rows averaged to a resolution set by the motion, independent of the sampling rate.

Assumptions about neighbouring rows (how fast a tracker wanders, how often a part rests, how long a segment is) are made
about neighbouring steps. So the same motion sampled 16 times as often gives the same segments, at the same cost, and
white noise is averaged first. A rest counts at most as long as the motion from end to end: however early the tracker
was switched on, a motion has its steps. Changepoints are then refined to the row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import dist

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.learning.roughness import bends, extent, std_of_bends
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack

_BLOCKS, _FEWEST_BLOCKS = 2048, 8  # in which the length of the path is measured
WINDOW_SWEEPS = 4.0  # there and back in a window; what moves more often is learned in several
MOST_SWEEPS = 16.0  # for which there are steps, where all rows are learned at once
_FINE_STRIDE = 0.02  # of the extent
_GROWTH = 1.3  # from one lag to the double, from which on it is motion (2 to 4) or wander (1.4)
_LARGEST_NOISE = 0.25  # of the extent
_CLEAR = 10.0  # times its noise, by which a part that moves is further away at some time
_STRIDE = 3  # times the fine stride, which noise does not make
_PUSH = 0.1  # of the root mean square action
_WITH_REST = 1.25  # times the rows of motion, with rests, for which `resolution` steps are enough
_QUICK = 0.25  # of the strides are quicker than what a moving part is expected to make
_REST = 4  # times as long as such a stride is rest, or so slow that it needs no more steps


@dataclass(frozen=True, eq=False)
class Steps:
    """A track at the resolution at which it is segmented.

    Attributes:
        track: (m,) steps: means of the poses of a few rows; actions command the displacement from a step to the next
            one.
        counted: (n,) rows that steps are means of.
        first: (m + 1,) first row of every step in the track of all rows, and the number of rows.
        size: mean number of rows that a step is the mean of.
        sweeps: how often the part moves there and back.
    """

    track: PartTrack
    counted: Booleans
    first: Ints
    size: float
    sweeps: float

    def assumed(self, settings: LearnSettings) -> LearnSettings:
        """The settings converted from rows to steps."""
        return replace(settings.of_steps(self.size), sweeps=max(self.sweeps, 1.0))

    def of(self, track: PartTrack) -> Steps:
        """The rows of a track with other actions averaged in the same way."""
        return replace(self, track=averaged(track, self.counted, self.first))


def steps_of(track: PartTrack, inlier: Booleans, settings: LearnSettings) -> Steps:
    """Average rows to about `settings.resolution` steps per there and back of the part.

    Args:
        inlier: (n,) rows that count; a step without any is part of the one before.
        settings: with the number of sweeps, if they are not to be counted here.
    """
    used, sweeps, motions = np.flatnonzero(inlier), settings.sweeps, settings.sweeps
    if sweeps is None or motions is None:
        activity = activity_of(track, used)
        used, sweeps, motions = activity.rows, activity.sweeps, activity.motions_in(len(activity.rows))
    wanted = min(round(settings.resolution * float(np.clip(motions, 1.0, MOST_SWEEPS))), len(used))
    begins = np.unique(np.linspace(0, len(used), wanted, endpoint=False).astype(np.int64))
    first = np.append(used[begins], len(track))
    first[0] = 0
    counted = np.zeros(len(track), dtype=bool)
    counted[used] = True
    return Steps(averaged(track, counted, first), counted, first, len(used) / len(begins), sweeps)


@dataclass(frozen=True, eq=False)
class Activity:
    """Activity of a part: the steps in which it moves.

    Attributes:
        rows: (k,) rows that count, fewer of long rests: as many as a motion from end to end takes.
        moving: number of rows in motion, of slow strides as many as quick ones take; all, where motion cannot be
            separated from noise.
        sweeps: how often the part moves there and back: its path over that of once there and back.
    """

    rows: Ints
    moving: int
    sweeps: float

    def motions_in(self, rows: int) -> float:
        """Number of motions there and back represented by so many rows, with more steps in motion than at rest."""
        return max(self.sweeps, 1.0) * max(rows / (_WITH_REST * self.moving), 1.0)


def activity_of(track: PartTrack, used: Ints) -> Activity:
    """Activity of a part by position or rotation, whichever is clearer, from the rows `used`."""
    is_pushed = _is_pushed(track)
    while True:
        path = max((_path(values) for values in _channels(track.take(used))), key=lambda path: path.clarity)
        if path.clarity < _CLEAR:
            return Activity(used, len(used), path.sweeps)
        rows = np.diff(np.append(path.begins, len(used)))
        moving = int(np.minimum(rows, _REST * np.quantile(rows, _QUICK)).sum())
        one_way = int(np.ceil(moving / (2 * max(path.sweeps, 0.5))))
        # For a part that stands still while it is pushed, the pushes have information that a rest does not.
        group = 2 * np.repeat(np.arange(len(rows)), rows) + is_pushed[used]
        counts = np.bincount(group)
        if counts.max() <= one_way:
            return Activity(used, moving, path.sweeps)
        place = np.empty(len(used), dtype=np.int64)
        place[np.argsort(group, kind="stable")] = np.arange(len(used)) - np.repeat(np.cumsum(counts) - counts, counts)
        share = np.minimum(one_way / np.maximum(counts, 1), 1.0)[group]
        used = used[np.floor((place + 1) * share) > np.floor(place * share)]


def _is_pushed(track: PartTrack) -> Booleans:
    """(n,) whether an action exceeds a small fraction of the usual size."""
    if track.action is None:
        return np.zeros(len(track), dtype=bool)
    size = np.linalg.norm(track.action, axis=1)
    return np.asarray(size > _PUSH * np.sqrt(np.mean(size[size > 0] ** 2))) if size.any() else size > 0


def averaged(track: PartTrack, inlier: Booleans, first: Ints) -> PartTrack:
    """Means of the rows that count from `first[i]` to before `first[i + 1]`; there is one in each of them.

    Actions are summed: each step's commands the displacement from its mean to the next one's.
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


def is_long(track: PartTrack, inlier: Booleans) -> bool:
    """Whether a part moves to and fro more than `WINDOW_SWEEPS` times."""
    return activity_of(track, np.flatnonzero(inlier)).sweeps > WINDOW_SWEEPS


@dataclass(frozen=True, eq=False)
class _Path:
    """Path of a part in strides longer than noise.

    Attributes:
        clarity: extent over noise.
        sweeps: its length over that of once there and back.
        begins: (k,) row at which each stride begins.
    """

    clarity: float
    sweeps: float
    begins: Ints


def _channels(track: PartTrack) -> list[Floats]:
    """Rows (n, k) of position [m], and of rotation [rad] where it is measured."""
    return [track.position] if track.quaternion is None else [track.position, 2 * track.quaternion]


def _path(rows: Floats) -> _Path:
    """The path of rows (n, k)."""
    # Noise of a finer time scale than the finest steps does not matter, and looks different at every sampling rate.
    values = _block_means(rows, len(rows) / _BLOCKS)
    if len(values) < 4:
        return _Path(0.0, 1.0, np.zeros(1, dtype=np.int64))
    whole = extent(values)
    lag, level = _noise(values, whole)
    # Noise makes a path longer than the motion: average until it is small, and go in strides that are long against it.
    fine = _FINE_STRIDE * max(whole, 1e-12)
    means = _block_means(values, min(lag * (level / fine) ** 2, len(values) / _FEWEST_BLOCKS))
    points = means.tolist()
    anchor, length, strides = points[0], 0.0, [0]
    for number, point in enumerate(points[1:], 1):
        stride = dist(point, anchor)
        if stride > _STRIDE * fine:
            length, anchor = length + stride, point
            strides.append(number)
    begins = np.array(strides, dtype=np.int64) * len(rows) // len(means)
    return _Path(whole / max(level, 1e-12), 0.5 * length / max(extent(means), 1e-12), begins)


def _noise(values: Floats, whole: float) -> tuple[int, float]:
    """(decorrelation length in rows, std) of the noise of rows (n, k).

    The distance of rows from the middle of those `lag` before and after grows with the lag where there is motion, and
    where rows were interpolated between noisy ones; it is constant where it is noise that is uncorrelated over the lag.
    """
    stds: list[float] = []
    lags = [2**i for i in range(16) if 4 * 2**i <= len(values)]
    for lag in lags:
        stds.append(float(np.sqrt(3) * std_of_bends(bends(values, lag))))
        if len(stds) > 1 and stds[-1] < _GROWTH * stds[-2] and stds[-2] < _LARGEST_NOISE * whole:
            return lags[len(stds) - 2], stds[-2]
    return 1, stds[0]


def _block_means(values: Floats, size: float) -> Floats:
    """Means of neighbouring rows (n, k), about `size` of them at a time."""
    count = max(round(len(values) / max(size, 1.0)), 1)
    begins = np.unique(np.linspace(0, len(values), count, endpoint=False).astype(np.int64))
    sums = np.add.reduceat(values, begins, axis=0)
    return np.asarray(sums / np.diff(np.append(begins, len(values)))[:, None])
