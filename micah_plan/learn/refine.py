"""Maximum-likelihood refinement of a joint on SE(3), and the covariance of its parameters.

Every row has its own configuration, which the inverse kinematics profiles out; what remains is least squares over the
motions that a joint can be moved by: one of the base side (moves the axis), one of the part side (moves the origin)
and the pitch. Their redundancy (the motions along the joint itself) is left to the pseudo-inverse, so that one
parametrisation serves all kinds and has no singularity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.joint import (
    Joint,
    JointKind,
    ParameterCovariance,
    axis_basis,
    prismatic,
    revolute,
    rigid,
    screw,
)
from micah_plan.automaton.kinematics import forward, inverse, jacobian, origin

Floats = NDArray[np.float64]

_NULL = 1e-9  # directions of less relative information are gauge
_CONVERGED = 1e-5


@dataclass(frozen=True, eq=False)
class Residuals:
    """Rows compared with a joint (n rows).

    Attributes:
        configuration: (n,) [rad or m].
        error: (n, 6) measured minus model: rotation vector, base frame [rad], and position [m].
        expected: (n,) poses of the model.
    """

    configuration: Floats
    error: Floats
    expected: RigidTransform


def compare(joint: Joint, position: Floats, rotation: Rotation | None, rotation_length: float) -> Residuals:
    """Residuals of rows at their closest configurations; rotation errors are 0 where orientation is not measured."""
    c = inverse(joint, position, rotation, rotation_length)
    expected = forward(joint, c)
    error = np.zeros((len(position), 6))
    if rotation is not None:
        error[:, :3] = (rotation * expected.rotation.inv()).as_rotvec()
    error[:, 3:] = position - expected.translation
    return Residuals(c, error, expected)


def refine(
    joint: Joint,
    position: Floats,
    rotation: Rotation | None,
    weight: Floats,
    stds: tuple[float, float],
    iterations: int = 8,
) -> Joint:
    """The joint of least weighted squared error, by damped Gauss-Newton from a start.

    Args:
        joint: where to start; its kind is kept.
        position, rotation: (n, 3) [m] and (n,) rows; rotation None if not measured.
        weight: (n,) of the rows.
        stds: noise of a rotation [rad] and of a position [m].
        iterations: most steps taken.
    """
    length = stds[1] / stds[0]
    scale = 1 / np.repeat(stds, 3)
    residuals = compare(joint, position, rotation, length)
    cost = _cost(residuals, weight, scale)
    damping = 1e-6
    for _ in range(iterations):
        design = _design(joint, residuals, scale, rotation is not None)
        weighted = design * weight[:, None, None]
        information = np.einsum("tki,tkj->ij", weighted, design)
        pull = np.einsum("tki,tk->i", weighted, residuals.error * scale)
        step = np.linalg.pinv(information + damping * np.diag(np.diag(information)), rcond=_NULL, hermitian=True) @ pull
        trial = moved(joint, step)
        if trial is None:
            damping = max(damping, 1e-6) * 100
            continue
        after = compare(trial, position, rotation, length)
        trial_cost = _cost(after, weight, scale)
        if trial_cost > cost:
            damping = max(damping, 1e-6) * 100
            continue
        gain = cost - trial_cost
        joint, residuals, cost, damping = trial, after, trial_cost, damping / 10
        if gain <= _CONVERGED * max(cost, 1.0):
            break
    return joint


def moved(joint: Joint, step: Floats) -> Joint | None:
    """A joint moved by (13,): base-side twist (6), part-side twist (6), change of pitch; None if that is no joint."""
    if not np.isfinite(step).all() or np.abs(step).max() > 1e3:
        return None
    base, part = RigidTransform.from_exp_coords(step[:6]), RigidTransform.from_exp_coords(step[6:12])
    pose = base * part * origin(joint)
    position, quaternion = pose.translation, pose.rotation.as_quat()
    if joint.kind == "rigid":
        return rigid(position, quaternion, joint.held)
    axis = base.rotation.apply(joint.axis)
    if joint.kind == "prismatic":
        return prismatic(axis, position, quaternion)
    point = base.apply(joint.center)
    if joint.kind == "revolute":
        return revolute(axis, point, position, quaternion)
    return screw(axis, point, joint.pitch + float(step[12]), position, quaternion)


def with_covariance(
    joint: Joint, position: Floats, rotation: Rotation | None, weight: Floats, stds: tuple[float, float]
) -> Joint:
    """The refined joint with the covariance of its parameters.

    Errors of neighbouring rows are correlated (a tracker wanders), so the covariance is the sandwich with Bartlett's
    window over the rows (Newey and West 1987) around the Gauss-Newton information.
    """
    length = stds[1] / stds[0]
    scale = 1 / np.repeat(stds, 3)
    residuals = compare(joint, position, rotation, length)
    design = _design(joint, residuals, scale, rotation is not None)
    scores = np.einsum("tki,tk,t->ti", design, residuals.error * scale, weight)
    lags = round(len(position) ** 0.5)
    middle = scores.T @ scores
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        middle += (1 - lag / (lags + 1)) * (cross + cross.T)
    information = np.einsum("tki,tkj,t->ij", design, design, weight)
    spread = np.linalg.pinv(information, rcond=_NULL, hermitian=True)
    names, functional = _parameters(joint, rotation is not None)
    matrix = functional @ spread @ middle @ spread @ functional.T
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    matrix = (vectors * np.maximum(values, 0.0)) @ vectors.T
    rows = tuple(tuple(float(v) for v in row) for row in 0.5 * (matrix + matrix.T))
    return replace(joint, covariance=ParameterCovariance(names, rows))


def parameter_count(kind: JointKind, has_orientation: bool) -> int:
    """k of the BIC term: the numbers that fix a joint and where on it the segment starts."""
    if has_orientation:
        return {"rigid": 6, "prismatic": 8, "revolute": 10, "screw": 11}[kind]
    return {"rigid": 3, "prismatic": 5, "revolute": 7, "screw": 8}[kind]


def _cost(residuals: Residuals, weight: Floats, scale: Floats) -> float:
    return float(weight @ ((residuals.error * scale) ** 2).sum(axis=1))


def _design(joint: Joint, residuals: Residuals, scale: Floats, has_orientation: bool) -> Floats:
    """(n, 6, 13) derivative of the model's pose by `moved`'s step, whitened, free of the motion along the joint."""
    c, points = residuals.configuration, residuals.expected.translation
    n = len(c)
    design = np.zeros((n, 6, 13))
    design[:, :, :6] = _displacement_of(np.broadcast_to(np.eye(6), (n, 6, 6)), points)
    if joint.kind != "rigid":
        motion = residuals.expected * origin(joint).inv()
        design[:, :, 6:12] = _displacement_of(_adjoint(motion), points)
    if joint.kind == "screw":
        design[:, 3:, 12] = c[:, None] * np.array(joint.axis)
    if not has_orientation:
        design[:, :3] = 0.0
        # Without orientations the origin's is not a parameter; a part-side turn would be seen as a shift.
        design[:, :, 6:9] = 0.0
    design *= scale[:, None]
    if joint.kind == "rigid":
        return design
    along = jacobian(joint, c) * scale
    if not has_orientation:
        along[:, :3] = 0.0
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return np.asarray(design - along[:, :, None] * np.einsum("tk,tki->ti", along, design)[:, None, :])


def _displacement_of(twists: Floats, points: Floats) -> Floats:
    """Twists (n, 6, k) as [rotation, displacement of the point (n, 3)]: ω and v + ω × p."""
    result = twists.copy()
    result[:, 3:] += np.cross(twists[:, :3], points[:, :, None], axis=1)
    return result


def _adjoint(motion: RigidTransform) -> Floats:
    """(n, 6, 6) of twists [rotation, translation]: ω -> R ω, v -> R v + t × R ω."""
    matrix = motion.rotation.as_matrix()
    result = np.zeros((len(matrix), 6, 6))
    result[:, :3, :3] = result[:, 3:, 3:] = matrix
    result[:, 3:, :3] = np.cross(motion.translation[:, :, None], matrix, axis=1)
    return result


def _parameters(joint: Joint, has_orientation: bool) -> tuple[tuple[str, ...], Floats]:
    """Names of a joint's parameters and their derivative (k, 13) by `moved`'s step."""
    start = np.array(joint.position)
    pose = np.zeros((6, 13))
    pose[:, :6] = pose[:, 6:12] = _displacement_of(np.eye(6)[None], start[None])[0]
    names: list[str] = []
    rows: list[Floats] = []
    if joint.kind != "rigid":
        basis = axis_basis(joint.axis)
        tilt = np.zeros((2, 13))
        tilt[:, :3] = basis
        names += ["axis_1", "axis_2"]
        rows.append(tilt)
        if joint.kind != "prismatic":
            shift = np.zeros((2, 13))
            shift[:, :6] = basis @ _displacement_of(np.eye(6)[None], np.array(joint.center)[None])[0][3:]
            names += ["center_1", "center_2"]
            rows.append(shift)
        if joint.kind == "screw":
            names.append("pitch")
            rows.append(np.eye(13)[12:])
        along = jacobian(joint, 0.0)[0]
        if not has_orientation:
            along[:3] = 0.0
        along /= max(float(np.linalg.norm(along)), 1e-12)
        pose = pose - np.outer(along, along @ pose)
    if has_orientation:
        names += ["rotation_1", "rotation_2", "rotation_3"]
        rows.append(pose[:3])
    names += ["position_1", "position_2", "position_3"]
    rows.append(pose[3:])
    return tuple(names), np.vstack(rows)
