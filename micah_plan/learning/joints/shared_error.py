"""Uncertainty of a joint due to errors that all rows share, which residuals cannot reveal.

A small move of it (v, w) and a factor 1 + s of lengths move the axis by w x axis, a point p of it by v + w x p + s p,
and the pitch by s pitch.

Errors of neighbours are equal, so the information of a fit is that of one pose at the start, one in the middle and one
at the end of the motion: its covariance is that of three such poses, each with its own configuration.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.arrays import TINY, Floats
from micah_plan.automaton.joint import KINDS, Joint, ParameterCovariance, axis_basis
from micah_plan.automaton.kinematics import forward, jacobian
from micah_plan.learning.joints.parametrization import JointChart, chart_of, stepped
from micah_plan.learning.joints.quaternions import cross_matrix
from micah_plan.recording.shared_error import SharedError

_POSES = 3
_STEP = 1e-5  # rad, m, m/rad
_UNKNOWN = 1.0  # std of what three poses do not determine, in the same units
_PARAMETERS = (*KINDS["screw"].parameters, *(f"{what}_{k}" for what in ("rotation", "position") for k in (1, 2, 3)))
_ROWS = {name: row for row, name in enumerate(_PARAMETERS)}


def with_shared_error(joint: Joint, ends: tuple[float, float], error: SharedError) -> Joint:
    """The joint with an enlarged covariance of its parameters; unchanged if it has none.

    Args:
        ends: smallest and largest configuration of the rows that it was fitted to [rad or m].
    """
    if joint.covariance is None:
        return joint
    names = joint.covariance.names
    slopes = _slopes_by_frame(joint)[[_ROWS[name] for name in names]]
    matrix = np.array(joint.covariance.matrix) + slopes[:, :6] @ error.frame @ slopes[:, :6].T
    matrix += error.scale**2 * np.outer(slopes[:, 6], slopes[:, 6]) + _of_few_poses(joint, names, ends, error.pose)
    rows = (0.5 * (matrix + matrix.T)).tolist()
    return replace(joint, covariance=ParameterCovariance(names, tuple(tuple(row) for row in rows)))


def _slopes_by_frame(joint: Joint) -> Floats:
    """(11, 7) derivatives of the parameters by a shift and a rotation of the frame, and by the scale of lengths."""
    slopes = np.zeros((11, 7))
    if joint.moves:
        basis = axis_basis(joint.axis)
        slopes[0:2, 3:6] = basis
        slopes[2:4, :3] = basis
        slopes[2:4, 3:6] = -basis @ cross_matrix(np.array(joint.center))
        slopes[2:4, 6] = basis @ np.array(joint.center)
        slopes[4, 6] = joint.pitch
    slopes[5:8, 3:6] = slopes[8:, :3] = np.eye(3)
    slopes[8:, 3:6] = -cross_matrix(np.array(joint.position))
    slopes[8:, 6] = joint.position
    return slopes


def _of_few_poses(joint: Joint, names: tuple[str, ...], ends: tuple[float, float], pose: Floats) -> Floats:
    """(k, k) covariance of the parameters determined by a few poses with covariance (6, 6)."""
    has_turns = "rotation_1" in names
    chart = chart_of(joint, has_turns)
    if not pose.any():
        return np.zeros((len(chart.names),) * 2)
    seen = slice(0, 6) if has_turns else slice(0, 3)
    # Weighted as in the fit: positions and rotations, each isotropic.
    spread = np.repeat([np.trace(pose[:3, :3]) / 3.0, np.trace(pose[3:, 3:]) / 3.0], 3)[seen]
    weight = np.diag(1.0 / (spread + TINY))
    places = np.linspace(*ends, _POSES) if joint.moves else np.zeros(1)
    slopes = np.stack([_by_number(joint, chart, places, k) for k in range(chart.free.shape[1])], axis=2)
    information = np.eye(chart.free.shape[1]) / _UNKNOWN**2
    pulls = []
    for place, own in zip(places, slopes[:, seen], strict=True):
        known = weight
        if joint.moves:  # what is along the motion is another configuration
            turn_and_shift = jacobian(joint, place)[0]
            along = np.concatenate([turn_and_shift[3:], turn_and_shift[:3]])[seen]
            length = float(along @ weight @ along)
            known = weight - np.outer(weight @ along, weight @ along) / length if length > 0.0 else weight
        information += own.T @ known @ own
        pulls.append(own.T @ known)
    spread_of_pull = sum(pull @ pose[seen, seen] @ pull.T for pull in pulls) + np.eye(len(information)) / _UNKNOWN**2
    back = chart.free @ np.linalg.inv(information)
    return np.asarray(back @ spread_of_pull @ back.T)


def _by_number(joint: Joint, chart: JointChart, places: Floats, k: int) -> Floats:
    """(n, 6) derivative of the poses [position, turn] at configurations (n,) by one of the free numbers of a joint."""
    numbers = np.zeros(chart.free.shape[1])
    poses = []
    for sign in (1.0, -1.0):
        numbers[k] = sign * _STEP
        moved = stepped(joint, chart, numbers)
        if moved is None:
            raise ValueError("a step of 1e-5 is never too long")
        poses.append(forward(moved, places))
    ahead, behind = poses
    turn = (ahead.rotation * behind.rotation.inv()).as_rotvec()
    return np.concatenate([ahead.translation - behind.translation, turn], axis=1) / (2.0 * _STEP)
