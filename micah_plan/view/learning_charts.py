"""The charts on the page of a recording: per part and run what learning found and how sure it is, as HTML and SVG.

They show what the figure shows; a line in them follows the player.
"""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from micah_plan.recording.value import Recording
from micah_plan.view.certainty_words import changepoint_words, channel_words, headline, joint_words, misfit_words
from micah_plan.view.document import ChartBlock
from micah_plan.view.labels import LEVELS, kind_probabilities, line_labels, percents, segment_labels, shown_counts
from micah_plan.view.learned import FLOOR, LearnedRun
from micah_plan.view.palette import MISFIT
from micah_plan.view.segments import is_misfit
from micah_plan.view.svg import Panel, rectangle, text

Floats = NDArray[np.float64]

MOST_BLOCKS = 40

_WIDTH, _LEFT, _RIGHT = 420.0, 62.0, 8.0
_NAMES = 106.0
_TOP, _CONFIGURATION, _EVIDENCE, _CHANGEPOINT = 18.0 + 15.0 * (LEVELS - 1), 150.0, 104.0, 56.0
_GAP, _AXIS = 14.0, 38.0
_LETTER, _LINE = 7.2, 13.5
_MOST_KEYFRAMES = 120


def chart_block(recording: Recording, learned: LearnedRun, shown: Floats, *, several_runs: bool) -> ChartBlock:
    """One part and run.

    Args:
        shown: (n,) time of every row of the recording on the player [s].
    """
    name = learned.edge.child + (f", run {learned.run}" if several_runs else "")
    wrong = any(is_misfit(stretch.segment) for stretch in learned.stretches)
    joints = {s.colored.color: s.segment for s in learned.stretches if not is_misfit(s.segment)}
    words = [changepoint_words(learned)]
    words += [f"{s.joint.kind}: {joint_words(s)}" for s in joints.values() if s.joint.kind != "rigid"]
    drawing, frame = _drawing(learned)
    notes = [misfit_words(stretch.segment) for stretch in learned.stretches]
    notes += [channel_words(learned, recorded=recording.has_actions)]
    html = [
        f"<h3{' class=' + chr(34) + 'misfit' + chr(34) if wrong else ''}>{escape(f'{name}: {headline(learned)}')}</h3>",
        *(f"<p>{_sentence(line)}</p>" for line in words),
        drawing,
        _counts(learned),
        _kinds(learned),
        *(f'<p class="note">{_sentence(note)}</p>' for note in notes if note),
    ]
    rows = learned.rows[
        np.unique(np.linspace(0, len(learned.rows) - 1, min(len(learned.rows), _MOST_KEYFRAMES)).astype(int))
    ]
    return ChartBlock("".join(html), tuple((float(shown[row]), frame.x(float(row))) for row in rows))


def _sentence(words: str) -> str:
    """With a capital, and no line break between a number and its spread."""
    return escape(words[0].upper() + words[1:]).replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")


def _drawing(learned: LearnedRun) -> tuple[str, Panel]:
    """The SVG with all panels over the rows, and the panel that tells where a row is."""
    first, last = float(learned.rows[0]) - 0.5, float(learned.rows[-1]) + 0.5
    width = _WIDTH - _LEFT - (_NAMES if learned.evidence else _RIGHT)
    measured = np.concatenate([stretch.measured for stretch in learned.stretches])
    low, high = float(measured.min()), float(measured.max())
    margin = 0.08 * (high - low) or 0.01
    panel = Panel(_LEFT, _TOP, width, _CONFIGURATION, first, last, low - margin, high + margin)
    panels, parts = [panel], [_configuration(panel, learned)]
    if learned.evidence:
        top = max([12.0, *(float(line.values.max()) for line in learned.evidence)])
        extra = 0.08 * (top - FLOOR)
        second = Panel(_LEFT, panel.bottom + _GAP, width, _EVIDENCE, first, last, FLOOR - extra, top + extra)
        highest = 1.08 * max([0.05, *(bar.probability for bar in learned.changepoints)])
        third = Panel(_LEFT, second.bottom + _GAP, width, _CHANGEPOINT, first, last, 0.0, highest)
        panels += [second, third]
        parts += [_evidence(second, learned), _changepoint(third, learned)]
    shades = "".join(_shades(each, learned) for each in panels)
    frames = "".join(rectangle(p.left, p.top, p.width, p.height, "frame") for p in panels)
    end = panels[-1]
    cursor = f'<line class="cursor" x1="0" x2="0" y1="{panel.top:.1f}" y2="{end.bottom:.1f}" visibility="hidden"/>'
    body = "".join([shades, *parts, frames, end.x_axis("row of the recording"), cursor])
    box = f'viewBox="0 0 {_WIDTH:.0f} {end.bottom + _AXIS:.0f}"'
    return f'<svg class="chart" {box} role="img" aria-label="{escape(headline(learned))} over rows">{body}</svg>', panel


def _shades(panel: Panel, learned: LearnedRun) -> str:
    parts = []
    for number, stretch in enumerate(learned.stretches):
        left, right = stretch.segment.start - 0.5, stretch.segment.end + 0.5
        wrong = is_misfit(stretch.segment)
        parts.append(panel.band(left, right, "shade misfit" if wrong else "shade", stretch.colored.color))
        if number and stretch.interval is not None:
            parts.append(panel.band(stretch.interval[0] - 0.5, stretch.interval[1] + 0.5, "interval"))
        if number:
            parts.append(panel.vertical(left, "change"))
    return "".join(parts)


def _configuration(panel: Panel, learned: LearnedRun) -> str:
    parts = [panel.y_axis(f"{learned.quantity} [{learned.unit}]", 5)]
    for stretch in learned.stretches:
        if is_misfit(stretch.segment):
            parts.append(panel.curve(stretch.rows, stretch.measured, "dots rim", dots=True))
        parts.append(panel.curve(stretch.rows, stretch.measured, "dots", stretch.colored.color, dots=True))
    for label in segment_labels(learned, _LETTER * (panel.x1 - panel.x0) / panel.width):
        x, y = panel.x(label.row), panel.top - 6 - 15 * label.level
        if label.misfit:
            half = _LETTER * len(label.text) / 2
            parts.append(rectangle(x - half, y - 12, 2 * half, 16, "badge-box", MISFIT))
        parts.append(text(x, y, label.text, "name mid on-misfit" if label.misfit else "name mid"))
    return "".join(parts)


def _evidence(panel: Panel, learned: LearnedRun) -> str:
    parts = [panel.y_axis("evidence against\nbest single [nats]")]
    for line in sorted(learned.evidence, key=lambda line: line.color is not None):
        kind = "line" if line.color else "line other"
        parts.append(panel.curve(learned.evidence_rows, line.values, kind, line.color or ""))
    step = _LINE * (panel.y1 - panel.y0) / panel.height
    for place, name, used in line_labels(learned.evidence, step):
        parts.append(text(panel.left + panel.width + 5, panel.y(place) + 4, name, "name" if used else "number"))
    return "".join(parts)


def _changepoint(panel: Panel, learned: LearnedRun) -> str:
    parts = [panel.y_axis("P(change\nat row)", 2)]
    for bar in learned.changepoints:
        if bar.probability >= 1e-4:
            top = panel.y(bar.probability)
            width = max(bar.width * panel.width / (panel.x1 - panel.x0), 1.0)
            parts.append(rectangle(panel.x(bar.row) - width / 2, top, width, panel.bottom - top, "bar"))
    for stretch in learned.stretches[1:]:
        if stretch.interval is not None:
            low, high = stretch.interval
            words = f"95 %: {low} to {high}" if high > low else f"95 %: {low}"
            parts.append(text(panel.x(low - 0.5) - 5, panel.top + 12, words, "number end"))
    return "".join(parts)


def _counts(learned: LearnedRun) -> str:
    if not learned.counts:
        return ""
    chosen = len(learned.stretches) - 1
    rows = [
        _bar(str(number), percents(probability), probability, "" if number == chosen else "other")
        for number, probability in enumerate(shown_counts(learned))
    ]
    return '<h4>Number of changepoints</h4><div class="bars">' + "".join(rows) + "</div>"


def _kinds(learned: LearnedRun) -> str:
    """One bar per segment for its most probable kind; the next one in words."""
    rows = []
    for stretch in learned.stretches:
        if stretch.segment.certainty is None:
            continue
        (name, probability), *rest = kind_probabilities(stretch.segment)
        others = [f"{other} {percents(p)}" for other, p in rest if p >= 0.005][:1]
        words = ", then ".join([f"{name} {percents(probability)}", *others])
        label = f"rows {stretch.segment.start} to {stretch.segment.end}"
        rows.append(_bar(label, words, probability, "", stretch.colored.color))
    return '<h4>Kind of joint</h4><div class="bars">' + "".join(rows) + "</div>" if rows else ""


def _bar(label: str, words: str, share: float, kind: str, color: str = "") -> str:
    tint = f"--tint:{escape(color)};" if color else ""
    bar = f'<i class="{kind}" style="{tint}width:{100 * share:.1f}%"></i>'
    return f"<span>{escape(label)}</span><b>{bar}</b><span>{escape(words)}</span>"
