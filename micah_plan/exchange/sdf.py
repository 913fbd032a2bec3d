"""Models as SDF 1.9 (Gazebo, Drake): links whose poses refer to their parents, fixed to the world by the base.

As in URDF there are no modes, and screws are refused. Unlike there a joint may lie anywhere on its part, so no further
links are needed. Source: http://sdformat.org/spec, version 1.9.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Part, Primitive
from micah_plan.automaton.joint import IDENTITY
from micah_plan.exchange.bodies import DAMPING, DENSITY, MovingPart, inertia_of, moving_parts, roll_pitch_yaw, written

_Node = ElementTree.Element


def sdf_text(automaton: HybridAutomaton, title: str, density: float = DENSITY) -> str:
    """The text of an SDF file of the model.

    Args:
        automaton: each of its links must have one moving joint over all modes.
        title: name of the model in the file.
        density: of all shapes [kg/m^3].

    Raises:
        InputError: for a part on a screw, with different moving joints in different modes, or that moves with another.
    """
    root = ElementTree.Element("sdf", {"version": "1.9"})
    model = _add(root, "model", {"name": title})
    _link(model, automaton.part(BASE), density)
    mount = _add(model, "joint", {"name": f"{BASE}_mount", "type": "fixed"})
    _add(mount, "parent", text="world")
    _add(mount, "child", text=BASE)
    for part in moving_parts(automaton, screws=False):
        link = _link(model, part.part, density)
        link.insert(0, _pose(part.joint.position, part.joint.quaternion, part.parent))
        _joint(model, part)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _joint(model: _Node, part: MovingPart) -> None:
    """Add a joint in the frame of the part, through the centre of rotation."""
    joint, turn = part.joint, Rotation.from_quat(part.joint.quaternion)
    kind = {"rigid": "fixed"}.get(joint.kind, joint.kind)
    found = _add(model, "joint", {"name": part.name, "type": kind})
    if joint.turns:
        found.append(_pose(turn.inv().apply(np.subtract(joint.center, joint.position)), IDENTITY))
    _add(found, "parent", text=part.parent)
    _add(found, "child", text=part.child)
    if not joint.moves:
        return
    axis = _add(found, "axis")
    _add(axis, "xyz", text=written(turn.inv().apply(joint.axis)))
    limit = _add(axis, "limit")
    for key, end in zip(("lower", "upper"), part.limits, strict=True):
        if np.isfinite(end):
            _add(limit, key, text=repr(float(end)))
    _add(_add(axis, "dynamics"), "damping", text=repr(DAMPING[joint.unit]))


def _link(model: _Node, part: Part, density: float) -> _Node:
    link, inertia = _add(model, "link", {"name": part.name}), inertia_of(part, density)
    _add(link, "gravity", text="false")  # the base frame of a learned model is seldom level
    inertial = _add(link, "inertial")
    inertial.append(_pose(inertia.center, IDENTITY))
    _add(inertial, "mass", text=repr(inertia.mass))
    moments = _add(inertial, "inertia")
    for i in range(3):
        for j in range(i, 3):
            _add(moments, f"i{'xyz'[i]}{'xyz'[j]}", text=repr(float(inertia.moments[i, j])))
    for number, shape in enumerate(part.shapes):
        for tag in ("visual", "collision"):
            _shape(_add(link, tag, {"name": f"{part.name}_{tag}_{number}"}), shape, tag == "visual")
    return link


def _shape(owner: _Node, shape: Primitive, is_drawn: bool) -> None:
    owner.append(_pose(shape.position, shape.quaternion))
    solid = _add(_add(owner, "geometry"), shape.kind)
    if shape.kind == "box":
        _add(solid, "size", text=written(shape.size))
    else:
        for key, value in zip(("radius", "length"), shape.size, strict=False):
            _add(solid, key, text=repr(float(value)))
    if is_drawn:
        color = written([*(int(shape.color[i : i + 2], 16) / 255 for i in (1, 3, 5)), 1.0])
        _add(_add(owner, "material"), "diffuse", text=color)


def _pose(position: ArrayLike, quaternion: ArrayLike, relative_to: str = "") -> _Node:
    pose = ElementTree.Element("pose", {"relative_to": relative_to} if relative_to else {})
    turn = roll_pitch_yaw(Rotation.from_quat(quaternion))
    pose.text = written([*np.asarray(position, dtype=float), *turn])
    return pose


def _add(parent: _Node, tag: str, attributes: Mapping[str, str] | None = None, text: str | None = None) -> _Node:
    node = ElementTree.SubElement(parent, tag, dict(attributes or {}))
    node.text = text
    return node
