"""Posture cost: distance to joint limits, singularities and obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.robot.arm import Arm
from micah_plan.robot.clearance import ClearanceModel, Pair, PartPoses

_DIFFERENCE = 1e-4
_UNLIMITED_HALF_RANGE = np.pi
_LIMIT_ZONE = 0.15


@dataclass(frozen=True)
class PostureWeights:
    """Weights of the terms of a posture's cost, all without units.

    Attributes:
        rest: of the squared distance from the rest posture, each joint over half its range.
        limits: of coming near a limit: 1 at the limit, 0 from 15 % of the range on.
        manipulability: of the logarithm of the manipulability.
        clearance: of coming near an obstacle: 1 at contact, 0 from `influence` on.
        influence: [m].
    """

    rest: float = 0.2
    limits: float = 2.0
    manipulability: float = 0.3
    clearance: float = 3.0
    influence: float = 0.08


def half_range(arm: Arm) -> Floats:
    """(n,) half of each joint's range; π for joints without limits."""
    wide = np.isfinite(arm.upper) & np.isfinite(arm.lower)
    return np.where(wide, (np.where(wide, arm.upper, 0.0) - np.where(wide, arm.lower, 0.0)) / 2, _UNLIMITED_HALF_RANGE)


def posture_cost(
    model: ClearanceModel, q: Floats, parts: PartPoses, ignored: frozenset[Pair], weights: PostureWeights
) -> float:
    """The cost of a configuration q (n,); lower is better.

    Args:
        parts: pose (single) of each part in the base frame.
        ignored: pairs that may meet.
    """
    arm, half = model.arm, half_range(model.arm)
    near = _limit_share(arm, q, half)
    cost = weights.rest * float((((q - arm.rest) / half) ** 2).mean())
    cost += weights.limits * float((np.maximum(near, 0.0) ** 2).sum())
    cost -= weights.manipulability * float(np.log(max(float(arm.manipulability(q)[0]), 1e-9)))
    distance = model.at(q, parts, ignored).distance
    return cost + weights.clearance * max(0.0, 1.0 - distance / weights.influence) ** 2


def posture_gradient(
    model: ClearanceModel, q: Floats, parts: PartPoses, ignored: frozenset[Pair], weights: PostureWeights
) -> Floats:
    """(n,) derivative of `posture_cost` by q, held parts moving with the tool."""
    arm, half = model.arm, half_range(model.arm)
    near = _limit_share(arm, q, half)
    gradient = weights.rest * 2.0 * (q - arm.rest) / half**2 / arm.n
    sign = np.where(arm.upper - q < q - arm.lower, 1.0, -1.0)
    gradient = gradient + weights.limits * 2.0 * np.maximum(near, 0.0) * sign / (_LIMIT_ZONE * 2 * half)
    steps = q + _DIFFERENCE * np.concatenate([np.eye(arm.n), -np.eye(arm.n)])
    logs = np.log(np.maximum(arm.manipulability(steps), 1e-9))
    gradient -= weights.manipulability * (logs[: arm.n] - logs[arm.n :]) / (2 * _DIFFERENCE)
    clearance, away = model.gradient(q, parts, ignored)
    near_obstacle = max(0.0, 1.0 - clearance.distance / weights.influence)
    return np.asarray(gradient - weights.clearance * 2.0 * near_obstacle * away / weights.influence)


def _limit_share(arm: Arm, q: Floats, half: Floats) -> Floats:
    """(n,) 1 at a limit, 0 at 15 % of the range from it, negative beyond."""
    return np.asarray(1.0 - np.minimum(q - arm.lower, arm.upper - q) / (_LIMIT_ZONE * 2 * half))
