"""Cameras that see everything, joints drawn where they are, grids that suit the object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from view_objects import HINGE, cabinet

from micah_plan.automaton.joint import Joint
from micah_plan.recording.read import read_recording
from micah_plan.view.camera import camera
from micah_plan.view.drawing import circle, draw_ground, reach
from micah_plan.view.placement import joint_axis, joint_curve
from micah_plan.view.recording_page import recording_page
from micah_plan.view.scene import DrawnScene

length = st.floats(0.005, 3.0)


@given(st.tuples(length, length, length), st.integers(0, 1000), st.sampled_from([1, 2, 20]))
def test_the_camera_sees_every_corner(size: tuple[float, float, float], seed: int, points: int) -> None:
    scene = DrawnScene()
    motion = np.random.default_rng(seed).uniform(0, 1, (points, 3)) * size
    scene.reserve(np.array([np.zeros(3), size]))
    view = camera(scene, motion)
    position, target = np.array(view["position"]), np.array(view["target"])
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0, 0, 1.0]) / np.linalg.norm(np.cross(forward, [0, 0, 1.0]))
    up = np.cross(right, forward)
    corners = np.array(np.meshgrid(*[(0, s) for s in size])).reshape(3, -1).T - position
    depth = corners @ forward
    assert depth.min() > float(str(view["near"]))
    limit = np.tan(np.radians(float(str(view["angle"]))) / 2)
    assert np.abs(corners @ right / depth).max() <= limit
    assert np.abs(corners @ up / depth).max() <= limit


@pytest.mark.parametrize(("span", "spacing"), [(0.03, 0.005), (0.3, 0.05), (1.0, 0.2), (40.0, 5.0)])
def test_grid_lines_have_round_spacing_that_suits_the_object(span: float, spacing: float) -> None:
    scene = DrawnScene()
    scene.reserve(np.array([np.zeros(3), [span, 0, 0]]))
    assert draw_ground(scene) == pytest.approx(spacing)


def test_an_empty_scene_and_a_single_point_can_be_looked_at() -> None:
    for scene in (DrawnScene(), DrawnScene()):
        assert draw_ground(scene) > 0
        assert np.isfinite(camera(scene, np.zeros((1, 3)))["position"]).all()
        scene.reserve(np.ones((1, 3)))


def test_joint_curves_are_arc_helix_line_and_point() -> None:
    arc = joint_curve(HINGE, 0.0, 1.0)
    np.testing.assert_allclose(np.hypot(*arc[:, :2].T), 0.3)
    spiral = Joint("screw", HINGE.position, axis=HINGE.axis, center=HINGE.center, pitch=0.05)
    np.testing.assert_allclose(joint_curve(spiral, 0.0, 2.0)[-1, 2] - 0.1, -0.1, atol=1e-12)
    line = joint_curve(Joint("prismatic", (0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0)), -0.1, 0.2)
    np.testing.assert_allclose(line, [[0, -0.1, 0], [0, 0.2, 0]], atol=1e-12)
    assert joint_curve(Joint("rigid", (1.0, 2.0, 3.0)), 0.0, 1.0).tolist() == [[1.0, 2.0, 3.0]]


def test_the_axis_passes_through_the_centre_and_rigid_has_none() -> None:
    ends = joint_axis(HINGE, 0.4)
    assert ends is not None
    np.testing.assert_allclose(ends.mean(axis=0), HINGE.center, atol=1e-12)
    np.testing.assert_allclose(ends[1] - ends[0], 0.4 * np.array(HINGE.axis))
    assert joint_axis(Joint("rigid", (0.0, 0.0, 0.0)), 1.0) is None


def test_a_circle_is_round_closed_and_normal_to_its_axis() -> None:
    normal = np.array([0.6, 0.0, 0.8])
    points = circle(np.ones(3), normal, 0.2)
    np.testing.assert_allclose(np.linalg.norm(points - 1, axis=1), 0.2)
    np.testing.assert_allclose((points - 1) @ normal, 0.0, atol=1e-12)
    np.testing.assert_allclose(points[0], points[-1], atol=1e-12)


def test_reach_is_the_longest_way_between_two_positions() -> None:
    automaton = cabinet()
    assert reach(automaton, 0) == pytest.approx(2 * 0.3 * np.sin(0.75))  # the chord of 1.5 rad
    assert reach(automaton, 1) == pytest.approx(0.25)


@pytest.mark.parametrize("name", ["microwave_with_grasp", "stapler", "drawer_no_grasp"])
def test_measured_recordings_become_pages(name: str, shared_data: Path) -> None:
    recording = read_recording(shared_data / "demonstrations" / f"{name}.csv")
    page = recording_page(recording, title=name)
    assert f"<h1>{name}</h1>" in page
    assert f"<dd>{len(recording)}</dd>" in page
