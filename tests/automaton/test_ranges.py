"""What half-spaces and pins leave of one coordinate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import SHUT, cabinet, door, guard

from micah_plan.automaton.region import HalfSpace, Region

INF = float("inf")


@pytest.mark.parametrize(
    ("half_space", "expected"),
    [
        (HalfSpace((0.0, 2.0), (0.0,), 3.0), (1, 1.5, True)),
        (HalfSpace((-2.0, 0.0), (0.0,), 3.0), (0, -1.5, False)),
        (HalfSpace((1.0, 1.0), (0.0,), 3.0), None),
        (HalfSpace((1.0, 0.0), (1.0,), 3.0), None),
        (HalfSpace((0.0, 0.0), (1.0,), 3.0), None),
    ],
)
def test_a_half_space_bounds_one_coordinate_or_none(
    half_space: HalfSpace, expected: tuple[int, float, bool] | None
) -> None:
    assert half_space.bound == expected


def test_the_tightest_bounds_count_and_coupled_ones_do_not() -> None:
    region = guard(([1, 0], [0], 0.0), ([2, 0], [0], 1.0), ([-1, 0], [0], -3.0), ([-1, -1], [0], 0.0))
    assert region.interval(0) == (0.5, 3.0)
    assert region.interval(1) == (-INF, INF)


def test_a_mode_allows_its_pin_or_its_invariant() -> None:
    assert door().modes[0].interval(0) == (0.0, SHUT)
    assert door().modes[1].interval(0) == (SHUT, SHUT)


def test_ranges_of_modes_are_joined_and_ordered() -> None:
    for index in range(2):
        (found,) = cabinet().ranges(index)
        assert found == (min(m.interval(index)[0] for m in cabinet().modes),
                         max(m.interval(index)[1] for m in cabinet().modes))  # fmt: skip
    swings = door().modes[0]
    apart = replace(swings, invariant=guard(([1], [0], 2.0), ([-1], [0], -3.0)))
    nothing = replace(swings, invariant=guard(([1], [0], 5.0), ([-1], [0], -4.0)))
    assert door().ranges(0, (apart, nothing, swings)) == [(0.0, SHUT), (2.0, 3.0)]
    assert door().ranges(0, (replace(swings, invariant=Region()), apart)) == [(-np.inf, np.inf)]
