"""A held object among bodies as MJCF text: a hand on three slides, an arm that may turn in it, a part that swings.

Names that the plant looks up: joints and actuators ``x``, ``y``, ``z``, joints ``pivot`` and ``swing``, equality
``latch``, bodies `hand` and the two parts, geoms ``scene/..``, ``held/..``, ``moving/..``. ``swing`` is 0 at the datum.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.contacts.task import Grip, HeldPart
from micah_plan.automaton.hybrid import Primitive
from micah_plan.errors import InputError
from micah_plan.execution.held_parameters import HeldParameters
from micah_plan.execution.mjcf import add, geometry, numbers, scalar_first, volume
from micah_plan.scene.body import Body

# Contacts give by some hundredths of a millimetre under a hand's force.
_CONTACT = {"solref": "0.004 1", "solimp": "0.95 0.99 0.0005", "condim": "4"}
_RIGID = {"solref": "0.004 1", "solimp": "0.99 0.999 0.0001"}
_SCENE, _OBJECT = {"contype": "1", "conaffinity": "2"}, {"contype": "2", "conaffinity": "1"}
_HAND_MASS = 1.0


def held_mjcf(
    grip: Grip, scene: tuple[Body, ...], opening: float, turns: bool, latches: bool, parameters: HeldParameters
) -> str:
    """The MJCF text.

    Args:
        opening: how far the joint opens from the datum [rad or m].
        turns: whether it is a hinge.
        latches: whether the object has a latch at the datum.

    Raises:
        InputError: for a body of the scene that is a mesh.
    """
    root = ElementTree.Element("mujoco", model="held object")
    add(root, "compiler", {"angle": "radian"})
    add(root, "option", {"gravity": numbers((0.0, 0.0, -9.81)), "timestep": "0.001", "cone": "elliptic"})
    world = add(root, "worldbody", {})
    for body in scene:
        fixed = add(world, "body", {"pos": numbers(body.position), "quat": scalar_first(body.quaternion)})
        for number, shape in enumerate(body.shapes):
            if not isinstance(shape, Primitive):
                raise InputError(f"scene: the mesh of '{body.name}' cannot be simulated", remedy="use boxes")
            name = {"name": f"scene/{body.name}/{number}"}
            add(fixed, "geom", {**geometry(shape, mass=0.0), **_SCENE, **_CONTACT, **_friction(parameters), **name})
    hand = add(world, "body", {"name": "hand", "gravcomp": "1"})
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        add(hand, "joint", {"name": axis, "type": "slide", "axis": numbers(direction)})
    add(hand, "geom", {"type": "sphere", "size": "0.01", "mass": str(_HAND_MASS), "contype": "0", "conaffinity": "0"})
    _object(hand, grip, opening, turns, parameters)
    equality = add(root, "equality", {})
    if latches:
        add(
            equality,
            "joint",
            {"name": "latch", "joint1": "swing", "polycoef": "0 0 0 0 0", "active": "false", **_RIGID},
        )
    actuator = add(root, "actuator", {})
    mass = _HAND_MASS + 2 * parameters.mass
    gains = {"kp": str(parameters.stiffness), "kv": str(2 * np.sqrt(parameters.stiffness * mass))}
    limits = {"forcelimited": "true", "forcerange": numbers((-parameters.max_force, parameters.max_force))}
    for axis in "xyz":
        add(actuator, "position", {"name": axis, "joint": axis, **gains, **limits})
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _object(hand: ElementTree.Element, grip: Grip, opening: float, turns: bool, parameters: HeldParameters) -> None:
    rotation = Rotation.from_rotvec(grip.rotation)
    x, y, z, w = rotation.as_quat()
    place = {"pos": numbers(-rotation.apply(grip.point)), "quat": scalar_first((x, y, z, w))}
    held = add(hand, "body", {"name": grip.held.name, "gravcomp": "1", **place})
    if grip.pivots:
        spring = {"stiffness": str(parameters.pivot_stiffness), "damping": str(parameters.pivot_damping)}
        add(held, "joint", {"name": "pivot", "axis": "0 1 0", "pos": numbers(grip.point), **spring})
    _shapes(held, grip.held, "held", parameters)
    moving = add(held, "body", {"name": grip.moving.name})
    kind = {"type": "hinge", "axis": "0 -1 0"} if turns else {"type": "slide", "axis": "0 0 1"}
    stop = {"limited": "true", "range": numbers((-opening, 0.0))}
    # Soft constraints creep: dry friction holds the part up only if it is stiff.
    stiff = {f"{key}{kind}": value for key, value in _RIGID.items() for kind in ("limit", "friction")}
    resistance = {"frictionloss": str(parameters.joint_friction), "damping": str(parameters.joint_damping)}
    add(moving, "joint", {"name": "swing", **kind, **stop, **stiff, **resistance})
    _shapes(moving, grip.moving, "moving", parameters)


def _shapes(body: ElementTree.Element, part: HeldPart, name: str, parameters: HeldParameters) -> None:
    volumes = [volume(shape) for shape in part.shapes]
    for number, (shape, share) in enumerate(zip(part.shapes, volumes, strict=True)):
        solid = geometry(shape, mass=parameters.mass * share / sum(volumes))
        add(body, "geom", {**solid, **_OBJECT, **_CONTACT, **_friction(parameters), "name": f"{name}/{number}"})


def _friction(parameters: HeldParameters) -> dict[str, str]:
    return {"friction": numbers((parameters.contact_friction, 0.005, 0.0001))}
