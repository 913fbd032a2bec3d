"""Meshes that a viewer can draw: closed, of the stated size, and free of NaN."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micah_plan.view.solids import Mesh, arrow, beads, merge, perpendicular, tube


def open_edges(mesh: Mesh) -> int:
    """Edges that do not belong to exactly two triangles."""
    edges = Counter(tuple(sorted((int(face[i]), int(face[(i + 1) % 3])))) for face in mesh.faces for i in range(3))
    return sum(count != 2 for count in edges.values())


coordinate = st.floats(-1, 1).map(lambda value: round(value, 3))


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=8))
def test_a_tube_is_closed_and_stays_within_its_radius_of_the_polyline(points: list[tuple[float, float, float]]) -> None:
    line = np.array(points)
    mesh = tube(line, 0.01)
    assert np.isfinite(mesh.vertices).all()
    assert open_edges(mesh) == 0
    if len(mesh.vertices):
        distance = np.linalg.norm(mesh.vertices[:, None] - line[None], axis=-1).min(axis=1)
        assert distance.max() <= 0.01 + 1e-9


def test_a_tube_without_length_is_empty() -> None:
    assert len(tube(np.zeros((3, 3)), 0.1).faces) == 0
    assert len(arrow(np.ones(3), np.ones(3), 0.1).faces) == 0


def test_a_radius_may_change_where_the_polyline_rests() -> None:
    line = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 1.0]])
    mesh = tube(line, np.array([0.1, 0.3, 0.0]))
    assert np.isfinite(mesh.vertices).all()
    assert np.linalg.norm(mesh.vertices[:, :2], axis=1).max() == pytest.approx(0.3)


def test_an_arrow_points_from_start_to_end() -> None:
    start, end = np.array([0.1, 0.2, 0.3]), np.array([0.5, -0.2, 0.9])
    mesh = arrow(start, end, 0.01)
    along = (mesh.vertices - start) @ (end - start) / np.linalg.norm(end - start) ** 2
    assert along.min() == pytest.approx(0.0, abs=1e-9)
    assert along.max() == pytest.approx(1.0)
    off_axis = np.linalg.norm(np.cross(mesh.vertices - start, end - start), axis=1) / np.linalg.norm(end - start)
    assert along[np.argmax(off_axis)] > 0.5  # the head is at the end
    assert open_edges(mesh) == 0


def test_beads_are_closed_and_centred_on_their_points() -> None:
    points = np.random.default_rng(1).normal(size=(5, 3))
    mesh = beads(points, 0.02)
    assert open_edges(mesh) == 0
    np.testing.assert_allclose(mesh.vertices.reshape(5, 6, 3).mean(axis=1), points, atol=1e-12)


def test_merging_keeps_every_triangle_in_place() -> None:
    first, second = beads(np.zeros((1, 3)), 0.1), beads(np.ones((1, 3)), 0.2)
    both = merge([first, second])
    corners = np.concatenate([first.vertices[first.faces], second.vertices[second.faces]])
    np.testing.assert_array_equal(both.vertices[both.faces], corners)


@given(st.tuples(coordinate, coordinate, coordinate).filter(lambda v: np.linalg.norm(v) > 1e-2))
def test_perpendicular_is_a_unit_vector_at_right_angles(direction: tuple[float, float, float]) -> None:
    across = perpendicular(np.array(direction))
    assert np.linalg.norm(across) == pytest.approx(1.0)
    assert across @ direction == pytest.approx(0.0, abs=1e-12)
