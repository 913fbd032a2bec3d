"""Worlds as MJCF text, MuJoCo's model format, in radians and SI units. Text only: this file needs no MuJoCo.

Names that the plants look up: of a standing part P the body and joint `P`; of a held object the bodies `hand` and its
two parts, the joints `pivot` and `joint`, and `x`, `y`, `z` where the hand is on slides; of the scene bodies `scene/B`.
Source: MuJoCo documentation, "XML reference".
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from micah_plan.automaton.contacts.values import Grip
from micah_plan.automaton.hybrid import Primitive
from micah_plan.errors import InputError, shown
from micah_plan.execution.mujoco.core import latch_name, sensor_name
from micah_plan.execution.mujoco.held_object import JOINT, PIVOT, HeldObject
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing_object import StandingPart
from micah_plan.scene.body import Body

Attributes = dict[str, Any]
Element = ElementTree.Element

# What all names of bodies of the scene begin with.
SCENE = "scene/"
AXES = "xyz"
_DIRECTIONS = tuple(zip(AXES, np.eye(3), strict=True))
_ORIGIN = "/origin"
# MuJoCo's constraints are springs: these time constants [s] and impedances make end stops, latches and dry friction act
# as rigid ones within some micrometres under a hand's force, at time steps of 1 ms and less.
_STIFF = {"solref": "0.004 1", "solimp": "0.99 0.999 0.0001"}
_STOPS = {"limited": "true"} | {f"{key}{kind}": _STIFF[key] for key in _STIFF for kind in ("limit", "friction")}
# Contacts give by some hundredths of a millimetre under a hand's force.
_CONTACT = {"solref": "0.004 1", "solimp": "0.95 0.99 0.0005", "condim": "4"}
# Who meets whom (geoms meet if the type of one is among what the other meets): the scene meets all but what is fixed in
# it; an arm meets the moving part of the object, but not the part in the hand. Standing objects meet nothing.
_NOTHING = {"contype": "0", "conaffinity": "0"}
_FIXED, _LOOSE = {"contype": "1", "conaffinity": "2"}, {"contype": "3", "conaffinity": "3"}
_IN_HAND, _MOVING = {"contype": "2", "conaffinity": "1"}, {"contype": "6", "conaffinity": "1"}
ARM_TYPE, ARM_MEETS = 2, 5
_HAND_MASS, _GRAVITY = 1.0, 9.81
_UNLIMITED = 1e3


def standing_mjcf(
    parts: Sequence[StandingPart], base_shapes: Iterable[Primitive], parameters: PhysicalParameters
) -> str:
    """A standing object. Its joints' positions are the configurations; nothing collides.

    Raises:
        InputError: for a shape of unknown kind or size.
    """
    root = _root("standing object")
    _add(_add(root, "option", gravity=(0.0, 0.0, -parameters.gravity)), "flag", contact="disable")
    world, equality = _add(root, "worldbody"), _add(root, "equality")
    _add(world, "site", name=_ORIGIN)
    _solids(world, list(base_shapes), 0.0, _NOTHING)
    bodies: dict[str | None, Element] = {None: world}
    for part in parts:
        place = _pose(part.joint.position, part.joint.quaternion)
        body = bodies[part.name] = _add(bodies[part.parent], "body", name=part.name, **place)
        if part.joint.kind != "rigid":
            _standing_joint(body, equality, part, parameters)
        _solids(body, part.shapes, parameters.mass, _NOTHING)
        _add(body, "site", name=part.name, pos=part.handle)
    _motors_and_sensors(root, parts)
    return _text(root)


def _standing_joint(body: Element, equality: Element, part: StandingPart, parameters: PhysicalParameters) -> None:
    """A slide, a hinge, or for a screw a hinge with a slide that follows it; and its latches."""
    joint, to_part = part.joint, Rotation.from_quat(part.joint.quaternion).inv()
    axis, center = to_part.apply(joint.axis), to_part.apply(np.subtract(joint.center, joint.position))
    _add(
        body,
        "joint",
        name=part.name,
        type="slide" if joint.kind == "prismatic" else "hinge",
        pos=center,
        axis=axis,
        # A hinge's moment is the force at the handle times the arm; its damping relates moment to angular velocity.
        damping=parameters.damping * part.arm**2,
        frictionloss=parameters.friction * part.arm,
        range=np.clip([part.lower, part.upper], -_UNLIMITED, _UNLIMITED),
        **_STOPS,
    )
    _latches(equality, part.name, part.latches)
    if part.latches:
        _add(body, "site", name=f"{part.name}/axis", pos=center, zaxis=axis)
    if joint.kind == "screw":
        _add(body, "joint", name=slide_name(part.name), type="slide", axis=axis)
        _add(
            equality,
            "joint",
            joint1=slide_name(part.name),
            joint2=part.name,
            polycoef=(0, joint.pitch, 0, 0, 0),
            **_STIFF,
        )


def _motors_and_sensors(root: Element, parts: Sequence[StandingPart]) -> None:
    """Three motors per part, along the axes of the base frame, whose lengths are the place of its handle [m].

    Sensors: the lengths of all motors, their forces [N], and of each joint that can latch anchor, axis and position.
    """
    actuator, sensor = _add(root, "actuator"), _add(root, "sensor")
    motors = {f"{part.name}/{axis}": (part.name, direction) for part in parts for axis, direction in _DIRECTIONS}
    for name, (part, direction) in motors.items():
        gear = (*direction, 0.0, 0.0, 0.0)
        _add(actuator, "general", name=name, site=part, refsite=_ORIGIN, gear=gear, biastype="affine")
    for kind in ("actuatorpos", "actuatorfrc"):
        for name in motors:
            _add(sensor, kind, actuator=name)
    for part in (part.name for part in parts if part.can_latch):
        site = f"{part}/axis"
        _add(sensor, "framepos", name=lever_name(part), objtype="site", objname=site)
        _add(sensor, "framezaxis", objtype="site", objname=site)
        _add(sensor, "jointpos", name=sensor_name(part), joint=part)


def scene_mjcf(scene: Iterable[Body], parameters: PhysicalParameters) -> str:
    """The world around a held object. Bodies that have a mass are loose.

    Raises:
        InputError: for a body that is a mesh.
    """
    root = _root("scene")
    # An arm's joints are stiff and light: their damping is integrated implicitly.
    option = _add(root, "option", gravity=(0.0, 0.0, -_GRAVITY), cone="elliptic", integrator="implicitfast")
    _add(option, "flag", filterparent="disable")  # fingers and the part that moves between them do meet
    world = _add(root, "worldbody")
    for body in scene:
        stands = _add(world, "body", name=SCENE + body.name, **_pose(body.position, body.quaternion))
        if body.mass is not None:
            _add(stands, "freejoint")
        solids = [shape for shape in body.shapes if isinstance(shape, Primitive)]
        if len(solids) < len(body.shapes):
            raise InputError(f"scene: the mesh of '{body.name}' cannot be simulated", remedy="use boxes")
        _solids(stands, solids, body.mass or 0.0, {**(_FIXED if body.mass is None else _LOOSE), **_surface(parameters)})
    return _text(root)


def held_mjcf(held: HeldObject, grip: Grip, parameters: PhysicalParameters, *, slides: bool) -> str:
    """The hand at the origin, with the object.

    Args:
        slides: whether the hand moves on three position-controlled slides; else an arm is to carry it.
    """
    root, surface = _root("held object"), _surface(parameters)
    world, equality = _add(root, "worldbody"), _add(root, "equality")
    hand = _add(world, "body", name="hand", gravcomp=1.0)
    if slides:
        _slides(root, hand, parameters)
    rotation = Rotation.from_rotvec(grip.rotation)
    place = _pose(-rotation.apply(grip.point), rotation.as_quat())
    in_hand = _add(hand, "body", name=grip.held.name, gravcomp=1.0, **place)
    if grip.pivots:
        spring = {"stiffness": parameters.pivot_stiffness, "damping": parameters.pivot_damping}
        _add(in_hand, "joint", name=PIVOT, axis=(0.0, 1.0, 0.0), pos=grip.point, **spring)
    _solids(in_hand, grip.held.shapes, parameters.mass, {**_IN_HAND, **surface})
    joint = held.joint
    place = _pose(joint.position, joint.quaternion) if joint.kind == "rigid" else {}
    moving = _add(in_hand, "body", name=grip.moving.name, **place)
    if joint.kind != "rigid":
        turns = joint.kind == "revolute"
        kind = {"type": "hinge", "axis": (0.0, -1.0, 0.0)} if turns else {"type": "slide", "axis": (0.0, 0.0, 1.0)}
        # Soft constraints creep: dry friction holds the part up only if it is stiff.
        resistance = {"frictionloss": parameters.joint_friction, "damping": parameters.joint_damping}
        _add(moving, "joint", name=JOINT, range=held.stops, **kind, **_STOPS, **resistance)
    _solids(moving, grip.moving.shapes, parameters.mass, {**_MOVING, **surface})
    _latches(equality, JOINT, [position for _, position in held.latches])
    if held.latches:
        _add(_add(root, "sensor"), "jointpos", name=sensor_name(JOINT), joint=JOINT)
    return _text(root)


def _slides(root: Element, hand: Element, parameters: PhysicalParameters) -> None:
    actuator, limit = _add(root, "actuator"), parameters.max_force
    damping = 2 * np.sqrt(parameters.stiffness * (_HAND_MASS + 2 * parameters.mass))
    motor = {"kp": parameters.stiffness, "kv": damping, "forcelimited": "true", "forcerange": (-limit, limit)}
    for axis, direction in _DIRECTIONS:
        _add(hand, "joint", name=axis, type="slide", axis=direction)
        _add(actuator, "position", name=axis, joint=axis, **motor)
    _add(hand, "geom", type="sphere", size=0.01, mass=_HAND_MASS, **_NOTHING)


def slide_name(part: str) -> str:
    """Name of the joint along which a part on a screw advances, besides its hinge."""
    return f"{part}/slide"


def lever_name(part: str) -> str:
    """Name of the first of the sensors of a standing part's joint: its anchor; its axis and position follow."""
    return f"{part}/lever"


def _root(name: str) -> Element:
    root = ElementTree.Element("mujoco", model=name)
    _add(root, "compiler", angle="radian")
    return root


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add(above: Element, tag: str, **attributes: Any) -> Element:
    """A new element; attributes are texts, numbers or arrays of numbers."""

    def text(value: Any) -> str:
        return value if isinstance(value, str) else " ".join(repr(float(number)) for number in np.ravel(value))

    return ElementTree.SubElement(above, tag, {name: text(value) for name, value in attributes.items()})


def _latches(equality: Element, joint: str, positions: Iterable[float]) -> None:
    """Constraints that lock a joint at a position each; inactive until they catch."""
    for number, position in enumerate(positions):
        fixed = {"joint1": joint, "polycoef": (position, 0, 0, 0, 0), "active": "false"}
        _add(equality, "joint", name=latch_name(joint, number), **fixed, **_STIFF)


def _solids(body: Element, shapes: Sequence[Primitive], mass: float, attributes: Attributes) -> None:
    """The shapes of a body, which share its mass [kg] by volume."""
    solids = [(shape, *_size_and_volume(shape)) for shape in shapes]
    whole = sum(volume for *_, volume in solids)
    for shape, size, volume in solids:
        place = _pose(shape.position, shape.quaternion)
        _add(body, "geom", type=shape.kind, size=size, mass=mass * volume / whole, **place, **attributes)


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


def _surface(parameters: PhysicalParameters) -> Attributes:
    return {**_CONTACT, "friction": (parameters.contact_friction, 0.005, 0.0001)}


def _pose(position: ArrayLike, quaternion: ArrayLike) -> Attributes:
    """A pose with its quaternion (scalar last) as MJCF has it."""
    return {"pos": position, "quat": np.roll(quaternion, 1)}
