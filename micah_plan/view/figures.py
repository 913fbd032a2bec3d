"""Figures: a recording by segment with its fitted joints, and a belief trajectory against what was executed.

The only importer of matplotlib. Figures are made without pyplot, so nothing global is opened or left open.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.stats import norm

from micah_plan.automaton.graph import KinematicGraph
from micah_plan.automaton.kinematics import inverse
from micah_plan.automaton.tracks import tracks
from micah_plan.errors import InputError
from micah_plan.planning.plan import Plan, Trajectory
from micah_plan.planning.problem import Problem
from micah_plan.recording.value import Recording
from micah_plan.view.drawing import circle, joint_axis, joint_curve, viewing_direction
from micah_plan.view.model_page import mode_colors
from micah_plan.view.palette import BELIEF, EXECUTED, GOAL, GRID, GUARD, INK, MUTED
from micah_plan.view.placement import thresholds
from micah_plan.view.plan_page import step_times
from micah_plan.view.recording_page import UNITS, ColoredSegment, colored_segments, parent_pose, rows_of
from micah_plan.view.text import percent

Floats = NDArray[np.float64]

_DPI = 150
_TRUE_COLUMN = "true_{}"


def segments_figure(recording: Recording, graph: KinematicGraph | None = None) -> Figure:
    """The track in 3-D coloured by segment with the fitted joints, and below it the configuration over the rows.

    As the paper's figure of inferred motion models: points, an arc for revolute, a line for prismatic, a circle for
    rigid. Without a graph the second part shows the coordinates x, y and z instead.
    """
    figure = _figure((11.0, 5.0))
    space = figure.add_subplot(1, 2, 1, projection="3d")
    rows_axes = figure.add_subplot(1, 2, 2)
    segments = colored_segments(graph)
    rest = np.ones(len(recording), dtype=bool)
    size = max(float(np.linalg.norm(np.ptp(recording.position, axis=0))), 1e-3)
    for colored in segments:
        rows = rows_of(recording, colored)
        rest[rows] = False
        space.scatter(*recording.position[rows].T, s=12, color=colored.color, label=colored.label, depthshade=False)
        _plot_joint(space, recording, colored, size)
    if rest.any():
        label = "rows of no segment" if segments else "measured positions"
        space.scatter(*recording.position[rest].T, s=9, color=MUTED, label=label, depthshade=False)
    _finish_space(space, recording.position)
    if segments:
        _plot_configuration(rows_axes, recording, segments)
    else:
        for name, values, style in zip("xyz", recording.position.T, ("-", "--", ":"), strict=True):
            rows_axes.plot(values, style, color=INK, label=name)
        rows_axes.set(xlabel="row", ylabel="position [m]")
        rows_axes.legend(frameon=False)
    return figure


def belief_figure(problem: Problem, plan: Plan, runs: Recording | None = None) -> Figure:
    """The planned belief with error bars against the executed trajectories, one axes per coordinate.

    Error bars are ± k σ with Phi(k) = the problem's confidence: the margin that the plan keeps to guards and goal. The
    executed trajectories are the columns ``true_<coordinate>`` of `runs` where it has them, else the measured
    configurations.

    Raises:
        InputError: if the plan has no trajectory.
    """
    if plan.trajectory is None:
        raise InputError(
            f"a plan with outcome '{plan.outcome}' has no belief to draw", remedy="solve the problem first"
        )
    automaton, trajectory = problem.automaton, plan.trajectory
    figure = _figure((8.0, 1.6 + 2.8 * automaton.n))
    grid = figure.subplots(automaton.n, 1, sharex=True, squeeze=False)[:, 0]
    steps = step_times(trajectory)
    k = float(norm.ppf(problem.settings.confidence))
    bars = k * np.sqrt((trajectory.factors**2).sum(axis=2))
    executed = [] if runs is None else executed_configurations(problem, runs)
    _name_modes(grid[0], trajectory, steps)
    for i, (axes, coordinate) in enumerate(zip(grid, automaton.coordinates, strict=True)):
        _shade_modes(axes, problem, trajectory, steps)
        _mark_goal_and_guards(axes, problem, i)
        for number, x in enumerate(executed):
            label = f"executed ({len(executed)} runs)" if len(executed) > 1 else "executed"
            axes.plot(x[:, i], color=EXECUTED, lw=1.1, alpha=0.85, label="" if number else label, zorder=3)
        axes.errorbar(
            steps, trajectory.means[:, i], yerr=bars[:, i], color=BELIEF, lw=1.8, elinewidth=1.0, capsize=2.5,
            label=f"belief, ± {k:.2f} σ ({percent(problem.settings.confidence)})", zorder=4,
        )  # fmt: skip
        axes.set_ylabel(f"{coordinate.name} [{coordinate.unit}]")
    grid[-1].set_xlabel("step")
    grid[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    grid[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.05), ncols=4, frameon=False, fontsize=9)
    return figure


def executed_configurations(problem: Problem, runs: Recording) -> list[Floats]:
    """(T, n) configurations [rad or m] of every run: the true ones if the recording tells them, else the measured."""
    found = []
    for track in tracks(problem.automaton, runs):
        x = track.x.copy()
        rows = runs.select(run=track.run)
        rows = rows.select(part=rows.parts[0])
        for i, coordinate in enumerate(problem.automaton.coordinates):
            column = rows.extra.get(_TRUE_COLUMN.format(coordinate.name))
            if column is not None:
                x[:, i] = [float(text) if text else np.nan for text in column]
        found.append(x)
    return found


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a PNG at 150 dpi; the same figure gives the same bytes."""
    figure.savefig(Path(path), dpi=_DPI, format="png", metadata={"Software": None})


def _figure(size: tuple[float, float]) -> Figure:
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _plot_joint(space: Any, recording: Recording, colored: ColoredSegment, size: float) -> None:
    """The fitted joint: arc, line or circle in ink over the points, and the axis of rotation."""
    joint = colored.segment.joint
    curve = joint_curve(joint, *colored.segment.configuration_range)
    if joint.kind == "rigid":
        curve = circle(curve[0], np.array([0.0, 0.0, 1.0]), 0.06 * size)
    pose = parent_pose(recording, colored)
    space.plot(*pose.apply(curve).T, color=INK, lw=1.6)
    axis = joint_axis(joint, 0.6 * size)
    if axis is not None and joint.kind != "prismatic":
        space.plot(*pose.apply(axis).T, color=INK, lw=1.2, ls=(0, (4, 2)))


def _finish_space(space: Any, motion: Floats) -> None:
    toward = viewing_direction(motion, motion.mean(axis=0), 1.0)
    azimuth = np.degrees(np.arctan2(toward[1], toward[0]))
    space.view_init(elev=float(np.degrees(np.arcsin(toward[2]))), azim=float(azimuth))
    space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    limits = np.array([space.get_xlim3d(), space.get_ylim3d(), space.get_zlim3d()])
    half = np.ptp(limits, axis=1) / 2
    half = np.maximum(half, 0.3 * half.max())  # a flat motion still gets a box with a height
    low, high = limits.mean(axis=1) - half, limits.mean(axis=1) + half
    space.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    space.set_box_aspect(half, zoom=0.85)
    space.locator_params(nbins=4)
    space.tick_params(labelsize=8)
    space.zaxis.labelpad = 12.0
    for axis in (space.xaxis, space.yaxis, space.zaxis):
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor(GRID)
    space.legend(loc="upper center", bbox_to_anchor=(0.5, 1.06), frameon=False, fontsize=9)


def _plot_configuration(axes: Axes, recording: Recording, segments: tuple[ColoredSegment, ...]) -> None:
    """Configuration of every row by its segment's joint; a line where a new segment starts."""
    for colored in segments:
        joint = colored.segment.joint
        rows = rows_of(recording, colored)
        poses = parent_pose(recording, colored).inv() * recording.poses()[rows]
        rotation = poses.rotation if recording.has_orientation else None
        label = f"{joint.kind}, probability {colored.segment.probability:.2f}"
        axes.plot(rows, inverse(joint, poses.translation, rotation), ".", ms=5, color=colored.color, label=label)
        if colored.segment is not colored.edge.segments[0]:
            axes.axvline(colored.segment.start - 0.5, color=INK, lw=1.0, ls="--")
            axes.annotate(
                f"changepoint {colored.segment.start}", (colored.segment.start - 0.5, 0.02), xytext=(-4, 0),
                xycoords=("data", "axes fraction"), textcoords="offset points", rotation=90, ha="right", fontsize=8,
            )  # fmt: skip
    units = list(dict.fromkeys(unit for unit in (UNITS[c.segment.joint.kind] for c in segments) if unit))
    axes.set(xlabel="row", ylabel=f"configuration [{' or '.join(units)}]" if units else "configuration")
    axes.legend(frameon=False, fontsize=9)
    _tidy(axes)


def _stretches(trajectory: Trajectory, steps: NDArray[np.int64]) -> list[tuple[str, float, float]]:
    """(mode, first step, last step) of every stretch of one mode."""
    starts = [0] + [j for j in range(1, len(steps)) if trajectory.modes[j] != trajectory.modes[j - 1]]
    ends = [*starts[1:], len(steps) - 1]
    return [(trajectory.modes[i], float(steps[i]), float(steps[j])) for i, j in zip(starts, ends, strict=True)]


def _shade_modes(axes: Axes, problem: Problem, trajectory: Trajectory, steps: NDArray[np.int64]) -> None:
    colors = mode_colors(problem.automaton)
    for name, left, right in _stretches(trajectory, steps):
        axes.axvspan(left, right, color=colors[name], alpha=0.16, lw=0, zorder=0)
    _tidy(axes)


def _name_modes(axes: Axes, trajectory: Trajectory, steps: NDArray[np.int64]) -> None:
    """The names of the modes above their bands; a narrow band's name ends where the band ends."""
    for name, left, right in _stretches(trajectory, steps):
        narrow = right - left < 0.15 * float(steps[-1])
        place, side = (right, "right") if narrow else (left, "left")
        axes.annotate(name, (place, 1.01), xycoords=("data", "axes fraction"), ha=side, fontsize=9, color=INK)


def _mark_goal_and_guards(axes: Axes, problem: Problem, coordinate: int) -> None:
    for index, value, tolerance in problem.goal.target:
        if index == coordinate:
            axes.axhspan(value - tolerance, value + tolerance, color=GOAL, alpha=0.3, lw=0, label="goal", zorder=1)
            axes.axhline(value, color=GOAL, lw=0.8, zorder=1)
    labelled = False
    for mark in thresholds(problem.automaton):
        if mark.coordinate == coordinate:
            axes.axhline(mark.value, color=GUARD, lw=1.1, ls="--", label="" if labelled else "guard", zorder=2)
            labelled = True


def _tidy(axes: Axes) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.margins(x=0.02)
