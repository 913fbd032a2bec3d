"""Joints through the fewest rows that fix one, many at once: the random starts of a robust fit (MLESAC).

Two poses fix any of the motions, for their relative displacement is one screw (Chasles); three positions fix a circle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import IDENTITY, KINDS, JointKind
from micah_plan.learn.joints.joint_arrays import JointArrays, arrays_of
from micah_plan.learn.joints.quaternions import conjugate, rotation_vector, times

_SHORTEST = 1e-9  # m
_LEAST_TURN = 1e-6  # rad
_FLATTEST = 1e-12  # relative area of a triangle


def joints_through(
    kind: JointKind, position: Floats, quaternion: Floats | None, rng: np.random.Generator, draws: int
) -> JointArrays:
    """Joints through `draws` random minimal sets of rows (n, 3), (n, 4); fewer where sets fix none."""
    need = minimal_rows(kind, quaternion is not None)
    if draws <= 0 or len(position) < need:
        return arrays_of([])
    chosen = np.sort(np.argsort(rng.random((draws, len(position))), axis=1)[:, :need], axis=1)
    p = position[chosen]
    first = np.broadcast_to(np.array(IDENTITY), (draws, 4)) if quaternion is None else quaternion[chosen[:, 0]]
    axis, center, pitch = np.zeros((draws, 3)), np.zeros((draws, 3)), np.zeros(draws)
    fixed = np.ones(draws, dtype=bool)
    if KINDS[kind].moves and not KINDS[kind].turns:
        axis, fixed = _lines(p)
    elif KINDS[kind].turns and quaternion is None:
        axis, center, fixed = _circles(p)
    elif KINDS[kind].turns and quaternion is not None:
        axis, point, climbed, fixed = _screws(p, quaternion[chosen])
        center = point + np.sum((p[:, 0] - point) * axis, axis=1, keepdims=True) * axis
        pitch = climbed if KINDS[kind].climbs else pitch
    found = JointArrays((kind,) * draws, axis, center, p[:, 0], first, pitch)
    return found.take(np.flatnonzero(fixed & np.isfinite(center).all(axis=1)))


def minimal_rows(kind: JointKind, has_orientation: bool) -> int:
    """How many rows fix a joint: 1 pose for rigid, 2 poses else; 3 positions for a circle."""
    freedom = KINDS[kind]
    return 3 if freedom.turns and not has_orientation else 2 if freedom.moves else 1


def _lines(p: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Directions from one position to another (m, 2, 3)."""
    step = p[:, 1] - p[:, 0]
    length = np.linalg.norm(step, axis=1)
    fixed = length > _SHORTEST
    return step / np.where(fixed, length, 1.0)[:, None], fixed


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
