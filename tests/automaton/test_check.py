"""Each mistake in an automaton gets one line that says where; what is right passes."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import cabinet, detent, door, guard, two_rails
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.feasibility import is_empty
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Noise, Part, Pin, Reset
from micah_plan.automaton.joint import rigid
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.automaton.sensing import Light
from micah_plan.errors import InputError

IN = guard(([1], [0], 0.0))


def with_mode(**changes: object) -> HybridAutomaton:
    automaton = door()
    return replace(automaton, modes=(replace(automaton.modes[0], **changes), *automaton.modes[1:]))


def with_edge(edge: Edge) -> HybridAutomaton:
    automaton = door()
    return replace(automaton, edges=(*automaton.edges, edge))


def shut(**changes: object) -> HybridAutomaton:
    automaton = door()
    return replace(automaton, modes=(automaton.modes[0], replace(automaton.modes[1], **changes)))


MISTAKES = {
    "mode names must be unique. Got 'rigid' twice": with_mode(name="rigid"),
    "coordinate names must be unique": replace(cabinet(), coordinates=(Coordinate("x", "m"),) * 2),
    "part names must be unique": replace(door(), parts=(Part("door"), Part("door"))),
    "at least one coordinate and one mode": replace(door(), modes=(), edges=()),
    "link to door: coordinate must be 0 to 0. Got -1": replace(door(), links=(Link("base", "door", -1),)),
    "link to door: parent must be base": replace(door(), links=(Link("bsae", "door", 0),)),
    "part door must be the child of one link": replace(
        door(),
        links=(Link("base", "door", 0),) * 2,
        modes=tuple(replace(mode, joints=mode.joints * 2) for mode in door().modes),
    ),
    "mode revolute: input matrix B must be finite": with_mode(input_matrix=((np.nan,),)),
    "mode revolute: invariant must not be empty": with_mode(invariant=guard(([1], [0], 1.0), ([-1], [0], 0.0))),
    "mode revolute: admissible inputs must not be empty": with_mode(inputs=guard(([0], [1], 1.0), ([0], [-2], 0.0))),
    "mode rigid: pinned coordinate must be 0 to 0. Got 1": shut(pins=(Pin(1, 0.0, 0.1),)),
    "mode rigid: B must have a zero row for the pinned coordinate door": shut(input_matrix=((0.5,),)),
    "mode rigid: a pin must have a finite value and a std > 0. Got 1.2, 0.0": shut(pins=(Pin(0, 1.2, 0.0),)),
    "edge rigid -> ajar: unknown mode 'ajar'; choose one of revolute, rigid": with_edge(Edge("rigid", "ajar", IN)),
    "edge ajar -> rigid: unknown mode 'ajar'": with_edge(Edge("ajar", "rigid", IN)),
    "edge rigid -> revolute: a guard must have at least one half-space": with_edge(Edge("rigid", "revolute", Region())),
    "mode rigid: the pin of door, 1.3 rad, lies outside of the mode's invariant [1.17, 1.23]; move": shut(
        pins=(Pin(0, 1.3, 0.01),), joints=(rigid([1.2, 0, 0], fixed_at=1.3),)
    ),
    "mode rigid: the rigid joint of door is fixed at 1.2001 rad, but the pin of door is at 1.2 rad; give": shut(
        joints=(rigid([1.2, 0, 0], fixed_at=1.2001),)
    ),
    "edge revolute -> rigid: enters mode rigid at door = 1, outside of its invariant [1.17, 1.23]; move the guard or "
    "the invariant, or give a reset": with_edge(Edge("revolute", "rigid", guard(([2], [0], 2.0)))),
    "edge rigid -> revolute: enters mode revolute at door = 1.2, outside of its invariant [0, 1]": with_mode(
        invariant=guard(([1], [0], 0.0), ([-1], [0], -1.0))
    ),
    "edge revolute -> rigid: enters mode rigid at door = 0.6, outside": with_edge(
        Edge("revolute", "rigid", guard(([1], [0], 1.2)), Reset(A=((0.5,),)))
    ),
    "edge revolute -> rigid: enters mode rigid at door = [0.5, 0.8], outside": with_edge(
        Edge("revolute", "rigid", guard(([1], [0], 0.5), ([-1], [0], -0.8)))
    ),
    "mode ajar is not connected: no transition enters or leaves it": replace(
        door(), modes=(*door().modes, replace(door().modes[0], name="ajar"))
    ),
    "edge rigid -> revolute: guard must not be empty": with_edge(
        Edge("rigid", "revolute", guard(([1], [0], 0.0, True), ([-1], [0], 0.0)))
    ),
    "edge rigid -> rigid: a self transition must have a reset": with_edge(Edge("rigid", "rigid", IN)),
    "unknown mode 'ajar'": replace(door(), init=(("ajar", Region()),)),
    "init of mode rigid must not be empty": replace(door(), init=(("rigid", guard(([0], [0], 1.0))),)),
    "noise: process_std must be 1 finite numbers >= 0. Got [-0.1]": replace(door(), noise=Noise((-0.1,), (0.1,))),
    "noise: observation_std must be 1 numbers > 0. Got [0.0]": replace(door(), noise=Noise((0.1,), (0.0,))),
    "mode rigid: measured coordinate must be 0 to 0. Got 1": shut(observation_std=((1, 0.1),)),
    "mode rigid: observation_std of door must be a finite number > 0, here and in the model's noise. Got 0.0 and": shut(
        observation_std=((0, 0.0),)
    ),
    "mode rigid: observation_std of door must be a finite number > 0, here and in the model's noise. Got 0.1 and inf": (
        replace(shut(observation_std=((0, 0.1),)), noise=Noise((0.1,), (float("inf"),)))
    ),
    "noise: a light must be at finite values of coordinates 0 to 0. Got ()": replace(
        door(), noise=Noise((0.1,), (0.1,), Light((), (0.1,)))
    ),
    "noise: growth of a light must be 1 finite numbers >= 0. Got [-1.0]": replace(
        door(), noise=Noise((0.1,), (0.1,), Light(((0, 0.0),), (-1.0,)))
    ),
}


WRONG_SIZES: dict[str, Callable[[], object]] = {
    "unit of door must be one of rad, m. Got 'deg'": lambda: Coordinate("door", "deg"),
    "mode revolute: must have 1 joints, one for each link (door). Got 0": lambda: with_mode(joints=()),
    "mode revolute: input_matrix: must be 1 x 1: one for each coordinate (door), one column for each input (door). Got "
    "1 x 2": lambda: with_mode(input_matrix=((1.0, 0.0),)),
    "mode revolute: input_matrix: must be rows of numbers": lambda: with_mode(input_matrix=(1.0,)),
    "mode revolute: invariant, half-space 1 'h': must have 1 weights of coordinates and 1 of inputs. Got 2 and 1": (
        lambda: with_mode(invariant=Region((HalfSpace((1.0, 0.0), (0.0,), 0.0, name="h"),)))
    ),
    "edge rigid -> revolute: guard, half-space 1: must have 1 weights of coordinates and 1 of inputs. Got 1 and 2": (
        lambda: with_edge(Edge("rigid", "revolute", guard(([1], [0, 0], 0.0))))
    ),
    "edge rigid -> rigid: reset matrix A: must be 1 x 1": lambda: with_edge(
        Edge("rigid", "rigid", IN, Reset(A=((1.0,), (1.0,))))
    ),
    "edge rigid -> rigid: reset matrix B: must be 1 x 1": lambda: with_edge(Edge("rigid", "rigid", IN, Reset(B=((),)))),
    "edge rigid -> rigid: reset offset c: must be 1 numbers, one for each coordinate (door). Got 2": lambda: with_edge(
        Edge("rigid", "rigid", IN, Reset(c=(0.0, 0.0)))
    ),
    "noise: observation_std: must be 1 numbers, one for each coordinate (door). Got 2": lambda: replace(
        door(), noise=Noise((0.1,), (0.1, 0.1))
    ),
}


@pytest.mark.parametrize("message", WRONG_SIZES)
def test_a_wrong_size_is_reported_when_the_automaton_is_made(message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        WRONG_SIZES[message]()


@pytest.mark.parametrize("message", MISTAKES)
def test_a_mistake_is_reported(message: str) -> None:
    with pytest.raises(InputError) as raised:
        check_automaton(MISTAKES[message])
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("automaton", [door(), two_rails(), detent(), cabinet()])
def test_what_is_right_passes(automaton: HybridAutomaton) -> None:
    check_automaton(automaton)


def test_known_motion_and_unmeasured_coordinates_are_allowed() -> None:
    check_automaton(replace(door(), noise=Noise((0.0,), (np.inf,))))


LEGAL_EDGES = [
    Edge("revolute", "rigid", guard(([1], [0], 1.0)), Reset(A=((0.0,),), c=(1.2,))),
    Edge("revolute", "rigid", guard(([1], [0], 1.0)), Reset(B=((1.0,),))),  # an input may bring it anywhere
    Edge("revolute", "rigid", guard(([1], [0], 1.165))),  # within the std of the pin
    Edge("rigid", "revolute", guard(([0], [-1], 0.01)), Reset(A=((0.0,),), c=(1.205,))),  # above its end, within it
    Edge("revolute", "rigid", guard(([1], [1], 1.0))),  # an input decides where
    Edge("revolute", "rigid", guard(([1], [0], 1.0), ([0], [1], 0.1))),  # inputs may come late
    Edge("revolute", "rigid", guard(([1], [0], 7.0), ([-1], [0], -8.0))),  # nowhere in its mode
    Edge("rigid", "revolute", guard(([1], [0], 1.2))),
]


@pytest.mark.parametrize("edge", LEGAL_EDGES)
def test_a_transition_that_may_enter_its_target_passes(edge: Edge) -> None:
    check_automaton(with_edge(edge))


def test_one_mode_needs_no_transition() -> None:
    check_automaton(replace(door(), modes=door().modes[:1], edges=()))


def test_small_differences_of_numbers_written_by_hand_pass() -> None:
    check_automaton(shut(joints=(rigid([1.2, 0, 0], fixed_at=1.2000005),)))
    check_automaton(shut(invariant=guard(([1], [0], 1.205))))


@pytest.mark.parametrize("side", [1, -1], ids=["from here", "up to here"])
def test_a_pin_known_exactly_lies_in_its_invariant_but_for_rounding(side: int) -> None:
    exact = (Pin(0, 1.2, 1e-12),)
    from_here = [guard(([side], [0], 1.2 * side + beyond)) for beyond in (5e-10, 1e-7)]
    check_automaton(shut(pins=exact, invariant=from_here[0]))
    with pytest.raises(InputError, match=r"the pin of door, 1\.2 rad, lies outside"):
        check_automaton(shut(pins=exact, invariant=from_here[1]))


class TestEmpty:
    def test_boxes(self) -> None:
        assert not is_empty(Region())
        assert not is_empty(guard(([1], [0], 1.0), ([-1], [0], -1.0)))
        assert is_empty(guard(([1], [0], 1.0), ([-1], [0], -1.0, True)))
        assert is_empty(guard(([2], [0], 3.0), ([-4], [0], -5.0)))
        assert not is_empty(guard(([0], [0], -1.0)))
        assert is_empty(guard(([0], [0], 0.0, True)))

    def test_coupled_half_spaces(self) -> None:
        triangle = (([1, 0], [0], 0.0), ([0, 1], [0], 0.0))
        assert not is_empty(guard(*triangle, ([-1, -1], [0], -1.0)))
        assert is_empty(guard(*triangle, ([-1, -1], [0], 1.0)))
        assert not is_empty(guard(*triangle, ([-1, -1], [0], 0.0)))
        assert is_empty(guard(*triangle, ([-1, -1], [0], 0.0, True)))
        assert not is_empty(guard(([1, 1], [0], 0.0, True)))

    @given(st.lists(st.tuples(st.integers(0, 2), st.sampled_from([-2, -1, 1, 2]), st.integers(-4, 4)), max_size=5))
    @settings(max_examples=60)
    def test_the_linear_programme_agrees_with_the_comparison_of_bounds(self, rows: list[tuple[int, int, int]]) -> None:
        def weights(index: int, w: int) -> tuple[float, ...]:
            return tuple(float(w) if i == index else 0.0 for i in range(3))

        single = [HalfSpace(weights(i, w)[:2], weights(i, w)[2:], float(c)) for i, w, c in rows]
        # A half-space over both states that holds wherever the others can lie sends the same set through the programme.
        coupled = HalfSpace((1.0, 1.0), (0.0,), -100.0)
        bounded = [HalfSpace(weights(i, s)[:2], weights(i, s)[2:], -40.0) for i in range(3) for s in (1, -1)]
        is_nothing = is_empty(Region((*single, *bounded, coupled)))
        assert is_empty(Region((*single, *bounded))) == is_nothing
        assert is_empty(Region(tuple(single)), Region(tuple(bounded))) == is_nothing
