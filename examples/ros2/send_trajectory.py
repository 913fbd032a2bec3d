"""Sends the joint trajectory of a plan to a robot's controller with ROS 2, and waits until it has ended.

    python examples/ros2/send_trajectory.py plan.json [CONTROLLER]

CONTROLLER is the name of a `FollowJointTrajectory` action; /joint_trajectory_controller/follow_joint_trajectory if none
is given. The trajectory begins where the plan begins: a robot that stands elsewhere is not moved. Nothing looks at the
object on the way; where it must be looked at, execute the plan on a plant (`hand.py`). Ctrl-C cancels the goal. The
tests run this file against a stand-in for rclpy.
"""

import sys
import time

import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions
from rosidl_runtime_py.set_message import set_message_fields
from sensor_msgs.msg import JointState

from micah_plan.documents.plan import load_plan
from micah_plan.exchange.joint_trajectory import trajectory_goal

CONTROLLER = "/joint_trajectory_controller/follow_joint_trajectory"
TIMEOUT_S, NEAR_RAD = 5.0, 0.05


def send(plan, controller=CONTROLLER):
    """Sends the trajectory of a plan file; what went wrong, or an empty text."""
    goal = trajectory_goal(load_plan(plan))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C cancels
    node = rclpy.create_node("micah_plan_trajectory")
    try:
        return _followed(node, controller, goal)
    finally:
        node.destroy_node()
        rclpy.shutdown()


def _followed(node, controller, goal):
    client = ActionClient(node, FollowJointTrajectory, controller)
    if not client.wait_for_server(timeout_sec=TIMEOUT_S):
        return f"nothing answers at {controller}"
    problem = _far_from_start(node, goal["trajectory"])
    if problem:
        return problem
    message = FollowJointTrajectory.Goal()
    set_message_fields(message, goal)
    handle = _result(node, client.send_goal_async(message))
    if not handle.accepted:
        return "the controller refused the trajectory; its log says why"
    try:
        result = _result(node, handle.get_result_async()).result
    except KeyboardInterrupt:
        _result(node, handle.cancel_goal_async())
        return "cancelled"
    if result.error_code == FollowJointTrajectory.Result.SUCCESSFUL:
        return ""
    return f"the controller ended with error {result.error_code}: {result.error_string}"


def _far_from_start(node, trajectory):
    """Why the robot is not where the plan begins; empty if it is there."""
    names, begin = trajectory["joint_names"], trajectory["points"][0]["positions"]
    measured = {}
    node.create_subscription(
        JointState, "joint_states", lambda m: measured.update(zip(m.name, m.position, strict=True)), 1
    )
    until = time.monotonic() + TIMEOUT_S
    while not measured.keys() >= set(names):
        if time.monotonic() > until:
            return f"/joint_states has no {', '.join(sorted(set(names) - measured.keys()))}"
        rclpy.spin_once(node, timeout_sec=0.05)
    far = {name: measured[name] - place for name, place in zip(names, begin, strict=True)}
    worst = max(far, key=lambda name: abs(far[name]))
    if abs(far[worst]) <= NEAR_RAD:
        return ""
    return f"{worst} is {far[worst]:+.3f} away from where the plan begins; move the robot there first"


def _result(node, future):
    rclpy.spin_until_future_complete(node, future)
    return future.result()


if __name__ == "__main__":
    sys.exit(send(*sys.argv[1:]) or 0)
