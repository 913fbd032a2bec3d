"""Steps of a screw joint that positions alone see: straight in the numbers in which they are nearly linear.

A piece of a helix shows its tangent, its curvature and its torsion at the middle one after the other, each less clearly
than the one before. Axis, centre and pitch are quotients of these: along what the rows hardly tell they run on curves,
on which straight steps are too short to ever arrive.

Source: do Carmo, Differential Geometry of Curves and Surfaces, 1976, section 1-5 (Frenet's frame).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.stats import norm
from scipy.stats.qmc import Halton

from micah_plan.automaton.joint import Joint, screw
from micah_plan.learn.joints.joint_frame import cross, frame_of, seen_by
from micah_plan.learn.joints.parametrization import Chart, stepped
from micah_plan.learn.joints.quaternions import rotated, rotation_quaternion

Floats = NDArray[np.float64]

_SMALL = 1e-5  # of a unit step; for derivatives
_SAMPLES = 64  # and as many opposite ones
_SHARE = 0.95
_TINY = 1e-300
_FLATTEST = 1e-3  # 1/m; a straighter path has no frame


@dataclass(frozen=True, eq=False)
class _Frenet:
    """A helix at a point [m]: rows of its frame are tangent, normal and binormal; curvature and torsion [1/m]."""

    point: Floats
    frame: Floats
    curvature: float
    torsion: float


def helix_stepped(joint: Joint, chart: Chart, numbers: Floats, middle: float) -> Joint | None:
    """The screw after a step of the free numbers (p,), taken straight in tangent, curvature and torsion at the middle.

    Args:
        chart: of the joint, without orientations.
        middle: arc length from the joint's origin to the middle of the rows [m].

    Returns:
        None where the step leads to no screw.
    """
    length = float(np.linalg.norm(numbers))
    small = _SMALL / max(length, _SMALL)
    ahead, behind = (stepped(joint, chart, sign * small * numbers) for sign in (1.0, -1.0))
    here = _frenet(joint, middle)
    one = None if ahead is None else _frenet(ahead, middle)
    other = None if behind is None else _frenet(behind, middle)
    if here is None or one is None or other is None:
        return stepped(joint, chart, numbers)
    share = 0.5 / small
    turn = one.frame.T @ other.frame  # so small that it is 1 + [w]x
    w = share * 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return _screw(
        _Frenet(
            here.point + share * (one.point - other.point),
            rotated(rotation_quaternion(w), here.frame),
            here.curvature + share * (one.curvature - other.curvature),
            here.torsion + share * (one.torsion - other.torsion),
        ),
        middle,
        joint,
    )


def helix_covariance(joint: Joint, chart: Chart, covariance: Floats, middle: float) -> Floats:
    """(k, k) covariance of a screw's named parameters, from that of its free numbers (p, p), along the curves.

    Stds are as much wider than straight steps make them as the 95 % quantiles are; steps are a fixed even sample of the
    normal distribution. Other arguments are those of `helix_stepped`.
    """
    frame, _ = frame_of(joint)
    planar = frame[:2] @ chart.basis.T
    # In the joint's frame, so that nothing hangs on the base's.
    turn = np.asarray(block_diag(planar, planar, 1.0, frame))
    named = turn @ chart.free
    values, vectors = np.linalg.eigh(named @ covariance @ named.T)
    vectors = vectors * np.sign(np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0))
    values, vectors = values[-len(covariance) :], vectors[:, -len(covariance) :]
    root = np.linalg.pinv(named) @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    halton = Halton(len(root), scramble=False)
    halton.fast_forward(1)
    normal = norm.ppf(halton.random(_SAMPLES))
    steps = np.concatenate([normal, -normal]) @ root.T
    moved = [(step, helix_stepped(joint, chart, step, middle)) for step in steps]
    kept = [_difference(one, joint, chart, step) for step, one in moved if one is not None]
    if len(kept) <= _SAMPLES:  # the other half led to no screw: no picture of the curves
        return np.asarray(chart.free @ covariance @ chart.free.T)
    off = np.array(kept) @ turn.T
    straight = np.array([step for step, one in moved if one is not None]) @ named.T
    matrix = off.T @ off / len(off)
    # So few steps tell how much wider the curves are than the straight lines, not how wide these are.
    high, low = (np.maximum(np.quantile(np.abs(side), _SHARE, axis=0), _TINY) for side in (off, straight))
    wide = np.sqrt(np.maximum(np.diag(named @ covariance @ named.T), 0.0)) * high / low
    scale = wide / np.sqrt(np.maximum(np.diag(matrix), _TINY))
    return np.asarray(turn.T @ (matrix * scale[:, None] * scale) @ turn)


def _difference(moved: Joint, joint: Joint, chart: Chart, step: Floats) -> Floats:
    """(k,) named parameters of a screw less those of another, counted from where it comes closest to its origin."""
    seen = seen_by(moved, np.array([joint.position]), None, 1.0)
    axis, before = np.array(moved.axis), np.array(joint.axis)
    center = np.array(moved.center) + moved.pitch * float(seen.configuration[0]) * axis
    named = chart.free @ step  # an origin moves as straight as the rows
    named[:2] = chart.basis @ cross(before, axis)
    named[2:4] = chart.basis @ (center - joint.center)
    named[4] = moved.pitch - joint.pitch
    return np.asarray(named)


def _frenet(joint: Joint, length: float) -> _Frenet | None:
    """The helix at an arc length [m] from the origin; None where it is straight."""
    frame, radius = frame_of(joint)
    square = radius**2 + joint.pitch**2
    if radius < _FLATTEST * square:
        return None
    width = float(np.sqrt(square))
    c = length / width
    axis = frame[2]
    outwards = np.cos(c) * frame[0] + np.sin(c) * frame[1]
    around = cross(axis, outwards)
    point = np.array(joint.center) + radius * outwards + joint.pitch * c * axis
    rows = [(radius * around + joint.pitch * axis) / width, -outwards, (radius * axis - joint.pitch * around) / width]
    return _Frenet(point, np.stack(rows), radius / square, joint.pitch / square)


def _screw(at: _Frenet, length: float, like: Joint) -> Joint | None:
    """The screw whose origin lies an arc length [m] before a point of its helix; its orientation is not looked at."""
    if at.curvature < _FLATTEST:
        return None
    square = 1 / (at.curvature**2 + at.torsion**2)
    width, radius, pitch = float(np.sqrt(square)), at.curvature * square, at.torsion * square
    tangent, normal, binormal = at.frame
    axis = (pitch * tangent + radius * binormal) / width
    outwards, c = -normal, -length / width
    center = at.point - radius * outwards + pitch * c * axis
    position = center + radius * (np.cos(c) * outwards + np.sin(c) * cross(axis, outwards))
    return screw(axis, center, pitch, position, like.quaternion)
