"""Joints: rigid, prismatic, revolute and screw, as one-parameter motions f(c) = exp(c ξ) ∘ origin; and any path.

The first four are the same motion with another twist ξ, so one value and one set of functions serve them (Sturm et al.,
JAIR 2011, for the models; Murray, Li and Sastry, "A Mathematical Introduction to Robotic Manipulation", ch. 2 and 3,
for the product of exponentials). A path has poses at knots instead (`automaton.path`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, shown

JointKind = Literal["rigid", "prismatic", "revolute", "screw", "path"]
_AXIS, _CENTER = ("axis_1", "axis_2"), ("center_1", "center_2")
Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Freedom:
    """Properties of a kind of joint; formulas are shared by all kinds otherwise.

    Attributes:
        moves, turns, climbs: whether its part moves at all, about an axis, and along that axis while it turns.
        unit: of its configuration.
        parameters: of the joint besides the pose of its part (see `ParameterCovariance`).
    """

    moves: bool
    turns: bool
    climbs: bool
    unit: str
    parameters: tuple[str, ...] = ()


KINDS: dict[JointKind, Freedom] = {
    "rigid": Freedom(False, False, False, ""),
    "prismatic": Freedom(True, False, False, "m", _AXIS),
    "revolute": Freedom(True, True, False, "rad", _AXIS + _CENTER),
    "screw": Freedom(True, True, True, "rad", (*_AXIS, *_CENTER, "pitch")),
    "path": Freedom(True, False, False, "m"),
}
JOINT_KINDS: tuple[JointKind, ...] = tuple(KINDS)
SCREW_KINDS = JOINT_KINDS[:4]  # those with a constant twist


@dataclass(frozen=True)
class ParameterCovariance:
    """Covariance of a joint's parameters.

    Attributes:
        names: among ``axis_1, axis_2`` [rad] (tilts of the axis about the two directions of `axis_basis`),
            ``center_1, center_2`` [m] (shifts of the centre along them), ``pitch`` [m/rad],
            ``rotation_1..3`` [rad] and ``position_1..3`` [m] (of the origin pose, base frame).
        matrix: (k, k), symmetric positive semi-definite, in the units above.
    """

    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Joint:
    """A one-degree-of-freedom (or rigid) connection of a part to its base.

    Attributes:
        kind: rigid, prismatic, revolute, screw or path.
        position: origin of the part in the base frame at configuration 0 [m] (rigid: at all times).
        quaternion: orientation of the part at configuration 0, scalar last.
        axis: unit vector of motion or rotation in the base frame; (0, 0, 0) for rigid and path.
        center: point on the axis of rotation closest to `position` [m]; (0, 0, 0) without a rotation.
        pitch: translation along the axis per angle [m/rad]; 0 unless screw.
        fixed_at: configuration at which a rigid joint fixes its part [rad or m]; 0 for others.
        covariance: of the parameters, if they were estimated.
        knots: of a path: configurations with the part's position and quaternion there; () for others.

    The configuration c is in rad for revolute and screw, in m for prismatic and path.
    """

    kind: JointKind
    position: Vector3
    quaternion: Quaternion = IDENTITY
    axis: Vector3 = (0.0, 0.0, 0.0)
    center: Vector3 = (0.0, 0.0, 0.0)
    pitch: float = 0.0
    fixed_at: float = 0.0
    covariance: ParameterCovariance | None = None
    knots: tuple[tuple[float, ...], ...] = ()

    @property
    def moves(self) -> bool:
        """Whether its part moves."""
        return KINDS[self.kind].moves

    @property
    def has_axis(self) -> bool:
        """Whether its part moves along or about one axis, or both."""
        return self.moves and self.kind in SCREW_KINDS

    @property
    def turns(self) -> bool:
        """Whether its part turns about an axis."""
        return KINDS[self.kind].turns

    @property
    def slides(self) -> bool:
        """Whether its part moves along an axis without turning about it."""
        return self.has_axis and not self.turns

    @property
    def climbs(self) -> bool:
        """Whether its part moves along an axis while it turns about it."""
        return KINDS[self.kind].climbs

    @property
    def unit(self) -> str:
        """Unit of its configuration; none of a rigid one."""
        return KINDS[self.kind].unit


def rigid(position: ArrayLike, quaternion: ArrayLike = IDENTITY, fixed_at: float = 0.0) -> Joint:
    """A part that rests at a pose; `fixed_at` is the configuration of that pose [rad or m]."""
    return Joint("rigid", _vector(position, "position"), _unit_quaternion(quaternion), fixed_at=float(fixed_at))


def prismatic(axis: ArrayLike, position: ArrayLike, quaternion: ArrayLike = IDENTITY) -> Joint:
    """A part that slides along `axis` (any length but 0) from `position` [m]."""
    return twisting("prismatic", axis, position, 0.0, position, quaternion)


def revolute(axis: ArrayLike, point: ArrayLike, position: ArrayLike, quaternion: ArrayLike = IDENTITY) -> Joint:
    """A part that turns about the line through `point` along `axis` (right-handed), at `position` at configuration 0.

    Any point of the line will do: the joint's centre is the one closest to `position`.
    """
    return twisting("revolute", axis, point, 0.0, position, quaternion)


def screw(
    axis: ArrayLike, point: ArrayLike, pitch: float, position: ArrayLike, quaternion: ArrayLike = IDENTITY
) -> Joint:
    """A part that turns as a revolute one and moves `pitch` [m/rad] along the axis while it turns."""
    return twisting("screw", axis, point, float(pitch), position, quaternion)


def twisting(
    kind: JointKind, axis: ArrayLike, point: ArrayLike, pitch: float, position: ArrayLike, quaternion: ArrayLike
) -> Joint:
    """The joint of a constant twist by kind; arguments that the kind does not have are ignored."""
    if not KINDS[kind].moves:
        return rigid(position, quaternion)
    direction, origin = _direction(axis), _vector(position, "position")
    center = (0.0, 0.0, 0.0)
    if KINDS[kind].turns:
        through = np.array(_vector(point, "point"))
        along = np.dot(np.subtract(origin, through), direction) * np.array(direction)
        center = _vector(through + along, "center")
    return Joint(
        kind, origin, _unit_quaternion(quaternion), direction, center, float(pitch) if KINDS[kind].climbs else 0.0
    )


def radius(joint: Joint) -> float:
    """Distance of the part's origin from the axis of rotation [m]; 0 for joints that do not rotate."""
    if not joint.turns:
        return 0.0
    return float(np.linalg.norm(np.subtract(joint.position, joint.center)))


def axis_std(joint: Joint) -> float:
    """Std of the axis' tilt in its least certain direction [rad]; 0 if unknown."""
    number = _numbers(joint)
    tilts = [number[name] for name in ("axis_1", "axis_2") if name in number]
    if joint.covariance is None or not tilts:
        return 0.0
    return float(np.sqrt(max(np.linalg.eigvalsh(np.array(joint.covariance.matrix)[np.ix_(tilts, tilts)])[-1], 0.0)))


def radius_std(joint: Joint) -> float:
    """Std of the radius [m]; 0 if unknown."""
    if joint.covariance is None or radius(joint) == 0.0:
        return 0.0
    outwards = np.subtract(joint.position, joint.center) / radius(joint)
    first, second = axis_basis(joint.axis)
    slopes = {"center_1": -first @ outwards, "center_2": -second @ outwards}
    slopes |= {f"position_{i + 1}": outwards[i] for i in range(3)}
    slope = np.array([slopes.get(name, 0.0) for name in joint.covariance.names])
    return float(np.sqrt(max(slope @ np.array(joint.covariance.matrix) @ slope, 0.0)))


def _numbers(joint: Joint) -> dict[str, int]:
    return {} if joint.covariance is None else {name: i for i, name in enumerate(joint.covariance.names)}


def axis_basis(axis: ArrayLike) -> Floats:
    """(2, 3) unit vectors b1, b2 normal to an axis, with b1 x b2 = axis; the covariance of parameters refers to them.

    b1 is the base direction least aligned with the axis, crossed with the axis; so the basis of -axis is (-b1, b2).
    """
    # By hand: for one vector NumPy's functions take fifty times as long.
    a = _direction(axis)
    i = min(range(3), key=lambda j: abs(a[j]))
    j, k = (i + 1) % 3, (i + 2) % 3
    length = math.hypot(a[j], a[k])
    b1 = [0.0, 0.0, 0.0]
    b1[j], b1[k] = -a[k] / length, a[j] / length
    b2 = (a[1] * b1[2] - a[2] * b1[1], a[2] * b1[0] - a[0] * b1[2], a[0] * b1[1] - a[1] * b1[0])
    return np.array([b1, b2])


def _vector(value: ArrayLike, name: str) -> Vector3:
    array = np.asarray(value, dtype=float)
    if array.shape != (3,) or not all(map(math.isfinite, array.tolist())):
        raise InputError(f"{name} must be 3 finite numbers. Got {shown(value)}")
    x, y, z = array.tolist()
    return (x, y, z)


def _direction(value: ArrayLike) -> Vector3:
    array = np.array(_vector(value, "axis"))
    length = float(np.linalg.norm(array))
    if length < 1e-12:
        raise InputError(f"axis must not be zero. Got {shown(value)}")
    return _vector(array / length, "axis")


def _unit_quaternion(value: ArrayLike) -> Quaternion:
    array = np.asarray(value, dtype=float)
    if array.shape != (4,) or not np.isfinite(array).all() or np.linalg.norm(array) < 1e-12:
        raise InputError(f"quaternion must be 4 finite numbers (scalar last), not all zero. Got {shown(value)}")
    x, y, z, w = (float(v) for v in array / np.linalg.norm(array))
    return (x, y, z, w)
