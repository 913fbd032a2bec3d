"""The figures: their artists are the data."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.image import imread
from scipy.stats import norm
from view_objects import OPEN_AT, door, measured, problem, solved, trajectory

from micah_plan.errors import InputError
from micah_plan.recording.value import Recording
from micah_plan.task.plan import Plan
from micah_plan.view.executed import configurations
from micah_plan.view.figures import belief_figure, save_figure
from micah_plan.view.learning_figure import learning_figure
from micah_plan.view.palette import EXECUTED


def executed(runs: int = 3, *, true_column: bool = False) -> Recording:
    one, _ = measured(rows=22, noise=0.0)
    count = 22 * runs
    repeated = one.rows(np.tile(np.arange(22), runs))
    extra = {"true_door": tuple(f"{0.01 * i:.3f}" for i in range(count))} if true_column else {}
    return dataclasses.replace(repeated, run=np.repeat(np.arange(runs), 22), has_run=True, extra=extra)


def errorbars(figure: Figure) -> ErrorbarContainer:
    return next(c for c in figure.axes[0].containers if isinstance(c, ErrorbarContainer))


@pytest.mark.parametrize("confidence", [0.9, 0.99])
def test_error_bars_are_k_sigma_of_the_plan(confidence: float) -> None:
    container = errorbars(belief_figure(problem(confidence=confidence), solved()))
    line, _, (bars,) = container
    plan = trajectory()
    np.testing.assert_allclose(line.get_ydata(), plan.means[:, 0])
    half = norm.ppf(confidence) * plan.factors[:, 0, 0]
    segments = np.array(bars.get_segments())
    np.testing.assert_allclose(segments[:, 0, 1], plan.means[:, 0] - half)
    np.testing.assert_allclose(segments[:, 1, 1], plan.means[:, 0] + half)


def test_a_transition_takes_no_step() -> None:
    line = errorbars(belief_figure(problem(), solved()))[0]
    np.testing.assert_array_equal(line.get_xdata(), [*range(20), 19, 20])


def test_each_run_is_one_line_of_measured_configurations() -> None:
    figure = belief_figure(problem(), solved(), executed(3))
    lines = [line for line in figure.axes[0].lines if to_hex(line.get_color()) == EXECUTED.lower()]
    assert len(lines) == 3
    np.testing.assert_allclose(lines[1].get_ydata(), np.r_[np.linspace(0, OPEN_AT, 14), [OPEN_AT] * 8], atol=1e-9)


def test_true_columns_are_preferred_to_measurements() -> None:
    x = configurations(problem(), executed(2, true_column=True))
    np.testing.assert_allclose(x[1][:, 0], 0.01 * np.arange(22, 44))


def test_goal_guard_and_modes_are_marked() -> None:
    axes = belief_figure(problem(), solved()).axes[0]
    assert [text.get_text() for text in axes.texts] == ["swinging", "stopped"]
    goal = next(patch for patch in axes.patches if patch.get_label() == "goal")
    box = goal.get_bbox()
    assert (box.y0, box.y1) == pytest.approx((OPEN_AT - 0.02, OPEN_AT + 0.02))
    guard = next(line for line in axes.lines if line.get_label() == "guard")
    np.testing.assert_allclose(guard.get_ydata(), OPEN_AT)
    assert axes.get_ylabel() == "door [rad]"


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
