"""Actions that were given relative to a measured pose, turned to where the part really was.

A controller that steps on from what it measures points its command along the motion at the *measured* configuration,
which differs from the true one by the tracker's noise. The noise of a measured step is then known from the direction
of its action, to a channel with a strong gain across the motion: such a channel explains noise, not motion. So what of
the directions follows the rows' own errors is taken out, by regression (Frisch and Waugh, Econometrica 1933).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.joint import Joint, axis_basis
from micah_plan.automaton.kinematics import inverse
from micah_plan.learn.track import PartTrack

Rows = NDArray[np.intp]

_CALM = 64  # windows per run that configurations are averaged over
_NEAR = 4  # rows on each side that a direction is compared with


def configurations(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans
) -> list[tuple[Rows, Floats, Floats]]:
    """Per piece its rows that count, their measured configurations, and these without most of their noise.

    A row counts in its average no more than its neighbours do, so what noise is left has nothing to do with that of a
    step from row to row.
    """
    found = []
    half = max(1, round(len(track) / (2 * _CALM)))
    for first, last in pieces:
        rows = np.arange(first, last + 1)[inlier[first : last + 1]]
        rotation = None if track.quaternion is None else Rotation.from_quat(track.quaternion[rows])
        measured = inverse(joint, track.position[rows], rotation)
        if joint.turns:
            measured = np.unwrap(measured)
        found.append((rows, measured, _running_mean(measured, half)))
    return found


def with_anchored_actions(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans
) -> PartTrack:
    """The track with the actions of the pieces' rows turned back by what follows the rows' own errors."""
    if not joint.turns or track.action is None:
        return track
    found = configurations(joint, pieces, track, inlier)
    rows, error = np.concatenate([r for r, _, _ in found]), np.concatenate([c - calm for _, c, calm in found])
    if not len(rows):
        return track
    world = None if track.quaternion is None else Rotation.from_quat(track.quaternion[rows])
    action = track.action[rows] if world is None else world.apply(track.action[rows])
    axis, (first, second) = np.array(joint.axis), axis_basis(joint.axis)
    local = (action @ first + 1j * (action @ second)) * np.exp(-1j * np.concatenate([calm for _, _, calm in found]))
    # A push and a pull have one direction: angles are doubled.
    doubled = local**2 / np.maximum(np.abs(local), 1e-300)
    around = np.convolve(doubled, np.ones(2 * _NEAR + 1))[_NEAR : _NEAR + len(doubled)]
    turned, weight = 0.5 * np.angle(doubled * around.conj()), np.abs(doubled) * np.abs(around)
    power = float(weight @ error**2)
    share = 0.0 if power == 0.0 else float(np.clip((weight * error) @ turned / power, 0.0, 1.0))
    action = Rotation.from_rotvec(-share * error[:, None] * axis).apply(action)
    actions = np.array(track.action)
    actions[rows] = action if world is None else world.inv().apply(action)
    return replace(track, action=actions)


def _running_mean(value: Floats, half: int) -> Floats:
    """Means over as many rows before as after, `half` at most."""
    n = len(value)
    total = np.concatenate([[0.0], np.cumsum(value)])
    reach = np.minimum(np.minimum(np.arange(n), np.arange(n)[::-1]), half)
    at = np.arange(n)
    return np.asarray((total[at + reach + 1] - total[at - reach]) / (2 * reach + 1))
