"""The charts on the page of a plan: curves where the numbers are, marks at goal and guards, in step with the player."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from scipy.stats import norm
from view_objects import OPEN_AT, problem, solved, trajectory, words_of

from micah_plan.task.plan import ArmTrajectory, Plan
from micah_plan.view.motion import duration, knot_times, step_times, stretches
from micah_plan.view.plan_charts import plan_charts

Element = ElementTree.Element
CONFIDENCE = 0.9


def drawn(number: int = 0, **changes) -> tuple[Element, str, np.ndarray]:
    """One block's drawing, the words around it, and its cursor's (time, x)."""
    block = plan_charts(solved(**changes), problem(confidence=CONFIDENCE))[number]
    parsed = ElementTree.fromstring(block.drawing)  # noqa: S314 (our own drawing)
    return parsed, words_of(block), np.array(block.keyframes)


def of_class(drawing: Element, name: str) -> list[Element]:
    return [element for element in drawing.iter() if element.get("class") == name]


def points(element: Element) -> np.ndarray:
    """The corners of a path."""
    return np.array(re.findall(r"([-\d.]+) ([-\d.]+)", element.get("d", "")), dtype=float)


def heights(drawing: Element, *values: float) -> np.ndarray:
    """Where values of the coordinate lie in the first panel, told by the mean's curve alone."""
    curve, mean = points(of_class(drawing, "line")[0])[:, 1], trajectory().means[:, 0]
    slope, offset = np.polyfit(mean, curve, 1)
    return slope * np.array(values) + offset


def test_the_curves_are_the_belief() -> None:
    drawing, _, _ = drawn()
    mean, spread = trajectory().means[:, 0], norm.ppf(CONFIDENCE) * trajectory().factors[:, 0, 0]
    curve, area = points(of_class(drawing, "line")[0]), points(of_class(drawing, "spread")[0])
    np.testing.assert_allclose(curve[:, 1], heights(drawing, *mean), atol=0.1)
    np.testing.assert_allclose(area[: len(mean), 1], heights(drawing, *(mean + spread)), atol=0.15)
    np.testing.assert_allclose(area[len(mean) :, 1][::-1], heights(drawing, *(mean - spread)), atol=0.15)
    below = points(of_class(drawing, "line")[1])[:, 1]
    assert np.corrcoef(below, spread)[0, 1] == pytest.approx(-1.0, abs=1e-3), "σ goes up where the belief is wide"


def test_goal_and_guard_are_marked_at_their_values() -> None:
    drawing, words, _ = drawn()
    (band,) = of_class(drawing, "level")
    top, bottom = heights(drawing, OPEN_AT + 0.02, OPEN_AT - 0.02)
    assert float(band.get("y", "nan")) == pytest.approx(top, abs=0.15)
    assert float(band.get("height", "nan")) == pytest.approx(bottom - top, abs=0.2)
    (guard,) = of_class(drawing, "guard")
    assert float(guard.get("y1", "nan")) == pytest.approx(heights(drawing, OPEN_AT)[0], abs=0.15)
    assert "± 1.28 σ, the room that a confidence of 90 % asks for" in words


def test_the_line_of_the_player_stands_at_the_step_that_is_shown() -> None:
    drawing, _, cursor = drawn()
    np.testing.assert_allclose(cursor[:-1, 0], knot_times(trajectory()))
    np.testing.assert_allclose(cursor[:-1, 1], points(of_class(drawing, "line")[0])[:, 0], atol=0.06)
    assert cursor[-1].tolist() == pytest.approx([duration(trajectory()), cursor[-2, 1]]), "it rests at the end"
    assert (np.diff(cursor[:, 0]) > 0).all()


def test_modes_shade_the_steps_that_they_govern() -> None:
    drawing, _, cursor = drawn()
    modes = trajectory().modes
    change = modes.index("stopped")
    assert stretches(modes) == [(0, change), (change, len(modes) - 1)]
    swing, rest = of_class(drawing, "shade")[:2]
    assert float(rest.get("x", "nan")) == pytest.approx(cursor[change, 1], abs=0.1)
    assert float(swing.get("width", "nan")) == pytest.approx(cursor[change, 1] - cursor[0, 1], abs=0.1)


def test_an_arm_has_charts_of_its_own() -> None:
    knots = len(trajectory().modes)
    rising = np.linspace(0.02, 0.1, knots)
    arm = ArmTrajectory(
        ("j",), np.zeros((knots, 1)), rising, (None, *(0.001 * k for k in range(1, knots))), 0.001, ("a", "b"), 1, 0.0
    )
    drawing, words, _ = drawn(1, arm=arm)
    manipulability, clearance = (points(line) for line in of_class(drawing, "line"))
    assert (np.diff(manipulability[:, 1]) < 0).all()
    assert len(clearance) == knots - 1, "where nothing can meet there is no clearance"
    assert "clearance" in words
    assert "[mm]" in words


def test_no_plan_has_no_charts() -> None:
    assert plan_charts(Plan("no_plan", "no mode reaches the goal"), problem()) == []


def test_a_plan_that_never_leaves_its_place_is_drawn() -> None:
    still = trajectory(2)
    assert step_times(still)[-1] == 2
    drawing, _, cursor = drawn(trajectory=still)
    assert len(points(of_class(drawing, "line")[0])) == len(cursor) - 1 == 4
