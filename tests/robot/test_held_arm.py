"""An arm that presses a held stapler on the table: where the parts really are, what may touch, and the joints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from micah_plan.documents.problem import load_problem
from micah_plan.robot.along_plan import arm_along, problem_clearance, tool_path
from micah_plan.robot.tool_path import ArmFailure, follow
from micah_plan.task.body import corners
from micah_plan.task.contact_poses import settled_poses, touching_pairs
from micah_plan.task.plan import ArmTrajectory, Trajectory
from micah_plan.task.problem import Problem

ROOT = Path(__file__).resolve().parents[2]
LATCH = 0.5735


@cache
def stapler() -> Problem:
    return load_problem(ROOT / "problems" / "stapler_on_books.yaml")


def pressed() -> Trajectory:
    """Down to the table with the mean of the joint left behind, shut, up again and in under the shelf."""
    down = np.linspace([-0.1, 0.0, 0.25, 0.2], [0.02, 0.0, 0.065, 0.2], 11)
    shut = np.linspace([0.03, 0.0, 0.063, 0.54], [0.05, 0.0, 0.055, 0.63], 3)
    up = np.linspace([0.05, 0.0, 0.06, LATCH], [0.23, 0.0, 0.278, LATCH], 13)
    into = np.linspace([0.25, 0.0, 0.279, LATCH], [0.45, 0.0, 0.288, LATCH], 11)
    means = np.concatenate([down, shut, up, into])
    modes = ("free",) * 11 + ("surface",) * 3 + ("rigid",) * 24
    count = len(means)
    zeros = np.zeros((count - 1, 3))
    return Trajectory(
        modes, means, np.zeros((count, 4, 4)), zeros, np.zeros((count - 1, 3, 4)), np.zeros(count - 1, dtype=bool)
    )


def test_no_part_is_drawn_inside_the_table() -> None:
    problem, trajectory = stapler(), pressed()
    assert problem.hold is not None
    lowest, raw, touched = [], [], []
    for mode, x in zip(trajectory.modes, trajectory.means, strict=True):
        poses = settled_poses(problem, mode, x)
        points = corners(problem.hold.grip.moving.shapes[0])
        lowest.append(poses["lower_arm"].apply(points)[:, 2].min())
        touched.append(touching_pairs(problem, poses))
        # The hand is where it is believed to be, but no lower than the shut object stops it.
        stopped = problem.automaton.mode("rigid").interval(2)[0]
        hand = [*x[:2], x[2] if mode == "rigid" else max(x[2], stopped)]
        np.testing.assert_allclose(poses["hand"].translation, hand, atol=1e-9)
        # The hand's point stays on the held part, however that turns.
        np.testing.assert_allclose(poses["upper_arm"].apply(problem.hold.grip.point), hand, atol=1e-9)
        raw.append(poses["upper_arm"].rotation.magnitude())
    assert min(lowest) > -0.0015  # the chords of the contact model
    first, last = 8, 14
    assert all(touched[k] == {("lower_arm", "table")} for k in range(first + 1, last + 1))
    assert not any(touched[:first])
    assert not any(touched[last + 2 :])
    assert raw[last] < 1e-3  # flat where it latches
    assert raw[0] == pytest.approx(0.12)
    assert raw[-1] == pytest.approx(0.12)


def test_poses_of_an_object_that_stands_are_those_of_its_mode() -> None:
    drawer = load_problem(ROOT / "problems" / "drawer_close.yaml")
    mode = drawer.automaton.modes[0]
    poses = settled_poses(drawer, mode.name, np.array([0.1]))
    assert touching_pairs(drawer, poses) == frozenset()
    assert set(poses) == {link.child for link in drawer.automaton.links}


@pytest.mark.slow
def test_the_arm_presses_and_carries_without_other_contacts() -> None:
    problem, trajectory = stapler(), pressed()
    found = arm_along(problem, trajectory)
    assert isinstance(found, ArmTrajectory)
    assert problem.grasp is not None
    assert found.least_clearance is not None
    assert found.least_clearance > 0.003
    assert np.abs(np.diff(found.positions, axis=0)).max() < 0.6
    arm = problem_clearance(problem).arm
    for q, mode, x in zip(found.positions, trajectory.modes, trajectory.means, strict=True):
        hand = settled_poses(problem, mode, x)["hand"].translation
        np.testing.assert_allclose(arm.matrix(q)[:3, 3], hand + problem.grasp.position, atol=1e-6)


@pytest.mark.slow
def test_contact_that_is_not_intended_is_a_collision() -> None:
    problem, trajectory = stapler(), pressed()
    path = tool_path(problem, trajectory.modes, trajectory.means)
    found = follow(problem_clearance(problem), replace(path, touching=None))
    assert isinstance(found, ArmFailure)
    assert set(found.names) == {"lower_arm", "table"}
    low = replace(
        problem, scene=tuple(b if b.name != "shelf" else replace(b, position=(0.475, 0.0, 0.30)) for b in problem.scene)
    )
    found = arm_along(low, trajectory)
    assert isinstance(found, ArmFailure)
    assert "shelf" in found.names
