"""Models from SDF (Gazebo, Drake), converted to a URDF of the same joints.

In SDF a joint has its own frame, and every pose names the frame that it is relative to; in URDF a joint's frame is that
of its child. So each moving link gets a further one that rotates on the joint and that it is fixed to, as `urdf_text`
makes them. Links without a parent are in the model's frame, like links fixed to the world.

Source: http://sdformat.org/tutorials (pose semantics, version 1.7 on) and /spec.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError, shown
from micah_plan.exchange.bodies import roll_pitch_yaw, written
from micah_plan.exchange.urdf import AXIS_LINK, automaton_of_urdf
from micah_plan.robot.robot_text import NO_LIMIT
from micah_plan.xml_text import Element, parse_xml, read_xml

_WORLD, _MODEL = "world", "__model__"
_MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
_SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")
_HERE = RigidTransform.identity()
# Frames that are relative to each other; more is a circle, or unreadable.
_DEEPEST = 100


def load_sdf(path: str | Path, packages: Mapping[str, str] | None = None) -> tuple[HybridAutomaton, tuple[str, ...]]:
    """(model of an SDF file, its losses and suspicions, one line each).

    Args:
        packages: folder by the name behind ``model://``, for meshes.

    Raises:
        InputError: if it is not SDF, has several models or joints of another kind, or nothing moves.
    """
    root = parse_xml(read_xml(path, "SDF"), str(path))
    if root.tag != "sdf":
        raise InputError(f"expected <sdf>, found <{root.tag[:40]}>", source=path, remedy="give an SDF file")
    models = [*root.all("model"), *(model for world in root.all("world") for model in world.all("model"))]
    if len(models) != 1:
        names = ", ".join(shown(_name(model)) for model in models[:5])
        found = f"{len(models)} ({names})" if models else "none"
        raise InputError(f"expected one <model>, found {found}", source=path, remedy="keep the object alone")
    urdf, notes = _Model(models[0]).urdf()
    automaton, doubts = automaton_of_urdf(urdf, path, packages or {}, "sdf")
    return automaton, (*notes, *doubts)


@dataclass(frozen=True)
class _Frame:
    """A named frame: its pose in another."""

    element: Element
    pose: RigidTransform
    relative_to: str


class _Model:
    """A <model>."""

    def __init__(self, model: Element) -> None:
        self._model = model
        for tag in ("include", "model"):
            for nested in model.all(tag):
                raise nested.error(f"a <{tag}> within a model is not read", "write its links and joints out")
        self._links = {_name(link): link for link in model.all("link")}
        self._joints = [joint for joint in model.all("joint") if joint.children]
        self._frames = dict[str, _Frame]()
        for element in (e for tag in ("link", "frame", "joint") for e in model.all(tag)):
            name = _name(element)
            if name in self._frames or name == _WORLD:
                before = f" on line {self._frames[name].element.line}" if name in self._frames else ""
                raise element.error(f"the name {shown(name)} is taken already{before}", "rename it")
            within = {"frame": element.attributes.get("attached_to", ""), "joint": _text(element, "child")}
            self._frames[name] = _placed(element, within.get(element.tag) or _MODEL)
        self._notes: list[str] = []

    def urdf(self) -> tuple[Element, list[str]]:
        """(root element of an equivalent URDF, losses)."""
        robot = Element("robot", {"name": _name(self._model)}, self._model.line, source=self._model.source)
        robot.children.append(_made(self._model, "link", {"name": _WORLD}))
        robot.children += [self._link(name, link) for name, link in self._links.items()]
        for joint in self._joints:
            robot.children += self._joined(joint)
        carried = {self._link_of(_text(joint, "child")) for joint in self._joints}
        standing = [name for name in self._links if name not in carried]
        is_held = any(self._link_of(_text(joint, "parent")) == _WORLD for joint in self._joints)
        for name in standing:
            if is_held or len(standing) > 1:
                self._notes.append(f"link {name}: no joint holds it, it stands where it is")
            link = self._links[name]
            robot.children.append(_fixed(link, f"{name}_stands", _WORLD, name, self._pose_of(name, link)))
        return robot, self._notes

    def _joined(self, joint: Element) -> list[Element]:
        """The joint with a link that moves on it, and the child that is fixed to that."""
        name, kind = _name(joint), joint.attributes.get("type", "")
        parent, child = _text(joint, "parent"), _text(joint, "child")
        for end, key in ((parent, "parent"), (child, "child")):
            if end not in self._frames and (end != _WORLD or key == "child"):
                raise joint.error(f"expected the name of a link as {key}, found {shown(end)}", "correct the SDF")
        parent, child = self._link_of(parent), self._link_of(child)
        before, at, after = (self._pose_of(frame, joint) for frame in (parent, name, child))
        if kind == "fixed":
            return [_fixed(joint, name, parent, child, before.inv() * after)]
        if kind not in _MOVING:
            known = ", ".join([*_MOVING, "fixed"])
            raise joint.error(
                f"expected a joint of type {known}, found {shown(kind)}", "leave it out, or make it fixed"
            )
        axis = joint.first("axis")
        if axis is None:
            raise joint.error(f"missing <axis> of a {kind} joint", "add <axis><xyz>")
        moving = f"{child}{AXIS_LINK}"
        lower, upper = _limits(axis)
        is_endless = kind == "continuous" or (kind == "revolute" and lower <= -NO_LIMIT and upper >= NO_LIMIT)
        found = _made(joint, "joint", {"name": name, "type": "continuous" if is_endless else _MOVING[kind]})
        along = at.rotation.inv().apply(self._direction(axis, name))
        found.children = [
            _origin(joint, before.inv() * at),
            _made(joint, "parent", {"link": parent}),
            _made(joint, "child", {"link": moving}),
            _made(axis, "axis", {"xyz": written(along)}),
        ]
        if not is_endless:
            found.children.append(_made(axis, "limit", {"lower": repr(lower), "upper": repr(upper)}))
        found.children += _mimic(axis)
        link = _made(joint, "link", {"name": moving})
        return [link, found, _fixed(joint, f"{moving}_fixed", moving, child, at.inv() * after)]

    def _link_of(self, frame: str) -> str:
        """The link that a frame is attached to."""
        for _ in range(_DEEPEST):
            if frame in self._links or frame == _WORLD:
                return frame
            if frame == _MODEL or frame not in self._frames:
                return _WORLD
            frame = self._frames[frame].element.attributes.get("attached_to") or self._frames[frame].relative_to
        return _WORLD

    def _direction(self, axis: Element, joint: str) -> Floats:
        """(3,) of an axis, in the model's frame."""
        xyz = axis.first("xyz")
        direction = _numbers(axis if xyz is None else xyz, "0 0 1" if xyz is None else xyz.text, 3)
        legacy = axis.first("use_parent_model_frame")
        within = "" if xyz is None else xyz.attributes.get("expressed_in", "")
        if not within:
            within = _MODEL if legacy is not None and legacy.text.strip() in ("1", "true") else joint
        return np.asarray(self._pose_of(within, axis).rotation.apply(direction))

    def _pose_of(self, name: str, asked: Element) -> RigidTransform:
        """The pose of a link, joint or frame in the model's frame."""
        pose = _HERE
        for _ in range(_DEEPEST):
            if name in (_MODEL, _WORLD, ""):
                return pose
            if name not in self._frames:
                raise asked.error(f"no link, joint or frame is called {shown(name)}", "correct the name")
            frame = self._frames[name]
            pose, name = frame.pose * pose, frame.relative_to
        raise asked.error("poses are relative to each other in a circle", "let one be relative to the model")

    def _link(self, name: str, link: Element) -> Element:
        """The URDF link: collision and visual shapes in its frame."""
        found = _made(link, "link", {"name": name})
        for tag in ("visual", "collision"):
            for solid in link.all(tag):
                shape = self._shape(name, solid, tag == "collision")
                if shape is None:
                    continue
                own = _placed(solid, name)
                if own.relative_to != name:
                    at = self._pose_of(name, solid).inv() * self._pose_of(own.relative_to, solid) * own.pose
                else:
                    at = own.pose
                drawn = _made(solid, tag, {"name": solid.attributes.get("name", "")})
                geometry = _made(solid, "geometry", {})
                geometry.children.append(shape)
                drawn.children = [_origin(solid, at), geometry, *_material(solid)]
                found.children.append(drawn)
        return found

    def _shape(self, link: str, solid: Element, is_told: bool) -> Element | None:
        """The geometry of a solid; None, with one note, for unsupported ones."""
        geometry = solid.first("geometry")
        for kind in geometry.children if geometry is not None else ():
            if kind.tag not in _SHAPES:
                if is_told and kind.tag != "empty":
                    self._notes.append(f"link {link}: a {kind.tag} is left out")
                return None
            if kind.tag == "mesh":
                uri, scale = _text(kind, "uri"), _text(kind, "scale")
                named = f"package://{uri.removeprefix('model://')}" if uri.startswith("model://") else uri
                return _made(kind, "mesh", {"filename": named, **({"scale": scale} if scale else {})})
            if kind.tag == "box":
                return _made(kind, "box", {"size": _text(kind, "size") or "1 1 1"})
            sizes = {key: text for key in ("radius", "length") if (text := _text(kind, key))}
            return _made(kind, kind.tag, sizes)
        return None


def _name(element: Element) -> str:
    name = element.attributes.get("name", "")
    if not name:
        raise element.error(f"a <{element.tag}> has no name", "give it one")
    return name


def _text(owner: Element, tag: str) -> str:
    """The text of the first child of a tag; empty if there is none."""
    child = owner.first(tag)
    return "" if child is None else child.text.strip()


def _numbers(element: Element, text: str, count: int) -> list[float]:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise element.error(
            f"expected {count} number{'s' * (count > 1)}, found {shown(text.strip())}", "correct the SDF"
        )
    return numbers


def _placed(owner: Element, otherwise: str) -> _Frame:
    """The pose of an element, relative to its stated frame or the default one."""
    pose = owner.first("pose")
    if pose is None or not pose.text.strip():
        within = otherwise if pose is None else pose.attributes.get("relative_to") or otherwise
        return _Frame(owner, _HERE, within)
    within = pose.attributes.get("relative_to") or otherwise
    if pose.attributes.get("rotation_format") == "quat_xyzw":
        *place, x, y, z, w = _numbers(pose, pose.text, 7)
        if not any((x, y, z, w)):
            raise pose.error("expected a quaternion that is not zero", "correct the SDF")
        return _Frame(owner, RigidTransform.from_components(place, Rotation.from_quat([x, y, z, w])), within)
    values = _numbers(pose, pose.text, 6)
    degrees = pose.attributes.get("degrees") in ("1", "true")
    turn = Rotation.from_euler("xyz", values[3:], degrees=degrees)
    return _Frame(owner, RigidTransform.from_components(values[:3], turn), within)


def _limits(axis: Element) -> tuple[float, float]:
    """(lower, upper) limits of a joint [rad or m]."""
    limit = axis.first("limit")
    ends = []
    for key, none in (("lower", -NO_LIMIT), ("upper", NO_LIMIT)):
        text = "" if limit is None else _text(limit, key)
        ends.append(none if text in ("", "inf", "-inf") else _numbers(limit or axis, text, 1)[0])
    return max(ends[0], -NO_LIMIT), min(ends[1], NO_LIMIT)


def _mimic(axis: Element) -> list[Element]:
    """The URDF mimic element of a coupled joint."""
    mimic = axis.first("mimic")
    if mimic is None:
        return []
    usual = {"multiplier": "1", "offset": "0", "reference": "0"}
    multiplier, offset, reference = (_numbers(mimic, _text(mimic, tag) or text, 1)[0] for tag, text in usual.items())
    offset -= multiplier * reference
    leader = mimic.attributes.get("joint", "")
    return [_made(mimic, "mimic", {"joint": leader, "multiplier": repr(multiplier), "offset": repr(offset)})]


def _material(solid: Element) -> list[Element]:
    """The colour of a visual."""
    material = solid.first("material")
    diffuse = "" if material is None else _text(material, "diffuse") or _text(material, "ambient")
    if material is None or not diffuse:
        return []
    rgba = [*_numbers(material, diffuse, len(diffuse.split())), 1.0][:4]
    found = _made(material, "material", {"name": ""})
    found.children.append(_made(material, "color", {"rgba": written(rgba)}))
    return [found]


def _made(source: Element, tag: str, attributes: Mapping[str, str]) -> Element:
    """A URDF element that keeps the SDF source for messages."""
    return Element(tag, dict(attributes), source.line, source=source.source)


def _origin(source: Element, pose: RigidTransform) -> Element:
    turn = roll_pitch_yaw(pose.rotation)
    return _made(source, "origin", {"xyz": written(pose.translation), "rpy": written(turn)})


def _fixed(source: Element, name: str, parent: str, child: str, pose: RigidTransform) -> Element:
    joint = _made(source, "joint", {"name": name, "type": "fixed"})
    ends = (_made(source, key, {"link": end}) for key, end in (("parent", parent), ("child", child)))
    joint.children = [_origin(source, pose), *ends]
    return joint
