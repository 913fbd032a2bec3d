"""The rules of the transition logic: order, simultaneous guards, intersections, resets, chattering, limits, inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import cabinet, door, guard, plain, two_rails

from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Pin, Reset
from micah_plan.automaton.region import Region, input_box
from micah_plan.automaton.transition import MOST_EVENTS, simulate, step
from micah_plan.errors import InputError
from micah_plan.planning.limits import limited_input

ONE = [[1.0]]
PLANE = [[1.0, 0.0], [0.0, 1.0]]
UP = ([1], [0], 1.0)


def targets(automaton: HybridAutomaton, mode: str, x: list[float], u: list[float]) -> list[str]:
    return [event.target for event in step(automaton, mode, x, u).events]


class TestSimultaneousGuards:
    def test_the_first_listed_edge_is_taken(self) -> None:
        to_b, to_c = Edge("a", "b", guard(UP)), Edge("a", "c", guard(UP))
        modes = {"a": ONE, "b": ONE, "c": ONE}
        assert targets(plain(modes, [to_b, to_c]), "a", [0.5], [1.0]) == ["b"]
        assert targets(plain(modes, [to_c, to_b]), "a", [0.5], [1.0]) == ["c"]

    @pytest.mark.parametrize("x", [0.5, 1.0, 1.5])
    def test_a_mode_change_goes_before_a_clamp_however_they_are_listed(self, x: float) -> None:
        clamp = Edge("a", "a", guard(UP), Reset(A=((0.0,),), c=(1.0,)))
        change = Edge("a", "b", guard(UP))
        for edges in ([clamp, change], [change, clamp]):
            result = step(plain({"a": ONE, "b": ONE}, edges), "a", [x], [1.0])
            assert [event.target for event in result.events] == ["b"]
            assert result.x == pytest.approx([x + 1.0])

    def test_an_earlier_clamp_goes_before_a_later_mode_change(self) -> None:
        clamp = Edge("a", "a", guard(([1], [0], 0.8)), Reset(A=((0.0,),), c=(0.8,)))
        result = step(plain({"a": ONE, "b": ONE}, [Edge("a", "b", guard(UP)), clamp]), "a", [0.5], [1.0])
        assert ([event.target for event in result.events], float(result.x[0])) == (["a"], 0.8)

    def test_guards_of_the_two_links_met_at_one_instant_both_fire_in_the_listed_order(self) -> None:
        result = step(cabinet(), "revolute/prismatic_1", [1.1, 0.1], [0.2, 0.2])
        assert [event.target for event in result.events] == ["rigid/prismatic_1", "rigid/prismatic_2"]
        assert [event.fraction for event in result.events] == pytest.approx([0.5, 0.5])
        np.testing.assert_allclose(result.x, [1.2, 0.3], atol=1e-12)

    def test_guards_of_the_new_mode_are_evaluated_at_the_same_instant(self) -> None:
        edges = [Edge("a", "b", guard(UP)), Edge("b", "c", guard(([1], [0], 0.3)))]
        result = step(plain({"a": ONE, "b": ONE, "c": [[0.5]]}, edges), "a", [0.5], [1.0])
        assert [(event.target, event.fraction) for event in result.events] == [("b", 0.5), ("c", 0.5)]
        assert result.x == pytest.approx([1.25])


class TestGuardTrueAtTheStart:
    @pytest.mark.parametrize("u", [-0.2, 0.0, 0.2])
    def test_it_fires_at_fraction_zero_for_any_motion(self, u: float) -> None:
        result = step(plain({"a": ONE, "b": ONE}, [Edge("a", "b", guard(UP))]), "a", [1.5], [u])
        assert [(event.target, event.fraction) for event in result.events] == [("b", 0.0)]
        assert result.x == pytest.approx([1.5 + u])

    def test_a_chain_of_guards_that_are_true_is_run_through_at_once(self) -> None:
        edges = [Edge(a, b, guard(UP)) for a, b in ("ab", "bc", "cd")]
        result = step(plain(dict.fromkeys("abcd", ONE), edges), "a", [2.0], [0.1])
        assert [(event.target, event.fraction) for event in result.events] == [("b", 0.0), ("c", 0.0), ("d", 0.0)]


class TestIntersections:
    BOTH = (([1, 0], [0, 0], 1.0), ([0, 1], [0, 0], 1.0))

    def automaton(self, *rows: tuple[list[float], list[float], float]) -> HybridAutomaton:
        return plain({"a": PLANE, "b": PLANE}, [Edge("a", "b", guard(*rows))])

    @pytest.mark.parametrize("order", [1, -1])
    def test_it_fires_where_the_last_half_space_is_entered(self, order: int) -> None:
        result = step(self.automaton(*self.BOTH[::order]), "a", [0.5, 0.0], [1.0, 1.25])
        assert result.events[0].fraction == pytest.approx(0.8)
        np.testing.assert_allclose(result.events[0].x_before, [1.3, 1.0], atol=1e-12)

    def test_it_does_not_fire_with_one_half_space_missing(self) -> None:
        assert targets(self.automaton(*self.BOTH), "a", [0.5, 0.0], [1.0, 0.9]) == []

    def test_it_does_not_fire_if_one_is_left_before_the_other_is_entered(self) -> None:
        passing = self.automaton(([1, 0], [0, 0], 1.0), ([0, -1], [0, 0], -0.5))
        assert targets(passing, "a", [0.0, 0.0], [1.25, 0.6]) == ["b"]
        assert targets(passing, "a", [0.0, 0.0], [1.25, 0.7]) == []

    @pytest.mark.parametrize("order", [1, -1])
    def test_the_first_half_space_to_be_left_counts(self, order: int) -> None:
        left = (([0, -1], [0, 0], -0.25), ([-0.1, -1], [0, 0], -0.9))
        band = self.automaton(([1, 0], [0, 0], 1.0), *left[::order])
        assert targets(band, "a", [0.0, 0.0], [2.0, 0.4]) == ["b"]
        assert targets(band, "a", [0.0, 0.0], [2.0, 0.6]) == []

    def test_a_path_that_only_touches_the_corner_does_not_fire(self) -> None:
        corner = self.automaton(([1, 0], [0, 0], 1.0), ([0, -1], [0, 0], -1.0))
        assert targets(corner, "a", [0.0, 0.0], [2.0, 2.0]) == []

    def test_state_and_input_together(self) -> None:
        pushed = plain({"a": ONE, "b": ONE}, [Edge("a", "b", guard(UP, ([0], [1], 0.6, True)))])
        assert targets(pushed, "a", [0.5], [1.0]) == ["b"]
        assert targets(pushed, "a", [0.5], [0.6]) == []
        assert targets(pushed, "a", [1.5], [0.3]) == []

    def test_a_slanted_half_space_over_state_and_input(self) -> None:
        slanted = self.automaton(([1, 2], [0.5, 0], 2.0))
        (event,) = step(slanted, "a", [0.0, 0.0], [1.0, 1.0]).events
        assert event.fraction == pytest.approx(0.5)


class TestResets:
    def test_an_affine_reset_is_applied_and_the_rest_of_the_step_goes_on_from_there(self) -> None:
        reset = Reset(A=((0.5, 0.0), (1.0, 1.0)), B=((0.0, 0.0), (0.0, 0.1)), c=(3.0, -1.0))
        swap = plain({"a": PLANE, "b": [[0.0, 1.0], [1.0, 0.0]]}, [Edge("a", "b", guard(([1, 0], [0, 0], 1.0)), reset)])
        result = step(swap, "a", [0.5, 0.0], [1.0, 2.0])
        (event,) = result.events
        np.testing.assert_allclose(event.x_before, [1.0, 1.0])
        np.testing.assert_allclose(event.x_after, reset.apply(event.x_before, np.array([1.0, 2.0])))
        np.testing.assert_allclose(event.x_after, [3.5, 1.2])
        np.testing.assert_allclose(result.x, [3.5 + 0.5 * 2.0, 1.2 + 0.5 * 1.0])

    def test_a_reset_can_put_the_state_into_the_next_guard(self) -> None:
        edges = [Edge("a", "b", guard(UP), Reset(c=(5.0,))), Edge("b", "c", guard(([1], [0], 4.0)))]
        result = step(plain(dict.fromkeys("abc", ONE), edges), "a", [0.5], [1.0])
        assert [event.fraction for event in result.events] == [0.5, 0.5]
        assert result.x == pytest.approx([6.5])

    def pinned(self, *edges: Edge) -> HybridAutomaton:
        """x0 is held at 0, x1 moves."""
        automaton = plain({"a": [[0.0, 0.0], [0.0, 1.0]]}, edges)
        return replace(automaton, modes=(replace(automaton.modes[0], pins=(Pin(0, 0.0, 0.01),)),))

    def test_a_self_transition_does_not_set_a_pinned_coordinate_in_motion(self) -> None:
        mixing = Edge("a", "a", guard(([0, 1], [0, 0], 1.0)), Reset(A=((1.0, 1.0), (0.0, 0.0)), c=(0.0, 1.0)))
        np.testing.assert_allclose(step(self.pinned(mixing), "a", [0.0, 0.0], [0.0, 2.0]).x, [0.0, 1.0], atol=1e-12)

    def test_a_wall_does_not_set_a_pinned_coordinate_in_motion(self) -> None:
        wall = Edge("a", "a", guard(([1, 1], [0, 0], 1.0)))
        np.testing.assert_allclose(step(self.pinned(wall), "a", [0.0, 0.0], [0.0, 2.0]).x, [0.0, 1.0], atol=1e-12)

    def test_a_self_transition_turns_the_motion_with_the_linear_part_of_its_reset(self) -> None:
        bounce = Edge("a", "a", guard(UP), Reset(A=((-0.5,),), c=(1.5,)))
        result = step(plain({"a": ONE}, [bounce]), "a", [0.5], [1.0])
        assert [event.fraction for event in result.events] == [0.5]
        assert result.x == pytest.approx([1.0 - 0.25])

    def test_entering_a_mode_puts_pinned_coordinates_to_their_value(self) -> None:
        automaton = plain({"a": ONE, "b": [[0.0]]}, [Edge("a", "b", guard(UP))])
        held = replace(automaton.modes[1], pins=(Pin(0, 1.01, 0.01),))
        result = step(replace(automaton, modes=(automaton.modes[0], held)), "a", [0.5], [1.0], [0.2])
        np.testing.assert_allclose(result.events[0].x_after, [1.01])
        np.testing.assert_allclose(result.x, [1.01])


class TestChattering:
    def facing(self, modes: dict[str, list[list[float]]]) -> HybridAutomaton:
        """Two modes that push into each other at x0 = 0."""
        n = len(modes["a"])
        first, zero = [1.0] + [0.0] * (n - 1), [0.0] * n
        return plain(
            modes,
            [Edge("a", "b", guard((first, zero, 0.0))), Edge("b", "a", guard(([-w for w in first], zero, 0.0, True)))],
        )

    @pytest.mark.parametrize(("mode", "x"), [("a", -0.5), ("b", 0.5), ("a", 0.0), ("b", 0.0)])
    def test_modes_that_push_into_each_other_hold_the_state_on_their_boundary(self, mode: str, x: float) -> None:
        result = step(self.facing({"a": [[1.0]], "b": [[-1.0]]}), mode, [x], [1.0])
        assert len(result.events) == 1
        assert result.complete
        assert result.x == pytest.approx([0.0], abs=1e-15)

    def test_the_state_slides_along_the_boundary(self) -> None:
        result = step(self.facing({"a": PLANE, "b": [[-1.0, 0.0], [0.0, 0.5]]}), "a", [-0.25, 0.0], [1.0, 1.0])
        np.testing.assert_allclose(result.x, [0.0, 0.25 + 0.75 * 0.5], atol=1e-12)

    def test_it_stays_there_over_many_steps(self) -> None:
        run = simulate(self.facing({"a": [[1.0]], "b": [[-1.0]]}), "a", [-0.05], np.full((50, 1), 0.1))
        assert np.abs(run.states[1:]).max() < 1e-12
        assert run.complete

    def test_a_disturbance_that_pushes_back_what_the_input_pulls_out(self) -> None:
        result = step(door(), "rigid", [1.2], [-0.01], [0.03])
        assert len(result.events) == 1
        assert result.x == pytest.approx([1.2], abs=1e-15)

    def test_overlapping_guards_change_the_mode_once_per_step(self) -> None:
        edges = [Edge("a", "b", guard(([1], [0], 0.0))), Edge("b", "a", guard(([-1], [0], -1.0)))]
        automaton = plain({"a": ONE, "b": ONE}, edges)
        assert targets(automaton, "a", [0.5], [0.1]) == ["b"]
        assert simulate(automaton, "a", [0.5], np.full((4, 1), 0.01)).modes == ("a", "b", "a", "b", "a")

    def test_a_ring_of_guards_that_all_hold_ends_before_it_closes(self) -> None:
        everywhere = guard(([1], [0], -100.0))
        edges = [Edge(a, b, everywhere) for a, b in ("ab", "bc", "ca")]
        assert targets(plain(dict.fromkeys("abc", ONE), edges), "a", [0.0], [0.1]) == ["b", "c"]

    def test_resets_that_throw_the_state_from_guard_to_guard(self) -> None:
        edges = [
            Edge("a", "b", guard(UP), Reset(A=((0.0,),), c=(-1.0,))),
            Edge("b", "a", guard(([-1], [0], 1.0)), Reset(A=((0.0,),), c=(1.0,))),
        ]
        result = step(plain({"a": ONE, "b": ONE}, edges), "a", [0.5], [1.0])
        assert [event.target for event in result.events] == ["b"]
        assert result.x == pytest.approx([-0.5])

    def test_a_clamp_with_an_identity_reset_is_a_wall(self) -> None:
        wall = plain({"a": PLANE}, [Edge("a", "a", guard(([1, 1], [0, 0], 1.0)))])
        result = step(wall, "a", [0.0, 0.0], [2.0, 0.0])
        np.testing.assert_allclose(result.x, [1.0 + 0.25 * 2.0, -0.25 * 2.0], atol=1e-12)

    def test_two_walls_that_meet_at_an_acute_angle_hold_the_state(self) -> None:
        edges = [Edge("a", "a", guard(([1, 0.2], [0, 0], 1.0))), Edge("a", "a", guard(([1, -0.2], [0, 0], 1.0)))]
        result = step(plain({"a": PLANE}, edges), "a", [0.0, 0.0], [3.0, 0.0])
        np.testing.assert_allclose(result.x, [1.0, 0.0], atol=1e-12)
        assert result.complete

    def test_a_mode_change_forgets_the_walls_of_the_mode_before(self) -> None:
        """b pushes back and slides on x0 = 0; so the closed guard to c holds, and c, which pushes back too, slides."""
        right, left = ([1, 0], [0, 0], 0.0), ([-1, 0], [0, 0], 0.0, True)
        flows = {"a": PLANE, "b": [[-1.0, 0.0], [0.0, 1.0]], "c": [[-1.0, 0.0], [0.0, 0.5]]}
        edges = [
            Edge("a", "b", guard(right)),
            Edge("b", "a", guard(left)),
            Edge("b", "c", guard(([1, 0], [0, 0], 0.0))),
            Edge("c", "a", guard(left)),
        ]
        result = step(plain(flows, edges), "a", [-0.5, 0.0], [1.0, 1.0])
        assert [event.target for event in result.events] == ["b", "c"]
        np.testing.assert_allclose(result.x, [0.0, 0.5 + 0.5 * 0.5], atol=1e-12)

    def test_a_reset_in_front_of_its_own_guard_reaches_the_limit_and_is_reported(self) -> None:
        again = Edge("a", "a", guard(UP), Reset(c=(-1e-4,)))
        result = step(plain({"a": ONE}, [again]), "a", [0.5], [1.0])
        assert not result.complete
        assert len(result.events) == MOST_EVENTS
        assert result.x == pytest.approx([1.0], abs=1e-3)
        run = simulate(plain({"a": ONE}, [again]), "a", [0.5], [[1.0]])
        assert not run.complete

    def test_large_numbers_that_cancel_do_not_stop_the_motion(self) -> None:
        """The rounding of x, 1e-10, is larger than the margin that counts as 0."""
        automaton = plain({"a": PLANE, "b": PLANE}, [Edge("a", "b", guard(([1, -1], [0, 0], 0.3)))])
        result = step(automaton, "a", [1e6, 1e6 + 0.1], [0.7, 0.0])
        assert [event.target for event in result.events] == ["b"]


class TestInputs:
    def limited(self) -> HybridAutomaton:
        automaton = two_rails()
        region = input_box([-0.1], [0.2], 1, ["drawer"])
        return replace(automaton, modes=tuple(replace(mode, inputs=region) for mode in automaton.modes))

    def test_step_does_not_clip(self) -> None:
        assert step(self.limited(), "prismatic_1", [0.0], [0.3]).x == pytest.approx([0.3])

    @pytest.mark.parametrize(("u", "inside"), [(0.2, True), (-0.1, True), (0.21, False), (-0.11, False)])
    def test_admissible(self, u: float, inside: bool) -> None:
        admissible = self.limited().mode("prismatic_1").inputs
        assert admissible.contains(np.zeros(1), np.array([u])) == inside
        assert admissible.contains(np.zeros(1), np.array([u]), tolerance=0.02)

    @pytest.mark.parametrize(("u", "clipped"), [(0.5, 0.2), (-0.5, -0.1), (0.05, 0.05)])
    def test_a_planner_cuts_what_is_not(self, u: float, clipped: float) -> None:
        largest = np.array([1.0])
        assert limited_input(self.limited().modes[0], np.zeros(1), np.array([u]), largest) == pytest.approx([clipped])
        assert limited_input(two_rails().modes[0], np.zeros(1), np.array([u]), largest) == pytest.approx([u])

    def test_a_bound_may_depend_on_the_state(self) -> None:
        """u <= (1 - x) / 2: slower towards the end."""
        mode = replace(plain({"a": ONE}, []).modes[0], inputs=guard(([-1], [-2], -1.0)))
        assert limited_input(mode, np.array([0.4]), np.array([0.9]), np.array([1.0])) == pytest.approx([0.3])

    def test_inputs_that_are_bounded_together_change_as_little_as_possible(self) -> None:
        coupled = replace(plain({"a": PLANE}, []).modes[0], inputs=guard(([0, 0], [1, 1], 0.0)))
        cut = limited_input(coupled, np.zeros(2), np.array([-0.3, 0.1]), np.ones(2))
        assert cut == pytest.approx([-0.2, 0.2])
        assert coupled.inputs.contains(np.zeros(2), cut, tolerance=1e-12)

    @pytest.mark.parametrize(
        ("mode", "x", "u", "disturbance", "message"),
        [
            ("ajar", [0.0], [0.0], None, "unknown mode 'ajar'; choose one of prismatic_1, prismatic_2"),
            ("prismatic_1", [0.0, 0.0], [0.0], None, "x must be 1 finite numbers"),
            ("prismatic_1", [np.nan], [0.0], None, "x must be 1 finite numbers"),
            ("prismatic_1", [0.0], [np.inf], None, "u must be 1 finite numbers"),
            ("prismatic_1", [0.0], 0.0, None, "u must be 1 finite numbers"),
            ("prismatic_1", [0.0], [0.0], [0.0, 1.0], "disturbance must be 1 finite numbers"),
        ],
    )
    def test_bad_arguments(self, mode: str, x: object, u: object, disturbance: object, message: str) -> None:
        with pytest.raises(InputError, match=message):
            step(two_rails(), mode, x, u, disturbance)  # type: ignore[arg-type]

    def test_bad_arguments_of_simulate(self) -> None:
        with pytest.raises(InputError, match=r"inputs must be finite and have shape \(k, 1\)"):
            simulate(two_rails(), "prismatic_1", [0.0], [0.1, 0.1])
        with pytest.raises(InputError, match=r"as many rows as inputs, 2\. Got 1"):
            simulate(two_rails(), "prismatic_1", [0.0], [[0.1], [0.1]], [[0.0]])

    def test_arguments_are_left_as_they_were(self) -> None:
        x, u = np.array([0.1]), np.array([5.0])
        step(two_rails(), "prismatic_1", x, u)
        assert (float(x[0]), float(u[0])) == (0.1, 5.0)


def test_regions_without_half_spaces_admit_everything() -> None:
    assert plain({"a": ONE}, []).mode("a").inputs.contains(np.zeros(1), np.array([1e9]))
    assert Region().is_everything


class TestScale:
    """A guard means the same however its weights are scaled."""

    @pytest.mark.parametrize("scale", [1e-200, 1e-13, 1e-6, 1.0, 1e6, 1e13])
    def test_a_guard_on_states_fires_at_its_threshold(self, scale: float) -> None:
        automaton = plain({"a": ONE, "b": ONE}, [Edge("a", "b", guard(([scale], [0], scale)))])
        assert step(automaton, "a", [0.0], [0.0]).mode == "a"
        assert step(automaton, "a", [0.0], [0.5]).mode == "a"
        assert step(automaton, "a", [1.0 - 5e-7], [0.0]).mode == "a"
        assert step(automaton, "a", [1.0 - 1e-9], [5e-10]).mode == "a"
        result = step(automaton, "a", [0.0], [4.0])
        assert [event.fraction for event in result.events] == pytest.approx([0.25], abs=1e-12)

    @pytest.mark.parametrize("scale", [1e-13, 1e-6, 1.0, 1e13])
    def test_a_guard_on_inputs_fires_above_its_threshold(self, scale: float) -> None:
        automaton = plain({"a": [[0.0]], "b": ONE}, [Edge("a", "b", guard(([0], [scale], 0.1 * scale, True)))])
        modes = [step(automaton, "a", [0.0], [u]).mode for u in (0.0, 0.1 - 1e-9, 0.1 + 1e-9)]
        assert modes == ["a", "a", "b"]

    def test_weights_on_several_coordinates_are_scaled_together(self) -> None:
        small = Edge("a", "b", guard(([3e-13, 4e-13], [0, 0], 5e-13)))
        automaton = plain({"a": PLANE, "b": PLANE}, [small])
        assert step(automaton, "a", [0.0, 0.0], [0.0, 0.0]).mode == "a"
        (event,) = step(automaton, "a", [0.0, 0.0], [1.2, 1.6]).events
        assert event.fraction == pytest.approx(0.5)

    def test_a_threshold_too_far_away_for_floats_is_not_reached(self) -> None:
        automaton = plain({"a": ONE, "b": ONE}, [Edge("a", "b", guard(([1e-300], [0], 1e300)))])
        assert step(automaton, "a", [0.0], [1.0]).mode == "a"
