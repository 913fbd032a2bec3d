"""The figures: their artists are the data."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imread
from scipy.stats import norm
from view_objects import OPEN_AT, door, measured, problem, solved, trajectory

from micah_plan.errors import InputError
from micah_plan.recording.value import Recording
from micah_plan.task.plan import Plan
from micah_plan.view.chart import Chart, Curve, Level, Panel, widened, with_common_ranges
from micah_plan.view.executed import run_configurations
from micah_plan.view.figures import belief_figure, chart_figure, save_figure
from micah_plan.view.learning_figure import learning_figure
from micah_plan.view.palette import BELIEF, EXECUTED


def executed(runs: int = 3, *, true_column: bool = False) -> Recording:
    one, _ = measured(rows=22, noise=0.0)
    count = 22 * runs
    repeated = one.rows(np.tile(np.arange(22), runs))
    extra = {"true_door": tuple(f"{0.01 * i:.3f}" for i in range(count))} if true_column else {}
    return dataclasses.replace(repeated, run=np.repeat(np.arange(runs), 22), has_run=True, extra=extra)


def belief_of(figure: Figure) -> tuple[np.ndarray, np.ndarray]:
    """The points (k, 2) of the mean, and of the corners of the area around it."""
    (area,) = (one for one in figure.axes[0].collections if str(one.get_label()).startswith("belief"))
    mean = next(line for line in figure.axes[0].lines if to_hex(line.get_color()) == BELIEF.lower())
    return np.transpose(mean.get_data()), area.get_paths()[0].vertices


@pytest.mark.parametrize("confidence", [0.9, 0.99])
def test_the_area_is_k_sigma_of_the_plan(confidence: float) -> None:
    mean, corners = belief_of(belief_figure(problem(confidence=confidence), solved()))
    plan = trajectory()
    np.testing.assert_allclose(mean[:, 1], plan.means[:, 0])
    half = norm.ppf(confidence) * plan.factors[:, 0, 0]
    for (step, value), around in zip(mean, half, strict=True):
        for edge in (value - around, value + around):
            assert np.abs(corners - (step, edge)).max(axis=1).min() < 1e-9


def test_a_transition_takes_no_step() -> None:
    mean, _ = belief_of(belief_figure(problem(), solved()))
    np.testing.assert_array_equal(mean[:, 0], [*range(20), 19, 20])


def test_each_run_is_one_line_of_measured_configurations() -> None:
    figure = belief_figure(problem(), solved(), executed(3))
    lines = [line for line in figure.axes[0].lines if to_hex(line.get_color()) == EXECUTED.lower()]
    assert len(lines) == 3
    np.testing.assert_allclose(lines[1].get_ydata(), np.r_[np.linspace(0, OPEN_AT, 14), [OPEN_AT] * 8], atol=1e-9)


def test_true_columns_are_preferred_to_measurements() -> None:
    x = run_configurations(problem(), executed(2, true_column=True))
    np.testing.assert_allclose(x[1][:, 0], 0.01 * np.arange(22, 44))


def test_goal_guard_and_modes_are_marked() -> None:
    axes = belief_figure(problem(), solved()).axes[0]
    assert [text.get_text() for text in axes.texts] == ["swinging", "stopped"]
    goal = next(patch for patch in axes.patches if patch.get_label() == "goal")
    box = goal.get_bbox()
    assert (box.y0, box.y1) == pytest.approx((OPEN_AT - 0.02, OPEN_AT + 0.02))
    guard = next(line for line in axes.lines if line.get_label() == "guard")
    np.testing.assert_allclose(guard.get_ydata(), OPEN_AT)
    assert axes.get_ylabel() == "door\n[rad]"


def test_a_plan_without_trajectory_cannot_be_drawn() -> None:
    with pytest.raises(InputError, match="no_plan"):
        belief_figure(problem(door()), Plan("no_plan", "none"))


def test_files_are_not_blank_and_the_same_every_time(tmp_path: Path) -> None:
    recording, graph = measured()
    for name in ("a.png", "b.png"):
        save_figure(learning_figure(recording, graph), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    picture = imread(tmp_path / "a.png")
    assert picture.shape[1] == 1650
    ink = (picture[..., :3] < 0.9).any(axis=-1)
    assert 0.01 < ink.mean() < 0.5
    assert b"tIME" not in (tmp_path / "a.png").read_bytes()


def test_charts_side_by_side_share_their_ranges_and_one_legend() -> None:
    x = np.arange(5.0)
    marks = Level(1.0, label="guard"), Curve(x, x, label="way")
    panels = [Panel("y", low, low + 1, 96.0, marks) for low in (0.0, 3.0)]
    charts = [Chart("", "time [s]", 0.0, 4.0, (panel,)) for panel in panels]
    figure = chart_figure(charts, across=True)
    assert [axes.get_ylim() for axes in figure.axes] == [(0.0, 4.0)] * 2
    assert [axes.get_ylabel() for axes in figure.axes] == ["y", ""]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["guard", "way"]
    assert [panel.low for chart in with_common_ranges(charts) for panel in chart.panels] == [0.0, 0.0]
    assert len(chart_figure(charts).axes) == 2, "below each other each keeps its own"


@pytest.mark.parametrize("last", [1.0, 2.5, 7.5, 14.0, 250.0])
def test_an_axis_of_steps_has_no_half_ones(last: float) -> None:
    panel = Panel("y", 0.0, 1.0, 80.0, (Curve(np.array([0.0, last]), np.array([0.0, 1.0])),))
    figures = [chart_figure([Chart("", "x", 0.0, last, (panel,), whole=whole)]) for whole in (True, False)]
    whole, any_number = ([t for t in f.axes[0].get_xticks() if t <= last] for f in figures)
    assert len(whole) >= 2
    assert np.array_equal(whole, np.round(whole))
    assert last > 5 or not np.array_equal(any_number, np.round(any_number)), "else there would be nothing to see to"


def test_what_was_not_measured_is_left_out() -> None:
    curve = Curve(np.arange(4.0), np.array([0.0, np.nan, 2.0, np.inf]))
    assert (curve.x.tolist(), curve.y.tolist()) == ([0.0, 2.0], [0.0, 2.0])
    assert widened([np.array([np.nan, 1.0]), 3.0], 0.5) == (0.0, 4.0)
    low, high = widened([np.array([np.nan])])
    assert low < 0.0 < high


def test_a_curve_of_many_points_is_thinned_and_keeps_its_ends() -> None:
    x = np.linspace(0.0, 7.0, 100_001)
    curve = Curve(x, np.sin(x))
    assert len(curve.x) == len(curve.y) == 600
    assert (curve.x[0], curve.x[-1]) == (0.0, 7.0)
    np.testing.assert_allclose(curve.y, np.sin(curve.x))
