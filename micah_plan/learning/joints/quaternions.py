"""Products of quaternions (scalar last) over arrays of any shape, without SciPy's objects."""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import TINY, Floats

# against division by 0
_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
# Of the matrix of a product: which number of the right quaternion, and its sign.
_NUMBER = np.array([[3, 2, 1, 0], [2, 3, 0, 1], [1, 0, 3, 2], [0, 1, 2, 3]])
_SIGN = np.array([[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0], [-1.0, 1.0, 1.0, -1.0], [1.0, 1.0, 1.0, 1.0]])
# The same of the matrix of a cross product: row i is the i-th unit vector times the vector.
_OTHER = np.array([[0, 2, 1], [2, 1, 0], [1, 0, 2]])
_SIDE = np.array([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def times(a: Floats, b: Floats) -> Floats:
    """(..., 4) products a b: the rotation b followed by a."""
    return np.asarray(np.einsum("...i,...ij->...j", a, times_matrix(b)))


def times_matrix(right: Floats) -> Floats:
    """(..., 4, 4) matrices M with q M = q right for rows q, by quaternions (..., 4) on the right."""
    return np.asarray(right[..., _NUMBER] * _SIGN)


def cross_matrix(vectors: Floats) -> Floats:
    """(..., 3, 3) matrices M with M u = v x u, of vectors v (..., 3)."""
    return np.asarray(vectors[..., _OTHER] * _SIDE)


def cross_of_units(vectors: Floats) -> Floats:
    """(..., 3, 3, n) cross products of the unit vectors (last but one) with vectors (..., 3, n)."""
    return np.asarray(vectors[..., _OTHER, :] * -_SIDE[..., None])


def conjugate(q: Floats) -> Floats:
    """(..., 4) inverses of unit quaternions."""
    return np.asarray(q * _CONJUGATE)


def rotation_vector(q: Floats) -> Floats:
    """(..., 3) rotation vectors [rad] of at most half a turn, independent of the sign of q."""
    vector, scalar = q[..., :3], q[..., 3]
    return np.asarray(vector * _turn_per_sine(np.einsum("...i,...i->...", vector, vector), scalar)[..., None])


def rotation_vectors(q: Floats) -> Floats:
    """Rotation vectors of quaternions (..., 4, n) with rows last: (..., 3, n)."""
    vector, scalar = q[..., :3, :], q[..., 3, :]
    return np.asarray(vector * _turn_per_sine((vector**2).sum(axis=-2), scalar)[..., None, :])


def _turn_per_sine(square: Floats, scalar: Floats) -> Floats:
    """Factor from a quaternion's vector part to its rotation vector."""
    length = np.sqrt(square)
    angle = 2 * np.arctan2(length, np.abs(scalar))
    return np.copysign(np.where(length > TINY, angle / np.maximum(length, TINY), 2.0), scalar)


def rotated(quaternion: Floats, vector: Floats) -> Floats:
    """Vectors (..., 3) turned by unit quaternions (..., 4)."""
    double = 2 * cross_products(quaternion[..., :3], vector)
    return np.asarray(vector + quaternion[..., 3:] * double + cross_products(quaternion[..., :3], double))


def rotation_quaternion(vector: Floats) -> Floats:
    """Unit quaternions (..., 4) of rotation vectors (..., 3) [rad]."""
    angle = np.sqrt((vector**2).sum(axis=-1, keepdims=True))
    return np.concatenate([0.5 * np.sinc(angle / (2 * np.pi)) * vector, np.cos(0.5 * angle)], axis=-1)


def rotation_matrix(q: Floats) -> Floats:
    """(..., 3, 3) matrices of unit quaternions (..., 4)."""
    squares = (q[..., :, None] * q[..., None, :]).reshape(*q.shape[:-1], 16)
    return np.asarray((squares @ _ENTRIES).reshape(*q.shape[:-1], 3, 3))


def cross_products(a: Floats, b: Floats) -> Floats:
    """Cross products (..., 3): like np.cross without its overhead."""
    return np.asarray(a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT])


def _entries() -> Floats:
    """(16, 9) matrix entries by products of two components: (w² - v'v) I + 2 v v' + 2 w [v]x."""
    unit = np.eye(3)
    entries = np.zeros((4, 4, 3, 3))
    entries[:3, :3] = 2 * np.einsum("ia,jb->ijab", unit, unit) - np.einsum("ij,ab->ijab", unit, unit)
    entries[3, 3], entries[3, :3] = unit, 2 * cross_matrix(unit)
    return entries.reshape(16, 9)


_ENTRIES = _entries()
