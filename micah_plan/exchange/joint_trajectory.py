"""Plans as ``trajectory_msgs/JointTrajectory``: the message as plain data, for JSON and for MCAP."""

from __future__ import annotations

import json
from typing import Any

from micah_plan.documents.plan_file import StoredPlan, require_executable
from micah_plan.execution.held_parameters import parameters_of
from micah_plan.ros.log import NANOSECONDS, Logged, header_at, write_log

TOPIC = "/joint_trajectory"


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
        time = round(step * period * NANOSECONDS)
        point = {"positions": positions[k].tolist(), "velocities": [], "accelerations": [], "effort": []}
        points.append({**point, "time_from_start": {"sec": time // NANOSECONDS, "nanosec": time % NANOSECONDS}})
    return {"header": header_at(0, "base"), "joint_names": names, "points": points}


def trajectory_json(stored: StoredPlan) -> str:
    """The message as JSON text, its keys as in ROS 2."""
    return json.dumps(joint_trajectory(stored), indent=2, ensure_ascii=False) + "\n"


def trajectory_mcap(stored: StoredPlan) -> bytes:
    """The content of an MCAP file with the message.

    Raises:
        MissingDependencyError: without the extra ``ros``.
    """
    return write_log([Logged(TOPIC, "trajectory_msgs/msg/JointTrajectory", 0, joint_trajectory(stored))])
