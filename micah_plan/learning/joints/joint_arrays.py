"""Many joints as arrays: h joints of any kinds, one row each, so that a pool is compared, moved and fitted at once.

**Residuals.** Many joints compared with all rows of a track at once, in plain arrays.

The same closed forms as automaton.kinematics (MICAH, section II-B), over (h, n) arrays instead of SciPy's transforms:
a pool of joints against a few hundred rows is then a handful of array operations.

**Quaternions.** Their products (scalar last) over arrays of any shape, without SciPy's objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import TINY, Booleans, Floats, Ints
from micah_plan.automaton.joint import KINDS, Joint, JointKind, twisting
from micah_plan.automaton.kinematics import balanced


@dataclass(frozen=True, eq=False)
class JointArrays:
    """h joints.

    Attributes:
        kinds: (h,) kinds.
        axis, center, position: (h, 3) unit vector, a point of the axis [m] and origin at configuration 0 [m].
        quaternion: (h, 4) orientation at configuration 0, scalar last.
        pitch: (h,) [m/rad]; 0 unless screw.
    """

    kinds: tuple[JointKind, ...]
    axis: Floats
    center: Floats
    position: Floats
    quaternion: Floats
    pitch: Floats

    def __len__(self) -> int:
        return len(self.kinds)

    @cached_property
    def moving(self) -> Booleans:
        """(h,) which are not rigid."""
        return np.array([KINDS[kind].moves for kind in self.kinds], dtype=bool)

    @cached_property
    def turning(self) -> Booleans:
        """(h,) which rotate."""
        return np.array([KINDS[kind].turns for kind in self.kinds], dtype=bool)

    @cached_property
    def twisting(self) -> Booleans:
        """(h,) which have a pitch."""
        return np.array([KINDS[kind].climbs for kind in self.kinds], dtype=bool)

    def take(self, index: Sequence[int] | NDArray[np.int64]) -> JointArrays:
        """Some of the joints."""
        i = np.asarray(index, dtype=np.int64)
        kinds = tuple(self.kinds[j] for j in i)
        return JointArrays(kinds, self.axis[i], self.center[i], self.position[i], self.quaternion[i], self.pitch[i])

    def joint(self, i: int) -> Joint:
        """One of them as a joint."""
        fixed = self.axis[i], self.center[i], float(self.pitch[i])
        return twisting(self.kinds[i], *fixed, self.position[i], self.quaternion[i])

    def moved(self, step: Floats) -> JointArrays:
        """The joints moved by (h, 13): a base-side and a part-side displacement (6 each) and a change of pitch.

        A displacement is a rotation vector about the base's origin and a translation; those of the base side carry
        the axis along, those of the part side act first and move only the part's origin.
        """
        base, part = rotation_quaternion(np.stack([step[:, :3], step[:, 6:9]]))
        origin = rotated(part, self.position) + step[:, 9:12]
        # Of every joint: its axis, a point of it and its origin, carried along by the base side.
        carried = rotated(base, np.stack([self.axis, self.center, origin]))
        axis = carried[0] / np.where(self.moving, np.sqrt((carried[0] ** 2).sum(axis=1)), 1.0)[:, None]
        center = np.where(self.turning[:, None], carried[1] + step[:, 3:6], 0.0)
        quaternion = times(base, times(part, self.quaternion))
        quaternion /= np.sqrt((quaternion**2).sum(axis=1))[:, None]
        pitch = np.where(self.twisting, self.pitch + step[:, 12], 0.0)
        return JointArrays(self.kinds, axis, center, carried[2] + step[:, 3:6], quaternion, pitch)

    def where(self, condition: Booleans, alternative: JointArrays) -> JointArrays:
        """These joints where a condition (h,) holds, the other ones (of the same kinds) elsewhere."""
        wide = condition[:, None]
        return JointArrays(
            self.kinds,
            np.where(wide, self.axis, alternative.axis),
            np.where(wide, self.center, alternative.center),
            np.where(wide, self.position, alternative.position),
            np.where(wide, self.quaternion, alternative.quaternion),
            np.where(condition, self.pitch, alternative.pitch),
        )


def arrays_of(joints: Sequence[Joint]) -> JointArrays:
    """Joints as arrays."""
    return JointArrays(
        tuple(joint.kind for joint in joints),
        np.array([joint.axis for joint in joints]).reshape(-1, 3),
        np.array([joint.center for joint in joints]).reshape(-1, 3),
        np.array([joint.position for joint in joints]).reshape(-1, 3),
        np.array([joint.quaternion for joint in joints]).reshape(-1, 4),
        np.array([joint.pitch for joint in joints]).reshape(-1),
    )


def concatenated_joints(several: Sequence[JointArrays]) -> JointArrays:
    """All of their joints, one after another."""
    names = ("axis", "center", "position", "quaternion", "pitch")
    arrays = (np.concatenate([getattr(part, name) for part in several]) for name in names)
    return JointArrays(tuple(kind for part in several for kind in part.kinds), *arrays)


_TELLING_PITCH = 0.05 / (2 * np.pi)  # m/rad


@dataclass(frozen=True, eq=False)
class Compared:
    """All n rows as h joints see them, d = 6 [rotation vector (rad), position (m)] or 3 where only positions exist.

    Attributes:
        configuration: (h, n) closest configurations [rad or m], 0 for rigid.
        error: (h, d, n) measured minus model, base frame. Rows last: NumPy is slow at rows of three numbers.
        direction: (h, d, n) J, the derivative of the model's pose by the configuration; 0 for rigid.
    """

    configuration: Floats
    error: Floats
    direction: Floats

    def rows(self, index: Ints) -> Compared:
        """Some rows (h, k) of each joint."""
        wide = index[:, None]
        return Compared(
            np.take_along_axis(self.configuration, index, axis=1),
            np.take_along_axis(self.error, wide, axis=2),
            np.take_along_axis(self.direction, wide, axis=2),
        )

    def take(self, index: Ints | Booleans | slice) -> Compared:
        """Some of the joints."""
        return Compared(self.configuration[index], self.error[index], self.direction[index])

    def where(self, condition: Booleans, alternative: Compared) -> Compared:
        """These joints where a condition (h,) holds, the other ones elsewhere."""
        narrow, wide = condition[:, None], condition[:, None, None]
        return Compared(
            np.where(narrow, self.configuration, alternative.configuration),
            np.where(wide, self.error, alternative.error),
            np.where(wide, self.direction, alternative.direction),
        )


def compare_all(
    joints: Sequence[Joint], position: Floats, quaternion: Floats | None, rotation_length: float
) -> Compared:
    """Closest configurations, errors and directions of motion of rows (n, 3), (n, 4) under every joint."""
    return compare_arrays(arrays_of(joints), position, quaternion, rotation_length)


def compare_arrays(
    joints: JointArrays, position: Floats, quaternion: Floats | None, rotation_length: float | Floats
) -> Compared:
    """The same for joints that are arrays already.

    Args:
        joints: the h joints.
        position, quaternion: (n, 3) [m] and (n, 4) rows, or (h, n, 3) and (h, n, 4) of each joint its own; quaternion
            None if not measured.
        rotation_length: what weighs rotation against position in "closest" [m/rad], one number or one per joint (h, 1).
    """
    turning, moving = joints.turning, joints.moving
    arm = joints.position - joints.center
    arm = (arm - np.sum(arm * joints.axis, axis=1, keepdims=True) * joints.axis) * turning[:, None]
    # Of every joint: its axis, and the arm from it to the origin with the direction in which that turns.
    basis = np.stack([joints.axis, arm, cross_products(joints.axis, arm)], axis=1)
    from_start = np.ascontiguousarray(position.swapaxes(-1, -2)) - joints.position[..., None]
    along, real, imaginary = (basis @ from_start).swapaxes(0, 1)
    real += np.sum(arm**2, axis=1, keepdims=True)
    relative = None
    if quaternion is not None:
        # Of every row: its rotation from the start, and the same followed by half a turn back about the axis.
        start = times_matrix(conjugate(joints.quaternion))
        back = times_matrix(np.concatenate([-joints.axis, np.zeros((len(joints), 1))], axis=1))
        relative = np.concatenate([start, start @ back], axis=2).swapaxes(1, 2) @ quaternion.swapaxes(-1, -2)
        scalar, twist = relative[:, 3], relative[:, 7]
        real += rotation_length**2 * (scalar**2 - twist**2)
        imaginary += rotation_length**2 * 2 * scalar * twist
    weight = np.sqrt(real**2 + imaginary**2)
    angle = np.where(turning[:, None] & (weight > TINY), np.arctan2(imaginary, real), 0.0)
    pitched = np.flatnonzero(np.abs(joints.pitch) > 1e-7)
    if len(pitched):
        pitch = joints.pitch[pitched, None]
        # Whole turns only where the pitch is large against noise; a small one is left to continuity.
        turns = np.round((along[pitched] / pitch - angle[pitched]) / (2 * np.pi))
        counted = angle[pitched] + 2 * np.pi * np.where(np.abs(pitch) > _TELLING_PITCH, turns, 0.0)
        angle[pitched] = balanced(counted, weight[pitched], along[pitched], pitch)
    if angle.size:
        angle = _unwrapped(angle)
    half_sine, half_cosine = np.sin(0.5 * angle), np.cos(0.5 * angle)
    sliding = moving & ~turning
    configuration = np.where(sliding[:, None], along, angle)
    h, n = angle.shape
    # The way from the start, and the direction of motion, along the basis.
    way = np.empty((h, 3, 2, n))
    rate = np.where(turning, joints.pitch, sliding)[:, None]
    way[:, 2, 0], way[:, 1, 0], way[:, 0, 1] = 2 * half_sine * half_cosine, -2 * half_sine**2, rate
    way[:, 0, 0], way[:, 1, 1], way[:, 2, 1] = rate * configuration, -way[:, 2, 0], 1 + way[:, 1, 0]
    moved = (basis.swapaxes(1, 2) @ way.reshape(h, 3, 2 * n)).reshape(h, 3, 2, n)
    if relative is None:
        return Compared(configuration, from_start - moved[:, :, 0], moved[:, :, 1])
    error, direction = np.empty((h, 6, n)), np.empty((h, 6, n))
    np.subtract(from_start, moved[:, :, 0], out=error[:, 3:])
    residual = half_cosine[:, None] * relative[:, :4] + half_sine[:, None] * relative[:, 4:]
    error[:, :3] = rotation_vectors(residual)
    direction[:, :3], direction[:, 3:] = (turning[:, None] * joints.axis)[..., None], moved[:, :, 1]
    return Compared(configuration, error, direction)


def _unwrapped(angle: Floats) -> Floats:
    """Angles (h, n) without jumps of more than half a turn, as `np.unwrap` has them."""
    turns = np.round(np.diff(angle, axis=1) / (2 * np.pi))
    if turns.any():
        angle = angle.copy()
        angle[:, 1:] -= 2 * np.pi * np.cumsum(turns, axis=1)
    return angle


def levers(joints: JointArrays, in_part: bool) -> Floats:
    """(h, 3) J⁻¹ for a displacement of the part's origin: configuration per displacement [rad or m per m].

    In the part's frame (`in_part`) the direction in which a joint moves the part's origin is constant (MICAH, section
    IV-A); in the base frame it is the one at configuration 0.
    """
    side = cross_products(joints.axis, joints.position - joints.center) + joints.pitch[:, None] * joints.axis
    direction = np.where(joints.turning[:, None], side, joints.axis)
    lever = direction / np.maximum(np.sum(direction**2, axis=1, keepdims=True), TINY)
    if not in_part:
        return np.asarray(lever)
    from_base = conjugate(joints.quaternion)
    return rotated(from_base, lever)


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
    """(..., 3) rotation vectors [rad] of the shorter way, whatever the sign of q."""
    vector, scalar = q[..., :3], q[..., 3]
    return np.asarray(vector * _turn_per_sine(np.einsum("...i,...i->...", vector, vector), scalar)[..., None])


def rotation_vectors(q: Floats) -> Floats:
    """The same of quaternions (..., 4, n) with rows last: (..., 3, n)."""
    vector, scalar = q[..., :3, :], q[..., 3, :]
    return np.asarray(vector * _turn_per_sine((vector**2).sum(axis=-2), scalar)[..., None, :])


def _turn_per_sine(square: Floats, scalar: Floats) -> Floats:
    """What a quaternion's vector, of such squared length, is multiplied with to be a rotation vector."""
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
