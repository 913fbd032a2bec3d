"""Joints of maximum likelihood under the noise of a track, many at once: Gauss-Newton on the rows' innovations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.learn.joints.comparison import Compared, compare_arrays
from micah_plan.learn.joints.joint_arrays import JointArrays
from micah_plan.learn.joints.least_norm import least_norm
from micah_plan.learn.joints.quaternions import cross_matrix, cross_of_units
from micah_plan.learn.segmenting.noise import NoiseModel
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

_GAUGE = 1e-9  # directions of less relative information are redundant
_CONVERGED = 0.02  # nats that the next step promises
_ORDER = 3  # rows that a prediction looks back while fitting; the evidence looks further


def fit_likelihood(
    joints: JointArrays, used: Bools, track: PartTrack, noise: NoiseModel, iterations: int
) -> JointArrays:
    """The joints that make the innovations of their rows most likely, from a start; kinds are kept.

    Args:
        joints: h starts.
        used: (h, n) the rows that each is fitted to.
        iterations: Gauss-Newton steps, each taken only by the joints that it improves.
    """
    if not len(joints):
        return joints
    # The used rows of each first; as many as any of them has, the others count nothing.
    index = np.argsort(~used, axis=1, kind="stable")[:, : used.sum(axis=1).max()]
    order = np.take_along_axis(_known_before(used, min(_ORDER, noise.left.shape[1] - 1)), index, axis=1)
    used = np.take_along_axis(used, index, axis=1)
    poses = track.position[index], None if track.quaternion is None else track.quaternion[index]
    # Channels before rows: then one product of matrices per joint makes them independent.
    which = np.arange(len(noise))[:, None]
    scale = np.where(used[:, None], 1 / np.sqrt(noise.left[which, order].swapaxes(1, 2)), 0.0)
    coefficients = noise.coefficients[which, order, : order.max()].transpose(2, 0, 3, 1) * scale
    seen = compare_arrays(joints, *poses, noise.rotation_length)
    innovation, cost = _innovations(seen.error, coefficients, scale, noise)
    damping = np.full(len(joints), 1e-6)
    for _ in range(iterations):
        design = parameter_design(joints, seen, poses[0])
        size = design.shape[1]
        columns = _whitened(design, coefficients[..., None, :], scale[..., None, :])
        columns = noise.decorrelation @ columns.reshape(len(joints), size, -1)
        heavy = noise.dof[:, None] + size
        weight = heavy / (heavy + (innovation**2).sum(axis=1))
        rows = columns.reshape(design.shape).swapaxes(1, 2)
        weighted = (rows * weight[:, None, None]).reshape(len(joints), design.shape[2], -1)
        damped = weighted @ rows.reshape(len(joints), design.shape[2], -1).swapaxes(1, 2)
        pull = (weighted @ innovation.reshape(len(joints), -1, 1))[..., 0]
        diagonal = np.einsum("hii->hi", damped)
        diagonal += damping[:, None] * diagonal
        step = np.clip(np.nan_to_num(least_norm(damped, pull, _GAUGE)), -1.0, 1.0)
        if 0.5 * (step * pull).sum(axis=1).max() < _CONVERGED:
            break
        trial = joints.moved(step)
        after = compare_arrays(trial, *poses, noise.rotation_length)
        trial_innovation, trial_cost = _innovations(after.error, coefficients, scale, noise)
        better = trial_cost < cost
        joints, seen = trial.where(better, joints), _chosen(better, after, seen)
        innovation = np.where(better[:, None, None], trial_innovation, innovation)
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, damping / 10, np.maximum(damping, 1e-6) * 100)
    return joints


def parameter_design(joints: JointArrays, seen: Compared, position: Floats) -> Floats:
    """(h, d, 13, n) derivative of the model's pose by `JointArrays.moved`'s step, free of the motion along the joint.

    Args:
        position: (n, 3) or (h, n, 3) measured positions of the rows that were compared [m].
    """
    h, d, n = seen.error.shape
    c = seen.configuration[:, None]
    points = np.ascontiguousarray(position.swapaxes(-1, -2)) - seen.error[:, -3:]
    axis, turning = joints.axis[:, :, None], joints.turning[:, None, None]
    angle = np.where(turning, c, 0.0)
    cross = cross_matrix(joints.axis)
    turn = np.eye(3)[..., None] + np.sin(angle)[:, None] * cross[..., None]
    turn += (1 - np.cos(angle))[:, None] * (cross @ cross)[..., None]
    design = np.zeros((h, 6, 13, n))
    every = np.arange(3)
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
    # For a rigid part both sides say the same.
    design[~joints.moving, :, 6:] = 0.0
    design[:, 3:, 12] = np.where(joints.twisting[:, None, None], c, 0.0) * axis
    design = design[:, 6 - d :]
    length = np.sqrt((seen.direction**2).sum(axis=1, keepdims=True))
    along = (seen.direction / np.maximum(length, 1e-12))[:, :, None]
    design -= along * (along * design).sum(axis=1, keepdims=True)
    return design


def _known_before(used: Bools, most: int) -> Ints:
    """(h, n) how many rows directly before a row are used, up to `most`."""
    order = np.zeros(used.shape, dtype=np.int64)
    unbroken = np.ones(used.shape, dtype=bool)
    for back in range(1, most + 1):
        unbroken[:, :back] = False
        unbroken[:, back:] &= used[:, :-back]
        order += unbroken
    return order


def _whitened(values: Floats, coefficients: Floats, scale: Floats) -> Floats:
    """Values (h, d, ..., n) less their prediction from the rows before, in stds; coefficients count in stds too."""
    left = values * scale
    for lag, coefficient in enumerate(coefficients, start=1):
        left[..., lag:] -= coefficient[..., lag:] * values[..., :-lag]
    return left


def _innovations(error: Floats, coefficients: Floats, scale: Floats, noise: NoiseModel) -> tuple[Floats, Floats]:
    """(h, d, n) scaled innovations of the errors, 0 in rows that are not used, and what they cost (h,) [nats]."""
    innovation = noise.decorrelation @ _whitened(error, coefficients, scale)
    heavy = noise.dof[:, None] + error.shape[1]
    cost = 0.5 * (heavy * np.log1p((innovation**2).sum(axis=1) / heavy)).sum(axis=1)
    return innovation, cost


def _chosen(condition: Bools, first: Compared, second: Compared) -> Compared:
    wide = condition[:, None]
    return Compared(
        np.where(wide, first.configuration, second.configuration),
        np.where(wide[..., None], first.error, second.error),
        np.where(wide[..., None], first.direction, second.direction),
    )
