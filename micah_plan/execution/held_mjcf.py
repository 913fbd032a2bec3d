"""A held object, and the bodies around it, as MJCF text.

Names that the plant looks up: bodies ``scene/BODY``, and of the object joint ``swing``, equality ``latch``, bodies
``hand`` and the two parts. ``swing`` is 0 at the datum.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.contacts.values import Grip, HeldPart
from micah_plan.automaton.hybrid import Primitive
from micah_plan.errors import InputError
from micah_plan.execution.held_parameters import HeldParameters
from micah_plan.execution.mjcf import add, geometry, numbers, scalar_first, volume
from micah_plan.scene.body import Body

# What all names of the object begin with once it is in the world.
OBJECT = "object/"
# Who meets whom (geoms meet if the type of one is among what the other meets): the scene meets all but what is fixed
# in it; an arm meets the part that swings, but not the one that it holds.
_FIXED, _LOOSE = {"contype": "1", "conaffinity": "2"}, {"contype": "3", "conaffinity": "3"}
_HELD, _MOVING = {"contype": "2", "conaffinity": "1"}, {"contype": "6", "conaffinity": "1"}
ARM_TYPE, ARM_MEETS = 2, 5
# Contacts give by some hundredths of a millimetre under a hand's force.
_CONTACT = {"solref": "0.004 1", "solimp": "0.95 0.99 0.0005", "condim": "4"}
_RIGID = {"solref": "0.004 1", "solimp": "0.99 0.999 0.0001"}
_HAND_MASS = 1.0


def scene_mjcf(scene: tuple[Body, ...], parameters: HeldParameters) -> str:
    """The world without the object. Bodies that have a mass are loose.

    Raises:
        InputError: for a body that is a mesh.
    """
    root = _root()
    # An arm's joints are stiff and light: their damping is integrated implicitly.
    options = {"timestep": "0.001", "cone": "elliptic", "integrator": "implicitfast"}
    option = add(root, "option", {"gravity": numbers((0.0, 0.0, -9.81)), **options})
    add(option, "flag", {"filterparent": "disable"})  # fingers and the part that swings in them do meet
    world = add(root, "worldbody", {})
    for body in scene:
        place = {"pos": numbers(body.position), "quat": scalar_first(body.quaternion)}
        stands = add(world, "body", {"name": f"scene/{body.name}", **place})
        if body.mass is not None:
            add(stands, "freejoint", {})
        kind = _FIXED if body.mass is None else _LOOSE
        solids = [shape for shape in body.shapes if isinstance(shape, Primitive)]
        if len(solids) < len(body.shapes):
            raise InputError(f"scene: the mesh of '{body.name}' cannot be simulated", remedy="use boxes")
        for shape, mass in zip(solids, _masses(solids, body.mass or 0.0), strict=True):
            add(stands, "geom", {**geometry(shape, mass), **kind, **_CONTACT, **_friction(parameters)})
    return _text(root)


def object_mjcf(grip: Grip, turns: bool, latches: bool, parameters: HeldParameters, slides: bool) -> str:
    """The hand at the origin, with the object.

    Args:
        turns: whether the object's joint is a hinge.
        latches: whether it has a latch at the datum.
        slides: whether the hand moves on three position-controlled slides `x`, `y` and `z`; else an arm is to carry it.
    """
    root = _root()
    hand = add(add(root, "worldbody", {}), "body", {"name": "hand", "gravcomp": "1"})
    if slides:
        _slides(root, hand, parameters)
    _object(hand, grip, turns, parameters)
    if latches:
        held = {"name": "latch", "joint1": "swing", "polycoef": "0 0 0 0 0", "active": "false", **_RIGID}
        add(add(root, "equality", {}), "joint", held)
    return _text(root)


def _root() -> ElementTree.Element:
    root = ElementTree.Element("mujoco", model="held object")
    add(root, "compiler", {"angle": "radian"})
    return root


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _slides(root: ElementTree.Element, hand: ElementTree.Element, parameters: HeldParameters) -> None:
    actuator = add(root, "actuator", {})
    mass = _HAND_MASS + 2 * parameters.mass
    gains = {"kp": str(parameters.stiffness), "kv": str(2 * np.sqrt(parameters.stiffness * mass))}
    limits = {"forcelimited": "true", "forcerange": numbers((-parameters.max_force, parameters.max_force))}
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        add(hand, "joint", {"name": axis, "type": "slide", "axis": numbers(direction)})
        add(actuator, "position", {"name": axis, "joint": axis, **gains, **limits})
    add(hand, "geom", {"type": "sphere", "size": "0.01", "mass": str(_HAND_MASS), "contype": "0", "conaffinity": "0"})


def _object(hand: ElementTree.Element, grip: Grip, turns: bool, parameters: HeldParameters) -> None:
    rotation = Rotation.from_rotvec(grip.rotation)
    x, y, z, w = rotation.as_quat()
    place = {"pos": numbers(-rotation.apply(grip.point)), "quat": scalar_first((x, y, z, w))}
    held = add(hand, "body", {"name": grip.held.name, "gravcomp": "1", **place})
    if grip.pivots:
        spring = {"stiffness": str(parameters.pivot_stiffness), "damping": str(parameters.pivot_damping)}
        add(held, "joint", {"name": "pivot", "axis": "0 1 0", "pos": numbers(grip.point), **spring})
    _shapes(held, grip.held, _HELD, parameters)
    moving = add(held, "body", {"name": grip.moving.name})
    kind = {"type": "hinge", "axis": "0 -1 0"} if turns else {"type": "slide", "axis": "0 0 1"}
    stop = {"limited": "true", "range": numbers((-grip.travel, 0.0))}
    # Soft constraints creep: dry friction holds the part up only if it is stiff.
    stiff = {f"{key}{kind}": value for key, value in _RIGID.items() for kind in ("limit", "friction")}
    resistance = {"frictionloss": str(parameters.joint_friction), "damping": str(parameters.joint_damping)}
    add(moving, "joint", {"name": "swing", **kind, **stop, **stiff, **resistance})
    _shapes(moving, grip.moving, _MOVING, parameters)


def _shapes(body: ElementTree.Element, part: HeldPart, kind: dict[str, str], parameters: HeldParameters) -> None:
    for shape, mass in zip(part.shapes, _masses(part.shapes, parameters.mass), strict=True):
        add(body, "geom", {**geometry(shape, mass), **kind, **_CONTACT, **_friction(parameters)})


def _masses(shapes: Sequence[Primitive], mass: float) -> list[float]:
    """A body's mass [kg], shared among its shapes by volume."""
    volumes = [volume(shape) for shape in shapes]
    return [mass * share / sum(volumes) for share in volumes]


def _friction(parameters: HeldParameters) -> dict[str, str]:
    return {"friction": numbers((parameters.contact_friction, 0.005, 0.0001))}
