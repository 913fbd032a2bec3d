"""The charts of a plan: curves where the numbers are, marks at goal and guards, in step with the player."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm
from view_objects import OPEN_AT, marks, problem, solved, trajectory, words_of

from micah_plan.task.plan import ArmTrajectory, Plan
from micah_plan.view.chart import Area, Curve, Level, Range, Span, Words
from micah_plan.view.motion import knot_times, mode_stretches, shown_duration, step_times
from micah_plan.view.page import Block
from micah_plan.view.plan_charts import DrawnRun, plan_charts

CONFIDENCE = 0.9


def drawn(number: int = 0, **changes) -> Block:
    return plan_charts(solved(**changes), problem(confidence=CONFIDENCE))[number]


def test_the_curves_are_the_belief() -> None:
    chart = drawn().chart
    mean, std = trajectory().means[:, 0], trajectory().factors[:, 0, 0]
    (curve,), (area,) = marks(chart, Curve, 0), marks(chart, Area, 0)
    np.testing.assert_allclose(curve.y, mean)
    np.testing.assert_allclose(area.high, mean + norm.ppf(CONFIDENCE) * std)
    np.testing.assert_allclose(area.low, mean - norm.ppf(CONFIDENCE) * std)
    (below,) = marks(chart, Curve, 1)
    np.testing.assert_allclose(below.y, std)
    for panel, line in zip(chart.panels, (curve, below), strict=True):
        assert panel.low < line.y.min() <= line.y.max() < panel.high, "everything is inside of its panel"


def test_goal_and_guard_are_marked_at_their_values() -> None:
    block = drawn()
    (goal,) = marks(block.chart, Range)
    assert (goal.low, goal.high) == pytest.approx((OPEN_AT - 0.02, OPEN_AT + 0.02))
    (guard,) = marks(block.chart, Level)
    assert guard.value == pytest.approx(OPEN_AT)
    assert "± 1.28 σ, the room that a confidence of 90 % requires" in words_of(block)


def test_the_line_of_the_player_stands_at_the_step_that_is_shown() -> None:
    block = drawn()
    cursor, (curve,) = np.array(block.keyframes), marks(block.chart, Curve, 0)
    np.testing.assert_allclose(cursor[:-1, 0], knot_times(trajectory()))
    np.testing.assert_allclose(cursor[:-1, 1], curve.x)
    assert cursor[-1].tolist() == pytest.approx([shown_duration(trajectory()), cursor[-2, 1]]), "it rests at the end"
    assert (np.diff(cursor[:, 0]) > 0).all()


def test_modes_shade_the_steps_that_they_govern_and_are_named() -> None:
    chart, modes, steps = drawn().chart, trajectory().modes, step_times(trajectory())
    change = modes.index("stopped")
    assert mode_stretches(modes) == [(0, change), (change, len(modes) - 1)]
    for number in range(len(chart.panels)):
        swing, rest = marks(chart, Span, number)
        assert (swing.start, swing.end, rest.end) == (steps[0], steps[change], steps[-1])
        assert swing.end == rest.start
    assert [words.text for words in marks(chart, Words)] == ["swinging", "stopped"]
    assert chart.whole, "there are no half steps"


def test_an_arm_has_charts_of_its_own() -> None:
    knots = len(trajectory().modes)
    rising = np.linspace(0.02, 0.1, knots)
    arm = ArmTrajectory(
        ("j",), np.zeros((knots, 1)), rising, (None, *(0.001 * k for k in range(1, knots))), 0.001, ("a", "b"), 1, 0.0
    )
    block = drawn(1, arm=arm)
    (manipulability,), (clearance,) = (marks(block.chart, Curve, number) for number in (0, 1))
    assert (np.diff(manipulability.y) > 0).all()
    assert len(clearance.x) == knots - 1, "where nothing can meet there is no clearance"
    assert "clearance" in words_of(block)
    assert "[mm]" in words_of(block)


def test_no_plan_has_no_charts() -> None:
    assert plan_charts(Plan("no_plan", "no mode reaches the goal"), problem()) == []


def test_a_plan_that_never_leaves_its_place_is_drawn() -> None:
    still = trajectory(2)
    assert step_times(still)[-1] == 2
    block = drawn(trajectory=still)
    (curve,) = marks(block.chart, Curve, 0)
    assert len(curve.x) == len(block.keyframes) - 1 == 4


def test_a_run_has_its_number_and_makes_its_panel_high_enough() -> None:
    run = np.linspace(0.0, 3.0, 30)[:, None]
    (block,) = plan_charts(solved(), problem(confidence=CONFIDENCE), [DrawnRun(7, run)])
    curve = next(mark for mark in marks(block.chart, Curve, 0) if mark.look == "run")
    assert curve.run == 7
    np.testing.assert_array_equal(curve.y, run[:, 0])
    assert block.chart.panels[0].high > 3.0
    assert block.chart.last == max(29, step_times(trajectory())[-1])
