"""Actions given relative to a measured pose, rotated into the true pose.

A controller that steps on from its measurement directs its command along the motion at the *measured* configuration,
which differs from the true one by the tracker's noise. The noise of a measured step is then known from the direction of
its action, to a channel with a strong gain across the motion: such a channel explains noise, not motion. So the part of
the directions that follows the rows' own errors is removed by regression (Frisch and Waugh, Econometrica 1933).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Booleans
from micah_plan.automaton.joint import Joint, axis_basis
from micah_plan.learning.actions.configuration_steps import configurations_along
from micah_plan.learning.track import PartTrack

_NEAR = 4  # rows on each side that a direction is compared with


def with_anchored_actions(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans
) -> PartTrack:
    """The track with the pieces' actions rotated to remove their correlation with the rows' measurement errors."""
    if not joint.turns or track.action is None:
        return track
    configuration = configurations_along(joint, pieces, track, inlier)
    rows, error = (
        np.concatenate([r for r, _, _ in configuration]),
        np.concatenate([c - calm for _, c, calm in configuration]),
    )
    if not len(rows):
        return track
    world = None if track.quaternion is None else Rotation.from_quat(track.quaternion[rows])
    action = track.action[rows] if world is None else world.apply(track.action[rows])
    axis, (first, second) = np.array(joint.axis), axis_basis(joint.axis)
    local = (action @ first + 1j * (action @ second)) * np.exp(
        -1j * np.concatenate([calm for _, _, calm in configuration])
    )
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
