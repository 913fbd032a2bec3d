"""What the actions of a run command, as a path in time: late, smoothed, or as a servo follows it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_banded
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.learning.track import PartTrack

_BETWEEN = 4  # points per row that it is smoothed at
_LONGEST_GAPS = 16  # mean rows per median row


@dataclass(frozen=True, eq=False)
class CommandPath:
    """The running sum of the actions of a run as a path in time, base frame; beyond its ends it goes on as there.

    Attributes:
        time: (n,) of the points that are known, as a share of the run's duration: rows are at 0 to 1.
        path: (n, 3) what was commanded until then [m].
        before, after: (3,) rates before the first and after the last of them [m per run].
        lag: by how much later it is on average than what was commanded [share of the duration].
    """

    time: Floats
    path: Floats
    before: Floats
    after: Floats
    lag: float = 0.0

    def at(self, time: Floats) -> Floats:
        """(..., 3) what was commanded until the given times (...)."""
        path = np.stack([np.interp(time, self.time, self.path[:, i]) for i in range(3)], axis=-1)
        early, late = np.minimum(time - self.time[0], 0.0), np.maximum(time - self.time[-1], 0.0)
        if early.min(initial=0.0) < 0:
            path += early[..., None] * self.before
        if late.max(initial=0.0) > 0:
            path += late[..., None] * self.after
        return path

    @property
    def row(self) -> float:
        """How long a row usually is, as a share of the duration."""
        return max(float(np.median(np.diff(self.time))), 1 / (_LONGEST_GAPS * len(self.time)))

    def lagging(self, rows: float) -> CommandPath:
        """The same as what a servo of first order makes of it, with a time constant of so many rows."""
        step, lag = self.row / _BETWEEN, rows * self.row
        fine = np.arange(-self.row, 1 + self.row, step)
        told, kept = self.at(fine), float(np.exp(-step / lag))
        made = np.empty_like(told)
        made[0] = told[0] - lag * self.before
        # Between two points the command goes on evenly: behind[i] = kept behind[i - 1] + (1 - kept) lag rates[i].
        gained = (1.0 - kept) * lag * np.diff(told, axis=0) / step
        gained[0] += kept * (told[0] - made[0])
        ones = np.ones(len(gained))
        made[1:] = told[1:] - solve_banded((1, 0), np.stack([ones, -kept * ones]), gained)
        return replace(self, time=fine, path=made, lag=lag)

    def smoothed(self, rows: float) -> CommandPath:
        """The same, each action spread over time by a normal distribution, its std so many rows."""
        row = self.row
        # Four standard deviations beyond the ends, so that the path is what it is at the ends.
        edge = 4 * rows * row
        fine = np.arange(-edge, 1 + edge, row / _BETWEEN)
        inside = (fine > -row) & (fine < 1 + row)
        path = gaussian_filter1d(self.at(fine), rows * _BETWEEN, axis=0)
        return replace(self, time=fine[inside], path=path[inside])


def command_of(track: PartTrack) -> CommandPath | None:
    """What the run's actions command; None where there are none."""
    if track.action is None or track.duration <= 0 or not np.any(track.action):
        return None
    action = track.action if track.quaternion is None else Rotation.from_quat(track.quaternion).apply(track.action)
    time = (track.time - track.time[0]) / track.duration
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(action[:-1], axis=0)])
    edge = min(max(3, len(time) // 32), len(time) - 1)
    return CommandPath(
        time,
        path,
        (path[edge] - path[0]) / (time[edge] - time[0]),
        (path[-1] - path[-1 - edge]) / (time[-1] - time[-1 - edge]),
    )


def with_delayed_actions(track: PartTrack, delay: float) -> PartTrack:
    """The track with its actions `delay` [s] later: each row's action is what moves the part from it to the next.

    Nothing is commanded before the first and after the last row.
    """
    command = command_of(track)
    if command is None or delay == 0:
        return track
    path = replace(command, before=np.zeros(3), after=np.zeros(3)).at(command.time - delay / track.duration)
    action = np.concatenate([np.diff(path, axis=0), np.zeros((1, 3))])
    if track.quaternion is not None:
        action = Rotation.from_quat(track.quaternion).inv().apply(action)
    return replace(track, action=action)
