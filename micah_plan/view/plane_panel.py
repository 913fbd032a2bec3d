"""A plan in the plane: the belief's ellipses from knot to knot, walls, light and goal, and the executed paths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Rectangle
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem
from micah_plan.view.model_page import mode_colors
from micah_plan.view.palette import BELIEF, EXECUTED, GOAL, GUARD, INK
from micah_plan.view.placement import thresholds

Floats = NDArray[np.float64]

# The view holds every mean and the ellipses that are not larger than this many times the median one. It is not much
# narrower than high, or the other way round.
_LARGE = 6.0
_NARROWEST = 0.8
_ROOM = 0.1
_SHADES = 60


def is_plane(automaton: HybridAutomaton) -> bool:
    """Whether the object is a point in the plane: two coordinates that slide at right angles to each other."""
    if automaton.n != 2 or {c.unit for c in automaton.coordinates} != {"m"} or len(automaton.links) != 2:
        return False
    joints = automaton.modes[0].joints
    slides = all(joint.kind == "prismatic" for joint in joints)
    return slides and abs(float(np.dot(joints[0].axis, joints[1].axis))) < 1e-9


def plot_plane(axes: Axes, problem: Problem, trajectory: Trajectory, executed: Sequence[Floats] = ()) -> None:
    """The trajectory with the 1 σ ellipse of each knot in the colour of its mode.

    Args:
        executed: (T, 2) true or measured configurations of runs [m].
    """
    automaton = problem.automaton
    colors = mode_colors(automaton)
    named: set[str] = set()
    for mode, mean, factor in zip(trajectory.modes, trajectory.means, trajectory.factors, strict=True):
        label = "" if mode in named else f"belief in {mode}, 1 σ"
        named.add(mode)
        axes.add_patch(_ellipse(mean, factor, colors[mode], label))
    axes.plot(*trajectory.means.T, color=BELIEF, lw=1.6, marker=".", ms=3.5, zorder=5)
    for number, x in enumerate(executed):
        axes.plot(*x.T, color=EXECUTED, lw=0.9, alpha=0.85, label="" if number else "executed", zorder=4)
    _show(axes, trajectory)
    _draw_light(axes, problem)
    _draw_goal_and_walls(axes, problem)
    axes.set_aspect("equal", adjustable="box")
    for name, coordinate in zip(("x", "y"), automaton.coordinates, strict=True):
        axes.set(**{f"{name}label": f"{coordinate.name} [{coordinate.unit}]"})
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8)


def _ellipse(mean: Floats, factor: Floats, color: str, label: str) -> Ellipse:
    """{x: (x - mean)' (L L')⁻¹ (x - mean) = 1}."""
    axes, radii, _ = np.linalg.svd(factor)
    angle = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
    width, height = (2.0 * radii).tolist()
    center = float(mean[0]), float(mean[1])
    return Ellipse(center, width, height, angle=angle, fill=False, ec=color, lw=1.0, label=label, zorder=3)


def _show(axes: Axes, trajectory: Trajectory) -> None:
    """The view; a first ellipse and runs that begin far away may reach out of it."""
    stds = np.linalg.norm(trajectory.factors, axis=2)
    shown = stds.max(axis=1) <= _LARGE * np.median(stds.max(axis=1))
    points = np.concatenate([trajectory.means, (trajectory.means + stds)[shown], (trajectory.means - stds)[shown]])
    center, half = (points.min(axis=0) + points.max(axis=0)) / 2, np.ptp(points, axis=0) / 2
    half = np.maximum(half, _NARROWEST * half.max()) + _ROOM * half.max()
    axes.set_xlim(center[0] - half[0], center[0] + half[0])
    axes.set_ylim(center[1] - half[1], center[1] + half[1])


def _draw_light(axes: Axes, problem: Problem) -> None:
    """Darker where measurements are worse, if that depends on the place."""
    automaton = problem.automaton
    sensing = automaton.sensing(automaton.modes[0])
    if sensing.is_uniform:
        return
    x, y = (np.linspace(*ends, _SHADES) for ends in (axes.get_xlim(), axes.get_ylim()))
    std = sensing.std_at(np.stack(np.meshgrid(x, y), axis=-1)).mean(axis=-1)
    ends = (x[0], x[-1], y[0], y[-1])
    axes.imshow(std, cmap="Greys", alpha=0.55, origin="lower", extent=ends, zorder=0, interpolation="bilinear")
    axes.annotate("darker: worse measurements", (0.02, 0.02), xycoords="axes fraction", fontsize=8, color=INK)


def _draw_goal_and_walls(axes: Axes, problem: Problem) -> None:
    bounds = {index: (value - tol, value + tol) for index, value, tol in problem.goal.target}
    (left, right), (low, high) = bounds.get(0, axes.get_xlim()), bounds.get(1, axes.get_ylim())
    size = right - left, high - low
    axes.add_patch(Rectangle((left, low), *size, fc=GOAL, ec=GOAL, alpha=0.45, label="goal", zorder=2))
    lines = (axes.axvline, axes.axhline)
    marks = sorted({(mark.coordinate, mark.value) for mark in thresholds(problem.automaton)})
    for number, (coordinate, value) in enumerate(marks):
        lines[coordinate](value, color=GUARD, lw=2.0, label="" if number else "guard", zorder=1)
