"""The pool of candidate joints for segments, with all steps in their frames.

Joints are fitted to windows of the track and to the segments found so far, never to each pair of a first and a last
row; so segments that obey one joint share its parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.joint import JointKind
from micah_plan.learning.joints.joint_arrays import JointArrays, concatenated_joints
from micah_plan.learning.joints.linear_fits import linear_fits
from micah_plan.learning.joints.residuals import Compared, compare_arrays, levers
from micah_plan.learning.segmenting.noise import NoiseModel, NoiseScales
from micah_plan.learning.segmenting.pool_fits import fit_pool_likelihood
from micah_plan.learning.track import PartTrack

_LEVELS = 4  # of windows, each half as long
_FEWEST_ROWS = 8  # of a window
_MOTION_STDS = 3.0  # a window that spans less than so many stds of noise does not determine a joint
_ITERATIONS = 4
_TINY = 1e-30


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """h joints and the rows (h, n) of the track that each was fitted to."""

    joints: JointArrays
    used: Booleans

    def __len__(self) -> int:
        return len(self.joints)

    def take(self, index: Sequence[int] | Ints) -> Hypotheses:
        """The hypotheses with these indices."""
        return Hypotheses(self.joints.take(index), self.used[np.asarray(index, dtype=np.int64)])

    def joined(self, more: Hypotheses) -> Hypotheses:
        """These hypotheses followed by others."""
        return all_of([self, more])


def all_of(pools: Sequence[Hypotheses]) -> Hypotheses:
    """The concatenated hypotheses of several pools."""
    if len(pools) == 1:
        return pools[0]
    return Hypotheses(
        concatenated_joints([pool.joints for pool in pools]), np.concatenate([pool.used for pool in pools])
    )


@dataclass(frozen=True, eq=False)
class Pool:
    """All n rows of a track in the frames of h hypotheses, under a noise.

    Attributes:
        hypotheses: the h joints.
        seen: most likely configurations, errors and directions.
        along: noise of one configuration [rad² or m²].
        lever: (h, 3) J⁻¹ for the part's translation, in the frame of the track's actions [rad or m per m].
        moving: (h,) which are not rigid.
    """

    hypotheses: Hypotheses
    seen: Compared
    along: NoiseScales
    lever: Floats
    moving: Booleans

    def part(self, part: slice, hypotheses: Hypotheses) -> Pool:
        """The pool restricted to some hypotheses."""
        return Pool(hypotheses, self.seen.take(part), self.along.take(part), self.lever[part], self.moving[part])


def pool_of(hypotheses: Hypotheses, track: PartTrack, noise: NoiseModel) -> Pool:
    """Compare all rows of a track with joints; configurations are most likely under the noise's covariance."""
    joints = hypotheses.joints
    compared = compare_arrays(joints, track.position, track.quaternion, noise.rotation_length)
    weighed = np.linalg.inv(noise.innovation) @ compared.direction
    information = np.where(joints.moving[:, None], (weighed * compared.direction).sum(axis=1), 1.0)
    information = np.maximum(information, 1e-12)
    # The closed form weighs position against rotation by one number; one Newton step brings in the whole covariance.
    step = (weighed * compared.error).sum(axis=1) / information
    compared = Compared(
        compared.configuration + step, compared.error - step[:, None] * compared.direction, compared.direction
    )
    # A tracker's axes show across a joint, not along it: there its noise is that of all axes together.
    share = (weighed / information[:, None]) ** 2
    of_pose = noise.white, noise.fast, noise.slow, noise.fast * noise.fast_kept, noise.slow * noise.slow_kept
    white, fast, slow, *neighbours = np.median(np.stack(of_pose, axis=1) @ share, axis=2).T
    kept = (
        covariance / np.maximum(variance, _TINY) for covariance, variance in zip(neighbours, (fast, slow), strict=True)
    )
    along = NoiseScales(white, fast, slow, *kept)
    return Pool(hypotheses, compared, along, levers(joints, track.quaternion is not None), joints.moving)


def windows(rows: int) -> list[tuple[int, int]]:
    """(start, end inclusive) of windows of 1, 1/2, 1/4, 1/8 of the rows, half overlapping."""
    spans: list[tuple[int, int]] = []
    for level in range(_LEVELS):
        size = rows / 2**level
        if size < _FEWEST_ROWS and level:
            break
        for i in range(2 ** (level + 1) - 1):
            start = round(i * size / 2)
            spans.append((start, min(round(start + size), rows) - 1))
    return spans


def window_hypotheses(track: PartTrack, kinds: Sequence[JointKind], noise: NoiseModel) -> Hypotheses:
    """Closed-form joints of all kinds for every window; moving ones only where motion exceeds noise."""
    n, noise_of_row = len(track), noise.of_rows(1.0)
    of_kind: list[JointKind] = []
    used = []
    for start, end in windows(n):
        inside = np.zeros(n, dtype=bool)
        inside[start : end + 1] = True
        moved = _spread(track.position[inside]) > _MOTION_STDS * noise_of_row.position_white
        if track.quaternion is not None:
            moved = moved or 2 * _spread(track.quaternion[inside]) > _MOTION_STDS * noise_of_row.rotation_white
        for kind in kinds:
            if kind == "rigid" or (moved and not (kind == "screw" and end - start + 1 < n / 2 - 1)):
                of_kind.append(kind)
                used.append(inside)
    rows = np.array(used).reshape(-1, n)
    joints, fixed = linear_fits(of_kind, rows, track.position, track.quaternion)
    return Hypotheses(joints, rows).take(np.flatnonzero(fixed))


def refitted_hypotheses(kinds: Sequence[JointKind], used: Booleans, track: PartTrack, noise: NoiseModel) -> Hypotheses:
    """Maximum-likelihood joints of given kinds on given rows (h, n), where the rows determine them."""
    return all_refitted([(kinds, used)], track, noise)[0]


def all_refitted(
    wanted: Sequence[tuple[Sequence[JointKind], Booleans]], track: PartTrack, noise: NoiseModel
) -> list[Hypotheses]:
    """`refitted_hypotheses` for several sets of kinds and rows at once, each under its own noise."""
    kinds = [kind for wanted_kinds, _ in wanted for kind in wanted_kinds]
    used = np.concatenate([rows for _, rows in wanted])
    joints, fixed = linear_fits(kinds, used, track.position, track.quaternion)
    owner = np.repeat(np.arange(len(wanted)), [len(wanted_kinds) for wanted_kinds, _ in wanted])[fixed]
    chosen = Hypotheses(joints, used).take(np.flatnonzero(fixed))
    own_noise = noise.take(owner) if len(wanted) > 1 else noise
    hypotheses = Hypotheses(fit_pool_likelihood(chosen.joints, chosen.used, track, own_noise, _ITERATIONS), chosen.used)
    return [hypotheses.take(np.flatnonzero(owner == i)) for i in range(len(wanted))]


def _spread(rows: Floats) -> float:
    """Largest distance from the mean."""
    return float(np.linalg.norm(rows - rows.mean(axis=0), axis=1).max())
