"""The physical parameters of a held object, the hand and the tracker in MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from micah_plan.errors import InputError, shown
from micah_plan.execution.physical_parameters import PhysicalParameters, known_numbers
from micah_plan.task.problem import Problem

_MAY_BE_ZERO = {
    "contact_friction", "spread", "joint_friction", "joint_damping", "pivot_stiffness", "pivot_damping",
    "rotor_inertia", "latch_capture", "position_noise", "rotation_noise",
}  # fmt: skip


@dataclass(frozen=True)
class HeldParameters:
    """Defaults serve a desk stapler.

    Attributes:
        mass: of each part [kg]; contact_friction: its coefficient; spread: both vary by this share from trial to trial.
        joint_friction: dry friction of the object's joint [N m or N]: it holds the part up while nothing touches it.
        joint_damping: [N m s/rad or N s/m].
        pivot_stiffness, pivot_damping: of the held part in the hand [N m/rad], [N m s/rad].
        stiffness: of a hand without an arm [N/m]; max_force: its per axis [N].
        joint_deflection: error at which a joint of an arm pushes with all its effort [rad or m].
        joint_effort: of joints whose file states none [N m or N].
        rotor_inertia: of each motor as its joint feels it through the gears [kg m^2 or kg].
        latch_capture: how close to the latched configuration it catches [rad or m].
        control_period: duration of one control step [s]; motion_share: in which share of it the target moves.
        position_noise, rotation_noise: of the tracker per axis [m], [rad] (std).
    """

    mass: float = 0.15
    contact_friction: float = 0.5
    spread: float = 0.2
    joint_friction: float = 0.2
    joint_damping: float = 0.01
    pivot_stiffness: float = 4.0
    pivot_damping: float = 0.2
    stiffness: float = 20000.0
    max_force: float = 80.0
    joint_deflection: float = 0.02
    joint_effort: float = 100.0
    rotor_inertia: float = 0.1
    latch_capture: float = 0.005
    control_period: float = 0.4
    motion_share: float = 0.7
    position_noise: float = 0.003
    rotation_noise: float = 0.03

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            lowest = 0.0 if item.name in _MAY_BE_ZERO else np.nextafter(0.0, 1.0)
            if not lowest <= value < np.inf:
                expected = "a number >= 0" if item.name in _MAY_BE_ZERO else "a number > 0"
                raise InputError(f"plant parameter '{item.name}' must be {expected}. Got {shown(value)}")
        for name in ("motion_share", "spread"):
            if getattr(self, name) > 1.0:
                raise InputError(f"plant parameter '{name}' must be at most 1. Got {shown(getattr(self, name))}")


def held_parameters(problem: Problem) -> HeldParameters:
    """What a problem's `plant` block states for its held object; defaults for the rest.

    Raises:
        InputError: for a name that a held object does not know, or an impossible value.
    """
    return HeldParameters(**known_numbers(problem.plant, [item.name for item in fields(HeldParameters)]))


def parameters_of(problem: Problem) -> HeldParameters | PhysicalParameters:
    """The parameters of a problem's plant: of a held object, or of one that stands."""
    if problem.hold is not None:
        return held_parameters(problem)
    return PhysicalParameters.from_mapping(problem.plant)
