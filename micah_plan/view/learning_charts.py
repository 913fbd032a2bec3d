"""The charts of a recording for page and figure: the learned model of each part and run, with its certainty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.quantities import count, percent
from micah_plan.recording.value import Recording
from micah_plan.view.chart import Change, Chart, Columns, Curve, Mark, Panel, Span, Words, evenly, widened
from micah_plan.view.learned import RunPicture, fits_no_joint
from micah_plan.view.learned_words import (
    LEVELS,
    any_fits_no_joint,
    block_notes,
    block_title,
    block_words,
    capital,
    headline,
    interval_labels,
    kind_words,
    line_labels,
    probability_words,
    segment_labels,
    shown_counts,
)
from micah_plan.view.page import Bar, Bars, Block
from micah_plan.view.palette import INK, NO_SINGLE_JOINT

MOST_BLOCKS = 40

_CONFIGURATION, _EVIDENCE, _CHANGEPOINT = 150.0, 104.0, 56.0
_WIDTH = 340.0  # of a panel, about, for the names in it
_LETTER, _LINE = 7.2, 13.5
_MOST_KEYFRAMES = 120


def learning_charts(recording: Recording, runs: Sequence[RunPicture], shown: Floats) -> list[Block]:
    """One block per part and run; of more than MOST_BLOCKS the rest is counted.

    Args:
        shown: (n,) time of every row of the recording on the player [s].
    """
    several = len(recording.runs) > 1
    blocks = [learning_block(recording, run, shown, several_runs=several) for run in runs[:MOST_BLOCKS]]
    if len(runs) > MOST_BLOCKS:
        blocks.append(Block(f"{count(len(runs) - MOST_BLOCKS, 'more run')} not shown"))
    return blocks


def learning_block(recording: Recording, learned: RunPicture, shown: Floats, *, several_runs: bool) -> Block:
    """The block of one part and run; `shown` as in `learning_charts`."""
    rows = learned.rows[evenly(len(learned.rows), _MOST_KEYFRAMES)]
    return Block(
        block_title(learned, several_runs=several_runs),
        tuple(map(capital, block_words(learned))),
        learning_chart(learned),
        tuple(bars for bars in (_counts(learned), _kinds(learned)) if bars.rows),
        tuple(block_notes(learned, recorded=recording.has_actions)),
        any_fits_no_joint(learned),
        tuple((float(shown[row]), float(at)) for row, at in zip(rows, learned.when(rows), strict=True)),
    )


def learning_chart(learned: RunPicture) -> Chart:
    """Configuration, and where learning traced them evidence and the posterior of the changepoints, all over time."""
    first, last = learned.span
    behind = _segments(learned)
    panels = [_configuration(learned, _LETTER * (last - first) / _WIDTH)]
    if learned.evidence:
        panels += [_evidence(learned), _changepoint(learned)]
    shaded = tuple(panel.with_marks(*behind) for panel in panels)
    described = f"{headline(learned)} over time"
    return Chart(described, "time [s]", first, last, shaded, lines=LEVELS, names=bool(learned.evidence))


def _segments(learned: RunPicture) -> list[Mark]:
    """The segments' colours behind a panel; a line at every changepoint, in the band of its 95 % interval."""
    marks: list[Mark] = []
    for number, stretch in enumerate(learned.stretches):
        left, right = learned.when([stretch.segment.start - 0.5, stretch.segment.end + 0.5]).tolist()
        marks.append(Span(left, right, "hatched" if fits_no_joint(stretch.segment) else "shade", stretch.colored.color))
        if number and stretch.interval is not None:
            low, high = learned.when([stretch.interval[0] - 0.5, stretch.interval[1] + 0.5]).tolist()
            marks.append(Span(low, high, "interval", label="95 % interval"))
        if number:
            marks.append(Change(left))
    return marks


def _configuration(learned: RunPicture, letter: float) -> Panel:
    """The measured configuration of every row in its segment's colour, and above it the segments' names.

    Args:
        letter: width of a letter [s].
    """
    marks: list[Mark] = []
    for stretch in learned.stretches:
        times = learned.when(stretch.rows)
        if fits_no_joint(stretch.segment):
            marks.append(Curve(times, stretch.measured, "rim", INK))
        marks.append(Curve(times, stretch.measured, "dots", stretch.colored.color))
        if not stretch.segment.joint.moves and learned.quantity == "configuration" and len(times):
            marks.append(Curve(times[[0, -1]], np.full(2, stretch.segment.configuration_start), "trend", INK))
    marks += [
        Words(label.text, label.time, line=label.level, color=NO_SINGLE_JOINT if label.no_single_joint else "")
        for label in segment_labels(learned, letter)
    ]
    low, high = widened([stretch.measured for stretch in learned.stretches if len(stretch.measured)])
    return Panel(f"{learned.quantity} [{learned.unit}]", low, high, _CONFIGURATION, tuple(marks))


def _evidence(learned: RunPicture) -> Panel:
    """Cumulative evidence of each model relative to the best single one: rising lines mark the segments of a model."""
    times, (low, high) = learned.when(learned.evidence_rows), learned.evidence_range
    marks: list[Mark] = [
        Curve(times, line.values, "line" if line.color else "other", line.color or "", line.model)
        for line in sorted(learned.evidence, key=lambda line: line.color is not None)
    ]
    for place, name, used in line_labels(learned.evidence, _LINE * (high - low) / _EVIDENCE):
        marks.append(Words(name, learned.span[1], place, side="edge", strong=used))
    return Panel("evidence against\nbest single [nats]", low, high, _EVIDENCE, tuple(marks))


def _changepoint(learned: RunPicture) -> Panel:
    """The posterior probability of every row to be the first of a segment."""
    bars = [bar for bar in learned.changepoints if bar.probability >= 1e-4]
    rows, widths, heights = (np.array([getattr(bar, name) for bar in bars]) for name in ("row", "width", "probability"))
    left, right = learned.when(rows - 0.5 * widths), learned.when(rows + 0.5 * widths)
    low, high = learned.changepoint_range
    marks: list[Mark] = [Columns(np.asarray(left), np.asarray(right), heights)]
    for first, name in interval_labels(learned):
        marks.append(Words(name, float(learned.when(first - 0.5)), 0.8 * high, side="left", strong=False))
    return Panel("P(change\nat row)", low, high, _CHANGEPOINT, tuple(marks))


def _counts(learned: RunPicture) -> Bars:
    chosen = len(learned.stretches) - 1
    probabilities = shown_counts(learned) if learned.counts else ()
    rows = [Bar(str(k), percent(p, 0), p, faint=k != chosen) for k, p in enumerate(probabilities)]
    return Bars("Number of changepoints", tuple(rows))


def _kinds(learned: RunPicture) -> Bars:
    """One bar per segment for its most probable kind; the second in words."""
    rows = []
    for stretch in learned.stretches:
        if stretch.segment.certainty is None:
            continue
        named = ", then ".join(filter(None, kind_words(stretch.segment)))
        label = f"rows {stretch.segment.start} to {stretch.segment.end}"
        rows.append(Bar(label, named, probability_words(stretch.segment)[0][1], stretch.colored.color))
    return Bars("Kind of joint", tuple(rows))
