"""Building of worlds with MuJoCo's model editor (MjSpec): bodies on joints with latches, in radians and SI units.

MuJoCo is imported here alone. Bodies of the scene are called `scene/NAME` in the world, those of a held object
`object/NAME`. Source: MuJoCo documentation, "XML reference".
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.values import AXES
from micah_plan.automaton.hybrid import Primitive
from micah_plan.errors import InputError, shown
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.mujoco_library import import_mujoco
from micah_plan.task.body import Body

Flags = NDArray[np.bool_]
Attributes = dict[str, Any]
"""Attributes of an element of a world."""

SCENE, OBJECT = "scene/", "object/"
# MuJoCo's constraints are springs: these time constants [s] and impedances make end stops, latches and dry friction act
# as rigid ones within some micrometres under a hand's force, at time steps of 1 ms and less.
_STIFF = {"solref": (0.004, 1.0), "solimp": (0.99, 0.999, 0.0001, 0.5, 2.0)}
STOPS = {"limited": True} | {f"{key}_{kind}": _STIFF[key] for key in _STIFF for kind in ("limit", "friction")}
# Contacts give by some hundredths of a millimetre under a hand's force.
_CONTACT = {"solref": (0.004, 1.0), "solimp": (0.95, 0.99, 0.0005, 0.5, 2.0), "condim": 4}
# Who meets whom (geoms meet if the type of one is among what the other meets): the scene meets all but what is fixed in
# it; an arm meets the moving part of the object, but not the part in the hand. Standing objects meet nothing.
NOTHING = {"contype": 0, "conaffinity": 0}
_FIXED, _MOVABLE = {"contype": 1, "conaffinity": 2}, {"contype": 3, "conaffinity": 3}
IN_HAND, MOVING = {"contype": 2, "conaffinity": 1}, {"contype": 6, "conaffinity": 1}
ARM_TYPE, ARM_MEETS = 2, 5
_HAND_MASS, _GRAVITY = 1.0, 9.81
# A finger with its drive [kg].
_FINGER_INERTIA = 0.1


@dataclass
class LatchState:
    """A latch and its state: it catches when armed and near, and opens when pulled hard enough in a free direction.

    Attributes:
        position: where it latches; low, high: between which positions it catches [rad or m].
        release: pull on the joint that opens it [N m or N]; infinite: none does.
        free_down, free_up: whether the joint can move away downwards and upwards.
        armed: whether it would catch now.
        equality, joint, sensor: in the compiled world, the constraint that locks the joint, the joint's address, and
            the column of its position in the sensors.
        coordinate: of the model, which it holds.
    """

    position: float
    low: float
    high: float
    release: float = math.inf
    free_down: bool = False
    free_up: bool = False
    armed: bool = True
    equality: int = -1
    joint: int = -1
    sensor: int = -1
    coordinate: int = -1

    def is_near(self, position: Floats | float) -> Flags | bool:
        """(k,) whether an armed latch would catch the joint at a position [rad or m]."""
        return (self.low <= position) & (position <= self.high)

    def opens(self, pull: Floats | float) -> Flags | bool:
        """(k,) whether a locked joint is released by the hand's static pull [N m or N]."""
        return (self.free_up & (pull > self.release)) | (self.free_down & (pull < -self.release))

    def catches(self, position: float, pull: float) -> bool:
        """Whether a joint near the latch is locked from now on."""
        # Once opened it catches again only after the part has left, or has been pushed back.
        self.armed = self.armed or (position - self.position) * pull < 0
        return self.armed


@dataclass(frozen=True, eq=False)
class WorldJoint:
    """A joint that represents a coordinate of the model.

    Attributes:
        name: in the world.
        coordinate: of the model; the joint's position is scale * x[coordinate] + zero.
        latches: where it may be locked.
        is_shown: whether the coordinate is read from it; otherwise it follows a joint that is.
    """

    name: str
    coordinate: int
    scale: float = 1.0
    zero: float = 0.0
    latches: Sequence[LatchState] = ()
    is_shown: bool = True


class World:
    """A world under construction.

    Attributes:
        mujoco, spec: the library, and the world in its editor.
        joints: those that coordinates are read from, in the order in which they were added.
    """

    def __init__(self) -> None:
        self.mujoco = import_mujoco()
        self.spec = self.mujoco.MjSpec()
        self.spec.compiler.degree = False
        self.joints: list[WorldJoint] = []

    def solids(self, body: Any, shapes: Sequence[Primitive], mass: float, surface: Attributes) -> None:
        """Add shapes to a body in its own frame, with its mass [kg] distributed by volume.

        Raises:
            InputError: for a shape of unknown kind or size.
        """
        solids = [(shape, *_size_and_volume(shape)) for shape in shapes]
        whole = sum(volume for *_, volume in solids)
        for shape, size, volume in solids:
            kind = getattr(self.mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}")
            place = pose(shape.position, shape.quaternion)
            body.add_geom(type=kind, size=size, mass=mass * volume / whole, **place, **surface)

    def joint(self, body: Any, kind: str, name: str, **attributes: Any) -> None:
        """Add a hinge or slide to a body."""
        body.add_joint(name=name, type=getattr(self.mujoco.mjtJoint, f"mjJNT_{kind.upper()}"), **attributes)

    def show(self, joint: WorldJoint) -> None:
        """Let a joint represent a coordinate, with its latches, initially open.

        A sensor called `sensor_name` shows the position of a joint with latches.
        """
        self.joints.append(joint)
        for number, latch in enumerate(joint.latches):
            self.tie(joint.name, (latch.position, 0.0), name=latch_name(joint.name, number), active=False)
        if joint.latches:
            reference = {"objtype": self.mujoco.mjtObj.mjOBJ_JOINT, "objname": joint.name}
            self.spec.add_sensor(name=sensor_name(joint.name), type=self.mujoco.mjtSensor.mjSENS_JOINTPOS, **reference)

    def tie(self, joint: str, coefficients: Sequence[float] | Floats, joint_2: str = "", **attributes: Any) -> None:
        """Constrain a joint to a + b q + ... + e q^4, where q is the position of another joint (none: 0)."""
        kind = self.mujoco.mjtEq.mjEQ_JOINT
        constraint = self.spec.add_equality(type=kind, name1=joint, name2=joint_2, **_STIFF, **attributes)
        constraint.data[:5] = [*coefficients, *(5 - len(coefficients)) * [0.0]]


def scene_world(scene: Iterable[Body], parameters: PhysicalParameters) -> World:
    """The world around a held object. Bodies that have a mass are loose.

    Raises:
        InputError: for a body that is a mesh.
    """
    world = World()
    option, kinds = world.spec.option, world.mujoco
    # An arm's joints are stiff and light: their damping is integrated implicitly.
    option.gravity, option.cone = (0.0, 0.0, -_GRAVITY), kinds.mjtCone.mjCONE_ELLIPTIC
    option.integrator = kinds.mjtIntegrator.mjINT_IMPLICITFAST
    # Fingers and the part that moves between them do meet.
    option.disableflags = int(kinds.mjtDisableBit.mjDSBL_FILTERPARENT)
    for body in scene:
        stands = world.spec.worldbody.add_body(name=SCENE + body.name, **pose(body.position, body.quaternion))
        if body.mass is not None:
            stands.add_freejoint()
        solids = [shape for shape in body.shapes if isinstance(shape, Primitive)]
        if len(solids) < len(body.shapes):
            raise InputError(f"scene: the mesh of '{body.name}' cannot be simulated", remedy="use boxes")
        world.solids(
            stands, solids, body.mass or 0.0, contact_surface(_FIXED if body.mass is None else _MOVABLE, parameters)
        )
    return world


def add_hand(world: World, parameters: PhysicalParameters, *, slides: bool) -> Any:
    """The body "hand" at the origin of a world.

    Args:
        slides: whether it moves on three position-controlled slides; otherwise on an arm.
    """
    hand = world.spec.worldbody.add_body(name="hand", gravcomp=1)
    if not slides:
        return hand
    damping, limit = 2 * np.sqrt(parameters.stiffness * (_HAND_MASS + 2 * parameters.mass)), parameters.max_force
    world.solids(hand, (Primitive("sphere", (0.01,)),), _HAND_MASS, NOTHING)
    for name, axis in zip(AXES, np.eye(3), strict=True):
        world.joint(hand, "slide", name, axis=axis)
        on_joint = {"trntype": world.mujoco.mjtTrn.mjTRN_JOINT, "target": name}
        motor = world.spec.add_actuator(name=name, forcelimited=True, forcerange=(-limit, limit), **on_joint)
        motor.set_to_position(kp=parameters.stiffness, kv=damping)
    return hand


def add_finger_motor(spec: Any, name: str, parameters: PhysicalParameters) -> None:
    """A motor that brings a finger's joint to a place with the force of the grip at most."""
    joint, force = spec.joint(name), parameters.grip_force
    joint.armature, joint.actfrclimited = max(joint.armature, _FINGER_INERTIA), False
    stiffness = force / parameters.grip_deflection
    motor = spec.add_actuator(name=name, target=name, trntype=import_mujoco().mjtTrn.mjTRN_JOINT, forcelimited=True)
    motor.forcerange = (-force, force)
    motor.set_to_position(kp=stiffness, kv=2 * np.sqrt(stiffness * 2 * _FINGER_INERTIA))


def latch_name(joint: str, number: int) -> str:
    """Name of the constraint of a joint's latch."""
    return f"{joint}/latch/{number}"


def sensor_name(joint: str) -> str:
    """Name of the sensor of a latching joint's position."""
    return f"{joint}/position"


def pose(position: ArrayLike, quaternion: ArrayLike) -> Attributes:
    """A pose with its quaternion (scalar last) as MuJoCo has it."""
    return {"pos": position, "quat": np.roll(quaternion, 1)}


def contact_surface(meets: Attributes, parameters: PhysicalParameters) -> Attributes:
    """Contact attributes of a surface that meets others."""
    return {**meets, **_CONTACT, "friction": (parameters.contact_friction, 0.005, 0.0001)}


def _size_and_volume(shape: Primitive) -> tuple[tuple[float, ...], float]:
    """The sizes as MJCF has them [m], and the volume [m^3]."""
    sizes = {"box": 3, "cylinder": 2, "sphere": 1}
    if shape.kind not in sizes:
        raise InputError(f"unknown shape {shown(shape.kind)}", remedy=f"choose among {', '.join(sizes)}")
    if len(shape.size) != sizes[shape.kind] or not all(math.isfinite(s) and s > 0 for s in shape.size):
        raise InputError(f"a {shape.kind} has {sizes[shape.kind]} positive sizes. Got {shown(shape.size)}")
    if shape.kind == "box":
        return tuple(side / 2 for side in shape.size), math.prod(shape.size)
    radius = shape.size[0]
    if shape.kind == "sphere":
        return (radius,), 4 / 3 * math.pi * radius**3
    return (radius, shape.size[1] / 2), math.pi * radius**2 * shape.size[1]
