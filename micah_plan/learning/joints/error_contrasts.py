"""Error contrasts: components of the pose errors that no configuration of the joint can absorb.

Each row has its own configuration, which is estimated with the joint. Combinations of a row's errors that no change of
its configuration can alter ("error contrasts") are free of it, so their likelihood is that of the joint alone: the many
configurations do not bias the noise scale (the problem of Neyman and Scott, 1948).

All is written in the joint's own frame, where every derivative is a sine, a cosine or a constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.joint import Joint
from micah_plan.learning.joints.parametrization import FRAME_NUMBERS, PITCH_NUMBER, Seen

# Columns of a design: tilt 0, 1; shift of the centre 2, 3; pitch 4; turn of the origin 5, 6, 7; its shift 8, 9, 10.
_TILT, _SHIFT, _PITCH, _TURN, _MOVE = 0, 2, PITCH_NUMBER, 5, 8


@dataclass(frozen=True, eq=False)
class Contrasts:
    """k error contrasts per row, of equal noise.

    Attributes:
        error: (n, k) [rad or m].
        design: (n, k, 11) derivative of the expected values by the frame's parameters (see parametrization).
        position: (n, k, 3) how the contrasts weigh the error of the position, joint's frame; None if they do not.
        rotation: (n, k, 3) the same for the error of the rotation [m/rad where mixed].
        reach: how far a radian of rotation noise counts in metres of position noise; 0 in pure ones.
    """

    error: Floats
    design: Floats
    position: Floats | None
    rotation: Floats | None
    reach: float = 0.0


def contrasts_of(joint: Joint, compared: Seen, stds: tuple[float, float]) -> list[Contrasts]:
    """Contrasts of the rows: of positions, of rotations and of both, as the joint allows.

    Args:
        stds: of a rotation [rad] and a position [m].
    """
    if not joint.turns:
        return _straight(joint, compared)
    n, c = len(compared.configuration), compared.configuration
    radius, reach = compared.radius, float(np.hypot(compared.radius, joint.pitch))
    forwards, upwards = (radius / reach, joint.pitch / reach) if reach > ROUND_OFF else (1.0, 0.0)
    cosine, sine = np.cos(c), np.sin(c)
    poses = _turning_design(c, cosine, sine, radius, joint.pitch)
    error = np.empty((n, 2))
    # A configuration that is off by its noise lies outside the circle, by half its variance times the radius.
    information = (reach / stds[1]) ** 2 + (0.0 if compared.rotation_error is None else stds[0] ** -2)
    error[:, 0] = compared.position_error[:, 0] - 0.5 * radius / max(information, ROUND_OFF)
    error[:, 1] = upwards * compared.position_error[:, 1] - forwards * compared.position_error[:, 2]
    design = np.stack([poses[:, 0], upwards * poses[:, 1] - forwards * poses[:, 2]], axis=1)
    weights = np.zeros((n, 2, 3))
    weights[:, 0, 0], weights[:, 0, 1] = cosine, sine
    weights[:, 1, 0], weights[:, 1, 1], weights[:, 1, 2] = -upwards * sine, upwards * cosine, -forwards
    result = [Contrasts(error, design, weights, None)]
    if compared.rotation_error is None:
        return result
    turning = np.zeros((n, 2, FRAME_NUMBERS))
    turning[:, 0, _TILT] = turning[:, 1, _TILT + 1] = 1 - cosine
    turning[:, 0, _TILT + 1], turning[:, 1, _TILT] = sine, -sine
    turning[:, 0, _TURN] = turning[:, 1, _TURN + 1] = cosine
    turning[:, 0, _TURN + 1], turning[:, 1, _TURN] = -sine, sine
    result.append(Contrasts(compared.rotation_error[:, :2], turning, None, np.broadcast_to(np.eye(3)[:2], (n, 2, 3))))
    mixed = forwards * poses[:, 1] + upwards * poses[:, 2]
    mixed[:, _TURN + 2] -= reach
    both = (
        forwards * compared.position_error[:, 1]
        + upwards * compared.position_error[:, 2]
        - reach * compared.rotation_error[:, 2]
    )
    by_position = np.stack([-forwards * sine, forwards * cosine, np.full(n, upwards)], axis=1)[:, None]
    by_rotation = np.broadcast_to([0.0, 0.0, -reach], (n, 1, 3))
    result.append(Contrasts(both[:, None], mixed[:, None], by_position, by_rotation, reach))
    return result


def _straight(joint: Joint, compared: Seen) -> list[Contrasts]:
    """Contrasts of a joint that does not turn."""
    n, k = len(compared.configuration), 2 if joint.moves else 3
    design = np.zeros((n, k, FRAME_NUMBERS))
    for i in range(k):
        design[:, i, _MOVE + i] = 1.0
    if joint.moves:
        design[:, 0, _TILT + 1], design[:, 1, _TILT] = compared.configuration, -compared.configuration
    frame = np.eye(3)
    result = [Contrasts(compared.position_error[:, :k], design, np.broadcast_to(frame[:k], (n, k, 3)), None)]
    if compared.rotation_error is not None:
        turning = np.zeros((n, 3, FRAME_NUMBERS))
        for i in range(3):
            turning[:, i, _TURN + i] = 1.0
        result.append(Contrasts(compared.rotation_error, turning, None, np.broadcast_to(frame, (n, 3, 3))))
    return result


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
