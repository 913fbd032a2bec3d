"""The charts on the page of a recording: per part and run what learning found and how sure it is.

They show what the figure shows; a line in them follows the player.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.quantities import count, percent
from micah_plan.recording.value import Recording
from micah_plan.view.learned import (
    LEVELS,
    LearnedRun,
    block_notes,
    block_title,
    block_words,
    capital,
    has_misfit,
    headline,
    interval_labels,
    is_misfit,
    kind_probabilities,
    kind_words,
    line_labels,
    segment_labels,
    shown_counts,
)
from micah_plan.view.page import Bar, Bars, Chart
from micah_plan.view.palette import MISFIT
from micah_plan.view.svg import Panel, Svg, evenly, played, rectangle, text

MOST_BLOCKS = 40

_WIDTH, _LEFT, _RIGHT = 420.0, 62.0, 8.0
_NAMES = 106.0
_TOP, _CONFIGURATION, _EVIDENCE, _CHANGEPOINT = 18.0 + 15.0 * (LEVELS - 1), 150.0, 104.0, 56.0
_GAP = 14.0
_LETTER, _LINE = 7.2, 13.5
_MOST_KEYFRAMES = 120


def learning_charts(recording: Recording, runs: Sequence[LearnedRun], shown: Floats) -> list[Chart]:
    """One chart per part and run; of more than MOST_BLOCKS the rest is counted.

    Args:
        shown: (n,) time of every row of the recording on the player [s].
    """
    several = len(recording.runs) > 1
    charts = [learning_chart(recording, run, shown, several_runs=several) for run in runs[:MOST_BLOCKS]]
    if len(runs) > MOST_BLOCKS:
        charts.append(Chart(f"{count(len(runs) - MOST_BLOCKS, 'more run')} not shown"))
    return charts


def learning_chart(recording: Recording, learned: LearnedRun, shown: Floats, *, several_runs: bool) -> Chart:
    """One part and run; `shown` as above."""
    panels = _panels(learned)
    drawn = zip((_configuration, _evidence, _changepoint), panels, strict=False)
    parts = [_shades(panel, learned) for panel in panels] + [part(panel, learned) for part, panel in drawn]
    rows = learned.rows[evenly(len(learned.rows), _MOST_KEYFRAMES)]
    return Chart(
        block_title(learned, several_runs=several_runs),
        tuple(map(capital, block_words(learned))),
        played(_WIDTH, panels, parts, "time [s]", f"{headline(learned)} over time"),
        tuple(bars for bars in (_counts(learned), _kinds(learned)) if bars.rows),
        tuple(block_notes(learned, recorded=recording.has_actions)),
        has_misfit(learned),
        tuple((float(shown[row]), panels[0].x(float(at))) for row, at in zip(rows, learned.when(rows), strict=True)),
    )


def _panels(learned: LearnedRun) -> list[Panel]:
    """Configuration, and where learning traced them evidence and changepoint, all over time."""
    first, last = learned.span
    width = _WIDTH - _LEFT - (_NAMES if learned.evidence else _RIGHT)
    measured = np.concatenate([stretch.measured for stretch in learned.stretches])
    low, high = float(measured.min()), float(measured.max())
    margin = 0.08 * (high - low) or 0.01
    upper = Panel(_LEFT, _TOP, width, _CONFIGURATION, first, last, low - margin, high + margin)
    if not learned.evidence:
        return [upper]
    middle = upper.below(_GAP, _EVIDENCE, *learned.evidence_range)
    return [upper, middle, middle.below(_GAP, _CHANGEPOINT, *learned.changepoint_range)]


def _shades(panel: Panel, learned: LearnedRun) -> Svg:
    parts = []
    for number, stretch in enumerate(learned.stretches):
        left, right = learned.when([stretch.segment.start - 0.5, stretch.segment.end + 0.5]).tolist()
        kind = "shade misfit" if is_misfit(stretch.segment) else "shade"
        parts.append(panel.band(left, right, kind, stretch.colored.color))
        if number and stretch.interval is not None:
            low, high = learned.when([stretch.interval[0] - 0.5, stretch.interval[1] + 0.5]).tolist()
            parts.append(panel.band(low, high, "interval"))
        if number:
            parts.append(panel.vertical(left, "change"))
    return Svg("".join(parts))


def _configuration(panel: Panel, learned: LearnedRun) -> Svg:
    parts = [panel.y_axis(f"{learned.quantity} [{learned.unit}]", 5)]
    for stretch in learned.stretches:
        if is_misfit(stretch.segment):
            parts.append(panel.curve(learned.when(stretch.rows), stretch.measured, "dots rim", dots=True))
        times, color = learned.when(stretch.rows), stretch.colored.color
        parts.append(panel.curve(times, stretch.measured, "dots", color, dots=True))
    for label in segment_labels(learned, _LETTER * (panel.x1 - panel.x0) / panel.width):
        x, y = panel.x(label.time), panel.top - 6 - 15 * label.level
        if label.misfit:
            half = _LETTER * len(label.text) / 2
            parts.append(rectangle(x - half, y - 12, 2 * half, 16, "badge-box", MISFIT))
        parts.append(text(x, y, label.text, "name mid on-misfit" if label.misfit else "name mid"))
    return Svg("".join(parts))


def _evidence(panel: Panel, learned: LearnedRun) -> Svg:
    parts = [panel.y_axis("evidence against\nbest single [nats]")]
    for line in sorted(learned.evidence, key=lambda line: line.color is not None):
        kind = "line" if line.color else "line other"
        parts.append(panel.curve(learned.when(learned.evidence_rows), line.values, kind, line.color or ""))
    step = _LINE * (panel.y1 - panel.y0) / panel.height
    for place, name, used in line_labels(learned.evidence, step):
        parts.append(text(panel.right + 5, panel.y(place) + 4, name, "name" if used else "number"))
    return Svg("".join(parts))


def _changepoint(panel: Panel, learned: LearnedRun) -> Svg:
    parts = [panel.y_axis("P(change\nat row)", 2)]
    for bar in learned.changepoints:
        if bar.probability >= 1e-4:
            top = panel.y(bar.probability)
            half = 0.5 * bar.width
            left, right = map(panel.x, learned.when([bar.row - half, bar.row + half]).tolist())
            parts.append(rectangle(left, top, max(right - left, 1.0), panel.bottom - top, "bar"))
    for first, name in interval_labels(learned):
        parts.append(text(panel.x(float(learned.when(first - 0.5))) - 5, panel.top + 12, name, "number end"))
    return Svg("".join(parts))


def _counts(learned: LearnedRun) -> Bars:
    chosen = len(learned.stretches) - 1
    probabilities = shown_counts(learned) if learned.counts else ()
    rows = [Bar(str(k), percent(p, 0), p, faint=k != chosen) for k, p in enumerate(probabilities)]
    return Bars("Number of changepoints", tuple(rows))


def _kinds(learned: LearnedRun) -> Bars:
    """One bar per segment for its most probable kind; the next one in words."""
    rows = []
    for stretch in learned.stretches:
        if stretch.segment.certainty is None:
            continue
        named = ", then ".join(filter(None, kind_words(stretch.segment)))
        label = f"rows {stretch.segment.start} to {stretch.segment.end}"
        rows.append(Bar(label, named, kind_probabilities(stretch.segment)[0][1], stretch.colored.color))
    return Bars("Kind of joint", tuple(rows))
