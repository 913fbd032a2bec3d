"""The physical parameters of an object, a hand and a tracker that a simulated execution needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from micah_plan.errors import InputError, shown

_MAY_BE_ZERO = {
    "damping", "friction", "latch_force", "latch_capture", "gravity", "position_noise", "rotation_noise",
    "position_wander", "rotation_wander",
}  # fmt: skip


@dataclass(frozen=True)
class PhysicalParameters:
    """Defaults serve a microwave door or a drawer, held by a hand, seen by a good visual tracker.

    Resistances are given as forces at the handle, so that one number means the same for a hinge and a slide; the
    plant turns them into moments with the handle's distance from the axis.

    Attributes:
        mass: of each moving part [kg].
        damping: viscous resistance [N s/m] at the handle.
        friction: dry friction [N] at the handle.
        latch_force: pull at the handle that opens a latch [N].
        latch_capture: distance of the handle from the latched position within which the latch catches [m].
        stiffness: of the hand [N/m]; its damping is critical for the part it holds.
        max_force: the largest force of the hand [N].
        control_period: duration of one control step [s].
        motion_share: share of the control step in which the hand's target moves; it rests for the remainder.
        gravity: acceleration along -z of the base frame [m/s^2]; 0 because a learned base frame is seldom level.
        position_noise, rotation_noise: white tracker noise per axis [m] and [rad] (std).
        position_wander, rotation_wander: slowly wandering tracker error per axis [m] and [rad] (std).
        wander_time: correlation time of the wander [s].
    """

    mass: float = 2.0
    damping: float = 2.0
    friction: float = 1.0
    latch_force: float = 8.0
    latch_capture: float = 0.004
    stiffness: float = 3000.0
    max_force: float = 80.0
    control_period: float = 0.5
    motion_share: float = 0.6
    gravity: float = 0.0
    position_noise: float = 0.003
    rotation_noise: float = 0.03
    position_wander: float = 0.0
    rotation_wander: float = 0.0
    wander_time: float = 5.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            lowest = 0.0 if item.name in _MAY_BE_ZERO else np.nextafter(0.0, 1.0)
            if not (np.isfinite(value) and value >= lowest):
                expected = "a number >= 0" if item.name in _MAY_BE_ZERO else "a number > 0"
                raise InputError(f"plant parameter '{item.name}' must be {expected}. Got {shown(value)}")
        if self.motion_share > 1.0:
            raise InputError(f"plant parameter 'motion_share' must be at most 1. Got {shown(self.motion_share)}")

    @classmethod
    def from_mapping(cls, values: Mapping[str, float]) -> PhysicalParameters:
        """The parameters of a problem file's `plant` block.

        Raises:
            InputError: for an unknown name or an impossible value.
        """
        return cls(**known_numbers(values, [item.name for item in fields(cls)]))


def known_numbers(values: Mapping[str, float], known: Sequence[str]) -> dict[str, float]:
    """The numbers of a problem file's `plant` block.

    Raises:
        InputError: for a name that is not known.
    """
    for name in values:
        if name not in known:
            raise InputError(f"unknown plant parameter {shown(name)}", remedy=f"choose among {', '.join(known)}")
    return {name: float(value) for name, value in values.items()}
