"""An arm carries the held object in MuJoCo: its own joints, motors and limits; what is loose can fall; plans ask it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from extras import requires

from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.held import HeldPlant
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.execution.pilot import Pilot, Replanning
from micah_plan.execution.plant import Command
from micah_plan.robot.along_plan import arm_along, start_posture
from micah_plan.robot.load_arm import load_arm
from micah_plan.robot.tool_path import ArmFailure
from micah_plan.task.plan import ArmTrajectory, Trajectory

pytestmark = requires("sim")

PROBLEM = Path(__file__).resolve().parents[2] / "problems" / "stapler_on_books.yaml"
EFFORT = np.array([90.0, 90.0, 90.0, 90.0, 20.0, 20.0, 20.0])  # as arm7.urdf says


@pytest.fixture(scope="module")
def problem():
    return load_problem(PROBLEM)


@pytest.fixture(scope="module")
def arm(problem):
    return load_arm(problem.robot)


@pytest.fixture(scope="module")
def posture(problem):
    return start_posture(problem)


@pytest.fixture(scope="module")
def plant(problem, posture):
    machine = HeldPlant(problem, posture=posture)
    yield machine
    machine.close()


def move(plant, u, posture=None):
    return plant.apply(Command(np.array(u), np.zeros((5, 3)), np.zeros((5, 3)), posture))


@pytest.mark.slow
def test_the_hand_is_where_the_joints_put_it(plant, problem, arm):
    """MuJoCo's reading of the robot's file agrees with Pinocchio's."""
    measured = plant.reset(np.random.default_rng(1))
    for u in ([0.02, 0.0, 0.01], [0.0, -0.03, 0.0]):
        measured = move(plant, u)
        tool = arm.matrix(measured.joints)
        hand = tool @ problem.grasp.pose.inv().as_matrix()
        np.testing.assert_allclose(plant.truth().x[:3], hand[:3, 3], atol=1e-9)
        np.testing.assert_allclose(hand[:3, :3], np.eye(3), atol=2e-3)  # it keeps its orientation


def test_the_hand_follows_its_command(plant):
    plant.reset(np.random.default_rng(2))
    for u in ([0.03, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, 0.03], [-0.02, -0.02, -0.02]):
        before = plant.truth().x[:3]
        move(plant, u)
        np.testing.assert_allclose(plant.truth().x[:3] - before, u, atol=5e-4)


def test_what_freedom_is_left_goes_to_the_posture_of_the_plan(plant, arm):
    joints = plant.reset(np.random.default_rng(3)).joints
    place = plant.truth().x[:3]
    wish = joints + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    jacobian = arm.jacobian(joints)
    reachable = (np.eye(7) - np.linalg.pinv(jacobian) @ jacobian) @ (wish - joints)
    after = move(plant, [0.0, 0.0, 0.0], wish).joints
    assert np.linalg.norm(reachable) > 0.02
    np.testing.assert_allclose(after - joints, reachable, atol=0.02)
    np.testing.assert_allclose(plant.truth().x[:3], place, atol=1e-3)


def test_no_motor_gives_more_than_the_file_of_the_robot_says(plant, arm):
    plant.reset(np.random.default_rng(4))
    motors = [int(plant.model.joint(f"robot/{name}").dofadr[0]) for name in arm.joints]
    most = np.zeros(7)
    for _ in range(16):
        move(plant, [0.0, 0.0, -0.03])
        most = np.maximum(most, np.abs(plant.data.qfrc_actuator[motors]))
    assert (most <= EFFORT + 1e-9).all()
    assert most.max() > 0.5 * EFFORT.min()  # it pressed hard on the table


def test_out_of_reach_is_reported(plant):
    plant.reset(np.random.default_rng(5))
    for _ in range(8):
        move(plant, [-0.2, 0.1, 0.2])
    assert "the arm's tool could get no nearer than" in plant.truth().incident


def test_an_arm_in_the_way_of_the_swinging_part_is_reported(problem, posture):
    low = replace(problem, grasp=replace(problem.grasp, position=(-0.03, 0.0, -0.055)))
    plant = HeldPlant(low, posture=posture)
    plant.reset(np.random.default_rng(10))
    move(plant, [0.0, 0.0, 0.0])
    assert plant.truth().incident.startswith("the arm's ")
    assert " hit 'lower_arm' at " in plant.truth().incident
    plant.close()


def test_joints_that_do_not_move_the_tool_stay(problem, posture):
    robot = problem.robot
    sliding = (
        '<joint name="left_finger_mount" type="prismatic"><axis xyz="0 1 0"/><limit lower="-0.01" upper="0.02" '
        'velocity="1" effort="5"/>'
    )
    text = robot.text.replace('<joint name="left_finger_mount" type="fixed">', sliding)
    fingered = replace(problem, robot=replace(robot, text=text, locked=(("left_finger_mount", 0.006),)))
    plant = HeldPlant(fingered, posture=posture)
    plant.reset(np.random.default_rng(6))
    move(plant, [0.0, 0.03, 0.03])
    assert plant.data.joint("robot/left_finger_mount").qpos[0] == pytest.approx(0.006, abs=1e-4)
    plant.close()


def test_meshes_are_the_hulls_that_planning_has_in_formats_that_mujoco_does_not_read(problem, posture, tmp_path):
    corners = [(x, y, z) for x in (-0.025, 0.025) for y in (-0.095, 0.095) for z in (-0.03, 0.03)]
    faces = ("0 1 3 2", "4 6 7 5", "0 4 5 1", "2 3 7 6", "0 2 6 4", "1 5 7 3")
    lines = ["OFF", "8 6 0", *(f"{x} {y} {z}" for x, y, z in corners), *(f"4 {face}" for face in faces)]
    (tmp_path / "palm.off").write_text("\n".join(lines) + "\n")
    before, box, after = problem.robot.text.rpartition('<box size="0.05 0.19 0.06"/>')
    robot = replace(problem.robot, text=f'{before}<mesh filename="palm.off"/>{after}', folder=str(tmp_path))
    assert box
    plant = HeldPlant(replace(problem, robot=robot), posture=posture)
    assert plant.model.nmesh == 1
    np.testing.assert_allclose(np.sort(np.abs(plant.model.mesh_vert), axis=None)[-8:], 0.095, atol=1e-6)
    plant.reset(np.random.default_rng(11))
    assert plant.truth().incident == ""
    plant.close()


def test_a_robot_that_mujoco_cannot_use_is_one_line(problem, posture):
    heavy = problem.robot.text.replace('ixx="0.0184682"', 'ixx="-1"')
    with pytest.raises(InputError, match="MuJoCo cannot use the robot"):
        HeldPlant(replace(problem, robot=replace(problem.robot, text=heavy)), posture=posture)


def test_without_a_robot_the_hand_moves_on_slides(problem):
    plant = HeldPlant(replace(problem, robot=None, grasp=None))
    assert plant.reset(np.random.default_rng(7)).joints is None
    before = plant.truth().x[:3]
    move(plant, [0.03, 0.0, 0.01])
    np.testing.assert_allclose(plant.truth().x[:3] - before, [0.03, 0.0, 0.01], atol=5e-4)
    plant.close()


def test_books_stand_until_they_are_pushed_and_then_it_is_reported(problem):
    plant = HeldPlant(replace(problem, robot=None, grasp=None))
    plant.reset(np.random.default_rng(8))
    for _ in range(5):
        move(plant, [0.0, 0.0, 0.0])
    assert plant.truth().incident == ""
    top = plant.model.body("scene/book_4").id
    np.testing.assert_allclose(plant.data.xpos[top], [0.475, 0.0, 0.175], atol=1e-4)
    move(plant, [0.0, 0.0, -0.06])
    for _ in range(14):
        move(plant, [0.03, 0.0, 0.0])
    assert plant.truth().mode == "collided"
    assert "'book_4' was knocked over: at" in plant.truth().incident
    assert plant.data.xpos[top][0] > 0.475 + 0.01
    plant.reset(np.random.default_rng(9))
    assert plant.truth().incident == ""
    plant.close()


def straight(begin, end, knots):
    """A trajectory in which the hand goes straight."""
    means = np.linspace([*begin, 0.2], [*end, 0.2], knots)
    moves = np.diff(means[:, :3], axis=0)
    still = np.zeros((knots, 4, 4)), moves, np.zeros((knots - 1, 3, 4))
    return Trajectory(("free",) * knots, means, *still, np.zeros(knots - 1, dtype=bool))


def test_a_new_plan_starts_where_the_arm_is_or_is_refused(problem, posture):
    begin = np.array(problem.start.mean[:3])
    near, far = (straight(begin, begin + away, 8) for away in ([0.1, 0.0, 0.0], [0.1, 0.0, 1.5]))
    turned = posture + 0.02
    found = arm_along(problem, near, start=turned)
    assert isinstance(found, ArmTrajectory)
    assert np.abs(found.positions[0] - turned).max() < 0.05
    refused = arm_along(problem, far, start=turned)
    assert isinstance(refused, ArmFailure)
    asked = Replanning(ask_arm=lambda trajectory, joints: arm_along(problem, trajectory, start=joints))
    pilot = Pilot(problem, near, found, asked)
    assert not pilot._follow(far, turned)
    assert refused.sentence in pilot.refusals[0]
    assert pilot.posture is found.positions[0] or np.array_equal(pilot.posture, found.positions[0])
    assert pilot._follow(near, turned)
    assert len(pilot.refusals) == 1


def test_a_problem_file_sets_the_parameters_of_a_held_object(problem):
    changed = load_problem(PROBLEM, {"plant.joint_friction": 0.3, "plant.joint_deflection": 0.04, "plant.mass": 0.2})
    stated = parameters_of(changed)
    assert (stated.joint_friction, stated.joint_deflection, stated.mass) == (0.3, 0.04, 0.2)
    assert stated.pivot_stiffness == parameters_of(problem).pivot_stiffness
    with pytest.raises(InputError, match="unknown plant parameter 'latch_force'"):
        parameters_of(load_problem(PROBLEM, {"plant.latch_force": 5.0}))
    with pytest.raises(InputError, match="joint_deflection"):
        replace(stated, joint_deflection=float("nan"))
