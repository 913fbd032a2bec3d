"""The charts on the page of a plan: belief, its spread and the arm over the steps; a line follows the player."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.quantities import count, percent, plain, quantity
from micah_plan.task.plan import ArmTrajectory, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.view.executed import ExecutedRun
from micah_plan.view.motion import duration, knot_times, step_times, stretches, times_of_steps
from micah_plan.view.page import Chart
from micah_plan.view.palette import BELIEF, EXECUTED, GOAL, mode_colors
from micah_plan.view.placement import guards_of
from micah_plan.view.svg import Panel, Svg, enlarged, played

Drawn = tuple[list[Panel], list[Svg]]

_WIDTH, _LEFT, _RIGHT = 420.0, 66.0, 8.0
_TOP, _MEAN, _SPREAD, _GAP = 6.0, 96.0, 44.0, 12.0
_MOST_COORDINATES = 12
_MARGIN = 0.08


def plan_charts(plan: Plan, problem: Problem, runs: Sequence[ExecutedRun] = ()) -> list[Chart]:
    """The belief over the steps, with executed runs on top, and the arm's manipulability and clearance where there is
    one; none without plan.
    """
    trajectory = plan.trajectory
    if trajectory is None:
        return []
    settings, colors = problem.settings, mode_colors(problem.automaton)
    steps = step_times(trajectory).astype(np.float64)
    last = max([float(steps[-1]), 1.0, *(len(run.x) - 1.0 for run in runs)])
    top = Panel(_LEFT, _TOP - _GAP, _WIDTH - _LEFT - _RIGHT, 0.0, 0.0, last, 0.0, 1.0)
    times = [
        *knot_times(trajectory),
        float(times_of_steps(trajectory, np.array([last]))[0]),
        duration(trajectory, last),
    ]
    frames = tuple((float(t), top.x(float(s))) for t, s in zip(times, [*steps, last, last], strict=True))
    frames = tuple(sorted(dict(frames).items()))
    bands = [(steps[i], steps[j], colors[trajectory.modes[i]]) for i, j in stretches(trajectory.modes)]

    def chart(title: str, words: tuple[str, ...], drawn: Drawn, label: str) -> Chart:
        panels, parts = drawn
        shades = [panel.band(first, end, "shade", color) for panel in panels for first, end, color in bands]
        drawing = played(_WIDTH, panels, [*shades, *parts], step_label(problem), f"{label} over the steps of the plan")
        return Chart(title, words, drawing, keyframes=frames)

    legend = (
        f"Mean ± {plain(settings.sigmas)} σ, the room that a confidence of {percent(settings.confidence)} asks for at "
        "a limit; below it σ alone. Green: goal. Dashed: where the mode changes."
    )
    left_out = problem.automaton.n - _MOST_COORDINATES
    words = (legend,) if left_out <= 0 else (legend, f"{count(left_out, 'more coordinate')} not shown.")
    if runs:
        words = (*words, "Orange: executed.")
    title = "Belief and executed runs" if runs else "Belief"
    charts = [chart(title, words, _belief(problem, trajectory, steps, top, runs), "belief")]
    if plan.arm is not None:
        charts.append(chart("Arm", (), _arm(plan.arm, steps, top), "manipulability and clearance of the arm"))
    return charts


def step_label(problem: Problem) -> str:
    """The name of the axis of steps, with their duration."""
    return f"step, of {quantity(parameters_of(problem).control_period, 's')} each"


def _panel(above: Panel, height: float, low: float, high: float) -> Panel:
    """A panel below another, its range widened by a margin."""
    extra = _MARGIN * (high - low) or 1e-3 * max(abs(high), 1.0)
    return above.below(_GAP, height, low - extra, high + extra)


def _belief(
    problem: Problem, trajectory: Trajectory, steps: Floats, above: Panel, runs: Sequence[ExecutedRun]
) -> Drawn:
    panels: list[Panel] = []
    parts: list[Svg] = []
    spreads = np.sqrt((trajectory.factors**2).sum(axis=2))
    larger = enlarged((_MEAN + _SPREAD) * min(problem.automaton.n, _MOST_COORDINATES))
    for i, coordinate in enumerate(problem.automaton.coordinates[:_MOST_COORDINATES]):
        mean, std = trajectory.means[:, i], spreads[:, i]
        lower, upper = mean - problem.settings.sigmas * std, mean + problem.settings.sigmas * std
        goals = [(value - tol, value + tol) for index, value, tol in problem.goal.target if index == i]
        low = min([float(lower.min()), *(start for start, _ in goals), *(float(run.x[:, i].min()) for run in runs)])
        high = max([float(upper.max()), *(end for _, end in goals), *(float(run.x[:, i].max()) for run in runs)])
        panel = _panel(above, larger * _MEAN, low, high)
        above = _panel(panel, larger * _SPREAD, 0.0, float(std.max()))
        panels += [panel, above]
        parts += [panel.level_band(*goal, "level", GOAL) for goal in goals]
        guards = guards_of(problem.automaton, i)
        parts += [panel.level(value, "guard") for value in guards if panel.y0 < value < panel.y1]
        parts += [panel.area(steps, lower, upper, "spread", BELIEF), panel.curve(steps, mean, "line", BELIEF)]
        for run in runs:
            parts.append(panel.curve(np.arange(len(run.x)), run.x[:, i], "run", EXECUTED, data_run=str(run.run)))
        parts += [panel.y_axis(f"{coordinate.name}\n[{coordinate.unit}]")]
        parts += [above.curve(steps, std, "line", BELIEF), above.y_axis(f"σ\n[{coordinate.unit}]", 2)]
    return panels, parts


def _arm(arm: ArmTrajectory, steps: Floats, above: Panel) -> Drawn:
    panels: list[Panel] = []
    parts: list[Svg] = []
    clearance = np.array([np.nan if c is None else 1000.0 * c for c in arm.clearance])
    for label, values in (("manipulability", arm.manipulability), ("clearance\n[mm]", clearance)):
        shown = np.isfinite(values)
        if shown.any():
            above = _panel(above, _MEAN, 0.0, float(values[shown].max()))
            panels.append(above)
            parts += [above.curve(steps[shown], values[shown], "line", BELIEF), above.y_axis(label)]
    return panels, parts
