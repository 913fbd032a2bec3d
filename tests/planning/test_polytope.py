"""Convex sets of states."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.automaton.region import HalfSpace, Region, above, below, box, input_above
from micah_plan.planning.no_way import NoWayError
from micah_plan.planning.search.polytope import Polytope

NAMES = ["x", "y"]
UNIT = Polytope(np.zeros(2), np.ones(2), np.zeros((0, 2)), np.zeros(0))
STEP = np.array([0.1])


def test_box_rows_shrink_the_box() -> None:
    cut = UNIT.intersect(box([0.2, -5.0], [np.inf, 0.7], 1, NAMES), -STEP, STEP)
    np.testing.assert_allclose((cut.lower, cut.upper), ([0.2, 0.0], [1.0, 0.7]))
    assert len(cut.b) == 0


def test_sets_that_touch_keep_their_common_boundary() -> None:
    touching = UNIT.intersect(Region((above(0, 1.0 + 1e-12, 2, 1),)), -STEP, STEP)
    assert not touching.is_empty
    np.testing.assert_allclose(touching.sample(np.random.default_rng(0), 3)[:, 0], 1.0)
    assert UNIT.intersect(Region((above(0, 1.0 + 1e-6, 2, 1),)), -STEP, STEP).is_empty


def test_input_rows_ask_for_an_input_within_the_limits() -> None:
    assert not UNIT.intersect(Region((input_above(0, 0.09, 2, 1),)), -STEP, STEP).is_empty
    assert UNIT.intersect(Region((input_above(0, 0.11, 2, 1),)), -STEP, STEP).is_empty
    both = UNIT.intersect(Region((HalfSpace((1.0, 0.0), (2.0,), 0.5),)), -STEP, STEP)
    assert both.lower[0] == pytest.approx(0.3)


def test_oblique_half_spaces_by_linear_programme() -> None:
    triangle = UNIT.intersect(Region((HalfSpace((1.0, 1.0), (0.0,), 1.5),)), -STEP, STEP)
    assert not triangle.is_empty
    points = triangle.sample(np.random.default_rng(1), 50)
    assert triangle.contains(points).all()
    assert points.std(axis=0).min() > 0.05
    np.testing.assert_allclose(np.abs(triangle.nearest(np.zeros(2))).sum(), 1.5)
    assert triangle.intersect(Region((HalfSpace((-1.0, -1.0), (0.0,), -1.0),)), -STEP, STEP).is_empty


@settings(max_examples=50)
@given(
    st.lists(st.tuples(*[st.floats(-1, 1, allow_subnormal=False)] * 3), max_size=3), st.tuples(*[st.floats(-2, 3)] * 2)
)
def test_samples_and_nearest_lie_inside_and_emptiness_agrees_with_a_grid(rows, point) -> None:  # type: ignore[no-untyped-def]
    region = Region(tuple(HalfSpace((a, b), (0.0,), c) for a, b, c in rows))
    cut = UNIT.intersect(region, -STEP, STEP)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 21)] * 2), axis=-1).reshape(-1, 2)
    inside = region.contains(grid, np.zeros((len(grid), 1)))
    if inside.any():
        assert not cut.is_empty
    if not cut.is_empty:
        nearest = cut.nearest(np.array(point))
        tolerance = 1e-6
        assert region.contains(cut.sample(np.random.default_rng(0), 5), np.zeros((5, 1)), tolerance).all()
        assert region.contains(nearest, np.zeros(1), tolerance)
        if inside.any():
            closest = np.abs(grid[inside] - point).sum(axis=1).min()
            assert np.abs(nearest - point).sum() <= closest + 1e-6


def test_below_and_above_are_closed() -> None:
    middle = UNIT.intersect(Region((above(1, 0.5, 2, 1), below(1, 0.5, 2, 1, strict=True))), -STEP, STEP)
    np.testing.assert_allclose(middle.nearest(np.zeros(2)), [0.0, 0.5])


def test_of_an_empty_set_no_state_is_the_nearest() -> None:
    """A belief may lie where its mode has no state: then there is no new plan; `execute` ended there with an error."""
    rows = np.array([[1.0, 1.0], [-1.0, -1.0]])
    empty = Polytope(np.zeros(2), np.ones(2), rows, np.array([1.5, -1.4]))
    with pytest.raises(NoWayError, match="no state of the mode lies within the limits"):
        empty.nearest(np.array([2.0, 0.3]))
