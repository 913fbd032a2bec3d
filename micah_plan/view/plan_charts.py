"""The charts on the page of a plan: belief, its spread and the arm over the steps; a line follows the player."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.quantities import count, percent, plain
from micah_plan.task.plan import ArmTrajectory, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.view.motion import duration, knot_times, step_times, stretches
from micah_plan.view.page import Chart
from micah_plan.view.palette import BELIEF, GOAL, mode_colors
from micah_plan.view.placement import guards_of
from micah_plan.view.svg import AXIS, Panel, Svg, cursor, drawing

Floats = NDArray[np.float64]

_WIDTH, _LEFT, _RIGHT = 420.0, 66.0, 8.0
_TOP, _MEAN, _SPREAD, _GAP = 6.0, 96.0, 44.0, 12.0
_MOST_COORDINATES = 12
_MARGIN = 0.08


def plan_charts(plan: Plan, problem: Problem) -> list[Chart]:
    """The belief over the steps, and the arm's manipulability and clearance where there is one; none without plan."""
    if plan.trajectory is None:
        return []
    chart = _Steps(problem, plan.trajectory)
    settings = problem.settings
    legend = (
        f"Mean ± {plain(settings.sigmas)} σ, the room that a confidence of {percent(settings.confidence)} asks for at "
        "a limit; below it σ alone. Green: goal. Dashed: where the mode changes."
    )
    left_out = problem.automaton.n - _MOST_COORDINATES
    words = (legend,) if left_out <= 0 else (legend, f"{count(left_out, 'more coordinate')} not shown.")
    charts = [Chart("Belief", words, _belief(chart, settings.sigmas), keyframes=chart.keyframes)]
    if plan.arm is not None:
        charts.append(Chart("Arm", (), _arm(chart, plan.arm), keyframes=chart.keyframes))
    return charts


class _Steps:
    """Panels below each other over one axis of steps."""

    def __init__(self, problem: Problem, trajectory: Trajectory) -> None:
        self.problem, self.trajectory = problem, trajectory
        self.steps = step_times(trajectory).astype(np.float64)
        self.last = max(float(self.steps[-1]), 1.0)
        self.stds = np.sqrt((trajectory.factors**2).sum(axis=2))
        colors = mode_colors(problem.automaton)
        self.bands = [
            (self.steps[first], self.steps[end], colors[trajectory.modes[first]])
            for first, end in stretches(trajectory.modes)
        ]

    def panel(self, above: Panel | None, height: float, low: float, high: float) -> Panel:
        """A panel below another, its range widened by a margin."""
        top = _TOP if above is None else above.bottom + _GAP
        extra = _MARGIN * (high - low) or 1e-3 * max(abs(high), 1.0)
        return Panel(_LEFT, top, _WIDTH - _LEFT - _RIGHT, height, 0.0, self.last, low - extra, high + extra)

    @property
    def keyframes(self) -> tuple[tuple[float, float], ...]:
        """Where the line of the player stands at each knot."""
        x = self.panel(None, _MEAN, 0.0, 1.0).x
        times = [*knot_times(self.trajectory), duration(self.trajectory)]
        return tuple((float(t), x(float(s))) for t, s in zip(times, [*self.steps, self.steps[-1]], strict=True))

    def drawing(self, panels: list[Panel], parts: list[Svg], label: str) -> Svg:
        """The modes' bands behind, the parts, frames, the axis of steps and the player's line."""
        shades = [panel.band(first, end, "shade", color) for panel in panels for first, end, color in self.bands]
        frames = [panel.frame for panel in panels]
        body = [*shades, *parts, *frames, panels[-1].x_axis("step"), cursor(panels)]
        return drawing(_WIDTH, panels[-1].bottom + AXIS, body, label)


def _belief(chart: _Steps, k: float) -> Svg:
    panels: list[Panel] = []
    parts: list[Svg] = []
    for i, coordinate in enumerate(chart.problem.automaton.coordinates[:_MOST_COORDINATES]):
        mean, std = chart.trajectory.means[:, i], chart.stds[:, i]
        goals = [(value - tol, value + tol) for index, value, tol in chart.problem.goal.target if index == i]
        low = min([float((mean - k * std).min()), *(start for start, _ in goals)])
        high = max([float((mean + k * std).max()), *(end for _, end in goals)])
        panel = chart.panel(panels[-1] if panels else None, _MEAN, low, high)
        parts += [panel.level_band(*goal, "level", GOAL) for goal in goals]
        parts += [
            panel.level(value, "guard")
            for value in guards_of(chart.problem.automaton, i)
            if panel.y0 < value < panel.y1
        ]
        parts.append(panel.area(chart.steps, mean - k * std, mean + k * std, "spread", BELIEF))
        parts.append(panel.curve(chart.steps, mean, "line", BELIEF))
        parts.append(panel.y_axis(f"{coordinate.name}\n[{coordinate.unit}]"))
        below = chart.panel(panel, _SPREAD, 0.0, float(std.max()))
        parts += [below.curve(chart.steps, std, "line", BELIEF), below.y_axis("σ", 2)]
        panels += [panel, below]
    return chart.drawing(panels, parts, "belief over the steps of the plan")


def _arm(chart: _Steps, arm: ArmTrajectory) -> Svg:
    panels = [chart.panel(None, _MEAN, 0.0, float(arm.manipulability.max()))]
    parts = [panels[0].curve(chart.steps, arm.manipulability, "line", BELIEF), panels[0].y_axis("manipulability")]
    clearance = np.array([np.nan if c is None else 1000.0 * c for c in arm.clearance])
    shown = np.isfinite(clearance)
    if shown.any():
        panel = chart.panel(panels[0], _MEAN, 0.0, float(clearance[shown].max()))
        parts += [panel.curve(chart.steps[shown], clearance[shown], "line", BELIEF), panel.y_axis("clearance\n[mm]")]
        panels.append(panel)
    return chart.drawing(panels, parts, "manipulability and clearance of the arm over the steps of the plan")
