"""The charts on the page of a plan: belief, its spread and the arm over the steps; a line follows the player."""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.contacts.product import COLLIDED
from micah_plan.task.plan import ArmTrajectory, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.view.document import ChartBlock
from micah_plan.view.model_page import mode_colors
from micah_plan.view.palette import BELIEF, GOAL
from micah_plan.view.placement import thresholds
from micah_plan.view.plan_clock import duration, knot_times, step_times, stretches
from micah_plan.view.svg import Panel, rectangle
from micah_plan.view.text import percent

Floats = NDArray[np.float64]

_WIDTH, _LEFT, _RIGHT = 420.0, 66.0, 8.0
_TOP, _MEAN, _SPREAD, _GAP, _AXIS = 6.0, 96.0, 44.0, 12.0, 38.0
_MOST_COORDINATES = 12
_MARGIN = 0.08


def plan_charts(plan: Plan, problem: Problem) -> list[ChartBlock]:
    """The belief over the steps, and the arm's manipulability and clearance where there is one; none without plan."""
    if plan.trajectory is None:
        return []
    chart = _Chart(problem, plan.trajectory)
    k = problem.settings.sigmas
    legend = f"Mean ± {k:.2f} σ ({percent(problem.settings.confidence)}); below it σ. Green: goal; dashed: guards."
    n = problem.automaton.n
    words = legend if n <= _MOST_COORDINATES else f"{legend} {n - _MOST_COORDINATES} more coordinates have no chart."
    blocks = [ChartBlock(f"<h3>Belief</h3><p>{escape(words)}</p>{_belief(chart, k)}", chart.cursor)]
    if plan.arm is not None:
        blocks.append(ChartBlock(f"<h3>Arm</h3>{_arm(chart, plan.arm)}", chart.cursor))
    return blocks


class _Chart:
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
    def cursor(self) -> tuple[tuple[float, float], ...]:
        """Where the line of the player stands at each knot."""
        x = self.panel(None, _MEAN, 0.0, 1.0).x
        times = [*knot_times(self.trajectory), duration(self.trajectory)]
        return tuple((float(t), x(float(s))) for t, s in zip(times, [*self.steps, self.steps[-1]], strict=True))

    def drawing(self, panels: list[Panel], parts: list[str], label: str) -> str:
        """The SVG: the modes' bands behind, the parts, frames, the axis of steps and the player's line."""
        shades = "".join(p.band(*band[:2], "shade", band[2]) for p in panels for band in self.bands)
        frames = "".join(rectangle(p.left, p.top, p.width, p.height, "frame") for p in panels)
        end = panels[-1]
        cursor = f'<line class="cursor" x1="0" x2="0" y1="{_TOP:.1f}" y2="{end.bottom:.1f}" visibility="hidden"/>'
        body = "".join([shades, *parts, frames, end.x_axis("step"), cursor])
        box = f'viewBox="0 0 {_WIDTH:.0f} {end.bottom + _AXIS:.0f}"'
        return f'<svg class="chart" {box} role="img" aria-label="{escape(label)}">{body}</svg>'


def _belief(chart: _Chart, k: float) -> str:
    panels: list[Panel] = []
    parts: list[str] = []
    for i, coordinate in enumerate(chart.problem.automaton.coordinates[:_MOST_COORDINATES]):
        mean, std = chart.trajectory.means[:, i], chart.stds[:, i]
        goals = [(value, tol) for index, value, tol in chart.problem.goal.target if index == i]
        low = min([float((mean - k * std).min()), *(value - tol for value, tol in goals)])
        high = max([float((mean + k * std).max()), *(value + tol for value, tol in goals)])
        panel = chart.panel(panels[-1] if panels else None, _MEAN, low, high)
        parts += [panel.level_band(value - tol, value + tol, "level", GOAL) for value, tol in goals]
        parts += [panel.level(value, "guard") for value in _guards(chart.problem, i) if panel.y0 < value < panel.y1]
        parts.append(panel.area(chart.steps, mean - k * std, mean + k * std, "spread", BELIEF))
        parts.append(panel.curve(chart.steps, mean, "line", BELIEF))
        parts.append(panel.y_axis(f"{coordinate.name}\n[{coordinate.unit}]"))
        below = chart.panel(panel, _SPREAD, 0.0, float(std.max()))
        parts.append(below.curve(chart.steps, std, "line", BELIEF))
        parts.append(below.y_axis("σ", 2))
        panels += [panel, below]
    return chart.drawing(panels, parts, "belief over the steps of the plan")


def _guards(problem: Problem, coordinate: int) -> list[float]:
    """Where the coordinate alone makes the mode change; one side of a box says little alone."""
    return [g.value for g in thresholds(problem.automaton) if g.coordinate == coordinate and g.target != COLLIDED]


def _arm(chart: _Chart, arm: ArmTrajectory) -> str:
    panels = [chart.panel(None, _MEAN, 0.0, float(arm.manipulability.max()))]
    parts = [panels[0].curve(chart.steps, arm.manipulability, "line", BELIEF), panels[0].y_axis("manipulability")]
    known = np.array([np.nan if c is None else 1000.0 * c for c in arm.clearance])
    if np.isfinite(known).any():
        shown = np.isfinite(known)
        panel = chart.panel(panels[0], _MEAN, 0.0, float(known[shown].max()))
        parts += [panel.curve(chart.steps[shown], known[shown], "line", BELIEF), panel.y_axis("clearance\n[mm]")]
        panels.append(panel)
    return chart.drawing(panels, parts, "manipulability and clearance of the arm over the steps of the plan")
