"""What half-spaces, regions and modes say of themselves."""

from __future__ import annotations

import numpy as np
import pytest
from automaton_examples import SHUT, cabinet, door

from micah_plan.automaton.hybrid import Reset, Tie
from micah_plan.automaton.region import HalfSpace, Region, above, below, input_above
from micah_plan.errors import InputError

UP, DOWN, PULL = above(0, 1.0, 2, 1), below(0, 1.0, 2, 1), input_above(0, 0.1, 2, 1)


def test_they_depend_on_states_or_inputs() -> None:
    assert [(h.on_state, h.on_input) for h in (UP, PULL)] == [(True, False), (False, True)]
    assert (Region((UP, PULL)).on_state, Region((UP, PULL)).on_input) == (True, True)
    assert (Region().on_state, Region().on_input) == (False, False)


def test_half_spaces_face_each_other_if_they_open_in_opposite_directions() -> None:
    assert UP.faces(DOWN)
    assert UP.faces(HalfSpace((-2.0, 0.0), (0.0,), 3.0))
    assert not UP.faces(UP)
    assert not UP.faces(above(1, 1.0, 2, 1))
    assert not PULL.faces(PULL)


@pytest.mark.parametrize(("at", "excluded"), [(0.5, True), (1.0, True), (1.5, False)])
def test_they_exclude_each_other_if_they_overlap_in_no_more_than_a_boundary(at: float, excluded: bool) -> None:
    other = HalfSpace((-2.0, 0.0), (0.0,), -2.0 * at)
    assert UP.excludes(other) == other.excludes(UP) == excluded
    assert not UP.excludes(UP)


def test_a_threshold_moves_and_the_rest_stays() -> None:
    assert UP.moved(0.25).bound == (0, 1.25, True)
    assert (UP.moved(0.25).a, UP.moved(0.25).name) == (UP.a, UP.name)


def test_a_region_that_nothing_changes_is_itself() -> None:
    region = Region((UP, PULL))
    assert region.mapped(lambda h: h) is region
    assert region.mapped(lambda h: h.moved(1.0) if h.on_state else h) == Region((UP.moved(1.0), PULL))


def test_modes_say_what_they_pin_and_what_inputs_move() -> None:
    automaton = door()
    assert [mode.free.tolist() for mode in automaton.modes] == [[True], [False]]
    assert [mode.driven.tolist() for mode in automaton.modes] == [[True], [False]]
    for mode in cabinet().modes:
        assert {pin.coordinate for pin in mode.pins} == set(np.flatnonzero(~mode.free).tolist())
        for array in (mode.free, mode.driven, mode.B):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0


def test_modes_are_found_by_name() -> None:
    automaton = cabinet()
    assert [automaton.mode_index(name) for name in automaton.mode_names] == list(range(len(automaton.modes)))
    assert automaton.coordinate_names == tuple(c.name for c in automaton.coordinates)
    with pytest.raises(InputError, match="choose one of"):
        automaton.mode_index("ajar")


def test_a_reset_puts_coordinates_at_values_and_where_ties_say() -> None:
    tie = Tie(2, (0.5, 0.0, 0.0), 0.1)
    reset = Reset.to({1: SHUT}, 3, [tie])
    assert reset.apply(np.array([0.4, 7.0, 7.0]), np.zeros(1)) == pytest.approx([0.4, SHUT, 0.3])
    assert reset.apply(np.array([[0.4, 7.0, 7.0]]), np.zeros((1, 1)))[0, 2] == pytest.approx(
        float(tie.value(np.array([0.4, 0.0, 0.0])))
    )
