"""Physical parameters of object, hand and tracker, with defaults by kind of object."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from micah_plan.automaton.plausible import Amount
from micah_plan.errors import InputError, shown
from micah_plan.task.problem import Problem

_UNUSUAL = 1000.0
"""Times its default: a parameter beyond that was probably given in another unit."""
_ABOVE_0 = float(np.nextafter(0.0, 1.0))


def _key(standing: float | None, held: float | None, *, least: float = 0.0, most: float = np.inf) -> Any:
    """A parameter with its range, and its default for standing and for held objects (None: not applicable)."""
    limits = {"least": least, "most": most}
    return field(default=held if standing is None else standing, metadata={"defaults": (standing, held), **limits})


@dataclass(frozen=True)
class PhysicalParameters:
    """Defaults serve a microwave door or a drawer that stands, and a desk stapler that is held.

    Resistances of a standing object are forces at its handle, so that one number means the same for a hinge and a
    slide; the plant turns them into moments.

    Attributes:
        mass: of each moving part of a standing object, of each part of a held one [kg].
        damping, friction: viscous resistance [N s/m] and dry friction [N] of a standing object, at the handle.
        latch_force: pull at the handle that opens a standing object's latch [N].
        latch_capture: how near to the latched configuration it catches: of a standing object's handle [m], of a held
            object's joint [rad or m].
        stiffness: of the hand [N/m], which is critically damped; an arm has the stiffness of its joints instead.
        max_force: the largest force of the hand; on slides: per axis [N].
        control_period: duration of one control step [s].
        motion_share: share of the control step in which the hand's target moves; it rests for the remainder.
        gravity: of a standing object, along -z of the base frame [m/s^2]; 0: a learned base frame is seldom level.
        position_noise, rotation_noise: white tracker noise per axis [m] and [rad] (std).
        position_wander, rotation_wander: slowly wandering tracker error per axis [m] and [rad] (std).
        wander_time: correlation time of the wander [s].
        contact_friction: coefficient, of a held object and the scene.
        spread: share by which friction and a held object's mass vary from trial to trial.
        joint_friction, joint_damping: of a held object's joint, [N m or N] and [N m s/rad or N s/m]; dry friction holds
            the part up without contact.
        pivot_stiffness, pivot_damping: of the part in the hand where it turns there, [N m/rad] and [N m s/rad].
        joint_deflection: error at which a joint of an arm pushes with all its effort [rad or m].
        joint_effort: of joints of an arm whose file states none [N m or N].
        grip_force: with which fingers hold an object, each [N].
        grip_deflection: error at which a finger pushes with all its force [m].
        grip_unevenness: a finger opens later than the other by up to this [s].
        force_noise: of the force that a hand feels (std) [N].
        rotor_inertia: of an arm's motors as the joints feel them through the gears [kg m^2 or kg].
    """

    mass: float = _key(2.0, 0.15, least=_ABOVE_0)
    damping: float = _key(2.0, None)
    friction: float = _key(1.0, None)
    latch_force: float = _key(8.0, None)
    latch_capture: float = _key(0.004, 0.005)
    stiffness: float = _key(3000.0, 20000.0, least=_ABOVE_0)
    max_force: float = _key(80.0, 80.0, least=_ABOVE_0)
    control_period: float = _key(0.5, 0.4, least=_ABOVE_0)
    motion_share: float = _key(0.6, 0.7, least=_ABOVE_0, most=1.0)
    gravity: float = _key(0.0, None)
    position_noise: float = _key(0.003, 0.003)
    rotation_noise: float = _key(0.03, 0.03)
    position_wander: float = _key(0.0, None)
    rotation_wander: float = _key(0.0, None)
    wander_time: float = _key(5.0, None, least=_ABOVE_0)
    contact_friction: float = _key(None, 0.5)
    spread: float = _key(None, 0.2, most=1.0)
    joint_friction: float = _key(None, 0.2)
    joint_damping: float = _key(None, 0.01)
    pivot_stiffness: float = _key(None, 4.0)
    pivot_damping: float = _key(None, 0.2)
    joint_deflection: float = _key(None, 0.02, least=_ABOVE_0)
    joint_effort: float = _key(None, 100.0, least=_ABOVE_0)
    rotor_inertia: float = _key(None, 0.1)
    grip_force: float = _key(None, 20.0, least=_ABOVE_0)
    grip_deflection: float = _key(None, 0.001, least=_ABOVE_0)
    grip_unevenness: float = _key(None, 0.03)
    force_noise: float = _key(None, 0.1)

    def __post_init__(self) -> None:
        for item in fields(self):
            value, least = getattr(self, item.name), item.metadata["least"]
            if not least <= value < np.inf:
                expected = "a number > 0" if least else "a number >= 0"
                raise InputError(f"plant parameter '{item.name}' must be {expected}. Got {shown(value)}")
            if value > item.metadata["most"]:
                raise InputError(f"plant parameter '{item.name}' must be at most 1. Got {shown(value)}")

    @classmethod
    def from_mapping(cls, values: Mapping[str, float], *, held: bool = False) -> PhysicalParameters:
        """The parameters of a problem file's `plant` block, for a held or a standing object; the rest are defaults.

        Raises:
            InputError: for a name that this kind of object does not know, or an impossible value.
        """
        allowed = defaults(held=held)
        for name in values:
            if name not in allowed:
                raise InputError(f"unknown plant parameter {shown(name)}", remedy=f"choose among {', '.join(allowed)}")
        return cls(**allowed | {name: float(value) for name, value in values.items()})


def defaults(*, held: bool) -> dict[str, float]:
    """The keys of `plant` that a held or a standing object knows, each with the value that it has if none is stated."""
    defaults = {item.name: item.metadata["defaults"][held] for item in fields(PhysicalParameters)}
    return {name: value for name, value in defaults.items() if value is not None}


def amounts(values: Mapping[str, float], *, held: bool) -> Iterator[Amount]:
    """The parameters of a `plant` block compared with their defaults, for plausibility checks."""
    usual = defaults(held=held)
    for name, value in values.items():
        yield Amount(f"plant.{name}", value, "", _UNUSUAL * usual.get(name, 0.0), f"{_UNUSUAL:,.0f} times its default")


def parameters_of(problem: Problem) -> PhysicalParameters:
    """The parameters of a problem's `plant` block, completed by defaults.

    Raises:
        InputError: as `PhysicalParameters.from_mapping`.
    """
    return PhysicalParameters.from_mapping(problem.plant, held=problem.hold is not None)
