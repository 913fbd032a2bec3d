"""A mechanism as MJCF text, MuJoCo's model format, in radians and SI units. Text only: this file needs no MuJoCo.

Names that the plant looks up: body, joint and site `P` for a part P, equality `P/latch/i` for its i-th latch.
Source: MuJoCo documentation, "XML reference".
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import Primitive
from micah_plan.automaton.joint import Quaternion
from micah_plan.errors import InputError, shown
from micah_plan.execution.physical_object import PhysicalLink
from micah_plan.execution.physical_parameters import PhysicalParameters

# MuJoCo's constraints are springs: these time constants [s] and impedances make end stops, latches and dry friction act
# as rigid ones within some micrometres under a hand's force, at time steps of 1 ms and less.
_STIFF = {"solref": "0.004 1", "solimp": "0.99 0.999 0.0001"}
_UNLIMITED = 1e3


def mjcf(links: Sequence[PhysicalLink], base_shapes: Iterable[Primitive], parameters: PhysicalParameters) -> str:
    """The MJCF text of a mechanism. Its joints' positions are the configurations; contacts are off.

    Raises:
        InputError: for a shape of unknown kind or size.
    """
    root = ElementTree.Element("mujoco", model="object")
    add(root, "compiler", {"angle": "radian"})
    add(root, "option", {"gravity": numbers((0.0, 0.0, -parameters.gravity))})
    world = add(root, "worldbody", {})
    for shape in base_shapes:
        add(world, "geom", geometry(shape, mass=0.0))
    equality = add(root, "equality", {})
    bodies: dict[str, ElementTree.Element] = {}
    for link in links:
        above = world if link.parent is None else bodies[link.parent]
        bodies[link.name] = _body(above, link, parameters)
        for constraint in _constraints(link):
            add(equality, "joint", constraint)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def add(above: ElementTree.Element, tag: str, attributes: dict[str, str]) -> ElementTree.Element:
    """A new element under another."""
    return ElementTree.SubElement(above, tag, attributes)


def _body(above: ElementTree.Element, link: PhysicalLink, parameters: PhysicalParameters) -> ElementTree.Element:
    pose = {"pos": numbers(link.joint.position), "quat": scalar_first(link.joint.quaternion)}
    body = add(above, "body", {"name": link.name, **pose})
    for joint in _joints(link, parameters):
        add(body, "joint", joint)
    volumes = [volume(shape) for shape in link.shapes]
    for shape, share in zip(link.shapes, volumes, strict=True):
        add(body, "geom", geometry(shape, mass=parameters.mass * share / sum(volumes)))
    add(body, "site", {"name": link.name, "pos": numbers(link.handle)})
    return body


def _joints(link: PhysicalLink, parameters: PhysicalParameters) -> list[dict[str, str]]:
    """None for rigid, a slide, a hinge, or for a screw a hinge with a slide that will follow it."""
    joint = link.joint
    if joint.kind == "rigid":
        return []
    to_part = Rotation.from_quat(joint.quaternion).inv()
    axis = {"axis": numbers(to_part.apply(joint.axis))}
    # A hinge's moment is the force at the handle times the arm; its damping relates moment to angular velocity.
    resistance = {
        "damping": _number(parameters.damping * link.arm**2),
        "frictionloss": _number(parameters.friction * link.arm),
    }
    limits = {"range": numbers(np.clip([link.lower, link.upper], -_UNLIMITED, _UNLIMITED)), "limited": "true"}
    stiff = {f"{key}{kind}": value for key, value in _STIFF.items() for kind in ("limit", "friction")}
    common = {"name": link.name, **axis, **resistance, **limits, **stiff}
    if joint.kind == "prismatic":
        return [{"type": "slide", **common}]
    center = to_part.apply(np.subtract(joint.center, joint.position))
    hinge = {"type": "hinge", "pos": numbers(center), **common}
    return [hinge] if joint.kind == "revolute" else [hinge, {"name": _slide(link.name), "type": "slide", **axis}]


def _constraints(link: PhysicalLink) -> list[dict[str, str]]:
    """Latches (inactive until they catch), and for a screw the slide that follows its hinge."""
    if link.joint.kind == "rigid":
        return []
    constraints = []
    for number, configuration in enumerate(link.latches):
        held = {"joint1": link.name, "polycoef": numbers((configuration, 0, 0, 0, 0)), "active": "false"}
        constraints.append({"name": latch_name(link.name, number), **held, **_STIFF})
    if link.joint.kind == "screw":
        follow = numbers((0, link.joint.pitch, 0, 0, 0))
        constraints.append({"joint1": _slide(link.name), "joint2": link.name, "polycoef": follow, **_STIFF})
    return constraints


def latch_name(part: str, number: int) -> str:
    """Name of a part's latch in the text."""
    return f"{part}/latch/{number}"


def _slide(part: str) -> str:
    return f"{part}/slide"


def geometry(shape: Primitive, mass: float) -> dict[str, str]:
    """Attributes of the geom of a shape [kg], without contacts."""
    _check(shape)
    size = {"box": [s / 2 for s in shape.size], "cylinder": [shape.size[0], shape.size[-1] / 2], "sphere": shape.size}
    return {
        "type": shape.kind,
        "size": numbers(size[shape.kind]),
        "pos": numbers(shape.position),
        "quat": scalar_first(shape.quaternion),
        "mass": _number(mass),
        "contype": "0",
        "conaffinity": "0",
    }


def volume(shape: Primitive) -> float:
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


def numbers(values: Iterable[float]) -> str:
    """Numbers as MJCF writes them."""
    return " ".join(_number(value) for value in values)


def scalar_first(quaternion: Quaternion) -> str:
    """A quaternion (scalar last) as MJCF writes it."""
    x, y, z, w = quaternion
    return numbers((w, x, y, z))
