"""The pool of joints that segments choose from, and all steps as they see them.

Joints are fitted to windows of the track and to the segments found so far, never to each pair of a first and a last
row; so segments that obey one joint share its parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.joints.comparison import Compared, compare_arrays, levers
from micah_plan.learn.joints.joint_arrays import JointArrays, concatenated
from micah_plan.learn.joints.linear_fits import linear_fits
from micah_plan.learn.segmenting.noise import NoiseModel
from micah_plan.learn.segmenting.pool_fits import fit_likelihood
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

_LEVELS = 4
_FEWEST_ROWS = 8
_MOTION_STDS = 3.0  # a window that spans less than so many stds of noise cannot tell a joint
_ITERATIONS = 4


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """h joints and the rows (h, n) of the track that each was fitted to."""

    joints: JointArrays
    used: Bools

    def __len__(self) -> int:
        return len(self.joints)

    def take(self, index: Sequence[int] | Ints) -> Hypotheses:
        """Some of them."""
        return Hypotheses(self.joints.take(index), self.used[np.asarray(index, dtype=np.int64)])

    def joined(self, other: Hypotheses) -> Hypotheses:
        """These and others."""
        return Hypotheses(concatenated(self.joints, other.joints), np.concatenate([self.used, other.used]))


@dataclass(frozen=True, eq=False)
class Pool:
    """All n rows of a track as h hypotheses see them under a noise.

    Attributes:
        hypotheses: the h joints.
        seen: most likely configurations, errors and directions.
        white, renewed: (h,) variances of one configuration's white noise and of what each row adds to its wander.
        lever: (h, 3) J⁻¹ for the part's translation, in the frame of the track's actions [rad or m per m].
        moving: (h,) which are not rigid.
    """

    hypotheses: Hypotheses
    seen: Compared
    white: Floats
    renewed: Floats
    lever: Floats
    moving: Bools


def pool_of(hypotheses: Hypotheses, track: PartTrack, noise: NoiseModel) -> Pool:
    """Compare all rows of a track with joints; configurations are most likely under the noise's covariance."""
    joints = hypotheses.joints
    seen = compare_arrays(joints, track.position, track.quaternion, noise.rotation_length)
    weighed = seen.direction @ np.linalg.inv(noise.innovation)
    information = np.where(joints.moving[:, None], np.sum(weighed * seen.direction, axis=2), 1.0)
    information = np.maximum(information, 1e-12)
    # The closed form weighs position against rotation by one number; one Newton step brings in the whole covariance.
    step = np.sum(weighed * seen.error, axis=2) / information
    seen = Compared(seen.configuration + step, seen.error - step[..., None] * seen.direction, seen.direction)
    share = weighed / information[..., None]
    white, renewed = (np.median(share**2 @ part, axis=1) for part in (noise.white, noise.renewed))
    return Pool(hypotheses, seen, white, renewed, levers(joints, track.quaternion is not None), joints.moving)


def windows(rows: int) -> list[tuple[int, int]]:
    """(start, end inclusive) of windows of 1, 1/2, 1/4, 1/8 of the rows, half overlapping."""
    found: list[tuple[int, int]] = []
    for level in range(_LEVELS):
        size = rows / 2**level
        if size < _FEWEST_ROWS and level:
            break
        for i in range(2 ** (level + 1) - 1):
            start = round(i * size / 2)
            found.append((start, min(round(start + size), rows) - 1))
    return found


def window_hypotheses(track: PartTrack, kinds: Sequence[JointKind], noise: NoiseModel) -> Hypotheses:
    """Joints of all kinds fitted in closed form to every window; moving ones where something moves beyond noise."""
    n = len(track)
    of_kind: list[JointKind] = []
    used = []
    for start, end in windows(n):
        inside = np.zeros(n, dtype=bool)
        inside[start : end + 1] = True
        moved = _spread(track.position[inside]) > _MOTION_STDS * noise.position_white
        if track.quaternion is not None:
            moved = moved or 2 * _spread(track.quaternion[inside]) > _MOTION_STDS * noise.rotation_white
        for kind in kinds:
            if kind == "rigid" or (moved and not (kind == "screw" and end - start + 1 < n / 2 - 1)):
                of_kind.append(kind)
                used.append(inside)
    rows = np.array(used).reshape(-1, n)
    joints, fixed = linear_fits(of_kind, rows, track.position, track.quaternion)
    return Hypotheses(joints, rows).take(np.flatnonzero(fixed))


def refitted(kinds: Sequence[JointKind], used: Bools, track: PartTrack, noise: NoiseModel) -> Hypotheses:
    """Joints of maximum likelihood of given kinds on given rows (h, n), those that the rows determine."""
    if not len(kinds):
        return Hypotheses(linear_fits([], used[:0], track.position, track.quaternion)[0], used[:0])
    joints, fixed = linear_fits(kinds, used, track.position, track.quaternion)
    chosen = Hypotheses(joints, used).take(np.flatnonzero(fixed))
    return Hypotheses(fit_likelihood(chosen.joints, chosen.used, track, noise, _ITERATIONS), chosen.used)


def _spread(rows: Floats) -> float:
    """Largest distance from the mean."""
    return float(np.linalg.norm(rows - rows.mean(axis=0), axis=1).max())
