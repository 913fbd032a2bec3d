"""Kinematics: f(c) of a joint, its unique inverse and Jacobians, vectorised over rows; where an automaton's parts are.

Sources: MICAH, section IV-A, for f, f⁻¹, J and J⁻¹; Murray, Li and Sastry, ch. 2 and 3, for twists.

Conventions: a twist or pose derivative is [rotation (3), translation (3)] in the base frame, the order of SciPy's
exponential coordinates. Where a pose is not on the joint's manifold, "closest" weighs position [m] against rotation
[rad] with `rotation_length` [m/rad]: at the default, 0.2 m/rad, an error of 1 degree weighs as much as 3.5 mm.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import TINY, Floats
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.joint import Joint, ParameterCovariance, axis_basis, twisting
from micah_plan.automaton.motion_of_joints import turns_and_translations
from micah_plan.automaton.path import along_path, closest_on_path, recounted
from micah_plan.errors import InputError

ROTATION_LENGTH = 0.2
_TURNS, _SHIFTS = ("rotation_1", "rotation_2", "rotation_3"), ("position_1", "position_2", "position_3")
_PARAMETERS = ("axis_1", "axis_2", "center_1", "center_2", "pitch", *_TURNS, *_SHIFTS)
_NO_PITCH = 1e-7
_MOST_ITERATIONS = 50


@lru_cache(maxsize=1024)
def twist(joint: Joint) -> Floats:
    """ξ (6,) = [rotation, translation], base frame: the motion per unit of configuration. Zero for rigid."""
    axis, center = np.array(joint.axis), np.array(joint.center)
    turning = np.concatenate([axis, _cross(center, axis) + joint.pitch * axis])
    xi = np.concatenate([np.zeros(3), axis]) if joint.kind == "prismatic" else turning
    xi.setflags(write=False)
    return xi


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross product of two vectors (3,), without NumPy's overhead."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


@lru_cache(maxsize=1024)
def origin(joint: Joint) -> RigidTransform:
    """Pose of the part in the base frame at configuration 0 (single)."""
    return RigidTransform.from_components(joint.position, Rotation.from_quat(joint.quaternion))


def forward(joint: Joint, c: ArrayLike) -> RigidTransform:
    """f(c) = exp(c ξ) ∘ origin: (k,) poses of the part in the base frame at the configurations c (k,) [rad or m]."""
    configurations = np.atleast_1d(np.asarray(c, dtype=float))
    if joint.kind == "path":
        there = along_path(joint, configurations)
        return RigidTransform.from_components(there.position, Rotation.from_quat(there.quaternion))
    return RigidTransform.from_exp_coords(configurations[:, None] * twist(joint)) * origin(joint)


def placements(joint: Joint, c: ArrayLike) -> Floats:
    """f(c) as homogeneous matrices (k, 4, 4), for c (k,) [rad or m].

    The same as `forward` by Rodrigues' formula, for loops that need a few poses many times: SciPy's transforms take a
    hundred times as long for one of them.
    """
    turn, translation = turns_and_translations(joint, c)
    moved = np.zeros((len(turn), 4, 4))
    moved[:, :3, :3] = turn @ _start(joint)
    moved[:, :3, 3], moved[:, 3, 3] = translation, 1.0
    return moved


@lru_cache(maxsize=1024)
def _start(joint: Joint) -> Floats:
    """(3, 3) orientation of the part at configuration 0."""
    return np.asarray(origin(joint).rotation.as_matrix())


def inverse(
    joint: Joint,
    position: ArrayLike,
    rotation: Rotation | None = None,
    rotation_length: float = ROTATION_LENGTH,
    near: ArrayLike | None = None,
) -> Floats:
    """f⁻¹: the configuration whose pose is closest to each measured one, in the least-squares sense.

    The squared error is |p - p(c)|² + rotation_length² · 2(1 - cos e) with e the angle between the orientations, which
    for a revolute joint is smallest, in closed form, at the argument of a complex number (see `_turn`).

    Args:
        position: (k, 3) measured positions of the part's origin, base frame [m].
        rotation: (k,) or single measured orientation; None: from positions alone.
        rotation_length: weight of rotation against position [m/rad].
        near: (k,) or single configuration to choose the number of whole turns by: the one closest to it.

    Returns:
        (k,) configurations [rad or m], unique for every pose. Prismatic: along the axis. Revolute: in (-π, π]. Screw:
        the whole turns are counted by the displacement along the axis, so several turns are unique as long as a
        turn moves the part further than the noise; with smaller pitch, give `near`. A screw of pitch 0 is
        revolute. Rigid: `fixed_at`. Where a pose does not determine the angle (origin on the axis and no orientation),
        it is 0 for a revolute joint and that of the displacement along the axis for a screw.
    """
    measured = np.atleast_2d(np.asarray(position, dtype=float))
    if measured.ndim != 2 or measured.shape[1] != 3:
        raise InputError(f"positions must have shape (k, 3). Got {np.shape(position)}")
    if not joint.moves:
        return np.full(len(measured), joint.fixed_at)
    if joint.kind == "path":
        quaternion = None if rotation is None else np.broadcast_to(rotation.as_quat(), (len(measured), 4))
        return closest_on_path(joint, measured, quaternion, rotation_length)
    axis = np.array(joint.axis)
    along = (measured - joint.position) @ axis
    if joint.kind == "prismatic":
        return np.asarray(along)
    turn = _turn(joint, measured, rotation, rotation_length)
    weight = np.abs(turn)
    angle = np.where(weight > TINY, np.angle(turn), 0.0)
    angle = np.where(angle <= -np.pi, np.pi, angle)
    pitch = joint.pitch if joint.kind == "screw" and abs(joint.pitch) > _NO_PITCH else 0.0
    guess = along / pitch if pitch and near is None else near
    if guess is not None:
        angle = angle + 2 * np.pi * np.round((np.asarray(guess, dtype=float) - angle) / (2 * np.pi))
    return balanced(angle, weight, along, pitch) if pitch else np.asarray(angle)


def _turn(joint: Joint, measured: Floats, rotation: Rotation | None, rotation_length: float) -> NDArray[np.complex128]:
    """(k,) complex numbers z such that the squared error at angle c is constant - 2 Re(z e^(-ic)).

    Positions contribute conj(r0) r, with r0 and r the lever arms at 0 and now in the plane normal to the axis, as
    complex numbers. Orientations contribute rotation_length² (w + i a·v)², with (v, w) the quaternion of R R0ᵀ: its
    argument is the angle of twist about the axis a, and it fades where the rotation is about another axis.
    """
    plane = axis_basis(joint.axis)
    arms = (np.vstack([joint.position, measured]) - joint.center) @ plane.T
    complex_arms = arms[:, 0] + 1j * arms[:, 1]
    turn = np.conj(complex_arms[0]) * complex_arms[1:]
    if rotation is not None:
        quaternion = np.atleast_2d((rotation * Rotation.from_quat(joint.quaternion).inv()).as_quat())
        turn = turn + rotation_length**2 * (quaternion[:, 3] + 1j * (quaternion[:, :3] @ joint.axis)) ** 2
    return np.asarray(turn)


def balanced(angle: Floats, weight: Floats, along: Floats, pitch: float | Floats) -> Floats:
    """Configurations of a screw that minimise -2 weight cos(c - angle) + (along - pitch c)², from c = angle on.

    Each step minimises a parabola that touches the error from above, so the error cannot grow.

    Args:
        angle, weight, along: of one shape: the angle [rad] in the plane across the axis, its weight [m²], and the
            displacement along the axis [m].
        pitch: [m/rad], to be broadcast.
    """
    c = angle
    for _ in range(_MOST_ITERATIONS):
        slope = weight * np.sin(c - angle) - pitch * (along - pitch * c)
        step = slope / (weight + pitch**2)
        c = c - step
        if np.abs(step).max(initial=0.0) < 1e-14:
            break
    return np.asarray(c)


def jacobian(joint: Joint, c: ArrayLike) -> Floats:
    """J: (k, 6) derivative [rotation, translation of the part's origin] of the pose by c (k,), in the base frame.

    The rotation is a vector of rad per unit of c, as an angular velocity: R(c + dc) ≈ exp(rotation dc) R(c).
    """
    if joint.kind == "path":
        there = along_path(joint, c)
        return np.concatenate([there.turning, there.velocity], axis=1)
    xi = twist(joint)
    # The velocity of the origin at configuration 0, turned by the angle (Rodrigues).
    velocity = xi[3:] + _cross(xi[:3], np.array(joint.position))
    side = _cross(xi[:3], velocity)
    angle = np.atleast_1d(np.asarray(c, dtype=float))[:, None]
    turned = velocity + np.sin(angle) * side + (1 - np.cos(angle)) * _cross(xi[:3], side)
    return np.concatenate([np.broadcast_to(xi[:3], turned.shape), turned], axis=1)


def inverse_jacobian(
    joint: Joint, c: ArrayLike, displacement: ArrayLike, rotation_length: float = ROTATION_LENGTH
) -> Floats:
    """J⁻¹: the change of configuration that explains a small displacement best, in the least-squares sense.

    Args:
        c: (k,) configurations at which the displacement starts [rad or m].
        displacement: (k, 6) [rotation vector (rad), translation of the part's origin (m)] or (k, 3) translation only,
            base frame.
        rotation_length: weight of rotation against translation [m/rad].

    Returns:
        (k,) [rad or m]; 0 for rigid, and where the displacement is uninformative (origin on the axis, no rotation).
    """
    displacements = np.atleast_2d(np.asarray(displacement, dtype=float))
    if displacements.ndim != 2 or displacements.shape[1] not in (3, 6):
        raise InputError(f"displacements must have shape (k, 3) or (k, 6). Got {np.shape(displacement)}")
    direction = jacobian(joint, c)[:, 6 - displacements.shape[1] :]
    weights = np.repeat([rotation_length**2, 1.0], 3)[6 - displacements.shape[1] :]
    squared = (direction**2) @ weights
    projected = (direction * displacements) @ weights
    return np.where(squared > TINY, projected / np.maximum(squared, TINY), 0.0)


def shifted(joint: Joint, offset: float) -> Joint:
    """The same motion counted from configuration `offset`: c' = c - offset, so f'(c') = f(c).

    Carries the covariance along: the origin there depends on the axis, and is again compared where poses are closest.
    """
    if not joint.moves:
        return replace(joint, fixed_at=joint.fixed_at - offset)
    if joint.kind == "path":
        return recounted(joint, offset)
    pose = forward(joint, offset)[0]
    origin = pose.translation, pose.rotation.as_quat()
    moved = twisting(joint.kind, joint.axis, joint.center, joint.pitch, *origin)
    covariance = joint.covariance
    if covariance is not None:
        slopes = _origin_slopes(joint, offset, _TURNS[0] in covariance.names)
        index = [_PARAMETERS.index(name) for name in covariance.names]
        slopes = slopes[np.ix_(index, index)]
        matrix = slopes @ np.array(covariance.matrix) @ slopes.T
        covariance = _covariance(covariance.names, 0.5 * (matrix + matrix.T))
    return replace(moved, covariance=covariance)


def _origin_slopes(joint: Joint, c: float, has_rotation: bool) -> Floats:
    """(11, 11) derivative of the parameters relative to configuration c with respect to those relative to 0."""
    axis, basis = np.array(joint.axis), axis_basis(joint.axis)
    slopes, tilt, shift, rotation, position = np.eye(11), slice(2), slice(2, 4), slice(5, 8), slice(8, 11)
    if joint.kind == "prismatic":
        slopes[position, tilt] = c * np.cross(basis, axis).T
    else:
        turn = Rotation.from_rotvec(c * axis).as_matrix()
        arm = np.subtract(joint.position, joint.center)
        along = joint.pitch * c * np.cross(basis, axis)
        slopes[shift, tilt] = basis @ along.T
        slopes[rotation, tilt] = basis.T - turn @ basis.T
        slopes[rotation, rotation] = slopes[position, position] = turn
        slopes[position, tilt] = (np.cross(basis, turn @ arm) + along).T - turn @ np.cross(basis, arm).T
        slopes[position, shift] = basis.T - turn @ basis.T
        slopes[position, 4] = c * axis
    # What is left along the motion is another configuration, and no other joint.
    scale = np.repeat([ROTATION_LENGTH if has_rotation else 0.0, 1.0], 3)
    direction = jacobian(joint, c)[0]
    weighted = scale**2 * direction
    if direction @ weighted > TINY:
        slopes[5:] -= np.outer(direction, weighted @ slopes[5:]) / (direction @ weighted)
    return slopes


def reversed_direction(joint: Joint) -> Joint:
    """The same motion in the opposite direction: c' = -c, so f'(c') = f(c); the covariance is transformed too."""
    if not joint.moves:
        return replace(joint, fixed_at=-joint.fixed_at)
    if joint.kind == "path":
        return recounted(joint, 0.0, -1.0)
    # The basis of -axis is (-b1, b2), so the parameters along b1 change their sign.
    covariance = joint.covariance
    if covariance is not None:
        sign = np.array([-1.0 if name in ("axis_1", "center_1") else 1.0 for name in covariance.names])
        covariance = _covariance(covariance.names, np.outer(sign, sign) * np.array(covariance.matrix))
    x, y, z = joint.axis
    return replace(joint, axis=(-x, -y, -z), covariance=covariance)


def part_poses(automaton: HybridAutomaton, mode: Mode, x: Floats) -> dict[str, RigidTransform]:
    """Pose of every linked part in the base frame at the state x (n,), by part name."""
    return {name: poses[0] for name, poses in poses_of_states(automaton, mode, x[None]).items()}


def poses_of_states(automaton: HybridAutomaton, mode: Mode, states: Floats) -> dict[str, RigidTransform]:
    """(k,) poses of every linked part in the base frame at states (k, n), by part name."""
    poses: dict[str, RigidTransform] = {}
    for link, joint in zip(automaton.links, mode.joints, strict=True):
        relative = forward(joint, states[:, link.coordinate])
        poses[link.child] = poses[link.parent] * relative if link.parent in poses else relative
    return poses


def _covariance(names: tuple[str, ...], matrix: Floats) -> ParameterCovariance:
    return ParameterCovariance(names, tuple(map(tuple, matrix.tolist())))
