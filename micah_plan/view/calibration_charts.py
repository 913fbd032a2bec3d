"""The pictures of a calibration: what is left of the residual before and after, and how the candidates rank, as SVG."""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from micah_plan.residual.trace import LaneTrace
from micah_plan.view.palette import BLUE, ORANGE
from micah_plan.view.svg import Panel, rectangle, text, ticks

Floats = NDArray[np.float64]

_WIDTH, _HEIGHT = 330.0, 170.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 66.0, 10.0, 10.0, 42.0
_BAR = 20.0
_MOST_BARS = 12
_SHARE_SHOWN = 0.995


def residual_charts(one: LaneTrace) -> str:
    """Before and after, side by side, against time, configuration, direction and speed of the command."""
    lane = one.lane
    counted, starts = lane.counted, lane.counted_starts
    before = one.search.errors(one.nominal, "one_step")[counted]
    after = one.search.errors(one.final, "one_step")[counted]
    u = lane.u[starts]
    side = np.sign(u) + 0.24 * np.linspace(-1, 1, u.size)
    axes = (
        ("time in the run [s]", lane.time[counted]),
        (f"{lane.coordinate} [{lane.unit}]", lane.z[starts]),
        ("direction of the command", side),
        (f"size of the command [{lane.unit}]", np.abs(u)),
    )
    reach = float(np.quantile(np.abs(before), _SHARE_SHOWN)) * 1.1 or 1e-9
    rows = []
    for label, x in axes:
        pair = [
            _scatter(x, values, f"{name} [{lane.unit}]", label, reach, color)
            for name, values, color in (("before", before, ORANGE), ("after", after, BLUE))
        ]
        rows.append(f'<div class="pair">{"".join(pair)}</div>')
    return "".join(rows)


def ranking_chart(one: LaneTrace) -> str:
    """Evidence of every candidate alone, best first."""
    best = [row for row in one.ranking if row[1] > 0][:_MOST_BARS]
    if not best:
        return "<p>No candidate predicts better than the model as it is.</p>"
    width, name_width = 690.0, 150.0
    longest = max(evidence for _, evidence, _ in best)
    chosen = {finding.part.name for finding in one.findings}
    parts = []
    for number, (name, evidence, error) in enumerate(best):
        top = number * _BAR
        size = (width - name_width - 130.0) * evidence / longest
        kind = "bar chosen" if name in chosen else "bar"
        parts.append(text(name_width - 8, top + 14, name, "number end"))
        parts.append(rectangle(name_width, top + 3, max(size, 1.0), _BAR - 6, kind))
        parts.append(text(name_width + size + 6, top + 14, f"{evidence:.1f} ± {error:.1f} nats", "number"))
    label = escape(f"Evidence of candidates for {one.lane.coordinate}")
    return (
        f'<svg viewBox="0 0 {width:.0f} {_BAR * len(best):.0f}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
    )


def _scatter(x: Floats, y: Floats, y_label: str, x_label: str, reach: float, color: str) -> str:
    low, high = float(x.min()), float(x.max())
    margin = 0.03 * (high - low) or 1e-3
    width, height = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    panel = Panel(_LEFT, _TOP, width, height, low - margin, high + margin, -reach, reach)
    inside = np.clip(y, -reach, reach)
    parts = [
        rectangle(panel.left, panel.top, panel.width, panel.height, "frame"),
        panel.curve(np.array([panel.x0, panel.x1]), np.zeros(2), "zero"),
        panel.curve(x, inside, "dots", color, dots=True),
        _trend(panel, x, inside),
        panel.y_axis(y_label),
        *_x_axis(panel, x_label),
    ]
    label = escape(f"{y_label} against {x_label}")
    return f'<svg viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def _trend(panel: Panel, x: Floats, y: Floats) -> str:
    """Means over tenths of the rows, in order of x."""
    order = np.argsort(x, kind="stable")
    groups = [group for group in np.array_split(order, min(12, max(len(order) // 8, 1))) if group.size]
    at = np.array([float(np.median(x[group])) for group in groups])
    mean = np.array([float(np.mean(y[group])) for group in groups])
    return panel.curve(at, mean, "trend")


def _x_axis(panel: Panel, label: str) -> list[str]:
    found = ticks(panel.x0, panel.x1, 5)
    parts = [text(panel.x(value), panel.bottom + 15, f"{value:.4g}", "number mid") for value in found]
    return [*parts, text(panel.left + panel.width / 2, panel.bottom + 31, label, "label mid")]
