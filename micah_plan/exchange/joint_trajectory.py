"""Plans as ``trajectory_msgs/JointTrajectory``, and as the goal of a ``control_msgs/FollowJointTrajectory`` action."""

from __future__ import annotations

from typing import Any

import numpy as np

from micah_plan.documents.plan import StoredPlan, require_executable
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.recording.ros_mcap import NANOSECONDS, header_at, split_time


def trajectory_goal(stored: StoredPlan) -> dict[str, Any]:
    """The `FollowJointTrajectory` goal of a plan, starting on arrival, with one second of tolerance at its end.

    Raises:
        InputError: if the plan is no solution.
    """
    message = joint_trajectory(stored) | {"header": header_at(0, "")}
    return {"trajectory": message, "goal_time_tolerance": split_time(NANOSECONDS)}


def joint_trajectory(stored: StoredPlan) -> dict[str, Any]:
    """The message of a plan.

    The joints are those of the arm [rad or m] if the plan has one, else the object's coordinates along the mean of the
    belief. One control step of the problem's plant passes between two points; transitions take no time, so of their two
    knots the second is kept. Between points the joints move in straight lines; the velocity at a point
    [rad/s or m/s] is the mean of those before and after it, and 0 at both ends, where it rests.

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
    points, placed = [], np.asarray(positions)[kept]
    velocities = np.zeros_like(placed)
    velocities[1:-1] = (placed[2:] - placed[:-2]) / (2.0 * period)
    for step in range(len(kept)):
        moving = {"velocities": velocities[step].tolist(), "accelerations": [], "effort": []}
        point = {"positions": placed[step].tolist(), **moving}
        points.append({**point, "time_from_start": split_time(round(step * period * NANOSECONDS))})
    return {"header": header_at(0, "base"), "joint_names": names, "points": points}
