"""Models as URDF, which knows joints, limits and shapes, but no modes, guards or uncertainty.

Each link of the model must have one moving joint over all modes; it may go where any mode allows it. A part's frame
need not lie on its joint's axis, a URDF link's must: a link ``PART_axis`` turns, and the part's link is fixed to it.
Joints are named after the coordinates, with ``_joint`` behind where a part has that name already: programs that look
frames up by name would find two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Part, Primitive
from micah_plan.automaton.joint import IDENTITY
from micah_plan.exchange.bodies import DAMPING, DENSITY, Inertia, MovingPart, inertia_of, moving_parts
from micah_plan.robot.robot_text import NO_LIMIT
from micah_plan.robot.xml_text import Element, write_xml

AXIS_LINK = "_axis"


def urdf_text(automaton: HybridAutomaton, title: str, density: float = DENSITY) -> str:
    """The text of a URDF of the model.

    Args:
        automaton: each of its links must have one moving joint over all modes.
        title: name of the robot in the file.
        density: of all shapes [kg/m^3].

    Raises:
        InputError: for a part on a screw, with different moving joints in different modes, or that moves with another.
    """
    elements = [_link(BASE, automaton.part(BASE), None)]
    for part in moving_parts(automaton, screws=False):
        elements += _moved(part, density)
    lines = "".join(f"  {write_xml(element)}\n" for element in elements)
    head, _, tail = write_xml(Element("robot", {"name": title}, 0)).partition("</")
    return f'<?xml version="1.0"?>\n{head}\n{lines}</{tail}\n'


def _moved(part: MovingPart, density: float) -> list[Element]:
    """The link of a part with the joint that carries it."""
    joint, parent, child = part.joint, part.parent, part.child
    turn, link = Rotation.from_quat(joint.quaternion), _link(child, part.part, density)
    if not joint.moves:
        return [link, _joint(part.name, "fixed", parent, child, joint.position, joint.quaternion)]
    axis = Element("axis", {"xyz": _words(turn.inv().apply(joint.axis))}, 0)
    free = joint.kind == "revolute" and not np.isfinite(part.limits).any()
    low, high = (float(np.clip(end, -NO_LIMIT, NO_LIMIT)) for end in part.limits)
    bounds = {"lower": repr(low), "upper": repr(high), "effort": "100", "velocity": "1"}
    described = [axis] if free else [axis, Element("limit", bounds, 0)]
    described.append(Element("dynamics", {"damping": repr(DAMPING[joint.kind]), "friction": "0"}, 0))
    if part.follows is not None:
        leader, times, offset_at = part.follows
        words = {"joint": leader, "multiplier": repr(times), "offset": repr(offset_at)}
        described = [*described, Element("mimic", words, 0)]
    kind = "continuous" if free else joint.kind
    if joint.kind == "prismatic":
        return [link, _joint(part.name, kind, parent, child, joint.position, joint.quaternion, described)]
    carrier = f"{child}{AXIS_LINK}"
    offset = turn.inv().apply(np.subtract(joint.position, joint.center))
    return [
        _link(carrier, None, None),
        _joint(part.name, kind, parent, carrier, joint.center, joint.quaternion, described),
        link,
        _joint(f"{child}_mount", "fixed", carrier, child, offset, IDENTITY),
    ]


def _joint(
    name: str, kind: str, parent: str, child: str, position: ArrayLike, quaternion: ArrayLike,
    described: Sequence[Element] = (),
) -> Element:  # fmt: skip
    ends = [Element("parent", {"link": parent}, 0), Element("child", {"link": child}, 0)]
    return Element("joint", {"name": name, "type": kind}, 0, [_origin(position, quaternion), *ends, *described])


def _link(name: str, part: Part | None, density: float | None) -> Element:
    """A link with its shapes; with a density also with its mass and moments."""
    shapes = [] if part is None else [_shape(shape, tag) for shape in part.shapes for tag in ("visual", "collision")]
    if part is not None and density is not None:
        shapes.insert(0, _inertial(inertia_of(part, density)))
    return Element("link", {"name": name}, 0, shapes)


def _inertial(inertia: Inertia) -> Element:
    moments = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(inertia.moments[i, j])) for i in range(3) for j in range(i, 3)}
    mass = Element("mass", {"value": repr(inertia.mass)}, 0)
    return Element("inertial", {}, 0, [_origin(inertia.center, IDENTITY), mass, Element("inertia", moments, 0)])


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
