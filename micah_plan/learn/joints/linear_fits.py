"""Joints of all kinds by linear least squares, many stretches of rows at once: where fits start.

With orientations every model is linear in the measured rotation matrices: a part-fixed point c_b on the axis stays put,
p_t + R_t c_b = c_w (+ pitch · angle along the axis), and the axis is the direction the relative rotations share. A
circle through positions alone (Coope 1993) is biased on short arcs, so it only starts the refinement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import JointKind
from micah_plan.learn.joints.joint_arrays import JointArrays
from micah_plan.learn.joints.quaternions import conjugate, rotated, rotation_vector, times

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_TINY = 1e-9


def linear_fits(
    kinds: Sequence[JointKind], used: Bools, position: Floats, quaternion: Floats | None
) -> tuple[JointArrays, Bools]:
    """h joints of given kinds, each fitted to its rows.

    Args:
        kinds: of the h joints.
        used: (h, n) the rows that each is fitted to.
        position, quaternion: (n, 3) [m], (n, 4) rows; quaternion None if not measured.

    Returns:
        the joints, and (h,) whether the rows determine them (where not, the joint means nothing).
    """
    share = used / np.maximum(used.sum(axis=1, keepdims=True), 1)
    mean = share @ position
    centred = position[None] - mean[:, None]
    values, vectors = np.linalg.eigh(np.einsum("hn,hni,hnj->hij", share, centred, centred))
    rigid = np.array([kind == "rigid" for kind in kinds])
    sliding = np.array([kind == "prismatic" for kind in kinds])
    slid = np.sqrt(np.maximum(values[:, 2], 0.0)) > _TINY
    if quaternion is None:
        axis, center, start, curved = _circles(share, centred, vectors)
        axis, center, start = axis, center + mean, start + mean
        middle = np.tile([0.0, 0.0, 0.0, 1.0], (len(mean), 1))
        pitch, turned = np.zeros(len(mean)), curved
    else:
        middle = np.linalg.eigh(np.einsum("hn,ni,nj->hij", share, quaternion, quaternion))[1][:, :, 3]
        axis, center, start, pitch, turned = _turning(share, centred, middle, position, quaternion)
    straight = (rigid | sliding)[:, None]
    arrays = JointArrays(
        tuple(kinds),
        np.where(rigid[:, None], 0.0, np.where(sliding[:, None], vectors[:, :, 2], axis)),
        np.where(straight, 0.0, center),
        np.where(straight, mean, start),
        middle,
        np.where([kind == "screw" for kind in kinds], pitch, 0.0),
    )
    return arrays, rigid | (sliding & slid) | (~rigid & ~sliding & turned)


def _turning(
    share: Floats, centred: Floats, middle: Floats, position: Floats, quaternion: Floats
) -> tuple[Floats, Floats, Floats, Floats, Bools]:
    """Axes (h, 3), points on them (h, 3), origins in the middle (h, 3), pitches (h,) and whether anything turned."""
    relative = times(np.broadcast_to(quaternion, (len(share), *quaternion.shape)), conjugate(middle)[:, None])
    turns = rotation_vector(relative)
    values, vectors = np.linalg.eigh(np.einsum("hn,hni,hnj->hij", share, turns, turns))
    axis = vectors[:, :, 2]
    across = np.eye(3) - axis[:, :, None] * axis[:, None]
    matrices = Rotation.from_quat(quaternion).as_matrix()
    mean_matrix = across @ np.einsum("hn,nij->hij", share, matrices)
    left = np.einsum("hij,njk->hnik", across, matrices) - mean_matrix[:, None]
    right = -np.einsum("hij,hnj->hni", across, centred)
    normal = np.einsum("hn,hnki,hnkj->hij", share, left, left)
    pulled = np.einsum("hn,hnki,hnk->hi", share, left, right)
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
    pitch = np.sum(share * angle * along, axis=1) / np.maximum(spread, _TINY)
    return axis, center, start, pitch, np.sqrt(np.maximum(values[:, 2], 0.0)) > _TINY


def _circles(share: Floats, centred: Floats, vectors: Floats) -> tuple[Floats, Floats, Floats, Bools]:
    """Normals (h, 3), centres and starts (h, 3) relative to the mean, and whether there is a circle (h,)."""
    plane = vectors[:, :, :0:-1]
    flat = np.einsum("hni,hij->hnj", centred, plane)
    scale = np.sqrt(np.maximum(np.sum(share[..., None] * flat**2, axis=(1, 2)), 1e-300))[:, None]
    unit = flat / scale[..., None]
    design = np.concatenate([2 * unit, np.ones((*unit.shape[:2], 1))], axis=2)
    normal = np.einsum("hn,hni,hnj->hij", share, design, design)
    pulled = np.einsum("hn,hni,hn->hi", share, design, (unit**2).sum(axis=2))
    values, basis = np.linalg.eigh(normal)
    fixed = values[:, 0] > 1e-10
    inverse = np.where(values > 1e-10, 1 / np.maximum(values, 1e-10), 0.0)
    solution = np.einsum("hij,hj,hkj,hk->hi", basis, inverse, basis, pulled)[:, :2] * scale
    center = np.einsum("hij,hj->hi", plane, solution)
    # The origin: where the circle passes the mean.
    away = -solution / np.maximum(np.linalg.norm(solution, axis=1, keepdims=True), 1e-300)
    around = np.sqrt(np.maximum(np.sum(share * ((flat - solution[:, None]) ** 2).sum(axis=2), axis=1), 1e-300))
    start = center + np.einsum("hij,hj->hi", plane, away * around[:, None])
    return vectors[:, :, 0], center, start, fixed & (around > _TINY)
