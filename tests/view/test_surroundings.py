"""The scene and the arm on the page of a plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from micah_plan.automaton.hybrid import Primitive
from micah_plan.documents.problem import load_problem
from micah_plan.task.body import Body, Hull
from micah_plan.task.plan import ArmTrajectory, Plan
from micah_plan.task.problem import Problem
from micah_plan.view.camera import viewing_direction
from micah_plan.view.scene import DrawnScene
from micah_plan.view.surroundings import arm_facts, arm_legend, body_boxes, draw_arm, draw_bodies

CUBE = tuple((x, y, z) for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1))


@pytest.fixture(scope="module")
def problem(repository: Path) -> Problem:
    return load_problem(repository / "problems" / "microwave_close_by_arm.yaml")


def trajectory(positions: np.ndarray) -> ArmTrajectory:
    return ArmTrajectory(
        ("j",) * 7, positions, np.array([0.1, 0.05]), (0.02, 0.01), 0.0094, ("hand", "table"), 0, 0.001
    )


class Watched(DrawnScene):
    """A scene that remembers how things move."""

    def __init__(self) -> None:
        super().__init__()
        self.moved: dict[str, np.ndarray] = {}

    def animate(self, path: str, times: np.ndarray, poses: RigidTransform, *, scales: np.ndarray | None = None) -> None:
        self.moved[path] = poses.as_matrix()
        super().animate(path, times, poses, scales=scales)


def test_the_arm_moves_straight_in_the_joints(problem: Problem) -> None:
    from micah_plan.robot.load_arm import load_arm

    assert problem.robot is not None
    arm = load_arm(problem.robot)
    start, end = arm.rest, arm.rest + 0.3
    scene = Watched()
    draw_arm(scene, problem, trajectory(np.stack([start, end])), np.array([0.0, 2.0]), np.array([0.0, 0.5, 2.0]))
    assert set(scene.moved) == {f"robot/{joint}" for joint in range(1, 8)}
    expected = [arm.joint_matrices(start + share * (end - start))[7] for share in (0.0, 0.25, 1.0)]
    np.testing.assert_allclose(scene.moved["robot/7"], expected, atol=1e-12)
    lower, upper = scene.bounds()
    tool = arm.matrix(start)[:3, 3]
    assert np.all(lower < tool + 0.1)
    assert np.all(tool - 0.1 < upper)


def test_bodies_are_drawn_and_far_ends_need_not_be_seen() -> None:
    scene = DrawnScene()
    scene.reserve(np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]]))
    floor = Body("floor", (Primitive("box", (100.0, 100.0, 0.1), (0.0, 0.0, -0.55)), Hull(CUBE)))
    draw_bodies(scene, [floor])
    lower, upper = scene.bounds()
    assert upper.max() < 1.0
    assert lower.min() > -1.0
    boxes = body_boxes([floor])
    np.testing.assert_allclose(boxes[0], [[-50, -50, -0.6], [50, 50, -0.5]])
    np.testing.assert_allclose(boxes[1], [[-0.1] * 3, [0.1] * 3])
    assert len(scene.encoded()) >= 3


def test_the_camera_does_not_look_through_a_wall() -> None:
    motion = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.5, 0.2, 0.0]])
    free = viewing_direction(motion, np.array([0.2, 0.0, 0.0]), 0.5)
    side = float(np.sign(free[1]))
    wall = np.array([[[-5.0, side * 0.5 - 0.01, -5.0], [5.0, side * 0.5 + 0.01, 5.0]]])
    around = viewing_direction(motion, np.array([0.2, 0.0, 0.0]), 0.5, wall)
    assert np.sign(around[1]) != side
    behind = wall - np.array([0.0, side * 10.0, 0.0])
    np.testing.assert_array_equal(viewing_direction(motion, np.array([0.2, 0.0, 0.0]), 0.5, behind), free)


def test_facts_and_legend_mention_the_arm(problem: Problem) -> None:
    plan = Plan("solved", "found", arm=trajectory(np.zeros((2, 7))))
    facts = dict(arm_facts(plan))
    assert facts["Least clearance"].endswith("between hand and table")
    assert facts["Least manipulability"] == "0.05"
    assert [entry.layer for entry in arm_legend(plan, problem)] == ["scene", "robot"]
    assert arm_facts(replace(plan, arm=None)) == []
    assert arm_legend(replace(plan, arm=None), replace(problem, scene=())) == []
