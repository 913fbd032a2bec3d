"""Steps of a track: its rows averaged to a resolution that depends on the motion, not on the sampling rate.

What learning assumes of neighbouring rows (how fast a tracker wanders, how often a part rests, how long a segment is)
it assumes of neighbouring steps. So the same motion sampled 16 times as often gives the same segments, at the same
cost, and white noise is averaged before it is looked at. Changepoints are then found again to the row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

_BLOCKS, _FEWEST_BLOCKS = 256, 8  # in which the length of the path is measured
MOST_SWEEPS = 4.0
_STD_PER_MAD = 1.4826
_FINE_STRIDE = 0.02  # of the extent


@dataclass(frozen=True, eq=False)
class Steps:
    """A track at the resolution at which it is segmented.

    Attributes:
        track: (m,) steps: means of the poses of a few rows; actions command the way from a step to the next one.
        first: (m + 1,) first row of every step in the track of all rows, and the number of rows.
        size: mean number of rows of a step.
    """

    track: PartTrack
    first: Ints
    size: float


def steps_of(track: PartTrack, inlier: Bools, resolution: int) -> Steps:
    """Average rows to about `resolution` steps per there and back of the part.

    Args:
        inlier: (n,) rows that count; a step without any is part of the one before.
        resolution: steps while the part moves once through its range and back, or less far.
    """
    used = np.flatnonzero(inlier)
    sweeps = float(np.clip(sweeps_of(track.take(used)), 1.0, MOST_SWEEPS))
    wanted = min(round(resolution * sweeps), len(used))
    begins = np.unique(np.linspace(0, len(used), wanted, endpoint=False).astype(np.int64))
    first = np.append(used[begins], len(track))
    first[0] = 0
    return Steps(averaged(track, inlier, first), first, len(track) / len(begins))


def averaged(track: PartTrack, inlier: Bools, first: Ints) -> PartTrack:
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
    """Path over that of once there and back, of position or rotation, whichever is clearer."""
    channels = [track.position]
    if track.quaternion is not None:
        channels.append(2 * track.quaternion)
    found = [_clarity_and_sweeps(values) for values in channels]
    return max(found)[1]


def _clarity_and_sweeps(values: Floats) -> tuple[float, float]:
    """Extent over noise, and path over there and back, of rows (n, k)."""
    bends = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    if len(bends) < 2:
        return 0.0, 1.0
    level = float(np.linalg.norm(_STD_PER_MAD * np.median(np.abs(bends), axis=0) / np.sqrt(1.5)))
    extent = float(np.linalg.norm(np.ptp(values, axis=0)))
    # Noise makes a path longer than the motion: average until it is small, and go in strides that are long against it.
    fine = _FINE_STRIDE * max(extent, 1e-12)
    window = int(np.clip((level / fine) ** 2, len(values) / _BLOCKS, max(len(values) / _FEWEST_BLOCKS, 1)))
    begins = np.arange(0, len(values), max(window, 1))
    means = np.add.reduceat(values, begins, axis=0) / np.diff(np.append(begins, len(values)))[:, None]
    anchor, path = means[0], 0.0
    for point in means[1:]:
        length = float(np.linalg.norm(point - anchor))
        if length > 3 * fine:
            path, anchor = path + length, point
    reached = float(np.linalg.norm(np.ptp(means, axis=0)))
    return extent / max(level, 1e-12), 0.5 * path / max(reached, 1e-12)
