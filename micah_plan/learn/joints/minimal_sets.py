"""Joints through the fewest rows that fix one, many at once: the random starts of a robust fit (MLESAC).

Two poses fix any of the motions, for their relative displacement is one screw (Chasles); three positions fix a circle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import IDENTITY, Joint, JointKind
from micah_plan.learn.joints.quaternions import conjugate, rotation_vector, times

_SHORTEST = 1e-9  # m
_LEAST_TURN = 1e-6  # rad
_FLATTEST = 1e-12  # relative area of a triangle


def joints_through(
    kind: JointKind, position: Floats, quaternion: Floats | None, rng: np.random.Generator, draws: int
) -> list[Joint]:
    """Joints through `draws` random minimal sets of rows (n, 3), (n, 4); fewer where sets fix none."""
    need = minimal_rows(kind, quaternion is not None)
    if draws <= 0 or len(position) < need:
        return []
    chosen = np.sort(np.argsort(rng.random((draws, len(position))), axis=1)[:, :need], axis=1)
    p = position[chosen]
    q = None if quaternion is None else quaternion[chosen]
    first = np.broadcast_to(np.array(IDENTITY), (draws, 4)) if q is None else q[:, 0]
    if kind == "rigid":
        return _joints(kind, p[:, 0], first, np.zeros((draws, 3)), p[:, 0], np.zeros(draws), np.ones(draws, dtype=bool))
    if kind == "prismatic":
        step = p[:, 1] - p[:, 0]
        length = np.linalg.norm(step, axis=1)
        fixed = length > _SHORTEST
        axis = step / np.where(fixed, length, 1.0)[:, None]
        return _joints(kind, p[:, 0], first, axis, p[:, 0], np.zeros(draws), fixed)
    if q is None:
        axis, center, fixed = _circles(p)
        return _joints(kind, p[:, 0], first, axis, center, np.zeros(draws), fixed)
    axis, point, pitch, fixed = _screws(p, q)
    along = np.sum((p[:, 0] - point) * axis, axis=1, keepdims=True)
    return _joints(kind, p[:, 0], first, axis, point + along * axis, pitch if kind == "screw" else 0 * pitch, fixed)


def minimal_rows(kind: JointKind, has_orientation: bool) -> int:
    """How many rows fix a joint: 1 pose for rigid, 2 poses else; 3 positions for a circle."""
    if kind == "rigid":
        return 1
    return 2 if kind == "prismatic" or has_orientation else 3


def _screws(p: Floats, q: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Axes, points on them and pitches of the displacements between two poses (m, 2, 3), (m, 2, 4)."""
    turn = rotation_vector(times(q[:, 1], conjugate(q[:, 0])))
    angle = np.linalg.norm(turn, axis=1)
    fixed = angle > _LEAST_TURN
    angle = np.where(fixed, angle, 1.0)
    axis = turn / angle[:, None]
    step = p[:, 1] - p[:, 0]
    slide = np.sum(step * axis, axis=1)
    across = step - slide[:, None] * axis
    point = p[:, 0] + 0.5 * (across + np.cross(axis, across) / np.tan(angle / 2)[:, None])
    return axis, point, slide / angle, fixed


def _circles(p: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Normals and centres of the circles through three positions (m, 3, 3)."""
    u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    normal = np.cross(u, v)
    uu, vv, area = np.sum(u * u, axis=1), np.sum(v * v, axis=1), np.sum(normal * normal, axis=1)
    fixed = area > _FLATTEST * np.maximum(uu * vv, 1e-300)
    area = np.where(fixed, area, 1.0)
    to_center = np.cross(uu[:, None] * v - vv[:, None] * u, normal) / (2 * area)[:, None]
    return normal / np.sqrt(area)[:, None], p[:, 0] + to_center, fixed


def _joints(
    kind: JointKind,
    position: Floats,
    quaternion: Floats,
    axis: Floats,
    center: Floats,
    pitch: Floats,
    fixed: NDArray[np.bool_],
) -> list[Joint]:
    """Joint values of arrays that are right already: unit vectors, and centres closest to the positions."""
    none = (0.0, 0.0, 0.0)
    turning = kind in ("revolute", "screw")
    rows = np.concatenate([position, quaternion, axis, center], axis=1)[fixed].tolist()
    return [
        Joint(
            kind,
            (r[0], r[1], r[2]),
            (r[3], r[4], r[5], r[6]),
            none if kind == "rigid" else (r[7], r[8], r[9]),
            (r[10], r[11], r[12]) if turning else none,
            float(slide),
        )
        for r, slide in zip(rows, pitch[fixed].tolist(), strict=True)
        if np.isfinite(r).all()
    ]
