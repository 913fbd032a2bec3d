"""Robots that the tests use: the shipped arm, and small ones made on the spot."""

from __future__ import annotations

from pathlib import Path

from micah_plan.robot.arm import Arm
from micah_plan.robot.load_arm import describe_robot, load_arm
from micah_plan.task.robot_description import RobotDescription

ARM7 = Path(__file__).resolve().parents[2] / "models" / "robots" / "arm7.urdf"

# A slider that carries a wheel: joints of three kinds, axes that are not along x, y or z.
SLIDER = """<robot name="slider">
  <link name="rail"><collision><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
  <link name="cart"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="wheel"><collision><geometry><cylinder radius="0.2" length="0.05"/></geometry></collision></link>
  <link name="finger"/>
  <joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/>
    <origin xyz="0 0 0.3" rpy="0.1 -0.2 0.3"/><axis xyz="0.6 0 0.8"/><limit lower="-0.4" upper="0.5"/></joint>
  <joint name="turn" type="continuous"><parent link="cart"/><child link="wheel"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.4 0 0"/><axis xyz="0.48 0.64 0.6"/></joint>
  <joint name="tip" type="fixed"><parent link="wheel"/><child link="finger"/><origin xyz="0 0.2 0"/></joint>
</robot>
"""

# The same kind of thing in MuJoCo's format, with one joint that does not belong to the arm.
TWO_LINKS = """<mujoco model="two_links">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 0.5" quat="0.8 0.6 0 0">
      <inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
      <joint name="shoulder" type="hinge" axis="0 0.6 0.8" range="-2 2"/>
      <geom type="capsule" size="0.05 0.1" pos="0 0 0.1"/>
      <body name="lower" pos="0.1 0 0.3">
        <inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
        <joint name="elbow" type="hinge" axis="1 0 0" range="-1 2"/>
        <geom type="box" size="0.03 0.04 0.1" pos="0 0 0.15"/>
        <body name="jaw" pos="0 0 0.3">
          <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
          <joint name="grip" type="slide" axis="1 0 0" range="0 0.04"/>
          <geom type="sphere" size="0.01"/>
        </body>
        <site name="tool" pos="0 0.02 0.3" quat="0.6 0 0.8 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def arm7(position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Arm:
    return load_arm(describe_robot(ARM7, "tool", position))


def described(text: str, tool: str, **options: object) -> RobotDescription:
    return RobotDescription("robot.xml", text, tool, **options)  # type: ignore[arg-type]
