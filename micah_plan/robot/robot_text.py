"""Robot files checked before Pinocchio sees them: structure, numbers and mesh paths, each mistake with its line.

Pinocchio's parsers read over some mistakes (a mass that is no number, a joint from a link to itself), join mesh paths
without looking where they lead, and complain on stderr. Of a URDF they get only links and joints, continuous joints
turned into revolute ones without limits; of an MJCF no inclusion of other files; mesh paths are resolved within their
folder or package.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from micah_plan.errors import InputError, shown
from micah_plan.files import contained
from micah_plan.robot.xml_text import Element, write_xml

NO_LIMIT = 1e9
"""Limit of joints without limits [rad or m], in files whose parsers know no infinity."""
# Pinocchio descends from link to link by recursion: a chain of thousands ends in a crash.
MOST_LINKS = 1000
_KINDS = ("revolute", "continuous", "prismatic", "fixed")
_PACKAGE = "package://"
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# Attributes of URDF that hold numbers. Python reads "0.05 " and "1_0" as numbers; URDF's parser omits such a shape.
_NUMBERS = {"xyz", "rpy", "size", "radius", "length", "scale", "value", "lower", "upper", "effort", *_INERTIA}

# Of MJCF, what kinematics and clearances need; the rest (actuators, sensors, textures) names further files or is not
# read.
_KEPT = ("compiler", "default", "asset", "worldbody", "contact", "equality")
_FOLDERS = ("meshdir", "assetdir", "texturedir")
_DROPPED_ASSETS = ("texture", "hfield", "skin", "material")
_MJCF_NUMBERS = ("pos", "quat", "axis", "size", "range", "euler", "axisangle", "xyaxes", "zaxis", "fromto", "ref")
_MJCF_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


@dataclass(frozen=True)
class CheckedRobot:
    """What was found in a file.

    Attributes:
        kind: format of the text.
        text: clean, with absolute mesh paths.
        colors: of the shapes of each link, as ``"#rrggbb"``; the last serves further shapes.
        mimics: joints that follow another one.
    """

    kind: Literal["urdf", "mjcf"]
    text: str
    colors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mimics: frozenset[str] = frozenset()


def check_urdf(root: Element, source: str, folder: str, packages: Mapping[str, str]) -> CheckedRobot:
    """What a URDF says, fit to be handed to Pinocchio.

    Args:
        root: the file's root element; not changed.
        folder: where the file lies.
        packages: folder by package name; others are looked for among the folders above the file.

    Raises:
        InputError: for the first mistake.
    """
    return _Checker(source, folder, packages).checked(root)


class _Checker:
    """Builds the cleaned file element by element."""

    def __init__(self, source: str, folder: str, packages: Mapping[str, str]) -> None:
        self._source, self._folder, self._packages = source, folder, packages
        self._materials: dict[str, str] = {}

    def checked(self, root: Element) -> CheckedRobot:
        links = {self._name(link): link for link in root.all("link")}
        joints = {self._name(joint): joint for joint in root.all("joint")}
        if not links or len(links) < len(root.all("link")) or len(joints) < len(root.all("joint")):
            raise self._error(root, "expected links and joints with names of their own")
        if len(links) > MOST_LINKS:
            raise self._error(root, f"expected at most {MOST_LINKS} links, found {len(links)}", "leave out what is far")
        for material in root.all("material"):
            self._remember(material)
        children = [self._joint(joint, links) for joint in joints.values()]
        self._check_tree(root, links, list(joints.values()))
        bodies = [self._link(link) for link in links.values()]
        colors = {name: self._colors(link) for name, link in links.items()}
        clean = Element("robot", {"name": root.attributes.get("name", "robot")}, root.line, [*bodies, *children])
        for element in clean.walk():
            element.attributes.update(
                {key: _plain(text) for key, text in element.attributes.items() if key in _NUMBERS}
            )
        mimics = frozenset(name for name, joint in joints.items() if joint.first("mimic") is not None)
        return CheckedRobot("urdf", write_xml(clean), colors, mimics)

    def _error(self, element: Element, problem: str, remedy: str = "correct the URDF") -> InputError:
        return _fault(element, self._source, problem, remedy)

    def _name(self, element: Element) -> str:
        name = element.attributes.get("name", "")
        if not name or not name.isprintable():
            raise self._error(element, f"expected a name, found {shown(name)}")
        return name

    def _numbers(self, element: Element, key: str, count: int, default: str | None = None) -> list[float]:
        text = element.attributes.get(key, default)
        try:
            values = [float(word) for word in (text or "").split()]
        except ValueError:
            values = []
        if len(values) != count or not all(math.isfinite(value) for value in values):
            expected = "a number" if count == 1 else f"{count} numbers"
            raise self._error(element, f"expected {expected} for '{key}', found {shown(text)}")
        return values

    def _positive(self, element: Element, key: str, count: int = 1) -> None:
        if min(self._numbers(element, key, count)) <= 0:
            raise self._error(element, f"expected '{key}' > 0, found {shown(element.attributes[key])}")

    def _origin(self, owner: Element) -> list[Element]:
        origin = owner.first("origin")
        if origin is None:
            return []
        for key in ("xyz", "rpy"):
            self._numbers(origin, key, 3, "0 0 0")
        return [origin.alone()]

    def _joint(self, joint: Element, links: Mapping[str, Element]) -> Element:
        kind = joint.attributes.get("type", "")
        if kind not in _KINDS:
            raise self._error(joint, f"expected a joint of type {', '.join(_KINDS)}, found {shown(kind)}")
        clean = Element("joint", {"name": joint.attributes["name"], "type": kind}, joint.line, self._origin(joint))
        for key in ("parent", "child"):
            end = joint.first(key)
            name = "" if end is None else end.attributes.get("link", "")
            if name not in links:
                raise self._error(end or joint, f"expected the name of a link as {key}, found {shown(name)}")
            clean.children.append(Element(key, {"link": name}, joint.line))
        if kind == "fixed":
            return clean
        axis = joint.first("axis")
        if axis is not None:
            if not any(self._numbers(axis, "xyz", 3)):
                raise self._error(axis, "expected an axis that is not zero")
            clean.children.append(axis.alone())
        limit = joint.first("limit")
        if kind == "continuous":
            clean.attributes["type"] = "revolute"
            lower, upper = -NO_LIMIT, NO_LIMIT
        elif limit is None:
            raise self._error(joint, f"missing <limit> of a {kind} joint", "add lower and upper")
        else:
            (lower,), (upper,) = self._numbers(limit, "lower", 1, "0"), self._numbers(limit, "upper", 1, "0")
            if lower >= upper:
                raise self._error(limit, f"expected lower < upper, found {lower:g} and {upper:g}")
        bounds = {"lower": repr(lower), "upper": repr(upper), "effort": repr(self._effort(limit)), "velocity": "1"}
        clean.children.append(Element("limit", bounds, joint.line))
        return clean

    def _effort(self, limit: Element | None) -> float:
        """The largest force or moment of a joint; `NO_LIMIT` where the file states none."""
        effort = 0.0 if limit is None else self._numbers(limit, "effort", 1, "0")[0]
        return effort if effort > 0 else NO_LIMIT

    def _check_tree(self, root: Element, links: Mapping[str, Element], joints: list[Element]) -> None:
        """Every link is connected to one root by one joint each."""
        below: dict[str, list[str]] = {}
        carried: set[str] = set()
        for joint in joints:
            ends = [element.attributes["link"] for element in (joint.first("parent"), joint.first("child")) if element]
            if ends[1] in carried:
                raise self._error(joint, f"link {shown(ends[1])} is carried by two joints")
            carried.add(ends[1])
            below.setdefault(ends[0], []).append(ends[1])
        roots = [name for name in links if name not in carried]
        reached, waiting = set(roots[:1]), roots[:1]
        while waiting:
            found = below.get(waiting.pop(), [])
            reached.update(found)
            waiting.extend(found)
        if len(roots) != 1 or len(reached) != len(links):
            lost = next((name for name in links if name not in reached), "")
            problem = f"expected one tree of links, found {len(roots)} roots"
            raise self._error(root, problem + (f"; link {shown(lost)} is not connected to the first" if lost else ""))

    def _link(self, link: Element) -> Element:
        """The link with its inertia and its collision shapes, or those to draw if there are none."""
        clean = Element("link", {"name": link.attributes["name"]}, link.line)
        inertial = link.first("inertial")
        if inertial is not None:
            clean.children.append(self._inertial(inertial))
        for shape in link.all("collision") or link.all("visual"):
            geometry = shape.first("geometry")
            if geometry is None or len(geometry.children) != 1:
                raise self._error(shape, "expected one shape in <geometry>")
            solid = Element("geometry", {}, geometry.line, [self._solid(geometry.children[0])])
            clean.children.append(Element("collision", {}, shape.line, [*self._origin(shape), solid]))
        return clean

    def _inertial(self, inertial: Element) -> Element:
        mass, inertia = inertial.first("mass"), inertial.first("inertia")
        if mass is None or inertia is None:
            raise self._error(inertial, "expected <mass> and <inertia>")
        if self._numbers(mass, "value", 1)[0] < 0:
            raise self._error(mass, "expected a mass >= 0")
        for key in _INERTIA:
            self._numbers(inertia, key, 1, "0")
        return Element("inertial", {}, inertial.line, [*self._origin(inertial), mass.alone(), inertia.alone()])

    def _solid(self, solid: Element) -> Element:
        clean = solid.alone()
        if solid.tag == "box":
            self._positive(solid, "size", 3)
        elif solid.tag in ("cylinder", "capsule", "sphere"):
            self._positive(solid, "radius")
            if solid.tag != "sphere":
                self._positive(solid, "length")
        elif solid.tag == "mesh":
            if 0.0 in self._numbers(solid, "scale", 3, "1 1 1"):
                raise self._error(solid, "expected a scale without zeros")
            clean.attributes["filename"] = self._mesh(solid)
        else:
            raise self._error(solid, "expected a box, cylinder, capsule, sphere or mesh")
        return clean

    def _mesh(self, mesh: Element) -> str:
        name = mesh.attributes.get("filename", "")
        folder: str | Path = self._folder
        if name.startswith(_PACKAGE):
            package, _, name = name.removeprefix(_PACKAGE).partition("/")
            folder = self._package(mesh, package)
        return _mesh_path(mesh, self._source, name, folder)

    def _package(self, mesh: Element, name: str) -> str | Path:
        above = Path(self._folder).resolve()
        found = next((folder for folder in (above, *above.parents) if folder.name == name), None)
        if name in self._packages:
            return self._packages[name]
        if found is None or not name:
            problem = f"the package {shown(name)} is not known and no folder above the file has its name"
            raise self._error(mesh, problem, "give its folder under 'packages'")
        return found

    def _remember(self, material: Element) -> None:
        color = material.first("color")
        if color is not None:
            parts = self._numbers(color, "rgba", 4)[:3]
            rgb = "".join(f"{round(255 * min(max(part, 0.0), 1.0)):02x}" for part in parts)
            self._materials[material.attributes.get("name", "")] = f"#{rgb}"

    def _colors(self, link: Element) -> tuple[str, ...]:
        """Colours of what is drawn of a link, in order."""
        found = []
        for shape in link.all("visual"):
            material = shape.first("material")
            if material is not None:
                self._remember(material)
                found.append(self._materials.get(material.attributes.get("name", ""), ""))
        return tuple(color for color in found if color)


def _plain(text: str) -> str:
    """Numbers as every parser reads them."""
    return " ".join(repr(float(word)) for word in text.split())


def check_mjcf(root: Element, source: str, folder: str) -> CheckedRobot:
    """What an MJCF file says, fit to be handed to Pinocchio.

    Raises:
        InputError: for the first mistake.
    """
    for element in root.walk():
        _check_mjcf_element(element, source)
    stated = {key: value for compiler in root.all("compiler") for key, value in compiler.attributes.items()}
    meshes = stated.get("meshdir", stated.get("assetdir", ""))
    clean = root.alone()
    clean.children = [child for child in root.children if child.tag in _KEPT]
    return CheckedRobot("mjcf", write_xml(_mjcf_copy(clean, source, folder, meshes)))


def _check_mjcf_element(element: Element, source: str) -> None:
    if element.tag in ("include", "attach", "replicate", "model", "composite", "flexcomp", "plugin"):
        raise _fault(element, source, f"<{element.tag}> is not read", "write the file out in one piece")
    for key in _MJCF_NUMBERS:
        text = element.attributes.get(key, "")
        if not all(_MJCF_NUMBER.fullmatch(word) and math.isfinite(float(word)) for word in text.split()):
            raise _fault(element, source, f"expected numbers for '{key}', found {shown(text)}", "correct the MJCF")


def _mjcf_copy(element: Element, source: str, folder: str, meshes: str) -> Element:
    clean = element.alone()
    for key in (*_FOLDERS, *(["material"] if element.tag == "geom" else [])):
        clean.attributes.pop(key, None)
    name = clean.attributes.get("file")
    if name is not None:
        clean.attributes.setdefault("name", re.split(r"[/\\]", name)[-1].rpartition(".")[0])
        path = f"{meshes.rstrip('/')}/{name}" if meshes and name else name
        clean.attributes["file"] = _mesh_path(element, source, path, folder)
    kept = [child for child in element.children if child.tag not in _DROPPED_ASSETS]
    clean.children = [_mjcf_copy(child, source, folder, meshes) for child in kept]
    return clean


def _fault(element: Element, source: str, problem: str, remedy: str) -> InputError:
    return InputError(problem, source=source, where=f"line {element.line}, <{element.tag}>", remedy=remedy)


def _mesh_path(element: Element, source: str, name: str, folder: str | Path) -> str:
    """The absolute path of a mesh that an element names."""
    try:
        return str(contained(name, folder))
    except InputError as error:
        raise _fault(element, source, error.problem, error.remedy or "") from None
