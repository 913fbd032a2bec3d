"""Maximum-likelihood joints under the noise of a track, batched Gauss-Newton on innovations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import VANISHING, Booleans, Floats, Ints
from micah_plan.learning.joints.joint_arrays import JointArrays, concatenated_joints
from micah_plan.learning.joints.quaternions import cross_matrix, cross_of_units
from micah_plan.learning.joints.residuals import Compared, compare_arrays
from micah_plan.learning.segmenting.noise import NoiseModel
from micah_plan.learning.track import PartTrack

PARAMETERS = 13  # of `JointArrays.moved`'s step
_VECTORS = np.array([0, 3, 6, 9, 12])  # its first numbers of turns, shifts and the pitch
_VECTOR_OF = np.minimum(np.arange(PARAMETERS) // 3, 4)
_GAUGE = 1e-9  # directions of less relative information are redundant
_CONVERGED = 1e-3  # nats that the next step promises
_DAMPING = 1e-6  # of the first step
_ORDER = 3  # rows that a prediction looks back while fitting; the evidence looks further


def fit_pool_likelihood(
    joints: JointArrays, used: Booleans, track: PartTrack, noise: NoiseModel, iterations: int
) -> JointArrays:
    """The joints that make the innovations of their rows most likely, from a start; kinds are kept.

    Args:
        joints: h starts.
        used: (h, n) the rows that each is fitted to.
        iterations: Gauss-Newton steps, each taken only by the joints that it improves.
    """
    if not len(joints):
        return joints
    now = _start(joints, used, track, noise)
    done: list[tuple[JointArrays, Ints]] = []
    for _ in range(iterations):
        step, promise = now.step()
        converged = promise < _CONVERGED
        if converged.any():
            done.append((now.joints.take(np.flatnonzero(converged)), now.place[converged]))
            now, step = now.take(np.flatnonzero(~converged)), step[~converged]
        if not len(step):
            break
        now = now.after(step)
    done.append((now.joints, now.place))
    order = np.argsort(np.concatenate([place for _, place in done]))
    return concatenated_joints([part for part, _ in done]).take(order)


@dataclass(frozen=True, eq=False)
class _Fits:
    """State of a batched fit: joints with their rows and residuals.

    Attributes:
        joints, place: the h joints, and their indices among all those to be fitted.
        position, quaternion: (h, n, 3), (h, n, 4) the used rows of each joint first; others have no weight.
        coefficients, scale: (lags, h, d, n), (h, d, n) predictions from the rows before and 1/std of their errors.
        decorrelation, dof, rotation_length: (h, d, d), (h, 1), (h, 1) of the noise of each joint.
        seen, innovation, cost: of the rows under the joints: innovations (h, d, n) in stds and their costs (h,).
        damping: (h,) of the next step.
    """

    joints: JointArrays
    place: Ints
    position: Floats
    quaternion: Floats | None
    coefficients: Floats
    scale: Floats
    decorrelation: Floats
    dof: Floats
    rotation_length: Floats
    seen: Compared
    innovation: Floats
    cost: Floats
    damping: Floats

    def step(self) -> tuple[Floats, Floats]:
        """(h, 13) steps of `JointArrays.moved`, and their promised gain (h,) [nats]."""
        design = parameter_design(self.joints, self.seen, self.position)
        h, d, numbers, _ = design.shape
        columns = _whitened(design, self.coefficients[..., None, :], self.scale[..., None, :])
        columns = (self.decorrelation @ columns.reshape(h, d, -1)).reshape(design.shape)
        heavy = self.dof + d
        weighted = columns * (heavy / (heavy + (self.innovation**2).sum(axis=1)))[:, None, None]
        damped = (weighted @ columns.swapaxes(2, 3)).sum(axis=1)
        pull = (weighted @ self.innovation[..., None]).sum(axis=1)[..., 0]
        diagonal = np.einsum("hii->hi", damped)
        # One damping for the three numbers of a vector: no axes are preferred.
        scale = np.add.reduceat(diagonal, _VECTORS[numbers > _VECTORS], axis=1)[:, _VECTOR_OF[:numbers]]
        # Damping along redundant parameters, so that the step there is almost zero.
        diagonal += self.damping[:, None] * scale + _GAUGE * scale.max(axis=1, keepdims=True) + VANISHING
        solved = np.nan_to_num(np.linalg.solve(damped, pull[..., None])[..., 0])
        longest = np.sqrt(np.add.reduceat(solved**2, _VECTORS[numbers > _VECTORS], axis=1))[:, _VECTOR_OF[:numbers]]
        step = np.zeros((h, PARAMETERS))
        step[:, :numbers] = solved / np.maximum(longest, 1.0)
        return step, 0.5 * (step[:, :numbers] * pull).sum(axis=1)

    def after(self, step: Floats) -> _Fits:
        """The joints after a step, where it increases the likelihood."""
        trial = self.joints.moved(step)
        compared = compare_arrays(trial, self.position, self.quaternion, self.rotation_length)
        innovation, cost = _innovations(compared.error, self.coefficients, self.scale, self.decorrelation, self.dof)
        better = cost < self.cost
        damping = np.where(better, self.damping / 10, np.maximum(self.damping, _DAMPING) * 100)
        if better.all():
            return replace(self, joints=trial, seen=compared, innovation=innovation, cost=cost, damping=damping)
        return replace(
            self,
            joints=trial.where(better, self.joints),
            seen=compared.where(better, self.seen),
            innovation=np.where(better[:, None, None], innovation, self.innovation),
            cost=np.where(better, cost, self.cost),
            damping=damping,
        )

    def take(self, index: Ints) -> _Fits:
        """The entries with these indices."""
        return _Fits(
            joints=self.joints.take(index),
            place=self.place[index],
            position=self.position[index],
            quaternion=None if self.quaternion is None else self.quaternion[index],
            coefficients=self.coefficients[:, index],
            scale=self.scale[index],
            decorrelation=self.decorrelation[index],
            dof=self.dof[index],
            rotation_length=self.rotation_length[index],
            seen=self.seen.take(index),
            innovation=self.innovation[index],
            cost=self.cost[index],
            damping=self.damping[index],
        )


def _start(joints: JointArrays, used: Booleans, track: PartTrack, noise: NoiseModel) -> _Fits:
    """The initial joints with the rows (h, n) of each."""
    index = np.argsort(~used, axis=1, kind="stable")[:, : used.sum(axis=1).max()]
    order = np.take_along_axis(_known_before(used, min(_ORDER, noise.left.shape[1] - 1)), index, axis=1)
    used = np.take_along_axis(used, index, axis=1)
    position, quaternion = track.position[index], None if track.quaternion is None else track.quaternion[index]
    # Channels before rows: then one product of matrices per joint makes them independent.
    which = np.arange(len(noise))[:, None]
    scale = np.where(used[:, None], 1 / np.sqrt(noise.left[which, order].swapaxes(1, 2)), 0.0)
    coefficients = noise.coefficients[which, order, : order.max()].transpose(2, 0, 3, 1) * scale
    owner = np.zeros(len(joints), dtype=np.int64) if len(noise) == 1 else np.arange(len(joints))
    of_noise = noise.decorrelation[owner], noise.dof[owner, None], noise.rotation_length[owner]
    compared = compare_arrays(joints, position, quaternion, of_noise[2])
    innovation, cost = _innovations(compared.error, coefficients, scale, *of_noise[:2])
    damping = np.full(len(joints), _DAMPING)
    rows = position, quaternion, coefficients, scale
    return _Fits(joints, np.arange(len(joints)), *rows, *of_noise, compared, innovation, cost, damping)


def parameter_design(joints: JointArrays, compared: Compared, position: Floats) -> Floats:
    """(h, d, 13, n) derivative of the model's pose by `JointArrays.moved`'s step, free of the motion along the joint.

    Where all joints are rigid (h, d, 6, n): both sides are equivalent.

    Args:
        position: (n, 3) or (h, n, 3) measured positions of the rows that were compared [m].
    """
    h, d, n = compared.error.shape
    c = compared.configuration[:, None]
    points = np.ascontiguousarray(position.swapaxes(-1, -2)) - compared.error[:, -3:]
    every = np.arange(3)
    if not joints.moving.any():
        design = np.zeros((h, 6, 6, n))
        design[:, every, every] = design[:, every + 3, every + 3] = 1.0
        design[:, 3:, :3] = cross_of_units(points)
        return design[:, 6 - d :]
    axis, turning = joints.axis[:, :, None], joints.turning[:, None, None]
    angle = np.where(turning, c, 0.0)
    cross = cross_matrix(joints.axis)
    turn = np.eye(3)[..., None] + np.sin(angle)[:, None] * cross[..., None]
    turn += (1 - np.cos(angle))[:, None] * (cross @ cross)[..., None]
    design = np.zeros((h, 6, PARAMETERS, n))
    design[:, every, every] = design[:, every + 3, every + 3] = 1.0
    design[:, 3:, :3] = cross_of_units(points)
    design[:, 3:, 9:12] = turn
    if d == 6:
        # A part-side turn moves the point by (motion's rotation of ω) × (point - motion's translation).
        center = joints.center[:, :, None]
        slide = np.where(turning, joints.pitch[:, None, None] * c, c)
        shift = center - (turn * joints.center[:, None, :, None]).sum(axis=2) + slide * axis
        design[:, :3, 6:9] = turn
        arm = (points - shift)[:, :, None]
        for i, after, last in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            design[:, 3 + i, 6:9] = turn[:, after] * arm[:, last] - turn[:, last] * arm[:, after]
    # For a rigid part both sides are equivalent.
    design[~joints.moving, :, 6:] = 0.0
    design[:, 3:, 12] = np.where(joints.twisting[:, None, None], c, 0.0) * axis
    design = design[:, 6 - d :]
    length = np.sqrt((compared.direction**2).sum(axis=1, keepdims=True))
    along = (compared.direction / np.maximum(length, 1e-12))[:, :, None]
    design -= along * (along * design).sum(axis=1, keepdims=True)
    return design


def _known_before(used: Booleans, most: int) -> Ints:
    """(h, n) number of consecutive used rows before each row, up to `most`."""
    order = np.zeros(used.shape, dtype=np.int64)
    unbroken = np.ones(used.shape, dtype=bool)
    for back in range(1, most + 1):
        unbroken[:, :back] = False
        unbroken[:, back:] &= used[:, :-back]
        order += unbroken
    return order


def _whitened(values: Floats, coefficients: Floats, scale: Floats) -> Floats:
    """Values (h, d, ..., n) less their prediction from the rows before, in stds; coefficients count in stds too."""
    squared = values * scale
    for lag, coefficient in enumerate(coefficients, start=1):
        squared[..., lag:] -= coefficient[..., lag:] * values[..., :-lag]
    return squared


def _innovations(
    error: Floats, coefficients: Floats, scale: Floats, decorrelation: Floats, dof: Floats
) -> tuple[Floats, Floats]:
    """(h, d, n) scaled innovations of the errors, 0 in unused rows, and their cost (h,) [nats]."""
    innovation = decorrelation @ _whitened(error, coefficients, scale)
    heavy = dof + error.shape[1]
    cost = 0.5 * (heavy * np.log1p((innovation**2).sum(axis=1) / heavy)).sum(axis=1)
    return innovation, cost
