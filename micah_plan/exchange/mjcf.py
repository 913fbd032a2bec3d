"""Models as MJCF (MuJoCo's XML): nested bodies on hinges and slides, with handles as sites and a motor per coordinate.

MuJoCo has no screw: it is a hinge and a slide joined by an equality. Joints are damped a little, so that the object
comes to rest, and there is no gravity: the base frame of a learned model is seldom level. Source: MuJoCo documentation,
"XML reference".
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Part, Primitive
from micah_plan.exchange.bodies import DAMPING, DENSITY, MovingPart, inertia_of, moving_parts, written
from micah_plan.xml_text import Element, write_xml

_SCALAR_FIRST = [3, 0, 1, 2]


def mjcf_text(automaton: HybridAutomaton, title: str, density: float = DENSITY) -> str:
    """The text of an MJCF file of the model.

    Args:
        automaton: each of its links must have one moving joint over all modes.
        title: name of the model in the file.
        density: of all shapes [kg/m^3].

    Raises:
        InputError: for a part with different moving joints in different modes, or that moves with another.
    """
    bodies = {BASE: Element("body", {"name": BASE}, 0, _solids(automaton.part(BASE)))}
    root = bodies[BASE]
    equalities, motors = list[Element](), list[Element]()
    for part in moving_parts(automaton, screws=True):
        bodies[part.child] = _body(part, density)
        bodies[part.parent].children.append(bodies[part.child])
        if part.joint.climbs:
            pitch = {"joint1": f"{part.name}_slide", "joint2": part.name, "polycoef": f"0 {part.joint.pitch!r} 0 0 0"}
            equalities.append(Element("joint", pitch, 0))
        if part.joint.moves:
            motors.append(Element("motor", {"name": part.name, "joint": part.name}, 0))
    content = [
        Element("compiler", {"angle": "radian", "autolimits": "true"}, 0),
        Element("option", {"gravity": "0 0 0", "integrator": "implicitfast"}, 0),
        Element("worldbody", {}, 0, [root]),
        *([Element("equality", {}, 0, equalities)] if equalities else []),
        *([Element("actuator", {}, 0, motors)] if motors else []),
    ]
    return f'<?xml version="1.0"?>\n{write_xml(Element("mujoco", {"model": title}, 0, content))}\n'


def _body(part: MovingPart, density: float) -> Element:
    joint = part.joint
    inertia = inertia_of(part.part, density)
    moments = inertia.moments
    full = (*np.diag(moments), moments[0, 1], moments[0, 2], moments[1, 2])
    inertial = {"pos": written(inertia.center), "mass": repr(inertia.mass), "fullinertia": written(full)}
    children = [*_joints(part), Element("inertial", inertial, 0), *_solids(part.part)]
    if part.part.handle is not None:
        site = {"name": f"{part.child}_handle", "pos": written(part.part.handle), "size": "0.01"}
        children.append(Element("site", site, 0))
    placed = {"name": part.child, "pos": written(joint.position), "quat": _quat(joint.quaternion)}
    return Element("body", placed, 0, children)


def _joints(part: MovingPart) -> list[Element]:
    """Joints in the frame of the part, as in MJCF."""
    joint = part.joint
    if not joint.moves:
        return []
    back = Rotation.from_quat(joint.quaternion).inv()
    axis = written(back.apply(joint.axis))
    center = written(back.apply(np.subtract(joint.center, joint.position)))
    attributes = {"name": part.name, "axis": axis, "damping": repr(DAMPING[joint.unit])}
    if all(map(math.isfinite, part.limits)):
        attributes["range"] = written(part.limits)
    if joint.slides:
        return [Element("joint", {"type": "slide", **attributes}, 0)]
    elements = [Element("joint", {"type": "hinge", "pos": center, **attributes}, 0)]
    if joint.climbs:
        elements.insert(0, Element("joint", {"name": f"{part.name}_slide", "type": "slide", "axis": axis}, 0))
    return elements


def _solids(part: Part) -> list[Element]:
    """Shapes without collision: parts overlap where a joint holds them."""
    return [_solid(shape) for shape in part.shapes]


def _solid(shape: Primitive) -> Element:
    size = [length / 2 for length in shape.size] if shape.kind == "box" else list(shape.size)
    if shape.kind == "cylinder":
        size[1] /= 2
    color = [int(shape.color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    place = {"pos": written(shape.position), "quat": _quat(shape.quaternion), "rgba": f"{written(color)} 1"}
    meets = {"contype": "0", "conaffinity": "0", "mass": "0"}
    return Element("geom", {"type": shape.kind, "size": written(size), **place, **meets}, 0)


def _quat(quaternion: ArrayLike) -> str:
    return written(np.asarray(quaternion, dtype=float)[_SCALAR_FIRST])
