"""Rows compared with a joint where their own configurations cannot reach: the channels across the motion.

Each row has a configuration of its own, which is estimated with the joint. Combinations of a row's errors that no
change of its configuration can alter ("error contrasts") are free of it, so their likelihood is that of the joint
alone: the many configurations bias no noise scale (the problem of Neyman and Scott, 1948).

All is written in the joint's own frame: u1 towards the part at configuration 0, u2 = axis x u1, the axis. There the
motion is a turn of the plane and every derivative is a sine, a cosine or a constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.joint import Joint
from micah_plan.learn.parametrization import FRAME_NUMBERS, frame_of
from micah_plan.learn.quaternions import rotation_vector, times_matrix

Floats = NDArray[np.float64]

_TINY = 1e-9
_NEWTON_STEPS = 6
_TELLING_PITCH = 0.05  # m per turn; a smaller one cannot count whole turns
# Columns of a design: tilt 0, 1; shift of the centre 2, 3; pitch 4; turn of the origin 5, 6, 7; its shift 8, 9, 10.
_TILT, _SHIFT, _PITCH, _TURN, _MOVE = 0, 2, 4, 5, 8


@dataclass(frozen=True, eq=False)
class Channel:
    """k error contrasts of equal noise.

    Attributes:
        error: (n, k) [rad or m].
        design: (n, k, 11) derivative of what the model expects there by the frame's numbers (see parametrization).
        position: (n, k, 3) how the contrasts weigh the error of the position, joint's frame; None if they do not.
        rotation: (n, k, 3) the same for the error of the rotation [m/rad where mixed].
        reach: how far a radian of rotation noise counts in metres of position noise; 0 in pure channels.
    """

    error: Floats
    design: Floats
    position: Floats | None
    rotation: Floats | None
    reach: float = 0.0


@dataclass(frozen=True, eq=False)
class Seen:
    """Rows in the frame of a joint.

    Attributes:
        configuration: (n,) closest configurations [rad or m].
        position_error: (n, 3) measured minus model [m], for a turning joint along its radius, its tangent and its axis.
        rotation_error: (n, 3) [rad] along u1, u2 and the axis; None without orientations.
        radius: of the part about the axis [m].
        frame: (3, 3) rows u1, u2 and the axis.
    """

    configuration: Floats
    position_error: Floats
    rotation_error: Floats | None
    radius: float
    frame: Floats

    def squares(self) -> list[Floats]:
        """(n,) squared errors of positions [m²] and, where measured, of rotations [rad²]."""
        both = [self.position_error] if self.rotation_error is None else [self.position_error, self.rotation_error]
        return [np.einsum("ij,ij->i", e, e) for e in both]


def seen_by(joint: Joint, position: Floats, quaternion: Floats | None, rotation_length: float) -> Seen:
    """Rows (n, 3), (n, 4) at their closest configurations, in the joint's frame.

    Args:
        rotation_length: weight of rotation against position [m/rad].
    """
    frame, radius = frame_of(joint)
    relative = None
    if quaternion is not None:
        # In the frame's coordinates: the vector part turns like any vector.
        relative = quaternion @ times_matrix(np.array(joint.quaternion) * [-1.0, -1.0, -1.0, 1.0])
        relative = np.concatenate([relative[:, :3] @ frame.T, relative[:, 3:]], axis=1)
    if joint.kind in ("rigid", "prismatic"):
        error = (position - joint.position) @ frame.T
        c = np.zeros(len(error))
        if joint.kind == "prismatic":
            c = error[:, 2].copy()
            error[:, 2] = 0.0
        turns = None if relative is None else rotation_vector(relative)
        return Seen(c, error, turns, radius, frame)
    local = (position - joint.center) @ frame.T
    c = _angles(joint, radius, local, relative, rotation_length)
    cosine, sine = np.cos(c), np.sin(c)
    x, y = local[:, 0], local[:, 1]
    error = np.stack([x * cosine + y * sine - radius, y * cosine - x * sine, local[:, 2] - joint.pitch * c], axis=1)
    turns = None
    if relative is not None:
        half_cosine, half_sine = np.cos(0.5 * c), -np.sin(0.5 * c)
        i, j, k, w = relative.T
        back = [i * half_cosine + j * half_sine, j * half_cosine - i * half_sine]
        back += [k * half_cosine + w * half_sine, w * half_cosine - k * half_sine]
        turns = rotation_vector(np.stack(back, axis=1))
    return Seen(c, error, turns, radius, frame)


def channels_of(joint: Joint, seen: Seen, stds: tuple[float, float]) -> list[Channel]:
    """The channels of rows: positions, rotations and their mixture, those that the joint has.

    Args:
        stds: of a rotation [rad] and a position [m].
    """
    if joint.kind in ("rigid", "prismatic"):
        return _straight(joint, seen)
    n, c = len(seen.configuration), seen.configuration
    radius, reach = seen.radius, float(np.hypot(seen.radius, joint.pitch))
    forwards, upwards = (radius / reach, joint.pitch / reach) if reach > _TINY else (1.0, 0.0)
    cosine, sine = np.cos(c), np.sin(c)
    poses = _turning_design(c, cosine, sine, radius, joint.pitch)
    error = np.empty((n, 2))
    # A configuration that is off by its noise lies outside the circle, by half its variance times the radius.
    information = (reach / stds[1]) ** 2 + (0.0 if seen.rotation_error is None else stds[0] ** -2)
    error[:, 0] = seen.position_error[:, 0] - 0.5 * radius / max(information, _TINY)
    error[:, 1] = upwards * seen.position_error[:, 1] - forwards * seen.position_error[:, 2]
    design = np.stack([poses[:, 0], upwards * poses[:, 1] - forwards * poses[:, 2]], axis=1)
    weights = np.zeros((n, 2, 3))
    weights[:, 0, 0], weights[:, 0, 1] = cosine, sine
    weights[:, 1, 0], weights[:, 1, 1], weights[:, 1, 2] = -upwards * sine, upwards * cosine, -forwards
    channels = [Channel(error, design, weights, None)]
    if seen.rotation_error is None:
        return channels
    turning = np.zeros((n, 2, FRAME_NUMBERS))
    turning[:, 0, _TILT] = turning[:, 1, _TILT + 1] = 1 - cosine
    turning[:, 0, _TILT + 1], turning[:, 1, _TILT] = sine, -sine
    turning[:, 0, _TURN] = turning[:, 1, _TURN + 1] = cosine
    turning[:, 0, _TURN + 1], turning[:, 1, _TURN] = -sine, sine
    channels.append(Channel(seen.rotation_error[:, :2], turning, None, np.broadcast_to(np.eye(3)[:2], (n, 2, 3))))
    mixed = forwards * poses[:, 1] + upwards * poses[:, 2]
    mixed[:, _TURN + 2] -= reach
    both = (
        forwards * seen.position_error[:, 1] + upwards * seen.position_error[:, 2] - reach * seen.rotation_error[:, 2]
    )
    by_position = np.stack([-forwards * sine, forwards * cosine, np.full(n, upwards)], axis=1)[:, None]
    by_rotation = np.broadcast_to([0.0, 0.0, -reach], (n, 1, 3))
    channels.append(Channel(both[:, None], mixed[:, None], by_position, by_rotation, reach))
    return channels


def _straight(joint: Joint, seen: Seen) -> list[Channel]:
    """Channels of a joint that does not turn."""
    n, k = len(seen.configuration), 3 if joint.kind == "rigid" else 2
    design = np.zeros((n, k, FRAME_NUMBERS))
    for i in range(k):
        design[:, i, _MOVE + i] = 1.0
    if joint.kind == "prismatic":
        design[:, 0, _TILT + 1], design[:, 1, _TILT] = seen.configuration, -seen.configuration
    frame = np.eye(3)
    channels = [Channel(seen.position_error[:, :k], design, np.broadcast_to(frame[:k], (n, k, 3)), None)]
    if seen.rotation_error is not None:
        turning = np.zeros((n, 3, FRAME_NUMBERS))
        for i in range(3):
            turning[:, i, _TURN + i] = 1.0
        channels.append(Channel(seen.rotation_error, turning, None, np.broadcast_to(frame, (n, 3, 3))))
    return channels


def _turning_design(c: Floats, cosine: Floats, sine: Floats, radius: float, pitch: float) -> Floats:
    """(n, 3, 11) derivative of positions, along the radius, the tangent and the axis."""
    design = np.zeros((len(c), 3, FRAME_NUMBERS))
    height = pitch * c
    design[:, 0, _TILT], design[:, 0, _TILT + 1] = -height * sine, height * cosine
    design[:, 1, _TILT], design[:, 1, _TILT + 1] = -height * cosine, -height * sine
    design[:, 2, _TILT], design[:, 2, _TILT + 1] = radius * sine, radius * (1 - cosine)
    design[:, 0, _SHIFT] = design[:, 1, _SHIFT + 1] = cosine - 1
    design[:, 0, _SHIFT + 1], design[:, 1, _SHIFT] = sine, -sine
    design[:, 2, _PITCH] = c
    for i in range(3):
        design[:, i, _MOVE + i] = 1.0
    return design


def _angles(joint: Joint, radius: float, local: Floats, relative: Floats | None, rotation_length: float) -> Floats:
    """(n,) closest angles, continuous from row to row (see automaton.kinematics for the closed form)."""
    real, imaginary = radius * local[:, 0], radius * local[:, 1]
    if relative is not None:
        real = real + rotation_length**2 * (relative[:, 3] ** 2 - relative[:, 2] ** 2)
        imaginary = imaginary + rotation_length**2 * 2 * relative[:, 3] * relative[:, 2]
    target, weight = np.arctan2(imaginary, real), np.hypot(real, imaginary)
    if not joint.pitch:
        return target
    if abs(joint.pitch) * 2 * np.pi > _TELLING_PITCH:
        target = target + 2 * np.pi * np.round((local[:, 2] / joint.pitch - target) / (2 * np.pi))
    else:
        target = np.unwrap(target)
    c = target
    for _ in range(_NEWTON_STEPS):
        slope = weight * np.sin(c - target) - joint.pitch * (local[:, 2] - joint.pitch * c)
        curvature = weight * np.maximum(np.cos(c - target), 0.5) + joint.pitch**2
        c = c - slope / np.maximum(curvature, _TINY**2)
    return np.asarray(c)
