"""The physical parameters of a held object, the hand and the tracker in MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, fields

from micah_plan.errors import InputError, shown
from micah_plan.planning.problem import Problem


@dataclass(frozen=True)
class HeldParameters:
    """Defaults serve a desk stapler.

    Attributes:
        mass: of each part [kg]; contact_friction: its coefficient; spread: both vary by this share from trial to trial.
        joint_friction: dry friction of the object's joint [N m or N]: it holds the part up while nothing touches it.
        joint_damping: [N m s/rad or N s/m].
        pivot_stiffness, pivot_damping: of the held part in the hand [N m/rad], [N m s/rad].
        stiffness: of the hand [N/m]; max_force: per axis [N].
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
    latch_capture: float = 0.005
    control_period: float = 0.4
    motion_share: float = 0.7
    position_noise: float = 0.003
    rotation_noise: float = 0.03

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not 0 <= value < float("inf"):
                raise InputError(f"plant parameter '{item.name}' must be a number >= 0. Got {shown(value)}")


def held_parameters(problem: Problem) -> HeldParameters:
    """Those that a problem's `plant` block states and a held object knows; defaults for the rest."""
    known = {item.name for item in fields(HeldParameters)}
    return HeldParameters(**{name: float(value) for name, value in problem.plant.items() if name in known})
