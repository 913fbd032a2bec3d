"""Closed-form joints: from all rows by linear least squares, and from the fewest rows that fix a joint.

With orientations every model is linear in the measured rotation matrices: a part-fixed point c_b on the axis stays put,
p_t + R_t c_b = c_w (+ pitch · angle along the axis), and the axis is the direction the relative rotations share. A
circle through positions alone is the fallback; it is biased on short arcs, so it only starts the refinement.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import IDENTITY, Joint, JointKind, prismatic, revolute, rigid, screw

Floats = NDArray[np.float64]

_TINY = 1e-9


def fit_closed_form(kind: JointKind, position: Floats, rotation: Rotation | None, weight: Floats) -> Joint | None:
    """The joint of a kind by weighted linear least squares.

    Args:
        position: (n, 3) [m].
        rotation: (n,) orientations of the part; None if not measured.
        weight: (n,) >= 0.

    Returns:
        the joint, its origin near the first row; None where the rows do not determine it (no motion, too few rows).
    """
    share = weight / weight.sum()
    mean = share @ position
    middle = None if rotation is None else rotation.mean(weights=weight)
    quaternion = IDENTITY if middle is None else middle.as_quat()
    if kind == "rigid":
        return rigid(mean, quaternion)
    if kind == "prismatic":
        direction = _principal((position - mean) * np.sqrt(share)[:, None])
        return None if direction is None else prismatic(direction, mean, quaternion)
    if rotation is None:
        return _circle(kind, position, share)
    turns = (rotation * Rotation.from_quat(quaternion).inv()).as_rotvec()
    axis = _principal(turns * np.sqrt(share)[:, None])
    if axis is None:
        return None
    point = _fixed_point(axis, position, rotation, share)
    if kind == "revolute":
        return revolute(axis, point, mean, quaternion)
    angle, along = turns @ axis, (position - mean) @ axis
    spread = share @ (angle - share @ angle) ** 2
    pitch = float(share @ ((angle - share @ angle) * along) / max(spread, _TINY))
    return screw(axis, point, pitch, mean, quaternion)


def fit_minimal(kind: JointKind, position: Floats, rotation: Rotation | None) -> Joint | None:
    """The joint through the fewest rows: 1 for rigid, 2 poses (3 positions for a circle) else; None if unfixed.

    Two poses fix any of these motions in closed form: their relative displacement is one screw (Chasles).
    """
    first = IDENTITY if rotation is None else rotation[0].as_quat()
    if kind == "rigid":
        return rigid(position[0], first)
    step = position[1] - position[0]
    if kind == "prismatic":
        return prismatic(step, position[0], first) if np.linalg.norm(step) > _TINY else None
    if rotation is None:
        return _circle(kind, position, np.full(len(position), 1 / len(position)))
    turn = (rotation[1] * rotation[0].inv()).as_rotvec()
    angle = float(np.linalg.norm(turn))
    if angle < 1e-6:
        return None
    axis = turn / angle
    across = step - (step @ axis) * axis
    point = position[0] + 0.5 * (across + np.cross(axis, across) / np.tan(angle / 2))
    if kind == "revolute":
        return revolute(axis, point, position[0], first)
    return screw(axis, point, float(step @ axis) / angle, position[0], first)


def minimal_rows(kind: JointKind, has_orientation: bool) -> int:
    """How many rows `fit_minimal` needs."""
    if kind == "rigid":
        return 1
    return 2 if kind == "prismatic" or has_orientation else 3


def _principal(rows: Floats) -> Floats | None:
    """Direction of greatest second moment of (n, 3) rows; None if they are all zero."""
    _, vectors = np.linalg.eigh(rows.T @ rows)
    direction = vectors[:, 2]
    return np.asarray(direction) if np.linalg.norm(rows @ direction) > _TINY else None


def _fixed_point(axis: Floats, position: Floats, rotation: Rotation, share: Floats) -> Floats:
    """A point of the axis, from p_t + R_t c_b = c_w across the axis; least norm fixes what c_b has along it."""
    across = np.eye(3) - np.outer(axis, axis)
    matrices = across @ rotation.as_matrix()
    mean_matrix = np.einsum("t,tij->ij", share, matrices)
    mean_position = across @ (share @ position)
    left = matrices - mean_matrix
    right = -(position @ across.T - mean_position)
    normal = np.einsum("t,tki,tkj->ij", share, left, left)
    pulled = np.einsum("t,tki,tk->i", share, left, right)
    in_part = np.linalg.pinv(normal, rcond=1e-6, hermitian=True) @ pulled
    point = mean_position + mean_matrix @ in_part
    return np.asarray(point + (share @ position @ axis) * axis)


def _circle(kind: JointKind, position: Floats, share: Floats) -> Joint | None:
    """The algebraic circle through positions (Coope 1993), in the plane of their greatest spread."""
    mean = share @ position
    centred = position - mean
    scaled = centred * np.sqrt(share)[:, None]
    _, vectors = np.linalg.eigh(scaled.T @ scaled)
    plane, axis = vectors[:, 1:], vectors[:, 0]
    flat = centred @ plane
    design = np.column_stack([2 * flat, np.ones(len(flat))]) * np.sqrt(share)[:, None]
    if np.linalg.matrix_rank(design, tol=1e-10) < 3:
        return None
    solution = np.linalg.lstsq(design, (flat**2).sum(axis=1) * np.sqrt(share), rcond=None)[0]
    point = mean + plane @ solution[:2]
    start = point + plane @ (flat[0] - solution[:2])
    if np.linalg.norm(start - point) < _TINY:
        return None
    return revolute(axis, point, start) if kind == "revolute" else screw(axis, point, 0.0, start)
