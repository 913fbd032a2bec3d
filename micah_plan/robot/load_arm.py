"""Loading arms from robot descriptions: `load_arm`, and `describe_robot` for a file alone."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import IDENTITY, Quaternion, Vector3
from micah_plan.errors import InputError, shown
from micah_plan.robot.arm import Arm, middle
from micah_plan.robot.mjcf_arm import mjcf_arm
from micah_plan.robot.robot_text import MJCF_ROOTS, NO_LIMIT, CheckedRobot, check_mjcf, check_urdf
from micah_plan.task.robot_description import RobotDescription
from micah_plan.xml_text import parse_xml, read_xml, with_includes, write_xml

_MOST_JOINTS = 100
_MOST_LISTED = 12
# Between the name of a frame and its number while several have that name: no file can have it.
_RENAMED = "\0"


def describe_robot(
    path: str | Path, tool: str, position: Vector3 = (0.0, 0.0, 0.0), quaternion: Quaternion = IDENTITY
) -> RobotDescription:
    """The description of a robot file (URDF or MJCF) at a pose in the base frame.

    Raises:
        InputError: if the file cannot be read or is no text.
    """
    text, folder = read_xml(path, "URDF or MJCF"), str(Path(path).parent)
    if "<include" in text and (root := parse_xml(text, str(path))).tag == "mujoco":  # plans keep the text of all files
        text = write_xml(with_includes(root, folder, MJCF_ROOTS))
    return RobotDescription(str(path), text, tool, position, quaternion, folder=folder)


def load_arm(description: RobotDescription) -> Arm:
    """The chain of joints from the root to the tool; all other joints are locked.

    Raises:
        InputError: if the file is no URDF or MJCF, has a mistake, leads out of its folder, or the tool, a joint or the
            chain is not usable; one line with the place and the remedy.
    """
    checked = check_robot(description)
    model, geometry, mimics = _parsed(checked, description.path)
    tool = _tool(model, description)
    chain = [int(joint) for joint in list(model.supports[model.frames[tool].parentJoint]) if joint > 0]
    _check_chain(model, chain, mimics, description)
    positions = _locked_positions(model, description)
    locked = [joint for joint in range(1, model.njoints) if joint not in chain]
    still = [(str(model.names[i]), float(positions[model.idx_qs[i]])) for i in locked if model.joints[i].nq == 1]
    if locked:
        model, geometry = _with_locked(model, geometry, locked, positions)
    _place(model, geometry, description)
    return Arm(
        name=Path(description.path).name,
        model=model,
        geometry=geometry,
        tool=_tool(model, description),
        rest=_rest(model, description),
        colors=_colors(geometry, checked),
        separate=_separate(description),
        locked=tuple(still),
        data=model.createData(),
    )


def _with_locked(model: Any, geometry: Any, locked: list[int], positions: Any) -> tuple[Any, Any]:
    """The model and its geometry with some joints locked at positions.

    Pinocchio looks joints up by name among all frames, and a link may be called as its joint (LeRobot's arms have both
    a joint and a link `gripper`): frames of such names have others meanwhile.
    """
    counts = Counter(frame.name for frame in model.frames)
    for number, frame in enumerate(model.frames):
        if counts[frame.name] > 1 and frame.type != pin.FrameType.JOINT:
            frame.name = f"{frame.name}{_RENAMED}{number}"
    reduced, (shapes,) = pin.buildReducedModel(model, [geometry], locked, positions)
    for frame in reduced.frames:
        frame.name = frame.name.partition(_RENAMED)[0]
    return reduced, shapes


def check_robot(description: RobotDescription) -> CheckedRobot:
    """The validated robot file.

    Raises:
        InputError: for the first mistake in it.
    """
    root, source = parse_xml(description.text, description.path), description.path
    if root.tag == "robot":
        packages = {name: str(Path(description.root, folder)) for name, folder in description.packages}
        return check_urdf(root, description.folder, packages)
    if root.tag == "mujoco":
        return check_mjcf(root, description.folder)
    raise InputError(f"expected <robot> (URDF) or <mujoco> (MJCF), found <{root.tag[:40]}>", source=source)


def _parsed(checked: CheckedRobot, source: str) -> tuple[Any, Any, frozenset[str]]:
    """Model, collision geometry with meshes as convex hulls, and coupled joints."""
    mimics = frozenset(checked.mimics)
    try:
        if checked.kind == "urdf":
            model = pin.buildModelFromXML(checked.text)
            geometry = pin.buildGeomFromUrdfString(model, checked.text, pin.GeometryType.COLLISION, package_dirs="/")
        else:
            model, geometry, mimics = mjcf_arm(checked.text, source)
        for item in geometry.geometryObjects:
            if hasattr(item.geometry, "buildConvexRepresentation"):
                item.geometry.buildConvexRepresentation(False)
                item.geometry = item.geometry.convex
    except (ValueError, RuntimeError, IndexError, KeyError, TypeError) as error:
        message = " ".join(str(error).split())[:160]
        raise InputError(f"cannot be read as a robot: {message}", source=source, remedy="correct the file") from None
    if model.njoints - 1 > _MOST_JOINTS:
        raise InputError(f"expected at most {_MOST_JOINTS} joints, found {model.njoints - 1}", source=source)
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    model.lowerPositionLimit = np.where(low <= -NO_LIMIT, -np.inf, low)
    model.upperPositionLimit = np.where(high >= NO_LIMIT, np.inf, high)
    return model, geometry, mimics


def _tool(model: Any, description: RobotDescription) -> int:
    """The tool's frame: a body or site takes precedence over a joint of the same name."""
    named = [i for i, frame in enumerate(model.frames) if frame.name == description.tool]
    if not named:
        names = [frame.name for frame in model.frames if frame.type != pin.FrameType.JOINT and frame.name != "universe"]
        listed = ", ".join(names[-_MOST_LISTED:])
        problem = f"the robot has no frame {shown(description.tool)} to hold with"
        raise InputError(problem, source=description.path, remedy=f"choose one, for instance of {listed}")
    joints = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    return min(named, key=lambda i: model.frames[i].type in joints)


def _check_chain(model: Any, chain: list[int], mimics: frozenset[str], description: RobotDescription) -> None:
    source = description.path
    if not chain:
        problem = f"no joint moves the frame {shown(description.tool)}"
        raise InputError(problem, source=source, remedy="name a frame at the arm's end")
    for joint in chain:
        name = model.names[joint]
        if model.joints[joint].nq != 1:
            kind = model.joints[joint].shortname().removeprefix("JointModel")
            problem = f"joint {shown(name)} is of kind {kind}"
            raise InputError(problem, source=source, remedy="use revolute or prismatic")
        if name in mimics:
            raise InputError(f"joint {shown(name)} follows another one and moves the tool", source=source)
        index = model.idx_qs[joint]
        low, high = float(model.lowerPositionLimit[index]), float(model.upperPositionLimit[index])
        if not low < high:
            raise InputError(f"joint {shown(name)} has limits {low:g} and {high:g}", source=source, remedy="widen them")


def _locked_positions(model: Any, description: RobotDescription) -> Any:
    """(nq,) positions of all joints for locking those outside the chain."""
    q = pin.neutral(model)
    single = [model.idx_qs[joint] for joint in range(1, model.njoints) if model.joints[joint].nq == 1]
    q[single] = middle(model.lowerPositionLimit, model.upperPositionLimit)[single]
    for name, value in description.locked:
        index = _index(model, name, description)
        if index in single:
            q[index] = value
    return q


def _rest(model: Any, description: RobotDescription) -> Floats:
    """(n,) rest posture within the limits, the middle where the description has none [rad or m]."""
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    rest = middle(low, high)
    for name, value in description.rest:
        index = _index(model, name, description)
        if not low[index] <= value <= high[index]:
            problem = f"the rest posture has {shown(name)} at {value:g}, outside {low[index]:g} to {high[index]:g}"
            raise InputError(problem, source=description.path, remedy="choose a value within the limits")
        rest[index] = value
    return rest


def _index(model: Any, name: str, description: RobotDescription) -> int:
    """Index of a joint's first position among all positions."""
    names = list(model.names)[1:]
    if name not in names:
        remedy = f"choose one of {', '.join(names[:_MOST_LISTED])}"
        raise InputError(f"the robot has no joint {shown(name)}", source=description.path, remedy=remedy)
    return int(model.idx_qs[model.getJointId(name)])


def _place(model: Any, geometry: Any, description: RobotDescription) -> None:
    """Move the robot's root to its pose in the base frame."""
    base = pin.SE3(description.pose.as_matrix())
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = base * model.jointPlacements[joint]
    for item in (*model.frames, *geometry.geometryObjects):
        if item.parentJoint == 0:
            item.placement = base * item.placement


def _colors(geometry: Any, checked: CheckedRobot) -> dict[str, str]:
    """Colours by name of geometry; further shapes of a link have the colour of its last."""
    joint_index: dict[str, str] = {}
    shapes: Counter[str] = Counter()
    for item in geometry.geometryObjects:
        link = link_name(item)
        colors = checked.colors.get(link)
        if colors:
            joint_index[item.name] = colors[min(shapes[link], len(colors) - 1)]
        shapes[link] += 1
    return joint_index


def link_name(item: Any) -> str:
    """The link that a geometry belongs to, by its name: Pinocchio numbers the shapes of a link."""
    return str(item.name).rpartition("_")[0] or str(item.name)


def _separate(description: RobotDescription) -> frozenset[tuple[str, str]]:
    """Pairs of links that an SRDF excludes from collision checks."""
    if not description.srdf:
        return frozenset()
    entries = parse_xml(description.srdf, f"{description.path} (SRDF)").all("disable_collisions")
    pairs = [sorted(entry.attributes.get(key, "") for key in ("link1", "link2")) for entry in entries]
    return frozenset((first, second) for first, second in pairs)
