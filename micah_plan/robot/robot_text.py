"""Validation of robot files before Pinocchio or MuJoCo load them: structure, numbers, mesh paths, by line.

Pinocchio's parsers ignore some mistakes (a mass that is not a number, a joint from a link to itself), join mesh paths
without checking where they lead, and complain on stderr. From a URDF they get only links and joints, continuous joints
converted to revolute ones without limits. From an MJCF, MuJoCo gets the elements of kinematics and solids, without
inclusion of other files. Mesh paths are resolved within their folder or package.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

from micah_plan.errors import InputError, shown
from micah_plan.files import contained
from micah_plan.xml_text import Element, write_xml

NO_LIMIT = 1e9
_ENDS = ("lower", "upper")
"""Limit of joints without limits [rad or m], in files whose parsers know no infinity."""
# Pinocchio descends from link to link by recursion: a chain of thousands ends in a crash.
MOST_LINKS = 1000
_KINDS = ("revolute", "continuous", "prismatic", "fixed")
_PACKAGE, _FILE = "package://", "file://"
_SOLIDS = ("box", "cylinder", "capsule", "sphere", "mesh")
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# By element of URDF: its numbers, how many they are, and what they are where they are left out (None: they may not be).
_NUMBERS: dict[str, dict[str, tuple[int, str | None]]] = {
    "origin": {"xyz": (3, "0 0 0"), "rpy": (3, "0 0 0")},
    "axis": {"xyz": (3, None)},
    "mass": {"value": (1, None)},
    "inertia": dict.fromkeys(_INERTIA, (1, "0")),
    "box": {"size": (3, None)},
    "sphere": {"radius": (1, None)},
    "cylinder": {"radius": (1, None), "length": (1, None)},
    "capsule": {"radius": (1, None), "length": (1, None)},
    "mesh": {"scale": (3, "1 1 1")},
}

# Of MJCF, what kinematics and clearances need; the rest (actuators, sensors, textures) names further files or is not
# read.
_KEPT = ("compiler", "default", "asset", "worldbody", "contact", "equality")
_FOLDERS = ("meshdir", "assetdir", "texturedir")
_DROPPED = ("texture", "hfield", "skin", "material")
_MJCF_NUMBERS = ("pos", "quat", "axis", "size", "range", "euler", "axisangle", "xyaxes", "zaxis", "fromto", "ref")
_MJCF_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")

MJCF_ROOTS = ("mujocoinclude", "mujoco")
"""Roots of files that an MJCF may include."""


@dataclass(frozen=True)
class CheckedRobot:
    """A checked robot file.

    Attributes:
        kind: format of the text.
        text: clean, with absolute mesh paths.
        colors: of the shapes of each link, as ``"#rrggbb"``; the last serves further shapes.
        mimics: joints that follow another one, and how.
        left_out: elements of the object that its model does not have, one line each.
    """

    kind: Literal["urdf", "mjcf"]
    text: str
    colors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mimics: Mapping[str, Mimic] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()


class Mimic(NamedTuple):
    """A joint's position is `multiplier` times that of another joint, plus `offset` [rad or m]."""

    joint: str
    multiplier: float
    offset: float


def check_urdf(root: Element, folder: str, packages: Mapping[str, str], *, is_arm: bool = True) -> CheckedRobot:
    """A URDF validated for Pinocchio.

    Args:
        root: the file's root element; not changed.
        folder: of the file.
        packages: folder by package name; others are looked for among the folders above the file.
        is_arm: whether missing elements are errors. An arm without a mesh would collide unnoticed, and one with a joint
            that cannot move would not reach; an object can be used without them, with a note.

    Raises:
        InputError: for the first mistake.
    """
    _check_expanded(root)
    links, joints = (_by_name(root, tag) for tag in ("link", "joint"))
    if not links:
        raise _error(root, "expected links, found none")
    if len(links) > MOST_LINKS:
        raise _error(root, f"expected at most {MOST_LINKS} links, found {len(links)}", "leave out what is far")
    materials: dict[str, str] = {}
    for material in root.all("material"):
        _remember(material, materials)
    left_out: list[str] | None = None if is_arm else []
    children = [_joint(joint, links, left_out) for joint in joints.values()]
    _check_tree(root, links, joints.values())
    bodies = [_link(link, lambda mesh: _mesh(mesh, folder, packages), left_out) for link in links.values()]
    colors = {name: _colors(link, materials) for name, link in links.items()}
    clean = Element("robot", {"name": root.attributes.get("name", "robot")}, root.line, [*bodies, *children])
    moving = [child.attributes["name"] for child in children if child.attributes["type"] != "fixed"]
    mimics = {name: _mimic(mimic, joints) for name in moving if (mimic := joints[name].first("mimic")) is not None}
    return CheckedRobot("urdf", write_xml(clean), colors, mimics, tuple(left_out or ()))


def _check_expanded(root: Element) -> None:
    for element in root.walk():
        written = [element.tag, *element.attributes.values()]
        if element.tag.startswith("xacro:") or any("${" in text or "$(" in text for text in written):
            raise _error(element, "this is xacro, not yet a URDF", "expand it: xacro FILE.xacro > FILE.urdf")


def _by_name(root: Element, tag: str) -> dict[str, Element]:
    """The elements of a tag by their names, each of which is there once."""
    elements: dict[str, Element] = {}
    for element in root.all(tag):
        name = _name(element)
        if name in elements:
            problem = f"{tag} {shown(name)} is there already, on line {elements[name].line}"
            raise _error(element, problem, "rename or remove one of them")
        elements[name] = element
    return elements


def _mimic(mimic: Element, joints: Mapping[str, Element]) -> Mimic:
    name = mimic.attributes.get("joint", "")
    if name not in joints:
        raise _error(mimic, f"expected the name of a joint, found {shown(name)}")
    (multiplier,), (offset,) = _numbers(mimic, "multiplier", 1, "1"), _numbers(mimic, "offset", 1, "0")
    return Mimic(name, multiplier, offset)


def _error(element: Element, problem: str, remedy: str = "correct the file") -> InputError:
    return element.error(problem, remedy)


def _name(element: Element) -> str:
    name = element.attributes.get("name", "")
    if not name or not name.isprintable():
        raise _error(element, f"expected a name, found {shown(name)}")
    return name


def _numbers(element: Element, key: str, count: int, default: str | None = None) -> list[float]:
    text = element.attributes.get(key, default)
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        expected = "a number" if count == 1 else f"{count} numbers"
        raise _error(element, f"expected {expected} for '{key}', found {shown(text)}")
    return values


def _measured(element: Element | None) -> list[Element]:
    """A copy of an element without children, if present, with normalised numbers.

    Python reads "0.05 " and "1_0" as numbers; URDF's parser omits such a shape.
    """
    if element is None:
        return []
    clean = element.alone()
    for key, (count, default) in _NUMBERS[element.tag].items():
        values = _numbers(element, key, count, default)
        if key in ("size", "radius", "length") and min(values) <= 0:
            raise _error(element, f"expected '{key}' > 0, found {shown(element.attributes[key])}")
        if key in element.attributes:
            clean.attributes[key] = " ".join(map(repr, values))
    return [clean]


def _joint(joint: Element, links: Mapping[str, Element], left_out: list[str] | None) -> Element:
    """The joint with its ends and limits; `left_out` receives immovable ones (None: an error)."""
    kind = joint.attributes.get("type", "")
    if kind not in _KINDS:
        raise _error(joint, f"expected a joint of type {', '.join(_KINDS)}, found {shown(kind)}")
    clean = Element("joint", {"name": joint.attributes["name"], "type": kind}, joint.line)
    clean.children += _measured(joint.first("origin"))
    for key in ("parent", "child"):
        end = joint.first(key)
        name = "" if end is None else end.attributes.get("link", "")
        if name not in links:
            raise _error(end or joint, f"expected the name of a link as {key}, found {shown(name)}")
        clean.children.append(Element(key, {"link": name}, joint.line))
    if kind == "fixed":
        return clean
    axis, limit = joint.first("axis"), joint.first("limit")
    clean.children += _measured(axis)
    if axis is not None and not any(_numbers(axis, "xyz", 3)):
        raise _error(axis, "expected an axis that is not zero")
    lower, upper = -NO_LIMIT, NO_LIMIT
    follows = left_out is not None and joint.first("mimic") is not None
    if kind == "continuous":
        clean.attributes["type"] = "revolute"
    elif follows and (limit is None or not limit.attributes.keys() & set(_ENDS)):
        pass  # it goes where its leader does
    elif limit is None:
        raise _error(joint, f"missing <limit> of a {kind} joint", "add lower and upper")
    else:
        (lower,), (upper,) = _numbers(limit, "lower", 1, "0"), _numbers(limit, "upper", 1, "0")
        if lower == upper and left_out is not None:
            left_out.append(f"joint {joint.attributes['name']} is fixed: {_immobile_reason(limit, lower)}")
            clean.attributes["type"] = "fixed"
            return clean
        if lower >= upper:
            raise _error(limit, f"expected lower < upper, found {lower:g} and {upper:g}")
    effort = 0.0 if limit is None else _numbers(limit, "effort", 1, "0")[0]
    effort = effort if effort > 0 else NO_LIMIT  # the file states none
    bounds = {"lower": repr(lower), "upper": repr(upper), "effort": repr(effort), "velocity": "1"}
    clean.children.append(Element("limit", bounds, joint.line))
    return clean


def _immobile_reason(limit: Element, at: float) -> str:
    """The reason why a joint cannot move."""
    if limit.attributes.keys() & set(_ENDS):
        return f"lower and upper are both {at:g}"
    return "without lower and upper both are 0; give them, or the type continuous"


def _check_tree(root: Element, links: Mapping[str, Element], joints: Iterable[Element]) -> None:
    """Refuse links that are not connected to one root by one joint each."""
    below: dict[str, list[str]] = {}
    carried: set[str] = set()
    for joint in joints:
        parent, child = (end.attributes["link"] for end in (joint.first("parent"), joint.first("child")) if end)
        if child in carried:
            raise _error(joint, f"link {shown(child)} is carried by two joints")
        carried.add(child)
        below.setdefault(parent, []).append(child)
    roots = [name for name in links if name not in carried]
    reached = roots[:1]
    for name in reached:  # grows
        reached += below.get(name, [])
    if len(roots) != 1 or len(reached) != len(links):
        lost = next((name for name in links if name not in reached), "")
        problem = f"expected one tree of links, found {len(roots)} roots"
        raise _error(root, problem + (f"; link {shown(lost)} is not connected to the first" if lost else ""))


def _link(link: Element, mesh_path: Callable[[Element], str], left_out: list[str] | None) -> Element:
    """The link with its inertia and collision shapes, or its visual shapes if there are none.

    Args:
        left_out: takes a line for each shape that is none of ours, and each mesh that is not found; None: a mistake.
    """
    clean, inertial = Element("link", {"name": link.attributes["name"]}, link.line), link.first("inertial")
    if inertial is not None:
        mass, inertia = inertial.first("mass"), inertial.first("inertia")
        if mass is None or inertia is None:
            raise _error(inertial, "expected <mass> and <inertia>")
        if _numbers(mass, "value", 1)[0] < 0:
            raise _error(mass, "expected a mass >= 0")
        described = [*_measured(inertial.first("origin")), *_measured(mass), *_measured(inertia)]
        clean.children.append(Element("inertial", {}, inertial.line, described))
    for shape in link.all("collision") or link.all("visual"):
        geometry = shape.first("geometry")
        if geometry is None or len(geometry.children) != 1:
            raise _error(shape, "expected one shape in <geometry>")
        (solid,) = geometry.children
        if solid.tag not in _SOLIDS:
            if left_out is None:
                raise _error(solid, "expected a box, cylinder, capsule, sphere or mesh")
            left_out.append(f"link {link.attributes['name']}: <{solid.tag[:40]}> is left out, it is no solid")
            continue
        (measured,) = _measured(solid)
        if solid.tag == "mesh":
            if 0.0 in _numbers(solid, "scale", 3, "1 1 1"):
                raise _error(solid, "expected a scale without zeros")
            try:
                measured.attributes["filename"] = mesh_path(solid)
            except InputError as error:
                if left_out is None:
                    raise
                left_out.append(f"link {link.attributes['name']}: a mesh is left out, {error.problem}")
                continue
        placed = [*_measured(shape.first("origin")), Element("geometry", {}, geometry.line, [measured])]
        clean.children.append(Element("collision", {}, shape.line, placed))
    return clean


def _mesh(mesh: Element, folder: str, packages: Mapping[str, str]) -> str:
    """The absolute path of a mesh; package://NAME/ is a folder that is given, or one above the file of that name."""
    name = mesh.attributes.get("filename", "")
    if name.startswith(_FILE):
        path, here = Path(name.removeprefix(_FILE)), Path(folder).resolve()
        if not path.is_absolute() or not path.resolve().is_relative_to(here):
            problem = f"{shown(name)} leads out of the folder of the URDF"
            raise _error(mesh, problem, "put the mesh into that folder and name it relative to the URDF")
        return _mesh_path(mesh, str(path.resolve().relative_to(here)), folder)
    if not name.startswith(_PACKAGE):
        return _mesh_path(mesh, name, folder)
    package, _, name = name.removeprefix(_PACKAGE).partition("/")
    above = Path(folder).resolve()
    named = [folder for folder in (above, *above.parents) if package and folder.name == package]
    if package not in packages and not named:
        problem = f"the package {shown(package)} is not known and no folder above the file has its name"
        raise _error(mesh, problem, "give its folder: `packages` of the problem's robot, or --package NAME=FOLDER")
    return _mesh_path(mesh, name, packages.get(package) or named[0])


def _remember(material: Element, materials: dict[str, str]) -> None:
    color = material.first("color")
    if color is not None:
        parts = _numbers(color, "rgba", 4)[:3]
        rgb = "".join(f"{round(255 * min(max(part, 0.0), 1.0)):02x}" for part in parts)
        materials[material.attributes.get("name", "")] = f"#{rgb}"


def _colors(link: Element, materials: dict[str, str]) -> tuple[str, ...]:
    """Colours of the visuals of a link, in order."""
    elements = []
    for material in (material for shape in link.all("visual") for material in shape.all("material")[:1]):
        _remember(material, materials)
        elements.append(materials.get(material.attributes.get("name", ""), ""))
    return tuple(color for color in elements if color)


def check_mjcf(root: Element, folder: str) -> CheckedRobot:
    """Kinematics and solids of an MJCF file, validated for MuJoCo.

    Raises:
        InputError: for the first mistake.
    """
    for element in root.walk():
        if element.tag in ("include", "attach", "replicate", "model", "composite", "flexcomp", "plugin"):
            raise element.error(f"<{element.tag}> is not read", "write the file out in one piece")
        for key in _MJCF_NUMBERS:
            text = element.attributes.get(key, "")
            if not all(_MJCF_NUMBER.fullmatch(word) and math.isfinite(float(word)) for word in text.split()):
                raise element.error(f"expected numbers for '{key}', found {shown(text)}", "correct the MJCF")
    stated = {key: value for compiler in root.all("compiler") for key, value in compiler.attributes.items()}
    meshes = stated.get("meshdir", stated.get("assetdir", ""))
    clean = root.alone()
    clean.children = [child for child in root.children if child.tag in _KEPT]
    # Masses do not matter here, so bodies without any are no mistake.
    masses = {"boundmass": "1e-6", "boundinertia": "1e-9"}
    clean.children.append(Element("compiler", masses, root.line, source=root.source))
    return CheckedRobot("mjcf", write_xml(_mjcf_copy(clean, folder, meshes)))


def _mjcf_copy(element: Element, folder: str, meshes: str) -> Element:
    clean = element.alone()
    for key in (*_FOLDERS, *(["material"] if element.tag == "geom" else [])):
        clean.attributes.pop(key, None)
    name = clean.attributes.get("file")
    if name is not None:
        clean.attributes.setdefault("name", re.split(r"[/\\]", name)[-1].rpartition(".")[0])
        path = f"{meshes.rstrip('/')}/{name}" if meshes and name else name
        clean.attributes["file"] = _mesh_path(element, path, folder)
    clean.children = [_mjcf_copy(child, folder, meshes) for child in element.children if child.tag not in _DROPPED]
    return clean


def _mesh_path(element: Element, name: str, folder: str | Path) -> str:
    """The absolute path of a mesh that an element names."""
    try:
        return str(contained(name, folder))
    except InputError as error:
        raise element.error(error.problem, error.remedy or "") from None
