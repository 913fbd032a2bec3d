"""Models as URDF, which knows joints, limits and shapes, but no modes, guards or uncertainty.

Each link of the model must have one moving joint over all modes; it may go where any mode allows it. A part's frame
need not lie on its joint's axis, a URDF link's must: a link ``PART_axis`` turns, and the part's link is fixed to it.
Joints are named after the coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Part, Primitive
from micah_plan.automaton.joint import IDENTITY, Joint
from micah_plan.automaton.region import Interval
from micah_plan.errors import InputError
from micah_plan.robot.robot_text import NO_LIMIT
from micah_plan.robot.xml_text import Element, write_xml

AXIS_LINK = "_axis"
_REMEDY = "URDF cannot say that; keep the YAML"


def urdf_text(automaton: HybridAutomaton, title: str) -> str:
    """The text of a URDF of the model.

    Args:
        title: name of the robot in the file.

    Raises:
        InputError: for a part on a screw, with different moving joints in different modes, or that moves with another.
    """
    parts = {part.name: part for part in automaton.parts}
    elements = [_link(BASE, parts.get(BASE))]
    moving: set[int] = set()
    for k, link in enumerate(automaton.links):
        joint = _moving_joint(automaton, k)
        if joint.kind != "rigid" and link.coordinate in moving:
            raise InputError(f"part {link.child} moves with another one", remedy=_REMEDY)
        moving |= {link.coordinate} if joint.kind != "rigid" else set()
        ranges = automaton.ranges(link.coordinate) or [(-np.inf, np.inf)]
        limits = ranges[0][0], ranges[-1][1]
        name = automaton.coordinates[link.coordinate].name
        elements += _moved((name, link.parent, link.child), joint, limits, parts.get(link.child))
    lines = "".join(f"  {write_xml(element)}\n" for element in elements)
    head, _, tail = write_xml(Element("robot", {"name": title}, 0)).partition("</")
    return f'<?xml version="1.0"?>\n{head}\n{lines}</{tail}\n'


def _moving_joint(automaton: HybridAutomaton, k: int) -> Joint:
    """The one joint of a link that moves it in any mode; a rigid one if there is none."""
    part = automaton.links[k].child
    joints = [replace(mode.joints[k], covariance=None) for mode in automaton.modes]
    moving = list(dict.fromkeys(joint for joint in joints if joint.kind != "rigid"))
    if len(moving) > 1:
        raise InputError(f"part {part} has different joints in different modes", remedy=_REMEDY)
    if any(joint.kind == "screw" for joint in moving):
        raise InputError(f"part {part} moves on a screw", remedy=_REMEDY)
    return moving[0] if moving else joints[0]


def _moved(names: tuple[str, str, str], joint: Joint, limits: Interval, part: Part | None) -> list[Element]:
    """The link of a part with the joint that carries it; names of the coordinate, parent and child."""
    name, parent, child = names
    turn = Rotation.from_quat(joint.quaternion)
    if joint.kind == "rigid":
        return [_link(child, part), _joint(f"{child}_mount", "fixed", parent, child, joint.position, joint.quaternion)]
    axis = Element("axis", {"xyz": _words(turn.inv().apply(joint.axis))}, 0)
    free = joint.kind == "revolute" and not np.isfinite(limits).any()
    low, high = (float(np.clip(end, -NO_LIMIT, NO_LIMIT)) for end in limits)
    bounds = {"lower": repr(low), "upper": repr(high), "effort": "100", "velocity": "1"}
    described = [axis] if free else [axis, Element("limit", bounds, 0)]
    kind = "continuous" if free else joint.kind
    if joint.kind == "prismatic":
        return [_link(child, part), _joint(name, kind, parent, child, joint.position, joint.quaternion, described)]
    carrier = f"{child}{AXIS_LINK}"
    offset = turn.inv().apply(np.subtract(joint.position, joint.center))
    return [
        _link(carrier, None),
        _joint(name, kind, parent, carrier, joint.center, joint.quaternion, described),
        _link(child, part),
        _joint(f"{child}_mount", "fixed", carrier, child, offset, IDENTITY),
    ]


def _joint(
    name: str, kind: str, parent: str, child: str, position: ArrayLike, quaternion: ArrayLike,
    described: Sequence[Element] = (),
) -> Element:  # fmt: skip
    ends = [Element("parent", {"link": parent}, 0), Element("child", {"link": child}, 0)]
    return Element("joint", {"name": name, "type": kind}, 0, [_origin(position, quaternion), *ends, *described])


def _link(name: str, part: Part | None) -> Element:
    shapes = [] if part is None else [_shape(shape, tag) for shape in part.shapes for tag in ("visual", "collision")]
    return Element("link", {"name": name}, 0, shapes)


def _shape(shape: Primitive, tag: str) -> Element:
    """The shape to draw, with its colour, or to check."""
    if shape.kind == "box":
        solid = {"size": _words(shape.size)}
    else:
        solid = dict(zip(("radius", "length"), map(repr, shape.size), strict=False))
    geometry = Element("geometry", {}, 0, [Element(shape.kind, solid, 0)])
    element = Element(tag, {}, 0, [_origin(shape.position, shape.quaternion), geometry])
    if tag == "visual":
        parts = [int(shape.color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        color = Element("color", {"rgba": f"{_words(parts)} 1"}, 0)
        element.children.append(Element("material", {"name": shape.color}, 0, [color]))
    return element


def _origin(position: ArrayLike, quaternion: ArrayLike) -> Element:
    rpy = Rotation.from_quat(quaternion).as_euler("xyz")  # about fixed axes, as in URDF
    return Element("origin", {"xyz": _words(position), "rpy": _words(rpy)}, 0)


def _words(values: ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values, dtype=float))
