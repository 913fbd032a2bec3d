"""Paths: one-degree-of-freedom motions along smooth curves of poses, such as a garage door or four-bar lid.

A path is a natural cubic spline through poses at knots c_1 < ... < c_K: of positions, and of quaternions that are then
scaled to unit length. It is straight beyond both ends. A rotated or shifted frame rotates and shifts the curve. Source:
de Boor, "A Practical Guide to Splines", ch. 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import TINY, Floats
from micah_plan.automaton.joint import Joint
from micah_plan.errors import InputError, shown

FEWEST_KNOTS = 4
_FINENESS = 16  # places between neighbouring knots at which the closest pose is first looked for
_MOST_STEPS = 12


@dataclass(frozen=True, eq=False)
class PathPoses:
    """Poses along a path and how they change with the configuration.

    Attributes:
        position, velocity: (k, 3) [m] and [m per unit of c], base frame.
        quaternion: (k, 4), scalar last.
        turning: (k, 3) [rad per unit of c], base frame.
    """

    position: Floats
    velocity: Floats
    quaternion: Floats
    turning: Floats


def path(knots: ArrayLike) -> Joint:
    """A part that moves along a smooth curve of poses.

    Args:
        knots: (K, 8) rows of c [m], position [m] and quaternion (scalar last) of the part; c increases.

    The configuration c counts the length of the curve, in which a turn of 1 rad counts like 0.2 m; its zero may be
    anywhere.

    Raises:
        InputError: fewer than 4 knots, numbers that are not finite, c that does not increase, a zero quaternion.
    """
    rows = np.array(knots, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != 8 or len(rows) < FEWEST_KNOTS or not np.isfinite(rows).all():
        raise InputError(
            f"knots must be at least {FEWEST_KNOTS} rows of c, position (3) and quaternion (4). Got {shown(knots)}"
        )
    if not (np.diff(rows[:, 0]) > 0).all():
        raise InputError(f"knots must have increasing c. Got {shown(rows[:, 0].tolist())}")
    length = np.linalg.norm(rows[:, 4:], axis=1, keepdims=True)
    if not (length > 1e-12).all():
        raise InputError("knots must have quaternions that are not zero")
    rows[:, 4:] /= length
    # q and -q are one rotation; neighbours take the closer one.
    signs = np.cumprod(np.append(1.0, np.where((rows[1:, 4:] * rows[:-1, 4:]).sum(axis=1) < 0, -1.0, 1.0)))
    rows[:, 4:] *= signs[:, None]
    joint = Joint("path", (0.0, 0.0, 0.0), knots=tuple(map(tuple, rows.tolist())))
    start = along_path(joint, [0.0])
    (x, y, z), (i, j, k, w) = start.position[0].tolist(), start.quaternion[0].tolist()
    return Joint("path", (x, y, z), (i, j, k, w), knots=joint.knots)


def along_path(joint: Joint, c: ArrayLike) -> PathPoses:
    """Poses of a path's part at configurations c (k,)."""
    value, slope = _spline(joint, np.atleast_1d(np.asarray(c, dtype=float)))
    quaternion, change = value[:, 3:], slope[:, 3:]
    square = (quaternion**2).sum(axis=1, keepdims=True)
    # The rotation's velocity is 2 dq/dc q^-1; what changes the length of q drops out of its vector part.
    v, s, dv, ds = quaternion[:, :3], quaternion[:, 3:], change[:, :3], change[:, 3:]
    turning = 2 * (s * dv - ds * v - np.cross(dv, v)) / square
    return PathPoses(value[:, :3], slope[:, :3], quaternion / np.sqrt(square), turning)


def closest_on_path(joint: Joint, position: Floats, quaternion: Floats | None, rotation_length: float) -> Floats:
    """(k,) configurations whose poses are closest to measured positions (k, 3) [m] and quaternions (k, 4), if given.

    Args:
        rotation_length: weight of rotation against position [m/rad].
    """
    knots = np.array(joint.knots)[:, 0]
    shares = np.arange(_FINENESS) / _FINENESS
    grid = np.append((knots[:-1, None] + np.diff(knots)[:, None] * shares).ravel(), knots[-1])
    there = along_path(joint, grid)
    apart = ((position[:, None] - there.position) ** 2).sum(axis=2)
    if quaternion is not None:
        # 2 (1 - cos of the angle), as for other joints.
        apart += rotation_length**2 * 4 * (1 - (quaternion @ there.quaternion.T) ** 2)
    c = grid[np.argmin(apart, axis=1)]
    spacing = float(np.diff(grid).max())
    for _ in range(_MOST_STEPS):
        now = along_path(joint, c)
        pull = (now.velocity * (position - now.position)).sum(axis=1)
        size = (now.velocity**2).sum(axis=1)
        if quaternion is not None:
            pull += rotation_length**2 * (now.turning * _turn(now.quaternion, quaternion)).sum(axis=1)
            size += rotation_length**2 * (now.turning**2).sum(axis=1)
        step = pull / np.maximum(size, 1e-300)
        inside = (c + step > knots[0]) & (c + step < knots[-1])
        step = np.where(inside, np.clip(step, -spacing, spacing), step)
        c = c + step
        if np.abs(step).max(initial=0.0) < TINY:
            break
    return np.asarray(c)


def recounted(joint: Joint, offset: float, sign: float = 1.0) -> Joint:
    """The same path with configurations c' = sign (c - offset)."""
    rows = np.array(joint.knots)
    rows[:, 0] = sign * (rows[:, 0] - offset)
    return path(rows if sign > 0 else rows[::-1])


def _turn(a: Floats, b: Floats) -> Floats:
    """(k, 3) rotation vectors from quaternions a to b (k, 4), accurate for small rotations."""
    vector = a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(b[:, :3], a[:, :3])
    scalar = (a * b).sum(axis=1, keepdims=True)
    return np.asarray(2 * vector * np.where(scalar < 0, -1.0, 1.0))


def _spline(joint: Joint, c: Floats) -> tuple[Floats, Floats]:
    """(k, 7) values and derivatives of the natural cubic spline of a path's knots; straight beyond its ends."""
    knots, values, bends = _bends(joint)
    i = np.clip(np.searchsorted(knots, c, side="right") - 1, 0, len(knots) - 2)
    h = (knots[i + 1] - knots[i])[:, None]
    inside = np.clip(c, knots[0], knots[-1])
    b = (inside - knots[i])[:, None] / h
    a = 1 - b
    before, after = bends[i], bends[i + 1]
    value = a * values[i] + b * values[i + 1] + ((a**3 - a) * before + (b**3 - b) * after) * h**2 / 6
    slope = (values[i + 1] - values[i]) / h + ((3 * b**2 - 1) * after - (3 * a**2 - 1) * before) * h / 6
    return value + (c - inside)[:, None] * slope, slope


@lru_cache(maxsize=256)
def _bends(joint: Joint) -> tuple[Floats, Floats, Floats]:
    """Knots (K,), values (K, 7) there and second derivatives (K, 7), which are 0 at both ends."""
    rows = np.array(joint.knots)
    knots, values = rows[:, 0], rows[:, 1:]
    h, bends = np.diff(knots), np.zeros_like(values)
    rise = np.diff(values, axis=0) / h[:, None]
    matrix = np.diag((h[:-1] + h[1:]) / 3) + np.diag(h[1:-1] / 6, 1) + np.diag(h[1:-1] / 6, -1)
    bends[1:-1] = np.linalg.solve(matrix, np.diff(rise, axis=0))
    return knots, values, bends
