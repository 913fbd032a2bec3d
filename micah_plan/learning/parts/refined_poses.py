"""Poses of a part refined by the edge to its parent."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.ndimage import median_filter
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import ROUND_OFF, STDS_PER_MAD, Floats
from micah_plan.automaton.graph import KinematicEdge
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward, inverse, inverse_jacobian
from micah_plan.learning.parts.relative import RelativeRows

_WINDOW = 7  # rows of the running median
_FEWEST_ROWS = 8  # to smooth
_OUTLIER_STDS = 5.0  # from the running median


def branch_poses(edge: KinematicEdge, relative: RelativeRows, poses: RigidTransform) -> RigidTransform:
    """Poses in which those of an edge's child are projected on the edge.

    A part on a joint can only be where its joint allows: projected onto it (f ∘ f⁻¹) a measured pose keeps one of its
    six errors, and that one is reduced by smoothing the part of the segment's configurations that the actions do not
    explain. A rigid segment keeps none. If no joint explains how the part moves, all six are smoothed.

    Args:
        edge: learned from `relative`; its rows count within `relative.recording`.
        relative: with the frames of the parent to which the edge's poses are relative.
        poses: (n,) of the whole recording, base frame.

    Returns:
        (n,) poses, base frame; rows that no segment covers are as they were.
    """
    position, quaternion = poses.translation.copy(), poses.rotation.as_quat()
    relative_poses, seen_action = relative.recording.poses(), relative.recording.action
    for segment in edge.segments:
        index = slice(segment.start, segment.end + 1)
        if segment.no_single_joint is not None:
            local = _smoothed_freely(relative_poses[index])
        else:
            rotation = relative_poses.rotation[index] if relative.recording.has_orientation else None
            c = inverse(segment.joint, relative_poses.translation[index], rotation)
            if segment.joint.kind == "revolute":
                c = np.unwrap(c)
            if segment.joint.moves:
                commanded = (
                    np.zeros(len(c)) if seen_action is None else _commanded(segment.joint, c, seen_action[index])
                )
                c = commanded + _smoothed(c - commanded)
            local = forward(segment.joint, c)
        poses = relative.frames[index] * local
        rows = relative.rows[index]
        position[rows] = poses.translation
        quaternion[rows] = poses.rotation.as_quat()
    return RigidTransform.from_components(position, Rotation.from_quat(quaternion))


def _smoothed_freely(poses: RigidTransform) -> RigidTransform:
    """(k,) poses, each of their six coordinates smoothed."""
    middle = poses.rotation[len(poses) // 2]
    turned = np.unwrap((middle.inv() * poses.rotation).as_rotvec(), axis=0)
    position = np.stack([_smoothed(axis) for axis in poses.translation.T.copy()], axis=1)
    rotation = middle * Rotation.from_rotvec(np.stack([_smoothed(axis) for axis in turned.T.copy()], axis=1))
    return RigidTransform.from_components(position, rotation)


def _commanded(joint: Joint, c: Floats, action: Floats) -> Floats:
    """(k,) configurations integrated from the actions, up to a constant and scaled by how far they are followed."""
    asked = np.nan_to_num(inverse_jacobian(joint, c, action))[:-1]
    followed = float(asked @ np.diff(c)) / max(float(asked @ asked), 1e-12)
    return np.concatenate([[0.0], np.cumsum(followed * asked)])


def _smoothed(c: Floats) -> Floats:
    """Robust smoothing spline through configurations, with generalised cross-validation."""
    if len(c) < _FEWEST_ROWS:
        return c
    miss = c - median_filter(c, size=_WINDOW, mode="nearest")
    outlying = np.abs(miss) > _OUTLIER_STDS * max(STDS_PER_MAD * float(np.median(np.abs(miss))), ROUND_OFF)
    outlying[[0, -1]] = False
    rows = np.arange(len(c), dtype=float)
    clean = np.interp(rows, rows[~outlying], c[~outlying])
    if np.ptp(clean) < ROUND_OFF:
        return np.asarray(clean)
    return np.asarray(make_smoothing_spline(rows, clean)(rows))
