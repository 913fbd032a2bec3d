"""Where parts are, over which range they move and how uncertain a belief leaves them."""

from __future__ import annotations

import numpy as np
import pytest
from view_objects import HINGE, OPEN_AT, cabinet, door

from micah_plan.automaton.hybrid import Edge
from micah_plan.automaton.kinematics import forward, jacobian, part_poses
from micah_plan.automaton.region import HalfSpace, Region, above
from micah_plan.view.drawing import base_shapes, moving_shapes, shape_corners
from micah_plan.view.placement import (
    chain_coordinates,
    coordinate_range,
    ellipsoid,
    handle_in_part,
    handle_jacobian,
    representative_state,
    thresholds,
)


def test_a_chain_of_links_multiplies_poses() -> None:
    automaton = cabinet()
    mode = automaton.modes[0]
    x = np.array([0.7, 0.1])
    poses = part_poses(automaton, mode, x)
    expected = forward(mode.joints[0], 0.7)[0] * forward(mode.joints[1], 0.1)[0]
    np.testing.assert_allclose(poses["drawer"].as_matrix(), expected.as_matrix(), atol=1e-12)
    assert chain_coordinates(automaton, "drawer") == (0, 1)
    assert chain_coordinates(automaton, "door") == (0,)
    assert chain_coordinates(automaton, "base") == ()


def test_handle_jacobian_of_a_single_joint_is_the_joints_own() -> None:
    automaton = door(handle=None)
    found = handle_jacobian(automaton, automaton.mode("swinging"), np.array([0.6]), "door")
    np.testing.assert_allclose(found[:, 0], jacobian(HINGE, 0.6)[0, 3:], atol=1e-8)


def test_the_handle_is_where_the_part_holds_it() -> None:
    automaton = door(handle=(0.01, -0.03, 0.05))
    mode = automaton.mode("swinging")
    at_zero = part_poses(automaton, mode, np.zeros(1))["door"].apply(handle_in_part(automaton, "door"))
    np.testing.assert_allclose(at_zero, np.add(HINGE.position, (0.01, -0.03, 0.05)), atol=1e-12)


def test_range_comes_from_the_invariant_then_from_clamps_and_guards() -> None:
    automaton = door()
    assert coordinate_range(automaton, automaton.mode("swinging"), 0) == (0.0, OPEN_AT, True)
    assert coordinate_range(cabinet(), cabinet().modes[0], 1) == (0.0, 0.25, True)  # from its clamps
    lower, upper, stated = coordinate_range(automaton, automaton.mode("stopped"), 0)
    assert (lower, stated) == (OPEN_AT, False)
    assert upper > lower


def test_representative_state_lies_in_the_mode() -> None:
    automaton = door()
    for mode in automaton.modes:
        x = representative_state(automaton, mode)
        assert mode.invariant.contains(x, np.zeros(1))
    assert representative_state(automaton, automaton.mode("stopped"))[0] == OPEN_AT


def test_thresholds_are_the_guards_between_modes_each_once() -> None:
    marks = thresholds(door())
    assert [(m.source, m.target, m.coordinate, m.value) for m in marks] == [("swinging", "stopped", 0, OPEN_AT)]


def test_guards_on_inputs_or_on_sums_of_coordinates_are_no_threshold() -> None:
    automaton = door()
    push = Edge("stopped", "swinging", Region((HalfSpace((0.0,), (-1.0,), 0.01),)))
    tilted = Edge("stopped", "swinging", Region((HalfSpace((1.0,), (1.0,), 0.5),)))
    scaled = Edge("stopped", "swinging", Region((HalfSpace((2.0,), (0.0,), 0.5),)))
    changed = type(automaton)(**{**automaton.__dict__, "edges": (push, tilted, scaled)})
    assert [mark.value for mark in thresholds(changed)] == [0.25]
    assert above(0, 0.25, 1, 1).c == 0.25


def test_ellipsoid_bounds_the_requested_share_of_samples() -> None:
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(3, 3))
    axes, radii = ellipsoid(factor @ factor.T, 2.0, 0.0)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(axes @ np.diag((radii / 2.0) ** 2) @ axes.T, factor @ factor.T, atol=1e-9)
    samples = rng.normal(size=(20_000, 3)) @ factor.T
    inside = (((samples @ axes) / radii) ** 2).sum(axis=1) <= 1
    assert inside.mean() == pytest.approx(0.7385, abs=0.015)  # chi-square with 3 degrees of freedom at 2²


def test_a_flat_ellipsoid_is_drawn_with_the_floor() -> None:
    _, radii = ellipsoid(np.diag([0.01, 0.0, 0.0]), 2.0, 0.003)
    np.testing.assert_allclose(sorted(radii), [0.003, 0.003, 0.2])


def test_the_default_panel_reaches_from_the_axis_to_the_parts_origin() -> None:
    for angle in (0.0, 1.0):
        pose = forward(HINGE, angle)[0]
        corners = shape_corners(moving_shapes(HINGE, 0.3), pose)
        radial = (corners - HINGE.center) @ (pose.translation - HINGE.center) / 0.3
        assert radial.min() == pytest.approx(0.0, abs=1e-9)
        assert radial.max() == pytest.approx(0.3)


@pytest.mark.parametrize("link", [0, 1])
def test_default_shapes_have_a_size_for_every_joint(link: int) -> None:
    joint = cabinet().modes[0].joints[link]
    for shape in (*moving_shapes(joint, 0.2), *base_shapes(joint, 0.2)):
        assert min(shape.size) > 0
