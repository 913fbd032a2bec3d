"""Worlds as MJCF text, MuJoCo's model format, in radians and SI units. Text only: this file needs no MuJoCo.

Names that the plants look up: of a standing part P the body and joint `P`; of a held object the bodies `hand` and its
two parts, the joints `pivot` and `joint`, and `x`, `y`, `z` where the hand is on slides; of the scene bodies `scene/B`.
Source: MuJoCo documentation, "XML reference".
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.contacts.values import Grip
from micah_plan.automaton.hybrid import Primitive
from micah_plan.automaton.joint import Quaternion
from micah_plan.errors import InputError, shown
from micah_plan.execution.mujoco.held_object import JOINT, PIVOT, HeldObject
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing_object import StandingPart
from micah_plan.scene.body import Body

Floats = NDArray[np.float64]
Attributes = dict[str, str]
Element = ElementTree.Element

# What all names of the held object begin with once it is in the world, and those of the scene.
OBJECT, SCENE = "object/", "scene/"
AXES = "xyz"
# The sensor of the held object's joint.
POSITION = "position"
_DIRECTIONS = tuple(zip(AXES, np.eye(3), strict=True))
_ORIGIN = "/origin"
# MuJoCo's constraints are springs: these time constants [s] and impedances make end stops, latches and dry friction act
# as rigid ones within some micrometres under a hand's force, at time steps of 1 ms and less.
_STIFF = {"solref": "0.004 1", "solimp": "0.99 0.999 0.0001"}
_STIFF_JOINT = {f"{key}{kind}": value for key, value in _STIFF.items() for kind in ("limit", "friction")}
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
    option = _add(root, "option", {"gravity": _numbers((0.0, 0.0, -parameters.gravity))})
    _add(option, "flag", {"contact": "disable"})
    world, equality = (_add(root, tag, {}) for tag in ("worldbody", "equality"))
    _add(world, "site", {"name": _ORIGIN})
    for shape in base_shapes:
        _add(world, "geom", {**_geometry(shape, 0.0), **_NOTHING})
    bodies: dict[str | None, Element] = {None: world}
    for part in parts:
        bodies[part.name] = _standing_part(bodies[part.parent], part, parameters)
        for constraint in _constraints(part):
            _add(equality, "joint", constraint)
    _motors_and_sensors(root, parts)
    return _text(root)


def _motors_and_sensors(root: Element, parts: Sequence[StandingPart]) -> None:
    """Three motors per part, along the axes of the base frame, whose lengths are the place of its handle [m].

    Sensors: the lengths of all motors, their forces [N], and of each joint that can latch anchor, axis and position.
    """
    actuator, sensor = (_add(root, tag, {}) for tag in ("actuator", "sensor"))
    motors = [(part.name, f"{part.name}/{axis}", direction) for part in parts for axis, direction in _DIRECTIONS]
    for part, name, direction in motors:
        gear = {"refsite": _ORIGIN, "gear": _numbers((*direction, 0.0, 0.0, 0.0))}
        _add(actuator, "general", {"name": name, "site": part, **gear, "biastype": "affine"})
    for kind in ("actuatorpos", "actuatorfrc"):
        for _, name, _ in motors:
            _add(sensor, kind, {"actuator": name})
    for part in (part.name for part in parts if part.can_latch):
        site = {"objtype": "site", "objname": _axis_site(part)}
        _add(sensor, "framepos", {"name": lever_name(part), **site})
        _add(sensor, "framezaxis", site)
        _add(sensor, "jointpos", {"joint": part})


def scene_mjcf(scene: Iterable[Body], parameters: PhysicalParameters) -> str:
    """The world around a held object. Bodies that have a mass are loose.

    Raises:
        InputError: for a body that is a mesh.
    """
    root = _root("scene")
    # An arm's joints are stiff and light: their damping is integrated implicitly.
    options = {"cone": "elliptic", "integrator": "implicitfast"}
    option = _add(root, "option", {"gravity": _numbers((0.0, 0.0, -_GRAVITY)), **options})
    _add(option, "flag", {"filterparent": "disable"})  # fingers and the part that moves between them do meet
    world = _add(root, "worldbody", {})
    for body in scene:
        stands = _add(world, "body", {"name": SCENE + body.name, **_pose(body.position, body.quaternion)})
        if body.mass is not None:
            _add(stands, "freejoint", {})
        solids = [shape for shape in body.shapes if isinstance(shape, Primitive)]
        if len(solids) < len(body.shapes):
            raise InputError(f"scene: the mesh of '{body.name}' cannot be simulated", remedy="use boxes")
        meets = _FIXED if body.mass is None else _LOOSE
        _solids(stands, solids, body.mass or 0.0, {**meets, **_surface(parameters)})
    return _text(root)


def held_mjcf(held: HeldObject, grip: Grip, parameters: PhysicalParameters, *, slides: bool) -> str:
    """The hand at the origin, with the object.

    Args:
        slides: whether the hand moves on three position-controlled slides; else an arm is to carry it.
    """
    root = _root("held object")
    hand = _add(_add(root, "worldbody", {}), "body", {"name": "hand", "gravcomp": "1"})
    if slides:
        _slides(root, hand, parameters)
    rotation = Rotation.from_rotvec(grip.rotation)
    place = _pose(-rotation.apply(grip.point), rotation.as_quat())
    in_hand = _add(hand, "body", {"name": grip.held.name, "gravcomp": "1", **place})
    if grip.pivots:
        spring = {"stiffness": _number(parameters.pivot_stiffness), "damping": _number(parameters.pivot_damping)}
        _add(in_hand, "joint", {"name": PIVOT, "axis": "0 1 0", "pos": _numbers(grip.point), **spring})
    _solids(in_hand, grip.held.shapes, parameters.mass, {**_IN_HAND, **_surface(parameters)})
    _moving_part(in_hand, held, grip, parameters)
    equality = _add(root, "equality", {})
    for number, (_, position) in enumerate(held.latches):
        _add(equality, "joint", _latch(latch_name("", number), JOINT, position))
    if held.latches:
        _add(_add(root, "sensor", {}), "jointpos", {"name": POSITION, "joint": JOINT})
    return _text(root)


def latch_name(part: str, number: int) -> str:
    """Name of a latch in the text, of a part of a standing object or ('') of a held one."""
    return f"{part}/latch/{number}".removeprefix("/")


def lever_name(part: str) -> str:
    """Name of the first of the sensors of a standing part's joint: its anchor; its axis and position follow."""
    return f"{part}/lever"


def _root(name: str) -> Element:
    root = ElementTree.Element("mujoco", model=name)
    _add(root, "compiler", {"angle": "radian"})
    return root


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add(above: Element, tag: str, attributes: Attributes) -> Element:
    return ElementTree.SubElement(above, tag, attributes)


def _standing_part(above: Element, part: StandingPart, parameters: PhysicalParameters) -> Element:
    body = _add(above, "body", {"name": part.name, **_pose(part.joint.position, part.joint.quaternion)})
    for joint in _standing_joints(part, parameters):
        _add(body, "joint", joint)
    _solids(body, part.shapes, parameters.mass, _NOTHING)
    _add(body, "site", {"name": part.name, "pos": _numbers(part.handle)})
    if part.can_latch:
        axis, center = _axis(part)
        _add(body, "site", {"name": _axis_site(part.name), "pos": _numbers(center), "zaxis": _numbers(axis)})
    return body


def _axis(part: StandingPart) -> tuple[Floats, Floats]:
    """Direction and centre of a part's joint, in the part's frame [m]."""
    joint, to_part = part.joint, Rotation.from_quat(part.joint.quaternion).inv()
    return to_part.apply(joint.axis), to_part.apply(np.subtract(joint.center, joint.position))


def _axis_site(part: str) -> str:
    return f"{part}/axis"


def _standing_joints(part: StandingPart, parameters: PhysicalParameters) -> list[Attributes]:
    """None for rigid, a slide, a hinge, or for a screw a hinge with a slide that will follow it."""
    joint = part.joint
    if joint.kind == "rigid":
        return []
    direction, center = _axis(part)
    axis = {"axis": _numbers(direction)}
    # A hinge's moment is the force at the handle times the arm; its damping relates moment to angular velocity.
    resistance = {
        "damping": _number(parameters.damping * part.arm**2),
        "frictionloss": _number(parameters.friction * part.arm),
    }
    limits = {"range": _numbers(np.clip([part.lower, part.upper], -_UNLIMITED, _UNLIMITED)), "limited": "true"}
    common = {"name": part.name, **axis, **resistance, **limits, **_STIFF_JOINT}
    if joint.kind == "prismatic":
        return [{"type": "slide", **common}]
    hinge = {"type": "hinge", "pos": _numbers(center), **common}
    return [hinge] if joint.kind == "revolute" else [hinge, {"name": _screw_slide(part), "type": "slide", **axis}]


def _constraints(part: StandingPart) -> list[Attributes]:
    """Latches, and for a screw the slide that follows its hinge."""
    if part.joint.kind == "rigid":
        return []
    constraints = [_latch(latch_name(part.name, i), part.name, at) for i, at in enumerate(part.latches)]
    if part.joint.kind == "screw":
        follow = _numbers((0, part.joint.pitch, 0, 0, 0))
        constraints.append({"joint1": _screw_slide(part), "joint2": part.name, "polycoef": follow, **_STIFF})
    return constraints


def _screw_slide(part: StandingPart) -> str:
    return f"{part.name}/slide"


def _latch(name: str, joint: str, position: float) -> Attributes:
    """Inactive until it catches."""
    fixed = {"joint1": joint, "polycoef": _numbers((position, 0, 0, 0, 0)), "active": "false"}
    return {"name": name, **fixed, **_STIFF}


def _slides(root: Element, hand: Element, parameters: PhysicalParameters) -> None:
    actuator = _add(root, "actuator", {})
    mass = _HAND_MASS + 2 * parameters.mass
    gains = {"kp": _number(parameters.stiffness), "kv": _number(2 * np.sqrt(parameters.stiffness * mass))}
    limits = {"forcelimited": "true", "forcerange": _numbers((-parameters.max_force, parameters.max_force))}
    for axis, direction in _DIRECTIONS:
        _add(hand, "joint", {"name": axis, "type": "slide", "axis": _numbers(direction)})
        _add(actuator, "position", {"name": axis, "joint": axis, **gains, **limits})
    _add(hand, "geom", {"type": "sphere", "size": "0.01", "mass": _number(_HAND_MASS), **_NOTHING})


def _moving_part(in_hand: Element, held: HeldObject, grip: Grip, parameters: PhysicalParameters) -> None:
    """The other part of a held object: on its joint, or fixed where the model has it."""
    is_fixed = held.joint.kind == "rigid"
    place = _pose(held.joint.position, held.joint.quaternion) if is_fixed else {}
    body = _add(in_hand, "body", {"name": grip.moving.name, **place})
    if not is_fixed:
        turns = held.joint.kind == "revolute"
        kind = {"type": "hinge", "axis": "0 -1 0"} if turns else {"type": "slide", "axis": "0 0 1"}
        # Soft constraints creep: dry friction holds the part up only if it is stiff.
        stops = {"limited": "true", "range": _numbers(held.stops), **_STIFF_JOINT}
        resistance = {"frictionloss": _number(parameters.joint_friction), "damping": _number(parameters.joint_damping)}
        _add(body, "joint", {"name": JOINT, **kind, **stops, **resistance})
    _solids(body, grip.moving.shapes, parameters.mass, {**_MOVING, **_surface(parameters)})


def _solids(body: Element, shapes: Sequence[Primitive], mass: float, attributes: Attributes) -> None:
    """The shapes of a body, which share its mass [kg] by volume."""
    volumes = [_volume(shape) for shape in shapes]
    for shape, share in zip(shapes, volumes, strict=True):
        _add(body, "geom", {**_geometry(shape, mass * share / sum(volumes)), **attributes})


def _surface(parameters: PhysicalParameters) -> Attributes:
    return {**_CONTACT, "friction": _numbers((parameters.contact_friction, 0.005, 0.0001))}


def _geometry(shape: Primitive, mass: float) -> Attributes:
    _check(shape)
    size = {"box": [s / 2 for s in shape.size], "cylinder": [shape.size[0], shape.size[-1] / 2], "sphere": shape.size}
    kind, place = {"type": shape.kind, "size": _numbers(size[shape.kind])}, _pose(shape.position, shape.quaternion)
    return {**kind, **place, "mass": _number(mass)}


def _volume(shape: Primitive) -> float:
    """[m^3]."""
    _check(shape)
    if shape.kind == "box":
        return math.prod(shape.size)
    radius = shape.size[0]
    return math.pi * radius**2 * shape.size[1] if shape.kind == "cylinder" else 4 / 3 * math.pi * radius**3


def _check(shape: Primitive) -> None:
    sizes = {"box": 3, "cylinder": 2, "sphere": 1}
    if shape.kind not in sizes:
        raise InputError(f"unknown shape {shown(shape.kind)}", remedy=f"choose among {', '.join(sizes)}")
    if len(shape.size) != sizes[shape.kind] or not all(math.isfinite(s) and s > 0 for s in shape.size):
        raise InputError(f"a {shape.kind} has {sizes[shape.kind]} positive sizes. Got {shown(shape.size)}")


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(value) for value in values)


def _pose(position: Iterable[float], quaternion: Quaternion | Iterable[float]) -> Attributes:
    """A pose with its quaternion (scalar last) as MJCF has it."""
    x, y, z, w = quaternion
    return {"pos": _numbers(position), "quat": _numbers((w, x, y, z))}
