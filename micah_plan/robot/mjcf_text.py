"""MJCF (MuJoCo's format) before Pinocchio sees it: no inclusion of other files, mesh paths resolved in their folder."""

from __future__ import annotations

import math
import re

from micah_plan.errors import InputError, shown
from micah_plan.robot.checked_robot import CheckedRobot
from micah_plan.robot.xml_text import Element, write_xml
from micah_plan.scene.contained_path import contained

# What kinematics and clearances need; the rest (actuators, sensors, textures) names further files or is not read.
_KEPT = ("compiler", "default", "asset", "worldbody", "contact", "equality")
_FOLDERS = ("meshdir", "assetdir", "texturedir")
_DROPPED_ASSETS = ("texture", "hfield", "skin", "material")
_NUMERIC = ("pos", "quat", "axis", "size", "range", "euler", "axisangle", "xyaxes", "zaxis", "fromto", "ref")


def check_mjcf(root: Element, source: str, folder: str) -> CheckedRobot:
    """What an MJCF file says, fit to be handed to Pinocchio.

    Raises:
        InputError: for the first mistake.
    """
    for element in root.walk():
        _check(element, source)
    stated = {key: value for compiler in root.all("compiler") for key, value in compiler.attributes.items()}
    mesh_folder = stated.get("meshdir", stated.get("assetdir", ""))
    clean = Element("mujoco", dict(root.attributes), root.line, [e for e in root.children if e.tag in _KEPT])
    clean = _copied(clean, source, folder, mesh_folder)
    return CheckedRobot("mjcf", write_xml(clean))


def _error(element: Element, source: str, problem: str, remedy: str = "correct the MJCF") -> InputError:
    return InputError(problem, source=source, where=f"line {element.line}, <{element.tag}>", remedy=remedy)


def _check(element: Element, source: str) -> None:
    if element.tag in ("include", "attach", "replicate", "model", "composite", "flexcomp", "plugin"):
        raise _error(element, source, f"<{element.tag}> is not read", "write the file out in one piece")
    for key in _NUMERIC:
        for word in element.attributes.get(key, "").split():
            if not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", word) or not math.isfinite(float(word)):
                raise _error(element, source, f"expected numbers for '{key}', found {shown(element.attributes[key])}")


def _copied(element: Element, source: str, folder: str, meshes: str) -> Element:
    attributes = {key: value for key, value in element.attributes.items() if key not in _FOLDERS}
    if element.tag == "geom":
        attributes.pop("material", None)
    if "file" in attributes:
        name = f"{meshes.rstrip('/')}/{attributes['file']}" if meshes and attributes["file"] else attributes["file"]
        attributes.setdefault("name", re.split(r"[/\\]", attributes["file"])[-1].rpartition(".")[0])
        try:
            attributes["file"] = str(contained(name, folder))
        except InputError as error:
            raise _error(element, source, error.problem, error.remedy or "") from None
    kept = [child for child in element.children if child.tag not in _DROPPED_ASSETS]
    children = [_copied(child, source, folder, meshes) for child in kept]
    return Element(element.tag, attributes, element.line, children)
