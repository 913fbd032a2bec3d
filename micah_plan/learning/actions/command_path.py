"""Commands of a run as a path in time: delayed, smoothed, or lagged by a servo."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_banded
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import inverse, jacobian
from micah_plan.learning.actions.channel_search import ROTATION_STD
from micah_plan.learning.track import PartTrack, are_held

_BETWEEN = 4  # points per row that it is smoothed at
_LONGEST_GAPS = 16  # mean rows per median row
_SAME_PLACE = 0.5  # rad, by which a place that moves on is still where it was
_BRIEF = 0.01  # of a row, in which a command changes
_SAME_FRAME = 0.02  # rad, by which the frames of places and poses differ


@dataclass(frozen=True, eq=False)
class CommandPath:
    """Commands of a run as a path in time, extrapolated linearly beyond its ends.

    Displacements add up to a path in the base frame (k = 3); places are configurations of the joint (k = 1).

    Attributes:
        time: (n,) of the known points, as a share of the run's duration: rows are at 0 to 1.
        path: (n, k) sum of all commands until then [m; of places rad or m].
        before, after: (k,) rates before the first and after the last of them [per run].
        row: how long a row usually is [share of the duration].
        lag: mean delay behind the unfiltered command [share of the duration].
        frame_std: by how much its frame may be turned against that of the poses [rad].
    """

    time: Floats
    path: Floats
    before: Floats
    after: Floats
    row: float
    lag: float = 0.0
    frame_std: float = ROTATION_STD

    @property
    def is_of_places(self) -> bool:
        """Whether the path consists of positions along the joint."""
        return bool(self.path.shape[1] == 1)

    def at(self, time: Floats) -> Floats:
        """(..., k) commanded path at the given times (...)."""
        path = np.stack([np.interp(time, self.time, column) for column in self.path.T], axis=-1)
        early, late = np.minimum(time - self.time[0], 0.0), np.maximum(time - self.time[-1], 0.0)
        if early.min(initial=0.0) < 0:
            path += early[..., None] * self.before
        if late.max(initial=0.0) > 0:
            path += late[..., None] * self.after
        return path

    def lagging(self, rows: float) -> CommandPath:
        """The path behind a first-order lag with a time constant of `rows` rows."""
        step, lag = self.row / _BETWEEN, rows * self.row
        fine = np.arange(-self.row, 1 + self.row, step)
        commanded, kept = self.at(fine), float(np.exp(-step / lag))
        arrived = np.empty_like(commanded)
        arrived[0] = commanded[0] - lag * self.before
        # Between two points the command goes on evenly: behind[i] = kept behind[i - 1] + (1 - kept) lag rates[i].
        gained = (1.0 - kept) * lag * np.diff(commanded, axis=0) / step
        gained[0] += kept * (commanded[0] - arrived[0])
        ones = np.ones(len(gained))
        arrived[1:] = commanded[1:] - solve_banded((1, 0), np.stack([ones, -kept * ones]), gained)
        return replace(self, time=fine, path=arrived, lag=lag)

    def smoothed(self, rows: float) -> CommandPath:
        """The path with each action spread over time by a Gaussian of std `rows` rows."""
        row = self.row
        # Four standard deviations beyond the ends, so that the path is what it is at the ends.
        edge = 4 * rows * row
        fine = np.arange(-edge, 1 + edge, row / _BETWEEN)
        inside = (fine > -row) & (fine < 1 + row)
        path = gaussian_filter1d(self.at(fine), rows * _BETWEEN, axis=0)
        return replace(self, time=fine[inside], path=path[inside])


def commanded_places(joint: Joint, track: PartTrack) -> CommandPath | None:
    """The positions along a joint that a run's actions command, each until the next; None if they are displacements.

    An action may be the straight displacement to a place, or the displacement along the joint's tangent that is as long
    as its arc. Read correctly, a constant place is the same from row to row, however far the part has come. That
    identifies places where a recording does not state them: a displacement leads further with each row.
    """
    action = _in_base_frame(track)
    if action is None or track.meaning == "displacement":
        return None
    at = inverse(joint, track.position, track.rotation)
    at = np.unwrap(at) if joint.turns else at
    straight = inverse(joint, track.position + action)
    if joint.turns:
        straight = _unwrapped_near(straight, at)
    along = at + np.einsum("ij,ij->i", leverage(joint, at), action)
    # A row without an action is unknown, or the part has arrived: the place of the row before holds.
    rows = np.arange(len(at) - 1)
    latest = np.maximum.accumulate(np.where(np.any(action[:-1], axis=1), rows, 0))
    places = min((straight[latest], along[latest]), key=lambda read: float(np.abs(np.diff(read)).sum()))
    if track.meaning is None and not are_held(places[:, None], at[:-1, None]):
        return None
    time, still = (track.time - track.time[0]) / track.duration, np.zeros(1)
    until = time[1:] - _BRIEF * np.diff(time)
    return CommandPath(
        np.stack([time[:-1], until], axis=1).ravel(),
        np.repeat(places, 2)[:, None],
        still,
        still,
        _usual_row(time),
        frame_std=_SAME_FRAME,
    )


def _unwrapped_near(place: Floats, at: Floats) -> Floats:
    """Commanded angles (n,) [rad], unwrapped to the turn nearest to the part's angles (n,).

    While a part is on a long path to a place, the place is in the turn that the part is in when it arrives.
    """
    nearest = at + np.angle(np.exp(1j * (place - at)))
    further = np.angle(np.exp(1j * np.diff(nearest)))
    on = np.concatenate([[0.0], np.cumsum(further)])
    ends = np.append(np.flatnonzero(np.abs(further) >= _SAME_PLACE), len(place) - 1)
    end = ends[np.searchsorted(ends, np.arange(len(place)))]
    return np.asarray(on + nearest[end] - on[end])


def _usual_row(time: Floats) -> float:
    """Typical duration of a row, from the times of rows (n,)."""
    return max(float(np.median(np.diff(time))), 1 / (_LONGEST_GAPS * len(time)))


def _in_base_frame(track: PartTrack) -> Floats | None:
    """(n, 3) actions of a run [m]; None where there are none."""
    if track.action is None or track.duration <= 0 or not np.any(track.action):
        return None
    return track.action if track.quaternion is None else Rotation.from_quat(track.quaternion).apply(track.action)


def command_of(track: PartTrack) -> CommandPath | None:
    """The run's commanded path of displacements; None without actions."""
    action = _in_base_frame(track)
    if action is None:
        return None
    time = (track.time - track.time[0]) / track.duration
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(action[:-1], axis=0)])
    edge = min(max(3, len(time) // 32), len(time) - 1)
    return CommandPath(
        time,
        path,
        (path[edge] - path[0]) / (time[edge] - time[0]),
        (path[-1] - path[-1 - edge]) / (time[-1] - time[-1 - edge]),
        _usual_row(time),
    )


def leverage(joint: Joint, c: Floats) -> Floats:
    """(m, 3) rows of J⁻¹ for displacements; 0 where the part's origin lies on the axis."""
    if joint.kind == "prismatic":
        return np.broadcast_to(np.array(joint.axis), (len(c), 3))
    direction = jacobian(joint, c)[:, 3:]
    squared = np.sum(direction**2, axis=1, keepdims=True)
    return np.asarray(direction / np.maximum(squared, 1e-12))


def with_delayed_actions(track: PartTrack, delay: float) -> PartTrack:
    """The track with its actions `delay` [s] later: each row's action is that of the motion to the next row.

    The command is zero before the first and after the last row.
    """
    command = command_of(track)
    if command is None or delay == 0:
        return track
    path = replace(command, before=np.zeros(3), after=np.zeros(3)).at(command.time - delay / track.duration)
    action = np.concatenate([np.diff(path, axis=0), np.zeros((1, 3))])
    if track.quaternion is not None:
        action = Rotation.from_quat(track.quaternion).inv().apply(action)
    return replace(track, action=action)
