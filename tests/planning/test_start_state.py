"""Where a start is: within an invariant, within Init if the model has one, and by how much it may miss them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning_examples import DOOR_SHUT, door_problem

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.region import Region, above, box
from micah_plan.errors import InputError
from micah_plan.task.start import Start, sample_start, start_mode


def with_init(*regions: tuple[str, Region]) -> HybridAutomaton:
    return replace(door_problem(0.2, 0.6).automaton, init=regions)


def test_init_narrows_where_a_problem_starts() -> None:
    automaton = with_init(("swings", box([0.5], [0.6], 1, ["door"])), ("swings", box([0.9], [1.0], 1, ["door"])))
    modes = [start_mode(automaton, Start((mean,), (0.02,)))[0] for mean in (0.3, 0.45, 0.55, 0.75, 0.95, DOOR_SHUT)]
    assert modes == [None, "swings", "swings", None, "swings", None]
    assert start_mode(automaton, Start((DOOR_SHUT,), (0.02,), "shut"))[0] is None
    assert start_mode(automaton, Start((0.55,), (0.02,), "swings")) == ("swings", None)


def test_true_starts_are_drawn_within_init() -> None:
    automaton = with_init(("swings", box([0.5], [0.6], 1, ["door"])))
    rng = np.random.default_rng(0)
    drawn = np.array([sample_start(automaton, Start((0.5,), (0.1,)), rng)[1][0] for _ in range(50)])
    assert drawn.min() >= 0.5
    assert drawn.max() <= 0.6
    assert np.ptp(drawn) > 0.05
    with pytest.raises(InputError, match="is in the range of no mode"):
        sample_start(automaton, Start((0.2,), (0.01,)), rng)


@pytest.mark.parametrize("weight", [1e-9, 1.0, 1e9])
def test_standard_deviations_count_however_a_limit_is_scaled(weight: float) -> None:
    automaton = door_problem(0.2, 0.6).automaton
    limit = replace(above(0, 0.5 * weight, 1, 1), a=(weight,))
    swings = replace(automaton.modes[0], invariant=Region((limit,)))
    lone = replace(automaton, modes=(swings,), edges=())
    modes = [start_mode(lone, Start((mean,), (0.01,)))[0] for mean in (0.46, 0.48, 0.5)]
    assert modes == [None, "swings", "swings"]
