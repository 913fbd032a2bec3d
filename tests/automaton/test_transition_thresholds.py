"""Every edge of an object's automaton, both ways, on and around its threshold."""

from __future__ import annotations

import numpy as np
import pytest
from automaton_examples import END, SHUT, SPLIT, cabinet, detent, door, two_rails

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.transition import Step, step

ULP = float(np.spacing(SPLIT))
TINY = 1e-9


def moved(automaton: HybridAutomaton, mode: str, x: float, u: float) -> Step:
    return step(automaton, mode, [x], [u])


def path(result: Step, start: str) -> list[str]:
    return [start, *(event.target for event in result.events)]


class TestNoEvent:
    @pytest.mark.parametrize(("x", "u"), [(0.1, 0.05), (0.1, -0.05), (0.1, 0.0), (0.0, 0.1), (0.0, 0.0)])
    def test_inside_a_mode_the_state_follows_its_flow(self, x: float, u: float) -> None:
        result = moved(two_rails(), "prismatic_1", x, u)
        assert (result.mode, result.events, result.complete) == ("prismatic_1", (), True)
        assert result.x == pytest.approx([x + u], abs=1e-15)

    def test_a_disturbance_adds_to_the_flow(self) -> None:
        np.testing.assert_allclose(step(two_rails(), "prismatic_1", [0.1], [0.02], [-0.03]).x, [0.09], atol=1e-15)


class TestForward:
    """prismatic_1 -> prismatic_2 with the closed guard c >= SPLIT."""

    @pytest.mark.parametrize("x", [SPLIT - ULP, SPLIT, SPLIT + ULP])
    def test_on_the_threshold_and_moving_up_it_fires_at_once(self, x: float) -> None:
        result = moved(two_rails(), "prismatic_1", x, 0.05)
        assert path(result, "prismatic_1") == ["prismatic_1", "prismatic_2"]
        assert result.events[0].fraction == 0.0
        assert result.x == pytest.approx([SPLIT + 0.05], abs=1e-12)

    @pytest.mark.parametrize("x", [SPLIT - ULP, SPLIT, SPLIT + ULP])
    def test_on_the_threshold_and_moving_away_it_does_not_fire(self, x: float) -> None:
        result = moved(two_rails(), "prismatic_1", x, -0.05)
        assert (result.mode, result.events) == ("prismatic_1", ())

    @pytest.mark.parametrize("x", [SPLIT - ULP, SPLIT, SPLIT + ULP])
    def test_at_rest_on_the_threshold_the_closed_guard_includes_it(self, x: float) -> None:
        assert path(moved(two_rails(), "prismatic_1", x, 0.0), "prismatic_1") == ["prismatic_1", "prismatic_2"]

    def test_just_below_at_rest_or_moving_less_than_the_gap_it_does_not_fire(self) -> None:
        for u in (0.0, 0.5 * TINY, -TINY):
            assert moved(two_rails(), "prismatic_1", SPLIT - TINY, u).events == ()

    def test_just_below_and_moving_up_it_fires_where_the_threshold_is(self) -> None:
        result = moved(two_rails(), "prismatic_1", SPLIT - TINY, 2 * TINY)
        assert result.mode == "prismatic_2"
        assert result.events[0].fraction == pytest.approx(0.5, rel=1e-3)
        assert result.events[0].x_before == pytest.approx([SPLIT], abs=1e-15)

    def test_just_above_and_moving_down_it_fires_at_the_start_and_the_way_back_is_found(self) -> None:
        result = moved(two_rails(), "prismatic_1", SPLIT + TINY, -0.1)
        assert path(result, "prismatic_1") == ["prismatic_1", "prismatic_2", "prismatic_1"]
        assert [event.fraction for event in result.events] == pytest.approx([0.0, TINY / 0.1], rel=1e-6)
        assert result.x == pytest.approx([SPLIT + TINY - 0.1], abs=1e-12)

    @pytest.mark.parametrize(
        ("u", "mode"),
        [(0.1, "prismatic_2"), (0.1 - TINY, "prismatic_1"), (0.1 + TINY, "prismatic_2"), (0.1 - ULP, "prismatic_2")],
    )
    def test_landing_on_and_around_the_threshold(self, u: float, mode: str) -> None:
        result = moved(two_rails(), "prismatic_1", 0.1, u)
        assert result.mode == mode
        assert result.x == pytest.approx([0.1 + u], abs=1e-12)
        if result.events:
            assert result.events[0].fraction == pytest.approx(1.0, abs=1e-7)

    def test_the_event_lies_where_the_line_crosses(self) -> None:
        result = moved(two_rails(), "prismatic_1", 0.1, 0.25)
        (event,) = result.events
        assert event.fraction == pytest.approx(0.4)
        assert (event.source, event.target, event.name) == ("prismatic_1", "prismatic_2", "prismatic_1 -> prismatic_2")
        np.testing.assert_allclose([event.x_before, event.x_after], [[SPLIT], [SPLIT]], atol=1e-15)
        assert two_rails().edges[event.edge].target == "prismatic_2"


class TestBackward:
    """prismatic_2 -> prismatic_1 with the strict guard c < SPLIT."""

    @pytest.mark.parametrize("x", [SPLIT - ULP, SPLIT, SPLIT + ULP])
    def test_on_the_threshold_and_moving_down_it_fires_at_once(self, x: float) -> None:
        result = moved(two_rails(), "prismatic_2", x, -0.05)
        assert path(result, "prismatic_2") == ["prismatic_2", "prismatic_1"]
        assert result.events[0].fraction == 0.0

    @pytest.mark.parametrize("x", [SPLIT - ULP, SPLIT, SPLIT + ULP])
    @pytest.mark.parametrize("u", [0.0, 0.05])
    def test_on_the_threshold_at_rest_or_moving_up_it_does_not_fire(self, x: float, u: float) -> None:
        assert moved(two_rails(), "prismatic_2", x, u).events == ()

    def test_below_the_threshold_it_fires_for_any_motion(self) -> None:
        assert path(moved(two_rails(), "prismatic_2", SPLIT - TINY, 0.0), "prismatic_2") == [
            "prismatic_2",
            "prismatic_1",
        ]
        there_and_back = moved(two_rails(), "prismatic_2", SPLIT - TINY, 0.1)
        assert path(there_and_back, "prismatic_2") == ["prismatic_2", "prismatic_1", "prismatic_2"]

    def test_the_event_lies_where_the_line_crosses(self) -> None:
        result = moved(two_rails(), "prismatic_2", 0.3, -0.25)
        assert result.mode == "prismatic_1"
        assert result.events[0].fraction == pytest.approx(0.4)
        assert result.x == pytest.approx([0.05], abs=1e-12)


class TestRigid:
    def test_a_door_that_is_shut_stays_at_its_configuration(self) -> None:
        result = moved(door(), "revolute", 1.1, 0.4)
        assert result.mode == "rigid"
        assert result.events[0].fraction == pytest.approx(0.25)
        assert result.x == pytest.approx([SHUT], abs=1e-15)

    @pytest.mark.parametrize("u", [0.3, 0.0])
    def test_pushing_or_resting_keeps_it_shut(self, u: float) -> None:
        result = moved(door(), "rigid", SHUT, u)
        assert (result.mode, result.events, float(result.x[0])) == ("rigid", (), SHUT)

    def test_pulling_opens_it_and_the_whole_input_moves_it(self) -> None:
        result = moved(door(), "rigid", SHUT, -0.3)
        assert path(result, "rigid") == ["rigid", "revolute"]
        assert result.events[0].fraction == 0.0
        assert result.x == pytest.approx([0.9], abs=1e-15)

    @pytest.mark.parametrize(("u", "mode"), [(-0.1, "rigid"), (-0.1 - TINY, "revolute"), (-0.1 + TINY, "rigid")])
    def test_the_latch_gives_way_above_its_release_only(self, u: float, mode: str) -> None:
        assert moved(door(release=0.1), "rigid", SHUT, u).mode == mode

    @pytest.mark.parametrize("ulps", [-1, 1])
    def test_one_ulp_around_the_release_counts_as_the_release(self, ulps: int) -> None:
        assert moved(door(release=0.1), "rigid", SHUT, -0.1 + ulps * float(np.spacing(0.1))).mode == "rigid"

    def test_a_disturbance_does_not_move_what_is_held(self) -> None:
        result = step(door(), "rigid", [SHUT], [0.0], [-0.05])
        assert (result.mode, float(result.x[0])) == ("rigid", SHUT)

    @pytest.mark.parametrize("off", [-0.02, 0.02])
    def test_a_state_next_to_the_pin_is_put_there_and_can_leave(self, off: float) -> None:
        assert float(moved(door(), "rigid", SHUT + off, 0.0).x[0]) == SHUT
        assert moved(door(), "rigid", SHUT + off, -0.1).x == pytest.approx([SHUT - 0.1], abs=1e-15)

    def test_a_detent_lets_pass_at_zero_release_and_holds_at_a_larger_one(self) -> None:
        through = moved(detent(), "prismatic_1", 0.1, 0.2)
        assert path(through, "prismatic_1") == ["prismatic_1", "rigid", "prismatic_2"]
        assert through.x == pytest.approx([0.3], abs=1e-12)
        held = moved(detent(release=0.25), "prismatic_1", 0.1, 0.2)
        assert path(held, "prismatic_1") == ["prismatic_1", "rigid"]
        assert held.x == pytest.approx([SPLIT], abs=1e-15)

    @pytest.mark.parametrize(("u", "mode"), [(0.3, "prismatic_2"), (-0.15, "rigid"), (-0.26, "prismatic_1")])
    def test_a_detent_is_left_both_ways(self, u: float, mode: str) -> None:
        assert moved(detent(release=0.25), "rigid", SPLIT, u).mode == mode

    def test_a_detent_is_entered_from_above(self) -> None:
        assert path(moved(detent(release=0.5), "prismatic_2", 0.3, -0.2), "prismatic_2") == ["prismatic_2", "rigid"]


class TestClamps:
    def test_at_the_lower_end_the_state_stops_and_the_mode_stays(self) -> None:
        result = moved(two_rails(), "prismatic_1", 0.1, -0.4)
        assert path(result, "prismatic_1") == ["prismatic_1", "prismatic_1"]
        assert result.events[0].fraction == pytest.approx(0.25)
        assert float(result.x[0]) == 0.0

    def test_at_the_upper_end_the_state_stops_and_the_mode_stays(self) -> None:
        result = moved(two_rails(), "prismatic_2", 0.3, 0.4)
        assert path(result, "prismatic_2") == ["prismatic_2", "prismatic_2"]
        assert float(result.x[0]) == END

    @pytest.mark.parametrize(("mode", "end", "away"), [("prismatic_1", 0.0, 0.1), ("prismatic_2", END, -0.1)])
    def test_resting_at_an_end_or_leaving_it_is_no_event(self, mode: str, end: float, away: float) -> None:
        assert moved(two_rails(), mode, end, 0.0).events == ()
        left = moved(two_rails(), mode, end, away)
        assert left.events == ()
        assert left.x == pytest.approx([end + away])

    @pytest.mark.parametrize(("mode", "end", "into"), [("prismatic_1", 0.0, -0.1), ("prismatic_2", END, 0.1)])
    def test_pushing_on_at_an_end_is_one_event_and_no_motion(self, mode: str, end: float, into: float) -> None:
        result = moved(two_rails(), mode, end, into)
        assert [event.fraction for event in result.events] == [0.0]
        assert float(result.x[0]) == end

    def test_a_state_beyond_an_end_is_brought_back(self) -> None:
        assert float(moved(two_rails(), "prismatic_1", -0.3, 0.0).x[0]) == 0.0
        assert float(moved(two_rails(), "prismatic_2", END + 0.3, 0.0).x[0]) == END

    @pytest.mark.parametrize("off", [-TINY, -ULP, 0.0, ULP, TINY])
    def test_around_the_upper_end(self, off: float) -> None:
        result = moved(two_rails(), "prismatic_2", END + off, 0.1)
        assert len(result.events) == 1
        assert float(result.x[0]) == END

    def test_a_clamp_stops_one_coordinate_and_lets_the_other_go_on(self) -> None:
        result = step(cabinet(), "revolute/prismatic_1", [0.1, 0.1], [-0.4, 0.05])
        assert [event.target for event in result.events] == ["revolute/prismatic_1"]
        np.testing.assert_allclose(result.x, [0.0, 0.15], atol=1e-12)

    def test_in_a_corner_both_coordinates_stop(self) -> None:
        result = step(cabinet(), "revolute/prismatic_1", [0.1, 0.1], [-0.4, -0.2])
        assert [event.fraction for event in result.events] == pytest.approx([0.25, 0.5])
        np.testing.assert_array_equal(result.x, [0.0, 0.0])


class TestSeveralThresholds:
    def test_a_chain_of_modes_in_one_step_there_and_back(self) -> None:
        there = moved(detent(), "prismatic_1", 0.05, 1.0)
        assert path(there, "prismatic_1") == ["prismatic_1", "rigid", "prismatic_2", "prismatic_2"]
        assert [event.fraction for event in there.events] == pytest.approx([0.15, 0.15, 0.35])
        assert float(there.x[0]) == END
        back = moved(detent(), "prismatic_2", END, -1.0)
        assert path(back, "prismatic_2") == ["prismatic_2", "rigid", "prismatic_1", "prismatic_1"]
        assert float(back.x[0]) == 0.0

    def test_events_of_two_links_come_in_the_order_of_the_motion(self) -> None:
        door_first = step(cabinet(), "revolute/prismatic_1", [1.1, 0.0], [0.4, 0.25])
        assert [event.target for event in door_first.events] == ["rigid/prismatic_1", "rigid/prismatic_2"]
        assert [event.fraction for event in door_first.events] == pytest.approx([0.25, 0.8])
        drawer_first = step(cabinet(), "revolute/prismatic_1", [1.0, 0.14], [0.4, 0.25])
        assert [event.target for event in drawer_first.events] == ["revolute/prismatic_2", "rigid/prismatic_2"]
        np.testing.assert_allclose(drawer_first.x, [SHUT, 0.39], atol=1e-12)

    def test_links_do_not_influence_each_other(self) -> None:
        both = step(cabinet(), "rigid/prismatic_2", [SHUT, 0.3], [-0.2, -0.25])
        assert both.mode == "revolute/prismatic_1"
        assert both.x[0] == pytest.approx(moved(door(), "rigid", SHUT, -0.2).x[0], abs=1e-15)
        assert both.x[1] == pytest.approx(moved(two_rails(), "prismatic_2", 0.3, -0.25).x[0], abs=1e-12)
