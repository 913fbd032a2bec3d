"""A robot with ROS 2 that holds the handle of a drawer or a door, as a plant: `execute` moves it and looks at the part.

    micah-plan execute plan.json --plant examples/ros2/hand.py:RosPlant -o runs.csv

`parts` has the poses of the parts, in the order of the model's links, as a tracker publishes them; `current_pose` and
`target_frame` are the topics of a Cartesian controller. All are in the base frame of the model. Limits of force and
speed belong into the controller: a plan knows positions only. The tests run this class against a stand-in for rclpy.
"""

import time

import numpy as np
import rclpy
from geometry_msgs.msg import PoseArray, PoseStamped
from rclpy.signals import SignalHandlerOptions

from micah_plan.execution.plant import Measurement, PlantError

STEP_S, TIMEOUT_S = 1.0, 2.0


class RosPlant:
    def __init__(self, problem):
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C ends the execution
        self.node, self.latest = rclpy.create_node("micah_plan"), {}
        for topic, kind in (("parts", PoseArray), ("current_pose", PoseStamped)):
            self.node.create_subscription(kind, topic, lambda m, t=topic: self.latest.update({t: m}), 1)
        self.target = self.node.create_publisher(PoseStamped, "target_frame", 1)

    def reset(self, rng):
        input("Put the object at its start, let the robot hold the handle, and press Enter: ")
        self.begin = time.monotonic()
        return self.measured()

    def apply(self, command):
        target = self.fresh("current_pose")
        target.pose.position.x += float(command.handle[0, 0])
        target.pose.position.y += float(command.handle[0, 1])
        target.pose.position.z += float(command.handle[0, 2])
        self.target.publish(target)
        until = time.monotonic() + STEP_S
        while time.monotonic() < until:
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return self.measured()

    def close(self):  # the controller stays at its last target
        self.node.destroy_node()
        rclpy.shutdown()

    def measured(self):
        poses = self.fresh("parts").poses
        place = [[p.position.x, p.position.y, p.position.z] for p in poses]
        turn = [[p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w] for p in poses]
        return Measurement(time.monotonic() - self.begin, np.array(place), np.array(turn))

    def fresh(self, topic):
        self.latest.pop(topic, None)  # what came before now does not count
        until = time.monotonic() + TIMEOUT_S
        while topic not in self.latest:
            if time.monotonic() > until:
                raise PlantError(f"nothing came on '{topic}' for {TIMEOUT_S:g} s")
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return self.latest[topic]
