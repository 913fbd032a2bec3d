"""A plan in the plane: its artists are the belief, the goal and the walls."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle

from micah_plan.documents.model import load_model
from micah_plan.documents.problem import load_problem
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.view.figures import belief_figure, is_plane, plot_plane

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def walls() -> Problem:
    return load_problem(ROOT / "problems" / "walled_domain.yaml")


def bump() -> Trajectory:
    """Against a wall at y = -20 and along it, with a tilted belief first."""
    means = np.array([[0.0, 0.0], [0.0, -25.0], [0.0, -20.0], [-5.0, -20.0]])
    factors = np.array([[[3.0, 0.0], [2.0, 1.0]], [[3.0, 0.0], [0.0, 2.0]], *[[[3.0, 0.0], [0.0, 0.1]]] * 2])
    inputs = np.array([[0.0, -25.0], [0.0, 0.0], [-5.0, 0.0]])
    modes = ("free", "free", "wall_y", "wall_y")
    return Trajectory(modes, means, factors, inputs, np.zeros((3, 2, 2)), np.array([False, True, False]))


def drawn(problem: Problem, executed: tuple[np.ndarray, ...] = ()) -> Figure:
    figure = Figure()
    plot_plane(figure.subplots(), problem, bump(), executed)
    return figure


def test_each_ellipse_is_one_standard_deviation(walls: Problem) -> None:
    ellipses = [patch for patch in drawn(walls).axes[0].patches if isinstance(patch, Ellipse)]
    trajectory = bump()
    for patch, mean, factor in zip(ellipses, trajectory.means, trajectory.factors, strict=True):
        turn = np.deg2rad(patch.angle)
        angles = np.linspace(0, 2 * np.pi, 7)
        local = np.stack([patch.width / 2 * np.cos(angles), patch.height / 2 * np.sin(angles)])
        points = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ local
        np.testing.assert_allclose(patch.center, mean)
        np.testing.assert_allclose(np.linalg.norm(np.linalg.solve(factor, points), axis=0), 1.0)


def test_goal_walls_and_runs_are_where_they_are(walls: Problem) -> None:
    run = np.array([[0.0, 1.0], [0.2, -20.0]])
    axes = drawn(walls, (run,)).axes[0]
    (goal,) = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    assert (*goal.get_xy(), goal.get_width(), goal.get_height()) == (-2.0, -2.0, 4.0, 4.0)
    mean, executed, wall_x, wall_y = axes.lines
    np.testing.assert_array_equal(np.array(mean.get_data()).T, bump().means)
    np.testing.assert_array_equal(np.array(executed.get_data()).T, run)
    assert set(wall_x.get_xdata()) == {-20.0}
    assert set(wall_y.get_ydata()) == {-20.0}
    assert not axes.images


def test_darkness_is_shaded_where_sensing_depends_on_the_place() -> None:
    dark = load_problem(ROOT / "problems" / "light_dark.yaml")
    trajectory = replace(bump(), modes=("floor",) * 4)
    axes = Figure().subplots()
    plot_plane(axes, dark, trajectory)
    (image,) = axes.images
    left, right, *_ = image.get_extent()
    shades = np.asarray(image.get_array()).mean(axis=0)
    assert left + (right - left) * np.argmin(shades) / (len(shades) - 1) == pytest.approx(5.0, abs=0.5)


def test_only_a_point_in_the_plane_is_drawn_in_the_plane(walls: Problem) -> None:
    assert is_plane(walls.automaton)
    assert not is_plane(load_model(ROOT / "models" / "cabinet.yaml"))
    assert not is_plane(load_model(ROOT / "models" / "drawer.yaml"))
    figure = belief_figure(walls, Plan("solved", "", bump()))
    assert len(figure.axes) == 3
