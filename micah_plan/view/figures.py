"""Charts as Matplotlib figures; figures of planned beliefs over steps and in the plane; writing of figures.

Figures are made without pyplot, so there is no global state.
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

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.files import replace_file
from micah_plan.recording.value import Recording
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem
from micah_plan.view.chart import (
    Area,
    Change,
    Chart,
    Columns,
    Curve,
    Level,
    Mark,
    Range,
    Span,
    Words,
    with_common_ranges,
)
from micah_plan.view.executed import run_configurations
from micah_plan.view.palette import BELIEF, EXECUTED, GOAL, GRID, GUARD, INK, MUTED, mode_colors
from micah_plan.view.placement import thresholds
from micah_plan.view.plan_charts import DrawnRun, belief_chart

_DPI = 150
# The view holds every mean and the ellipses that are not larger than this many times the median one. It is not much
# narrower than high, or vice versa.
_LARGE = 6.0
_NARROWEST = 0.8
_ROOM = 0.1
_SHADES = 60
_INCH_OF_PIXEL = 1.6 / 72  # of a page's column, as a figure shows it
PANEL_INK = "#3E4C59"
_CURVES: dict[str, dict[str, Any]] = {
    "line": {"lw": 2.0, "zorder": 4},
    "other": {"lw": 1.0, "color": MUTED, "zorder": 2},
    "run": {"lw": 1.1, "alpha": 0.85, "zorder": 3},
    "trend": {"lw": 1.4, "zorder": 3},
    "dots": {"ls": "", "marker": "o", "ms": 4.0, "zorder": 3},
    "small": {"ls": "", "marker": ".", "ms": 3.5, "zorder": 3},
    "rim": {"ls": "", "marker": "o", "ms": 5.6, "zorder": 3},
}
_SPANS: dict[str, dict[str, Any]] = {
    "shade": {"alpha": 0.15, "zorder": 0},
    "hatched": {"alpha": 0.35, "hatch": "///", "zorder": 0},
    "interval": {"alpha": 0.16, "zorder": 1},
}
_LEVELS: dict[str, dict[str, Any]] = {
    "guard": {"color": GUARD, "ls": "--", "lw": 1.1},
    "zero": {"color": GRID, "lw": 0.8},
}


def draw(chart: Chart, axes: Sequence[Axes]) -> None:
    """The marks of a chart's panels in as many axes, which share the axis of x.

    Args:
        chart: as a page shows it.
        axes: from the top panel down.
    """
    for panel, place in zip(chart.panels, axes, strict=True):
        place.spines[["top", "right"]].set_visible(False)
        place.spines[["left", "bottom"]].set_color(MUTED)
        place.tick_params(labelsize=9, color=MUTED, labelcolor=PANEL_INK, labelbottom=place is axes[-1])
        place.set(xlim=(chart.first, chart.last), ylim=(panel.low, panel.high))
        place.set_ylabel(panel.label, color=PANEL_INK, fontsize=9)
        place.yaxis.set_major_locator(MaxNLocator(nbins=4 if panel.height > 80 else 2))
        for mark in panel.marks:
            _mark(place, mark)
    axes[-1].set_xlabel(chart.x_label, color=PANEL_INK)
    axes[-1].xaxis.set_major_locator(MaxNLocator(nbins=9, steps=[1, 2, 5, 10], integer=chart.whole))


def _mark(axes: Axes, mark: Mark) -> None:
    """Draw one mark; labels that Matplotlib knows already are not repeated in the legend."""
    named = getattr(mark, "label", "")
    label: dict[str, Any] = {"label": named} if named else {}
    match mark:
        case Curve():
            axes.plot(mark.x, mark.y, **({"color": mark.color or INK} | _CURVES[mark.look]), **label)
        case Area():
            alpha = {"spread": 0.28, "level": 0.75}[mark.look]
            axes.fill_between(mark.x, mark.low, mark.high, color=mark.color, alpha=alpha, lw=0, **label)
        case Span():
            axes.axvspan(mark.start, mark.end, color=mark.color or INK, lw=0, **_SPANS[mark.look], **label)
        case Range():
            axes.axhspan(mark.low, mark.high, color=mark.color, alpha=0.3, lw=0, zorder=1, **label)
        case Level():
            axes.axhline(mark.value, zorder=2, **_LEVELS[mark.look], **label)
        case Change():
            axes.axvline(mark.at, color=INK, lw=1.0, ls=(0, (4, 2)), zorder=2)
        case Columns():
            axes.bar(mark.left, mark.height, width=mark.right - mark.left, align="edge", color=INK, lw=0, zorder=3)
        case Words():
            _annotate(axes, mark)


def _annotate(axes: Axes, words: Words) -> None:
    """Draw words at their place in a panel, or above it."""
    shift = {"middle": 0, "left": -4, "right": 4, "edge": 5}[words.side]
    align = {"middle": "center", "left": "right", "right": "left", "edge": "left"}[words.side]
    box = {"facecolor": words.color, "edgecolor": "none", "pad": 1.5} if words.color else None
    look: dict[str, Any] = {"weight": "bold", "color": INK} if words.strong else {"color": PANEL_INK}
    above, edge = words.y is None, words.side == "edge"
    place = 1.0 if edge else words.x, 1.0 if words.y is None else words.y
    coordinates = "axes fraction" if edge else "data", "axes fraction" if above else "data"
    offset = shift, 5 + 14 * words.line if above else 0
    axes.annotate(
        words.text, place, offset, xycoords=coordinates, textcoords="offset points", ha=align,
        va="baseline" if above else "center", fontsize=9.5 if above else 8.5, bbox=box, annotation_clip=False, **look,
    )  # fmt: skip


def chart_figure(charts: Sequence[Chart], *, across: bool = False) -> Figure:
    """Charts in a column or in a row, with one legend.

    Args:
        charts: at least one.
        across: whether they are side by side and share their ranges of y; then all have the same panels.
    """
    rows = [panel.height for chart in (charts[:1] if across else charts) for panel in chart.panels]
    size = max(8.0, 3.4 * len(charts)) if across else 8.0, 1.2 + _INCH_OF_PIXEL * sum(rows)
    figure = empty_figure(size, layout="constrained")
    grid = figure.subplots(len(rows), len(charts) if across else 1, squeeze=False, height_ratios=rows)
    first = 0
    for number, chart in enumerate(with_common_ranges(charts) if across else charts):
        axes = list(grid[:, number] if across else grid[first : first + len(chart.panels), 0])
        draw(chart, axes)
        first += len(chart.panels)
        for place in axes if across and number else ():
            place.set_ylabel("")
            place.tick_params(labelleft=False)
    _legend(figure, list(grid.flat), loc="outside upper center", ncols=4, fontsize=9)
    return figure


def belief_figure(problem: Problem, plan: Plan, runs: Recording | None = None) -> Figure:
    """The planned belief against the executed trajectories, one panel per coordinate, as on the page of the plan.

    For a point in the plane, one more axes shows the plane itself, with the belief's ellipses. The executed
    trajectories are the columns ``true_<coordinate>`` of `runs` where it has them, else the measured configurations.

    Raises:
        InputError: if the plan has no trajectory.
    """
    problem = pre_release_problem(problem)
    if plan.trajectory is None:
        raise InputError(
            f"a plan with outcome '{plan.outcome}' has no belief to draw", remedy="solve the problem first"
        )
    automaton, trajectory = problem.automaton, plan.trajectory.of_first(problem.automaton.n)
    executed = [] if runs is None else run_configurations(problem, runs)
    chart = belief_chart(problem, trajectory, [DrawnRun(k, x) for k, x in enumerate(executed)], spreads=False)
    if not is_plane(automaton):
        return chart_figure([chart])
    figure = empty_figure((14.0, 7.2), layout="constrained")
    columns = figure.add_gridspec(2, 2, width_ratios=(6.0, 8.0))
    plot_plane(figure.add_subplot(columns[:, 0]), problem, trajectory, executed)
    upper = figure.add_subplot(columns[0, 1])
    axes = [upper, figure.add_subplot(columns[1, 1], sharex=upper)]
    draw(chart, axes)
    _legend(upper, axes, loc="lower center", bbox_to_anchor=(0.5, 1.05), ncols=4, fontsize=9)
    return figure


def _legend(place: Any, panels: Sequence[Axes], **look: Any) -> None:
    """Legend with one entry per label over all panels."""
    named = {label: mark for axes in panels for mark, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if named:
        place.legend(named.values(), named.keys(), frameon=False, **look)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a PNG at 150 dpi, atomically; equal figures give equal bytes.

    Raises:
        InputError: if the file cannot be written.
    """
    replace_file(path, png(figure))


def png(figure: Figure) -> bytes:
    """The PNG bytes of a figure, as `save_figure` writes them."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=_DPI, format="png", metadata={"Software": None})
    return buffer.getvalue()


def empty_figure(size: tuple[float, float], **options: Any) -> Figure:
    """A white figure of a width and height [in]."""
    figure = Figure(figsize=size, facecolor="white", **options)
    FigureCanvasAgg(figure)
    return figure


def is_plane(automaton: HybridAutomaton) -> bool:
    """Whether the object is a point in the plane: two coordinates that slide at right angles to each other."""
    if automaton.n != 2 or {c.unit for c in automaton.coordinates} != {"m"} or len(automaton.links) != 2:
        return False
    joints = automaton.modes[0].joints
    slides = all(joint.slides for joint in joints)
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
    _legend(axes, [axes], loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8)


def _ellipse(mean: Floats, factor: Floats, color: str, label: str) -> Ellipse:
    """{x: (x - mean)' (L L')⁻¹ (x - mean) = 1}."""
    axes, radii, _ = np.linalg.svd(factor)
    angle = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
    width, height = (2.0 * radii).tolist()
    center = float(mean[0]), float(mean[1])
    return Ellipse(center, width, height, angle=angle, fill=False, ec=color, lw=1.0, label=label, zorder=3)


def _show(axes: Axes, trajectory: Trajectory) -> None:
    """Set the view limits; the first ellipse and distant runs may exceed them."""
    stds = np.linalg.norm(trajectory.factors, axis=2)
    shown = stds.max(axis=1) <= _LARGE * np.median(stds.max(axis=1))
    points = np.concatenate([trajectory.means, (trajectory.means + stds)[shown], (trajectory.means - stds)[shown]])
    center, half = (points.min(axis=0) + points.max(axis=0)) / 2, np.ptp(points, axis=0) / 2
    half = np.maximum(half, _NARROWEST * half.max()) + _ROOM * half.max()
    axes.set_xlim(center[0] - half[0], center[0] + half[0])
    axes.set_ylim(center[1] - half[1], center[1] + half[1])


def _draw_light(axes: Axes, problem: Problem) -> None:
    """Shade places with worse measurements, where the noise depends on the place."""
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
