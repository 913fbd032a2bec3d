"""Linear least-squares fits of joints of all kinds to many stretches of rows, as starts.

With orientations every model is linear in the measured rotation matrices: a part-fixed point c_b on the axis does not
move, p_t + R_t c_b = c_w (+ pitch · angle along the axis), and the axis is the common direction of the relative
rotations. A circle through positions alone (Taubin 1991), and its osculating helix, only start the refinement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import ROUND_OFF, Booleans, Floats
from micah_plan.automaton.joint import JointKind
from micah_plan.learning.joints.joint_arrays import JointArrays
from micah_plan.learning.joints.quaternions import conjugate, rotated, rotation_matrix, rotation_vector, times

Line = tuple[Floats, Floats]
"""Directions (h, 3) of axes, and points (h, 3) on them."""

_STRAIGHTEST = 1e-4  # width of the rows in diameters of their circle


def linear_fits(
    kinds: Sequence[JointKind], used: Booleans, position: Floats, quaternion: Floats | None
) -> tuple[JointArrays, Booleans]:
    """h joints of given kinds, each fitted to its rows.

    Args:
        kinds: of the h joints.
        used: (h, n) the rows that each is fitted to.
        position, quaternion: (n, 3) [m], (n, 4) rows; quaternion None if not measured.

    Returns:
        the joints, and (h,) whether the rows determine them (otherwise the joint is meaningless).
    """
    kind_of = np.array(kinds, dtype=object)
    rigid, sliding = kind_of == "rigid", kind_of == "prismatic"
    turning = ~(rigid | sliding)
    # Joints of several kinds are fitted to the same rows: what does not depend on the kind is found once.
    numbers: dict[bytes, int] = {}
    stretch = np.array([numbers.setdefault(row.tobytes(), len(numbers)) for row in used], dtype=np.int64)
    rows = used[np.unique(stretch, return_index=True)[1]]
    share = rows / np.maximum(rows.sum(axis=1, keepdims=True), 1)
    mean = share @ position
    centred = position[None] - mean[:, None]
    values, vectors = np.linalg.eigh(_squared(share, centred))
    slid = np.sqrt(np.maximum(values[:, 2], 0.0)) > ROUND_OFF
    middle = np.tile([0.0, 0.0, 0.0, 1.0], (len(rows), 1))
    if quaternion is not None:
        products = (quaternion[:, :, None] * quaternion[:, None]).reshape(-1, 16)
        middle = np.linalg.eigh((share @ products).reshape(-1, 4, 4))[1][:, :, 3]
    axis, center, start = (
        np.where(rigid[:, None], 0.0, vectors[stretch, :, 2]),
        np.zeros((len(kinds), 3)),
        mean[stretch],
    )
    pitch, turned = np.zeros(len(kinds)), np.zeros(len(kinds), dtype=bool)
    if turning.any():
        turning_rows = np.unique(stretch[turning])
        at = np.searchsorted(turning_rows, stretch[turning])
        if quaternion is None:
            circles, starts, helices, pitches, fixed = _arcs(
                share[turning_rows], centred[turning_rows], vectors[turning_rows]
            )
            (axes, centers), starts = (circles[0], circles[1] + mean[turning_rows]), starts + mean[turning_rows]
        else:
            axes, centers, starts, pitches, fixed = _turning(
                share[turning_rows], centred[turning_rows], middle[turning_rows], position, quaternion
            )
        axis[turning], center[turning], start[turning] = axes[at], centers[at], starts[at]
        pitch[turning], turned[turning] = np.where(kind_of[turning] == "screw", pitches[at], 0.0), fixed[at]
        if quaternion is None:
            climbs = np.flatnonzero(kind_of == "screw")
            at = np.searchsorted(turning_rows, stretch[climbs])
            axis[climbs], center[climbs] = helices[0][at], helices[1][at] + mean[stretch[climbs]]
    arrays = JointArrays(tuple(kinds), axis, center, start, middle[stretch], pitch)
    return arrays, rigid | (sliding & slid[stretch]) | turned


def _squared(share: Floats, vectors: Floats) -> Floats:
    """(h, 3, 3) weighted sums of outer products of vectors (h, n, 3)."""
    return np.asarray((vectors * share[..., None]).swapaxes(1, 2) @ vectors)


def _turning(
    share: Floats, centred: Floats, middle: Floats, position: Floats, quaternion: Floats
) -> tuple[Floats, Floats, Floats, Floats, Booleans]:
    """Axes (h, 3), points on them (h, 3), mean origins (h, 3), pitches (h,), and (h,) whether there is a rotation."""
    relative = times(np.broadcast_to(quaternion, (len(share), *quaternion.shape)), conjugate(middle)[:, None])
    turns = rotation_vector(relative)
    values, vectors = np.linalg.eigh(_squared(share, turns))
    axis = vectors[:, :, 2]
    across = np.eye(3) - axis[:, :, None] * axis[:, None]
    matrices = rotation_matrix(quaternion)
    mean_matrix = across @ (share @ matrices.reshape(-1, 9)).reshape(-1, 3, 3)
    residual = (across[:, None] @ matrices - mean_matrix[:, None]).reshape(len(share), -1, 3)
    right = (centred @ across).reshape(len(share), -1, 1)
    weighted = (residual * np.repeat(share, 3, axis=1)[..., None]).swapaxes(1, 2)
    normal, pulled = weighted @ residual, -(weighted @ right)[..., 0]
    # What the point has along the axis stays open: the least norm fixes it.
    in_part = (np.linalg.pinv(normal, rcond=1e-6, hermitian=True) @ pulled[..., None])[..., 0]
    mean = share @ position
    center = mean + np.einsum("hij,hj->hi", mean_matrix, in_part)
    # The mean of an arc lies inside it: the origin is where the middle orientation puts it.
    out = np.einsum("hij,hj->hi", across, rotated(middle, in_part))
    start = center - out
    angle = np.einsum("hni,hi->hn", turns, axis)
    angle = angle - np.sum(share * angle, axis=1, keepdims=True)
    along = np.einsum("hni,hi->hn", centred, axis)
    spread = np.sum(share * angle**2, axis=1)
    pitch = np.sum(share * angle * along, axis=1) / np.maximum(spread, ROUND_OFF)
    return axis, center, start, pitch, np.sqrt(np.maximum(values[:, 2], 0.0)) > ROUND_OFF


def _arcs(share: Floats, centred: Floats, vectors: Floats) -> tuple[Line, Floats, Line, Floats, Booleans]:
    """Circles, starts (h, 3), helices through them, their pitches (h,), and whether the fit exists (h,).

    Points are relative to the mean of the rows. A helix leaves the plane of its circle with the cube of the angle, by a
    sixth of its torsion times the squared radius of the circle; torsion by curvature is the tangent of its lead angle.
    """
    normal, center, start, fixed = _circles(share, centred, vectors)
    out = start - center
    around = np.maximum(np.linalg.norm(out, axis=1), ROUND_OFF)
    away = out / around[:, None]
    tangent = np.cross(normal, away)
    arm = centred - center[:, None]
    angle = np.arctan2(np.einsum("hni,hi->hn", arm, tangent), np.einsum("hni,hi->hn", arm, away))
    powers = np.stack([np.ones_like(angle), angle, angle**2, angle**3], axis=2)
    weighted = (powers * share[..., None]).swapaxes(1, 2)
    off = np.einsum("hni,hi->hn", centred, normal)
    cubic = (np.linalg.pinv(weighted @ powers, hermitian=True) @ weighted @ off[..., None])[:, 3, 0]
    lead = np.arctan(6 * cubic / around)
    axis = np.cos(lead)[:, None] * normal + np.sin(lead)[:, None] * tangent
    radius = around * np.cos(lead) ** 2
    pitch = around * np.sin(lead) * np.cos(lead)
    return (normal, center), start, (axis, start - radius[:, None] * away), pitch, fixed


def _circles(share: Floats, centred: Floats, vectors: Floats) -> tuple[Floats, Floats, Floats, Booleans]:
    """Normals (h, 3), centres and starts (h, 3) relative to the mean, and whether there is a circle (h,)."""
    plane = vectors[:, :, :0:-1]
    flat = np.einsum("hni,hij->hnj", centred, plane)
    squares = (flat**2).sum(axis=2)
    scale = np.sqrt(np.maximum(np.sum(share * squares, axis=1), 1e-300))
    # Taubin's circle: least squares of a (x² + y² - their mean) + b x + c y, its gradient 1 on average.
    bend = (squares - scale[:, None] ** 2) / (2 * scale[:, None])
    values, basis = np.linalg.eigh(_squared(share, np.concatenate([bend[..., None], flat], axis=2)))
    bent, tilted = basis[:, 0, 0], basis[:, 1:, 0]
    fixed = (values[:, 1] > 1e-10 * values[:, 2]) & (np.abs(bent) > _STRAIGHTEST)
    solution = -tilted * (scale / np.where(fixed, bent, 1.0))[:, None]
    center = np.einsum("hij,hj->hi", plane, solution)
    # The origin: where the circle passes the mean.
    away = -solution / np.maximum(np.linalg.norm(solution, axis=1, keepdims=True), 1e-300)
    around = np.sqrt(np.maximum(np.sum(share * ((flat - solution[:, None]) ** 2).sum(axis=2), axis=1), 1e-300))
    start = center + np.einsum("hij,hj->hi", plane, away * around[:, None])
    return vectors[:, :, 0], center, start, fixed & (around > ROUND_OFF)
