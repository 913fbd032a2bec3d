"""From one file to another: what is in it, in the format that the other's ending names.

Plans become a ``trajectory_msgs/JointTrajectory``, as JSON or in an MCAP file.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any, Literal

from micah_plan.documents.model import dump_model, load_model
from micah_plan.documents.plan import StoredPlan, load_plan, require_executable
from micah_plan.errors import InputError, located_in, shown
from micah_plan.exchange.urdf_read import load_urdf
from micah_plan.exchange.urdf_write import urdf_text
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.files import replace_file
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.ros.log import NANOSECONDS, Logged, header_at, split_time, write_log

TOPIC = "/joint_trajectory"
Kind = Literal["recording", "plan", "model"]
RECORDINGS = (".csv", ".npz", ".tum", ".txt", ".mcap")
TARGETS = {
    **dict.fromkeys(RECORDINGS, RECORDINGS),
    ".json": (".json", ".mcap"),
    **dict.fromkeys((".yaml", ".yml"), (".urdf",)),
    ".urdf": (".yaml", ".yml"),
}
"""What a file may be converted to, by its ending."""


def targets(path: str | Path) -> tuple[str, ...]:
    """The endings that a file may be converted to.

    Raises:
        InputError: if there are none.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in TARGETS:
        remedy = "give a recording (.csv, .npz, .tum, .txt, .mcap), plan (.json), model (.yaml) or .urdf"
        raise InputError(f"nothing can be made of a {shown(suffix)} file", source=path, remedy=remedy)
    return TARGETS[suffix]


def convert(source: str | Path, target: str | Path, *, topics: Collection[str] = ()) -> tuple[Kind, tuple[str, ...]]:
    """Write what one file holds into another, at once or not at all.

    Args:
        topics: of an .mcap file, which to read; empty: all.

    Returns:
        What it was, and what of it is not in the target, one line each.

    Raises:
        InputError: if the one cannot be read, or the other cannot hold it.
        MissingDependencyError: for .mcap files without the extra ``ros``.
    """
    wanted = Path(target).suffix.lower()
    if wanted not in targets(source):
        remedy = f"choose one that ends in {' or '.join(targets(source))}"
        raise InputError(f"cannot be made of {Path(source).name}", source=target, remedy=remedy)
    given = Path(source).suffix.lower()
    if given in RECORDINGS:
        write_recording(read_recording(source, topics=topics), target)
        return "recording", ()
    if given == ".json":
        message = joint_trajectory(load_plan(source))
        content = f"{json.dumps(message, indent=2, ensure_ascii=False)}\n".encode()
        if wanted == ".mcap":
            content = write_log([Logged(TOPIC, "trajectory_msgs/msg/JointTrajectory", 0, message)])
        replace_file(target, content)
        return "plan", ()
    if given == ".urdf":
        automaton, notes = load_urdf(source)
        dump_model(automaton, target)
        return "model", notes
    with located_in(source):
        text = urdf_text(load_model(source), Path(source).stem)
    replace_file(target, text.encode())
    return "model", ()


def joint_trajectory(stored: StoredPlan) -> dict[str, Any]:
    """The message of a plan.

    The joints are those of the arm [rad or m] if the plan has one, else the object's coordinates along the mean of the
    belief. One control step of the problem's plant passes between two points; transitions take no time, so of their two
    knots the second is kept. Between points the joints move in straight lines, so no velocities are given.

    Raises:
        InputError: if the plan is no solution.
    """
    trajectory, arm = require_executable(stored), stored.plan.arm
    if arm is None:
        names, positions = list(stored.automaton.coordinate_names), trajectory.means
    else:
        names, positions = list(arm.joints), arm.positions
    period = parameters_of(stored.problem).control_period
    kept = [k for k in range(len(positions)) if k == len(positions) - 1 or not trajectory.is_transition[k]]
    points = []
    for step, k in enumerate(kept):
        point = {"positions": positions[k].tolist(), "velocities": [], "accelerations": [], "effort": []}
        points.append({**point, "time_from_start": split_time(round(step * period * NANOSECONDS))})
    return {"header": header_at(0, "base"), "joint_names": names, "points": points}
