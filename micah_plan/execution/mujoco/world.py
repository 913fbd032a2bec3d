"""Worlds: bodies on joints with latches, as values and as MJCF text, MuJoCo's model format, in radians and SI units.

Text only: this file needs no MuJoCo. Bodies of the scene are called `scene/NAME` in the world.
Source: MuJoCo documentation, "XML reference".
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.values import AXES
from micah_plan.automaton.hybrid import Primitive
from micah_plan.errors import InputError, shown
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.scene.body import Body

Flags = NDArray[np.bool_]
Attributes = dict[str, Any]
"""Attributes of an element of MJCF: texts, numbers and arrays of numbers."""
Element = ElementTree.Element

SCENE = "scene/"
# MuJoCo's constraints are springs: these time constants [s] and impedances make end stops, latches and dry friction act
# as rigid ones within some micrometres under a hand's force, at time steps of 1 ms and less.
_STIFF = {"solref": "0.004 1", "solimp": "0.99 0.999 0.0001"}
STOPS = {"limited": "true"} | {f"{key}{kind}": _STIFF[key] for key in _STIFF for kind in ("limit", "friction")}
# Contacts give by some hundredths of a millimetre under a hand's force.
_CONTACT = {"solref": "0.004 1", "solimp": "0.95 0.99 0.0005", "condim": "4"}
# Who meets whom (geoms meet if the type of one is among what the other meets): the scene meets all but what is fixed in
# it; an arm meets the moving part of the object, but not the part in the hand. Standing objects meet nothing.
NOTHING = {"contype": "0", "conaffinity": "0"}
_FIXED, _LOOSE = {"contype": "1", "conaffinity": "2"}, {"contype": "3", "conaffinity": "3"}
IN_HAND, MOVING = {"contype": "2", "conaffinity": "1"}, {"contype": "6", "conaffinity": "1"}
ARM_TYPE, ARM_MEETS = 2, 5
_HAND_MASS, _GRAVITY = 1.0, 9.81
_ORIGIN = "/origin"


@dataclass
class Latch:
    """A latch and its state: it catches when armed and near, and opens when pulled hard enough in a free direction.

    Attributes:
        position: where it latches; low, high: between which positions it catches [rad or m].
        release: pull on the joint that opens it [N m or N]; infinite: none does.
        free_down, free_up: whether the joint can move away downwards and upwards.
        armed: whether it would catch now.
        equality, joint, sensor: in the compiled world, the constraint that locks the joint, the joint's address, and
            the column of its position among what the sensors show.
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
        """Whether it would catch the joint at a position [rad or m], (k,) or one, if it is armed."""
        return (self.low <= position) & (position <= self.high)

    def opens(self, pull: Floats | float) -> Flags | bool:
        """Whether a locked joint comes free under the hand's static pull on it [N m or N], (k,) or one."""
        return (self.free_up & (pull > self.release)) | (self.free_down & (pull < -self.release))

    def catches(self, position: float, pull: float) -> bool:
        """Whether a joint near the latch is locked from now on."""
        # Once opened it catches again only after the part has left, or has been pushed back the way it came.
        self.armed = self.armed or (position - self.position) * pull < 0
        return self.armed


@dataclass(frozen=True, eq=False)
class WorldJoint:
    """A joint of a body.

    Attributes:
        name: in the world.
        attributes: of its element.
        coordinate: of the model, which shows it as position = scale * x[coordinate] + zero; -1: none does.
        latches: where it may be locked.
        follows: name of the joint whose position times `scale` it always has; empty if none.
    """

    name: str
    attributes: Attributes
    coordinate: int = -1
    scale: float = 1.0
    zero: float = 0.0
    latches: Sequence[Latch] = ()
    follows: str = ""


@dataclass(frozen=True, eq=False)
class WorldBody:
    """A body of the object, or the hand.

    Attributes:
        name, parent: its own and that of the body that carries it (None: the world).
        attributes: of its element.
        joints: by which it moves.
        shapes: in its own frame; they share its mass [kg] by volume.
        surface: attributes of these shapes.
        handle: where a hand pulls at it, in its frame [m]; None: none does.
        arm: how far the handle moves per unit of the joint [m/rad], or 1 for a slide.
    """

    name: str
    parent: str | None
    attributes: Attributes
    joints: Sequence[WorldJoint]
    shapes: Sequence[Primitive]
    mass: float
    surface: Attributes = field(default_factory=lambda: NOTHING)
    handle: ArrayLike | None = None
    arm: float = 1.0


def standing_mjcf(bodies: Sequence[WorldBody], base_shapes: Sequence[Primitive], gravity: float) -> str:
    """A standing object, each of its bodies with a hand: three motors along the axes of the base frame, whose lengths
    are the place of the body's handle [m]. Nothing collides.

    Sensors: the lengths of all motors, then their forces [N], then of each joint that can latch anchor and axis.

    Raises:
        InputError: for a shape of unknown kind or size.
    """
    root = _root("standing object")
    _add(_add(root, "option", gravity=(0.0, 0.0, -gravity)), "flag", contact="disable")
    world, actuator, sensor = _add(root, "worldbody"), _add(root, "actuator"), _add(root, "sensor")
    _add(world, "site", name=_ORIGIN)
    _add_solids(world, base_shapes, 0.0, NOTHING)
    motors = [(body.name, f"{body.name}/{axis}", axis) for body in bodies for axis in range(3)]
    for site, name, axis in motors:
        _add(actuator, "general", name=name, site=site, refsite=_ORIGIN, gear=np.eye(6)[axis], biastype="affine")
    for kind in ("actuatorpos", "actuatorfrc"):
        for _, name, _ in motors:
            _add(sensor, kind, actuator=name)
    elements = _add_bodies(root, world, bodies)
    for body in bodies:
        _add(elements[body.name], "site", name=body.name, pos=body.handle)
        for joint in (joint for joint in body.joints if joint.latches):
            place = {"pos": joint.attributes["pos"], "zaxis": joint.attributes["axis"]}
            _add(elements[body.name], "site", name=lever_name(joint.name), **place)
            _add(sensor, "framepos", name=lever_name(joint.name), objtype="site", objname=lever_name(joint.name))
            _add(sensor, "framezaxis", objtype="site", objname=lever_name(joint.name))
    return _text(root)


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
        stands = _add(world, "body", name=SCENE + body.name, **pose(body.position, body.quaternion))
        if body.mass is not None:
            _add(stands, "freejoint")
        solids = [shape for shape in body.shapes if isinstance(shape, Primitive)]
        if len(solids) < len(body.shapes):
            raise InputError(f"scene: the mesh of '{body.name}' cannot be simulated", remedy="use boxes")
        surface = rubbing(_FIXED if body.mass is None else _LOOSE, parameters)
        _add_solids(stands, solids, body.mass or 0.0, surface)
    return _text(root)


def held_mjcf(bodies: Sequence[WorldBody], parameters: PhysicalParameters, *, slides: bool) -> str:
    """A held object and what carries it, the body "hand" at the origin.

    Args:
        slides: whether the hand moves on three position-controlled slides; else an arm is to carry it.
    """
    root = _root("held object")
    hand = WorldBody("hand", None, {"gravcomp": 1}, (), (), 0.0)
    if slides:
        along = [WorldJoint(name, {"type": "slide", "axis": axis}) for name, axis in zip(AXES, np.eye(3), strict=True)]
        hand = replace(hand, joints=along, shapes=(Primitive("sphere", (0.01,)),), mass=_HAND_MASS)
    _add_bodies(root, _add(root, "worldbody"), [hand, *bodies])
    actuator, limit = _add(root, "actuator"), parameters.max_force
    damping = 2 * np.sqrt(parameters.stiffness * (_HAND_MASS + 2 * parameters.mass))
    motor = {"kp": parameters.stiffness, "kv": damping, "forcelimited": "true", "forcerange": (-limit, limit)}
    for joint in hand.joints:
        _add(actuator, "position", name=joint.name, joint=joint.name, **motor)
    return _text(root)


def _add_bodies(root: Element, world: Element, bodies: Sequence[WorldBody]) -> dict[str | None, Element]:
    """Add bodies, parents first, with constraints for their latches and sensors of where latching joints are."""
    equality, sensor = _add(root, "equality"), _add(root, "sensor")
    elements: dict[str | None, Element] = {None: world}
    for body in bodies:
        element = elements[body.name] = _add(elements[body.parent], "body", name=body.name, **body.attributes)
        for joint in body.joints:
            _add(element, "joint", name=joint.name, **joint.attributes)
            for number, latch in enumerate(joint.latches):  # inactive until it catches
                place = {"joint1": joint.name, "polycoef": (latch.position, 0, 0, 0, 0), "active": "false"}
                _add(equality, "joint", name=latch_name(joint.name, number), **place, **_STIFF)
            if joint.latches:
                _add(sensor, "jointpos", name=sensor_name(joint.name), joint=joint.name)
            if joint.follows:
                place = {"joint1": joint.name, "joint2": joint.follows, "polycoef": (0, joint.scale, 0, 0, 0)}
                _add(equality, "joint", **place, **_STIFF)
        _add_solids(element, body.shapes, body.mass, body.surface)
    return elements


def latch_name(joint: str, number: int) -> str:
    """Name of the constraint of a joint's latch."""
    return f"{joint}/latch/{number}"


def sensor_name(joint: str) -> str:
    """Name of the sensor of a latching joint's position."""
    return f"{joint}/position"


def lever_name(joint: str) -> str:
    """Name of the sensor of a standing body's latching joint that shows its anchor; that of its axis follows."""
    return f"{joint}/lever"


def _add(above: Element, tag: str, **attributes: Any) -> Element:
    """A new element; attributes are texts, numbers or arrays of numbers."""

    def text(value: Any) -> str:
        return value if isinstance(value, str) else " ".join(repr(float(number)) for number in np.ravel(value))

    return ElementTree.SubElement(above, tag, {name: text(value) for name, value in attributes.items()})


def pose(position: ArrayLike, quaternion: ArrayLike) -> Attributes:
    """A pose with its quaternion (scalar last) as MJCF has it."""
    return {"pos": position, "quat": np.roll(quaternion, 1)}


def rubbing(meets: Attributes, parameters: PhysicalParameters) -> Attributes:
    """The surface of what meets others."""
    return {**meets, **_CONTACT, "friction": (parameters.contact_friction, 0.005, 0.0001)}


def _root(name: str) -> Element:
    root = ElementTree.Element("mujoco", model=name)
    _add(root, "compiler", angle="radian")
    return root


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add_solids(body: Element, shapes: Sequence[Primitive], mass: float, attributes: Attributes) -> None:
    solids = [(shape, *_size_and_volume(shape)) for shape in shapes]
    whole = sum(volume for *_, volume in solids)
    for shape, size, volume in solids:
        place = pose(shape.position, shape.quaternion)
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
