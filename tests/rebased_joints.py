"""Joints seen from another base, with their covariances: what the equivariance of learning is compared with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.joint import Joint, ParameterCovariance, axis_basis, prismatic, revolute, rigid, screw
from micah_plan.automaton.kinematics import origin

Floats = NDArray[np.float64]


def rebased(joint: Joint, transform: RigidTransform) -> Joint:
    """The same joint seen from another base: f'(c) = transform ∘ f(c). Rotates the covariance along.

    Args:
        transform: pose of the old base in the new base (single).
    """
    axis = transform.rotation.apply(joint.axis)
    moved = _rebuilt(joint, axis, transform.apply(joint.center), transform * origin(joint))
    return replace(moved, covariance=_rotated(joint, axis, transform.rotation))


def _rotated(joint: Joint, axis: Floats, rotation: Rotation) -> ParameterCovariance | None:
    """The covariance in a rotated base; None if one of a pair or triple of parameters is missing."""
    covariance = joint.covariance
    if covariance is None:
        return None
    turn = rotation.as_matrix()
    blocks: dict[str, Floats] = {"pitch": np.eye(1), "rotation": turn, "position": turn}
    if joint.kind != "rigid":
        in_plane = axis_basis(axis) @ turn @ axis_basis(joint.axis).T
        blocks |= {"axis": in_plane, "center": in_plane}
    names = covariance.names
    change = np.zeros((len(names), len(names)))
    for group, block in blocks.items():
        members = [group] if group == "pitch" else [f"{group}_{i + 1}" for i in range(len(block))]
        present = [name for name in members if name in names]
        if not present:
            continue
        if len(present) != len(members):
            return None
        index = [names.index(name) for name in members]
        change[np.ix_(index, index)] = block
    matrix = change @ np.array(covariance.matrix) @ change.T
    return ParameterCovariance(names, tuple(map(tuple, matrix.tolist())))


def _rebuilt(joint: Joint, axis: ArrayLike, point: ArrayLike, pose: RigidTransform) -> Joint:
    position, quaternion = pose.translation, pose.rotation.as_quat()
    if joint.kind == "rigid":
        return rigid(position, quaternion, joint.fixed_at)
    if joint.kind == "prismatic":
        return prismatic(axis, position, quaternion)
    if joint.kind == "revolute":
        return revolute(axis, point, position, quaternion)
    return screw(axis, point, joint.pitch, position, quaternion)
