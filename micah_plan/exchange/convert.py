"""Conversion of a file to the format of the target's suffix."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.model import dump_model, load_model
from micah_plan.documents.plan import load_plan
from micah_plan.documents.yaml_lines import write_yaml
from micah_plan.errors import InputError, located_in, shown
from micah_plan.exchange.bodies import DENSITY, lost_in_bodies
from micah_plan.exchange.joint_trajectory import joint_trajectory, trajectory_goal
from micah_plan.exchange.load import load_recording
from micah_plan.exchange.mjcf import mjcf_text
from micah_plan.exchange.mjcf_reading import load_mjcf
from micah_plan.exchange.rerun import write_rrd
from micah_plan.exchange.sdf import sdf_text
from micah_plan.exchange.sdf_read import load_sdf
from micah_plan.exchange.urdf import load_urdf, urdf_text
from micah_plan.files import replace_file
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.read import write_recording
from micah_plan.recording.ros_bags import is_log
from micah_plan.recording.ros_mcap import Logged, write_log
from micah_plan.recording.value import Recording

TOPIC = "/joint_trajectory"
Kind = Literal["recording", "plan", "model"]
RECORDINGS = (".csv", ".npz", ".tum", ".txt", ".mcap")
READABLE = (*RECORDINGS, ".parquet", ".db3", ".bag")
TARGETS = {
    **dict.fromkeys(READABLE, (*RECORDINGS, ".rrd")),
    ".json": (".json", ".mcap", ".yaml"),
    **dict.fromkeys((".yaml", ".yml"), (".urdf", ".mjcf", ".xml", ".sdf")),
    **dict.fromkeys((".urdf", ".sdf", ".xml", ".mjcf"), (".yaml", ".yml")),
}
"""What a file may be converted to, by its ending."""
_MODELS = (".yaml", ".yml")
_USD = (".usd", ".usda", ".usdc", ".usdz")
_GOAL = """\
Goal of a control_msgs/action/FollowJointTrajectory; CONTROLLER is such as /joint_trajectory_controller:
  ros2 action send_goal CONTROLLER/follow_joint_trajectory control_msgs/action/FollowJointTrajectory "$(cat FILE)"
"""
_OBJECTS: Mapping[str, Callable[..., tuple[HybridAutomaton, tuple[str, ...]]]] = {
    ".urdf": load_urdf,
    ".sdf": load_sdf,
    **dict.fromkeys((".xml", ".mjcf"), lambda source, _: load_mjcf(source)),
}
_BODIES = {".urdf": urdf_text, ".sdf": sdf_text, ".mjcf": mjcf_text, ".xml": mjcf_text}


def targets(path: str | Path) -> tuple[str, ...]:
    """The suffixes that a file may be converted to.

    Raises:
        InputError: if there are none.
    """
    suffix = Path(path).suffix.lower() or (".mcap" if is_log(path) else "")
    if suffix in _USD:
        remedy = "export the object as URDF or MJCF, as the simulators that write USD can"
        raise InputError("a USD file is not read", source=path, remedy=remedy)
    if suffix not in TARGETS:
        remedy = f"give a recording ({', '.join(READABLE)}), plan (.json), model (.yaml), .urdf, .sdf or .xml (MuJoCo)"
        raise InputError(f"there is no conversion of a {shown(suffix)} file", source=path, remedy=remedy)
    return TARGETS[suffix]


def convert(
    source: str | Path,
    target: str | Path,
    *,
    part: str | None = None,
    run: int | None = None,
    poses_only: bool = False,
    density: float = DENSITY,
    packages: Mapping[str, str] | None = None,
    conventions: Conventions | None = None,
) -> tuple[Kind, tuple[str, ...]]:
    """Convert a file to another format, atomically.

    Args:
        source, target: the files.
        part, run: of a recording, which to write; None: all.
        poses_only: leave out everything but poses, such as actions, so that formats of trajectories can hold the rest.
        density: of the shapes of a model, for the masses of bodies [kg/m^3].
        packages: of a URDF or SDF, folder by package name of its meshes.
        conventions: of a recording; None: those next to its file, if any.

    Returns:
        The kind of file, and what the target does not contain, one line each.

    Raises:
        InputError: if the one cannot be read, or the other cannot hold it.
        MissingDependencyError: for ROS messages without the extra ``ros``, for .rrd without ``rerun``.
    """
    wanted = Path(target).suffix.lower()
    if wanted not in targets(source):
        remedy = f"choose one that ends in {' or '.join(targets(source))}"
        raise InputError(f"cannot be made of {Path(source).name}", source=target, remedy=remedy)
    suffix = Path(source).suffix.lower()
    if ".rrd" in targets(source):
        found = load_recording(source, conventions=conventions)
        recording, notes = _chosen(found, part, run, poses_only)
        notes = found.notes + notes
        if wanted == ".rrd":
            lost = write_rrd(recording, target)
            return "recording", notes + ((f"left out: {', '.join(lost)}, no numbers",) if lost else ())
        write_recording(recording, target)
        return "recording", notes
    if suffix == ".json":
        stored = load_plan(source)
        if wanted == ".yaml":
            replace_file(target, write_yaml(trajectory_goal(stored), _GOAL).encode())
            return "plan", ()
        message = joint_trajectory(stored)
        content = f"{json.dumps(message, indent=2, ensure_ascii=False)}\n".encode()
        if wanted == ".mcap":
            content = write_log([Logged(TOPIC, "trajectory_msgs/msg/JointTrajectory", 0, message)])
        replace_file(target, content)
        return "plan", ()
    if suffix in _OBJECTS:
        automaton, notes = _OBJECTS[suffix](source, packages)
        dump_model(automaton, target)
        return "model", notes
    with located_in(source):
        return "model", write_model(load_model(source), target, name=Path(source).stem, density=density)


def write_model(
    automaton: HybridAutomaton, path: str | Path, *, name: str = "object", density: float = DENSITY
) -> tuple[str, ...]:
    """Write a model in the format of the file's suffix, atomically.

    Args:
        automaton: the model.
        path: .yaml or .yml, which holds all of it; .urdf, .sdf, .mjcf or .xml (MuJoCo).
        name: of the body in these.
        density: of its shapes, for the masses of bodies [kg/m^3].

    Returns:
        What the file does not contain, one line each.

    Raises:
        InputError: for another ending, and for a model that the format cannot hold.
    """
    wanted = Path(path).suffix.lower()
    if wanted in _MODELS:
        dump_model(automaton, path)
        return ()
    if wanted not in _BODIES:
        remedy = f"choose one that ends in {', '.join((*_MODELS, *_BODIES))}"
        raise InputError(f"no model can be written to a {shown(wanted)} file", source=path, remedy=remedy)
    from micah_plan.view.drawing import with_shapes

    shaped = with_shapes(automaton)
    replace_file(path, _BODIES[wanted](shaped, name, density).encode())
    notes = lost_in_bodies(shaped, density, handles=_BODIES[wanted] is mjcf_text)
    return notes if shaped is automaton else (*notes, "the model has no shapes: those of the file are made up")


def _chosen(
    recording: Recording, part: str | None, run: int | None, poses_only: bool
) -> tuple[Recording, tuple[str, ...]]:
    """(requested rows, losses, one line each)."""
    if part is not None or run is not None:
        recording = recording.select(run=run, part=part)
    if not poses_only:
        return recording, ()
    lost = [name for name in ("action", "force") if getattr(recording, name) is not None] + list(recording.extra)
    kept = replace(recording, action=None, force=None, extra={})
    return kept, (f"left out: {', '.join(lost)}",) if lost else ()
