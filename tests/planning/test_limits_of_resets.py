"""Ranges of coordinates that nothing bounds reach as far as resets put them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planning_examples import one_dimensional

from micah_plan.automaton.hybrid import Reset
from micah_plan.automaton.region import Region, above
from micah_plan.planning.limits import limits_of
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start


@pytest.mark.parametrize("place", [7.0, -3.0, None])
def test_the_value_of_a_reset_is_within_the_range(place: float | None) -> None:
    automaton = one_dimensional(0.0, 0.5, 1.0)
    first, second = automaton.modes
    second = replace(second, invariant=Region((above(0, 0.5, 1, 1, name="c"),)))
    first = replace(first, invariant=Region(()))
    up, down, *_ = automaton.edges
    down = down if place is None else replace(down, reset=Reset.to({0: place}, 1))
    open_ended = replace(automaton, modes=(first, second), edges=(up, down))
    limits = limits_of(Problem(open_ended, Start((0.2,), (0.01,)), Goal(((0, 0.8, 0.05),))))
    reach = [0.2, 0.8] if place is None else [0.2, 0.8, place]
    assert limits.lower[0] <= min(reach)
    assert max(reach) <= limits.upper[0]
    if place is None:
        assert limits.upper[0] < 2.0, "nothing else is named"
