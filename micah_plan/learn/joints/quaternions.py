"""Products of quaternions (scalar last) over arrays of any shape, without SciPy's objects."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_TINY = 1e-12


def times(a: Floats, b: Floats) -> Floats:
    """(..., 4) products a b: the rotation b followed by a."""
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + cross(a[..., :3], b[..., :3])
    scalar = a[..., 3:] * b[..., 3:] - np.sum(a[..., :3] * b[..., :3], axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def times_matrix(right: Floats) -> Floats:
    """(4, 4) matrix M with q M = q right for rows q, by the quaternion (4,) on the right."""
    x, y, z, w = right.tolist()
    return np.array([[w, -z, y, -x], [z, w, -x, -y], [-y, x, w, -z], [x, y, z, w]])


def conjugate(q: Floats) -> Floats:
    """(..., 4) inverses of unit quaternions."""
    return np.asarray(q * np.array([-1.0, -1.0, -1.0, 1.0]))


def rotation_vector(q: Floats) -> Floats:
    """(..., 3) rotation vectors [rad] of the shorter way, whatever the sign of q."""
    q = np.where(q[..., 3:] < 0, -q, q)
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, q[..., 3:])
    return np.asarray(q[..., :3] * np.where(length > _TINY, angle / np.maximum(length, _TINY), 2.0))


def rotated(quaternion: Floats, vector: Floats) -> Floats:
    """Vectors (..., 3) turned by unit quaternions (..., 4)."""
    double = 2 * cross(quaternion[..., :3], vector)
    return np.asarray(vector + quaternion[..., 3:] * double + cross(quaternion[..., :3], double))


def rotation_quaternion(vector: Floats) -> Floats:
    """Unit quaternions (..., 4) of rotation vectors (..., 3) [rad]."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(angle / (2 * np.pi)) * vector, np.cos(0.5 * angle)], axis=-1)


def cross(a: Floats, b: Floats) -> Floats:
    """Cross products (..., 3): like np.cross without its overhead."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )
