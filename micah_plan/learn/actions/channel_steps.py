"""The steps of a joint's configuration and what was commanded for them: the linear part of the action channel.

A step between two measured rows is c' - c = g J⁻¹(c) R ΔA + w + v' - v, with ΔA the command given meanwhile, w a random
walk and v the white noise of a row. So the steps of a piece have a tridiagonal covariance (the innovations form of a
scalar Kalman filter), and the model is linear in the nine numbers of g R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import jacobian
from micah_plan.learn.actions.anchored import configurations
from micah_plan.learn.track import PartTrack

_WHITE_SPREAD = 0.4  # std of ln r about what the caller believes of the white variance r
_WALK_DECADES = np.arange(-9.0, 1.1)  # ln-grid of the random walk's variance, of the mean squared step
_REFINEMENTS = 4
_TINY = 1e-300  # against division by 0
_BETWEEN = 4  # points per row that it is smoothed at
_LONGEST_GAPS = 16  # mean rows per median row


@dataclass(frozen=True, eq=False)
class Command:
    """The running sum of the actions of a run as a path in time, base frame; beyond its ends it goes on as there.

    Attributes:
        time: (n,) of the points that are known, as a share of the run's duration: rows are at 0 to 1.
        path: (n, 3) what was commanded until then [m].
        before, after: (3,) rates before the first and after the last of them [m per run].
    """

    time: Floats
    path: Floats
    before: Floats
    after: Floats

    def at(self, time: Floats) -> Floats:
        """(..., 3) what was commanded until the given times (...)."""
        path = np.stack([np.interp(time, self.time, self.path[:, i]) for i in range(3)], axis=-1)
        early, late = np.minimum(time - self.time[0], 0.0), np.maximum(time - self.time[-1], 0.0)
        if early.min(initial=0.0) < 0:
            path += early[..., None] * self.before
        if late.max(initial=0.0) > 0:
            path += late[..., None] * self.after
        return path

    def smoothed(self, rows: float) -> Command:
        """The same, each action spread over time by a normal distribution, its std so many rows."""
        row = max(float(np.median(np.diff(self.time))), 1 / (_LONGEST_GAPS * len(self.time)))
        # Four standard deviations beyond the ends, so that the path is what it is at the ends.
        edge = 4 * rows * row
        fine = np.arange(-edge, 1 + edge, row / _BETWEEN)
        inside = (fine > -row) & (fine < 1 + row)
        path = gaussian_filter1d(self.at(fine), rows * _BETWEEN, axis=0)
        return replace(self, time=fine[inside], path=path[inside])


@dataclass(frozen=True, eq=False)
class Steps:
    """m steps of the configuration between measured rows.

    Attributes:
        start, end: (m,) when they begin and end, as shares of the run's duration.
        size: (m,) measured c' - c [rad or m].
        leverage: (m, 3) J⁻¹ halfway, of displacements in the base frame [rad or m per m].
        linked: (m - 1,) whether a step begins with the row that the one before it ends with.
        white: believed white variance of one row [rad² or m²].
    """

    start: Floats
    end: Floats
    size: Floats
    leverage: Floats
    linked: Booleans
    white: float

    def __len__(self) -> int:
        return len(self.size)

    def predictors(self, command: Command, delays: Floats) -> Floats:
        """(d, 9, m) what the entries of g R (row by row) make of the steps, for each delay (d,) [share of the run]."""
        ends = np.concatenate([self.start, self.end])
        path = command.at(ends - delays[:, None])
        given = path[:, len(self) :] - path[:, : len(self)]
        product = self.leverage.T[None, :, None, :] * given.transpose(0, 2, 1)[:, None, :, :]
        return product.reshape(len(delays), 9, len(self))


@dataclass(frozen=True, eq=False)
class StepNoise:
    """Covariance of the steps, factored.

    Attributes:
        walk: variance of the random walk per run [rad² or m²].
        white: variance of the white noise of a row [rad² or m²].
        log_density: of the steps it was fitted to, with the prior of `white` [nats].
    """

    walk: float
    white: float
    log_density: float
    diagonal: Floats
    below: Floats

    def solve(self, signals: Floats) -> Floats:
        """(k, m) signals multiplied by the inverse covariance."""
        # LAPACK wants columns: the transpose of rows is that without a copy.
        return np.asarray(lapack.dpttrs(self.diagonal, self.below, signals.T)[0].T)


def command_of(track: PartTrack) -> Command | None:
    """What the run's actions command; None where there are none."""
    if track.action is None or track.duration <= 0 or not np.any(track.action):
        return None
    action = track.action if track.quaternion is None else Rotation.from_quat(track.quaternion).apply(track.action)
    time = (track.time - track.time[0]) / track.duration
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(action[:-1], axis=0)])
    edge = min(max(3, len(time) // 32), len(time) - 1)
    return Command(
        time,
        path,
        (path[edge] - path[0]) / (time[edge] - time[0]),
        (path[-1] - path[-1 - edge]) / (time[-1] - time[-1 - edge]),
    )


def steps_of(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans, white: float, most: int | None
) -> Steps:
    """Steps of the rows of pieces that count; with `most`, about that many per run, between averages of rows.

    Args:
        white: variance of one measured configuration [rad² or m²].
    """
    found = configurations(joint, pieces, track, inlier)
    time = (track.time - track.time[0]) / track.duration
    group = 1 if most is None else max(1, round(len(track) / most))
    blocks = [(_averaged(time[rows], group), _averaged(c, group), _averaged(calm, group)) for rows, c, calm in found]
    start = np.concatenate([t[:-1] for t, _, _ in blocks])
    end = np.concatenate([t[1:] for t, _, _ in blocks])
    size = np.concatenate([np.diff(c) for _, c, _ in blocks])
    # Noise of the configuration that a direction is taken at would weaken what is explained.
    halfway = np.concatenate([0.5 * (calm[:-1] + calm[1:]) for _, _, calm in blocks])
    lengths = np.array([max(len(t) - 1, 0) for t, _, _ in blocks])
    linked = np.ones(max(len(size) - 1, 0), dtype=bool)
    ends = np.cumsum(lengths)[:-1]
    linked[ends[(ends > 0) & (ends < len(size))] - 1] = False
    return Steps(start, end, size, _leverage(joint, halfway), linked, white / group)


def fit_noise(steps: Steps, left: Floats, extra: Floats) -> StepNoise:
    """The most probable random walk and white noise behind what is left (m,) of the steps.

    Args:
        extra: (m,) variance known besides [rad² or m²].
    """
    scale = max(float(np.mean(left**2 / (steps.end - steps.start))), steps.white * 1e-6, 1e-24)

    def tried(walk: float, white: float) -> StepNoise:
        return noise_of(steps, left, extra, np.exp(walk) * scale, np.exp(white) * steps.white)

    best, at = max(((tried(w, 0.0), (w, 0.0)) for w in _WALK_DECADES), key=lambda pair: pair[0].log_density)
    width = np.array([0.5, 0.4])
    for _ in range(_REFINEMENTS):
        for i in range(2):
            for sign in (1.0, -1.0):
                moved = list(at)
                moved[i] += sign * width[i]
                other = tried(moved[0], moved[1])
                if other.log_density > best.log_density:
                    best, at = other, (moved[0], moved[1])
                    break
        width *= 0.6
    return best


def noise_of(steps: Steps, left: Floats, extra: Floats, walk: float, white: float) -> StepNoise:
    """Given noise (variances, see StepNoise), with its density of what is left (m,) of the steps."""
    diagonal = walk * (steps.end - steps.start) + extra + 2 * white * (1 + 1e-9)
    below = np.where(steps.linked, -white, 0.0)
    pivots, factor, _ = lapack.dpttrf(diagonal, below)
    solved = lapack.dpttrs(pivots, factor, left[:, None])[0][:, 0]
    misfit = float(left @ solved) + float(np.sum(np.log(np.maximum(pivots, _TINY)))) + len(left) * np.log(2 * np.pi)
    prior = (np.log(white / steps.white) / _WHITE_SPREAD) ** 2
    return StepNoise(walk, white, -0.5 * (misfit + prior), pivots, factor)


def _averaged(value: Floats, group: int) -> Floats:
    """Means of groups of rows; a last group that is not full is left out."""
    full = len(value) // group * group
    return np.asarray(value[:full].reshape(-1, group).mean(axis=1))


def _leverage(joint: Joint, c: Floats) -> Floats:
    """(m, 3) rows that J⁻¹ multiplies a displacement by; 0 where the part's origin is on the axis."""
    if joint.kind == "prismatic":
        return np.broadcast_to(np.array(joint.axis), (len(c), 3))
    direction = jacobian(joint, c)[:, 3:]
    squared = np.sum(direction**2, axis=1, keepdims=True)
    return np.asarray(direction / np.maximum(squared, 1e-12))
