"""The figure of a planned belief against what was executed, over the steps and in the plane; how figures are written.

Figures are made without pyplot, so nothing global is opened or left open.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.files import replace_file
from micah_plan.quantities import count, percent, plain
from micah_plan.recording.value import Recording
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import carrying
from micah_plan.view.executed import configurations
from micah_plan.view.motion import step_times, stretches
from micah_plan.view.palette import BELIEF, EXECUTED, GOAL, GUARD, INK, mode_colors
from micah_plan.view.placement import guards_of, thresholds
from micah_plan.view.plan_charts import step_label

_DPI = 150
_MOST_BARS = 30
# The view holds every mean and the ellipses that are not larger than this many times the median one. It is not much
# narrower than high, or the other way round.
_LARGE = 6.0
_NARROWEST = 0.8
_ROOM = 0.1
_SHADES = 60


def belief_figure(problem: Problem, plan: Plan, runs: Recording | None = None) -> Figure:
    """The planned belief with error bars against the executed trajectories, one axes per coordinate.

    Of a point in the plane, one more axes shows the plane itself, with the belief's ellipses.

    Error bars are ± k σ with Phi(k) = the problem's confidence: the margin that the plan keeps to guards and goal. The
    executed trajectories are the columns ``true_<coordinate>`` of `runs` where it has them, else the measured
    configurations.

    Raises:
        InputError: if the plan has no trajectory.
    """
    problem = carrying(problem)
    if plan.trajectory is None:
        raise InputError(
            f"a plan with outcome '{plan.outcome}' has no belief to draw", remedy="solve the problem first"
        )
    automaton, trajectory = problem.automaton, plan.trajectory.of_first(problem.automaton.n)
    executed = [] if runs is None else configurations(problem, runs)
    figure, grid = _with_plane(problem, trajectory, executed) if is_plane(automaton) else _stacked(automaton.n)
    steps, colors, settings = step_times(trajectory), mode_colors(automaton), problem.settings
    bands = [(trajectory.modes[i], float(steps[i]), float(steps[j])) for i, j in stretches(trajectory.modes)]
    margin = f"± {plain(settings.sigmas)} σ (confidence {percent(settings.confidence)})"
    bars = settings.sigmas * np.sqrt((trajectory.factors**2).sum(axis=2))
    _name_modes(grid[0], bands)
    for i, (axes, coordinate) in enumerate(zip(grid, automaton.coordinates, strict=True)):
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.02)
        for name, left, right in bands:
            axes.axvspan(left, right, color=colors[name], alpha=0.16, lw=0, zorder=0)
        _mark_goal_and_guards(axes, problem, i)
        for x in executed:
            label = f"executed ({count(len(executed), 'run')})" if len(executed) > 1 else "executed"
            axes.plot(x[:, i], color=EXECUTED, lw=1.1, alpha=0.85, label=label, zorder=3)
        _plot_belief(axes, steps, trajectory.means[:, i], bars[:, i], margin)
        axes.set_ylabel(f"{coordinate.name} [{coordinate.unit}]")
    grid[-1].set_xlabel(step_label(problem))
    grid[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    _legend(grid[0], grid, bbox_to_anchor=(0.5, 1.05), ncols=4, fontsize=9)
    return figure


def _legend(place: Axes, panels: Sequence[Axes], **look: Any) -> None:
    """One entry for everything that has the same label in any of the panels."""
    named = {label: mark for axes in panels for mark, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    place.legend(named.values(), named.keys(), loc="lower center", frameon=False, **look)


def _plot_belief(axes: Axes, steps: NDArray[np.int64], mean: Floats, bars: Floats, margin: str) -> None:
    """Mean (K,) with error bars (K,), or with a band where bars would stand too close."""
    look: dict[str, Any] = {"color": BELIEF, "lw": 1.8, "label": f"belief, {margin}", "zorder": 4}
    if int(steps[-1]) > _MOST_BARS:
        axes.fill_between(steps, mean - bars, mean + bars, color=BELIEF, alpha=0.28, lw=0, zorder=3)
        axes.plot(steps, mean, **look)
    else:
        axes.errorbar(steps, mean, yerr=bars, elinewidth=1.0, capsize=2.5, **look)


def _stacked(n: int) -> tuple[Figure, list[Axes]]:
    """A figure with n axes below each other."""
    figure = empty_figure((8.0, 1.6 + (2.8 if n < 4 else 1.9) * n), layout="constrained")
    return figure, list(figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0])


def _with_plane(problem: Problem, trajectory: Trajectory, executed: list[Floats]) -> tuple[Figure, list[Axes]]:
    """A figure with the plane on the left, and two axes below each other for the coordinates."""
    figure = empty_figure((14.0, 7.2), layout="constrained")
    columns = figure.add_gridspec(2, 2, width_ratios=(6.0, 8.0))
    plot_plane(figure.add_subplot(columns[:, 0]), problem, trajectory, executed)
    upper = figure.add_subplot(columns[0, 1])
    return figure, [upper, figure.add_subplot(columns[1, 1], sharex=upper)]


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a PNG at 150 dpi, at once or not at all; the same figure gives the same bytes.

    Raises:
        InputError: if the file cannot be written.
    """
    replace_file(path, png(figure))


def png(figure: Figure) -> bytes:
    """What `save_figure` writes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=_DPI, format="png", metadata={"Software": None})
    return buffer.getvalue()


def empty_figure(size: tuple[float, float], **options: Any) -> Figure:
    """A white figure of a width and height [in]."""
    figure = Figure(figsize=size, facecolor="white", **options)
    FigureCanvasAgg(figure)
    return figure


def _name_modes(axes: Axes, bands: list[tuple[str, float, float]]) -> None:
    """The names of the modes above their bands; those of narrow bands in a row end together where the last one ends."""
    narrow = [right - left < 0.15 * bands[-1][2] for _, left, right in bands]
    waiting: list[str] = []
    for number, (name, left, right) in enumerate(bands):
        waiting.append(name)
        if narrow[number] and any(narrow[number + 1 : number + 2]):
            continue
        place, side, shift = (right, "right", -2) if narrow[number] else (left, "left", 2)
        axes.annotate(
            ", ".join(waiting), (place, 1.01), (shift, 0), xycoords=("data", "axes fraction"),
            textcoords="offset points", ha=side, fontsize=9, color=INK,
        )  # fmt: skip
        waiting = []


def _mark_goal_and_guards(axes: Axes, problem: Problem, coordinate: int) -> None:
    for index, value, tolerance in problem.goal.target:
        if index == coordinate:
            axes.axhspan(value - tolerance, value + tolerance, color=GOAL, alpha=0.3, lw=0, label="goal", zorder=1)
            axes.axhline(value, color=GOAL, lw=0.8, zorder=1)
    for value in guards_of(problem.automaton, coordinate):
        axes.axhline(value, color=GUARD, lw=1.1, ls="--", label="guard", zorder=2)


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
    for mode, mean, factor in zip(trajectory.modes, trajectory.means, trajectory.factors, strict=True):
        axes.add_patch(_ellipse(mean, factor, colors[mode], f"belief in {mode}, 1 σ"))
    axes.plot(*trajectory.means.T, color=BELIEF, lw=1.6, marker=".", ms=3.5, zorder=5)
    for x in executed:
        axes.plot(*x.T, color=EXECUTED, lw=0.9, alpha=0.85, label="executed", zorder=4)
    _show(axes, trajectory)
    _draw_light(axes, problem)
    _draw_goal_and_walls(axes, problem)
    axes.set_aspect("equal", adjustable="box")
    x_label, y_label = (f"{coordinate.name} [{coordinate.unit}]" for coordinate in automaton.coordinates)
    axes.set(xlabel=x_label, ylabel=y_label)
    _legend(axes, [axes], bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8)


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
    for coordinate, value in sorted({(mark.coordinate, mark.value) for mark in thresholds(problem.automaton)}):
        lines[coordinate](value, color=GUARD, lw=2.0, label="guard", zorder=1)
