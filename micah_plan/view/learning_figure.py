"""The figure of what learning found: per part and run the track with its joints, and beside it, over the rows, the
configuration, the evidence for each model and the posterior of the changepoints.

Sizes are in inches: panels have fixed places, so that every block looks the same whatever it shows.

**The panels of the learning figure.** The track in 3-D, and what was learned over the rows, with its probabilities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import KinematicGraph
from micah_plan.quantities import count, percent
from micah_plan.recording.value import Recording
from micah_plan.view.camera import viewing_direction
from micah_plan.view.figures import PANEL_INK, draw, empty_figure
from micah_plan.view.learned import (
    NO_BREAK,
    RunPicture,
    Stretch,
    any_fits_no_joint,
    block_notes,
    block_title,
    block_words,
    fits_no_joint,
    kind_words,
    learned_runs,
    probability_words,
    shown_counts,
    wrapped,
)
from micah_plan.view.learning_charts import learning_chart
from micah_plan.view.palette import GRID, INK, MUTED, NO_SINGLE_JOINT
from micah_plan.view.placement import joint_axis, joint_curve

WIDTH = 11.0
MOST_BLOCKS = 12
"""Parts and runs drawn; a figure of more is too long to look at, so the rest is only counted."""

_LEFT, _SPLIT, _RIGHT, _NO_NAMES = 0.35, 5.35, 1.35, 0.3
_HEADER, _GAP, _AXIS = 1.2, 0.22, 0.55
_CONFIGURATION, _EVIDENCE, _CHANGEPOINT = 2.2, 1.45, 0.8
_BARS, _LEAST_SPACE = 0.95, 3.3
_LINE, _CHARACTERS = 0.19, 150


@dataclass(frozen=True)
class _Block:
    """One part and run, its words below the panels, and the heights of its panels [in]."""

    learned: RunPicture
    words: tuple[str, ...]
    panels: tuple[float, ...]
    bars: bool

    @property
    def height(self) -> float:
        panels = sum(self.panels) + _GAP * (len(self.panels) - 1)
        return _HEADER + panels + _AXIS + _LINE * len(self.words) + 0.15


def learning_figure(recording: Recording, graph: KinematicGraph | None = None) -> Figure:
    """Per part and run: the track by segment with its joints, configuration, evidence, posteriors, and words.

    What learning did not estimate (evidence over time, posteriors, the action channel) has no panel. Without a graph:
    the track and its coordinates.

    Args:
        recording: at least one row.
        graph: what was learned from it.
    """
    runs = () if graph is None else learned_runs(recording, graph)
    if not runs:
        return _plain(recording)
    blocks = [_block(learned, recording) for learned in runs[:MOST_BLOCKS]]
    note = 0.3 if len(runs) > MOST_BLOCKS else 0.0
    top = sum(block.height for block in blocks) + note
    figure = empty_figure((WIDTH, top))
    for block in blocks:
        _draw_block(figure, block, top, several_runs=len(recording.runs) > 1)
        top -= block.height
    if note:
        _write(figure, 0.1, f"{count(len(runs) - MOST_BLOCKS, 'more run')} not shown", color=MUTED)
    return figure


def _block(learned: RunPicture, recording: Recording) -> _Block:
    notes = block_notes(learned, recorded=recording.has_actions)
    glued = [note.replace(" ± ", f"{NO_BREAK}±{NO_BREAK}") for note in notes]
    lines = tuple(line for note in glued for line in wrapped(note, _CHARACTERS))
    traced = (_EVIDENCE, _CHANGEPOINT) if learned.evidence else ()
    bars = bool(learned.counts) or any(s.segment.certainty is not None for s in learned.stretches)
    needed = _LEAST_SPACE + (_BARS + 0.5 if bars else 0.0) - sum(traced) - _GAP * len(traced)
    return _Block(learned, lines, (max(_CONFIGURATION, needed), *traced), bars)


def _plain(recording: Recording) -> Figure:
    height = 4.6
    figure = empty_figure((WIDTH, height))
    plot_plain_track(_space(figure, 0.1, 0.2, _SPLIT - 0.9, height - 0.5), recording)
    axes = _panel(figure, _SPLIT, 0.6, WIDTH - _SPLIT - 0.5, height - 1.1)
    for name, values, style in zip("xyz", recording.position.T, ("-", "--", ":"), strict=True):
        axes.plot(values, style, color=INK, lw=1.4)
        axes.annotate(name, (len(values) - 1, values[-1]), xytext=(5, 0), textcoords="offset points", va="center")
    axes.set(xlabel="row", ylabel="position [m]")
    return figure


def _draw_block(figure: Figure, block: _Block, top: float, *, several_runs: bool) -> None:
    """The finding in large letters, on yellow if no joint fits; changepoints and parameters; panels; sentences."""
    learned = block.learned
    box = {"facecolor": NO_SINGLE_JOINT, "edgecolor": "none", "pad": 4.0} if any_fits_no_joint(learned) else None
    title = block_title(learned, several_runs=several_runs)
    _write(figure, top - 0.38, title, fontsize=15, weight="bold", color=INK, va="center", bbox=box)
    words = "   ·   ".join(block_words(learned))
    _write(figure, top - 0.7, words, fontsize=10, color=PANEL_INK, va="center")
    width = WIDTH - _SPLIT - (_RIGHT if learned.evidence else _NO_NAMES)
    bottom = top - _HEADER + _GAP
    axes: list[Axes] = []
    for height in block.panels:
        bottom -= _GAP + height
        axes.append(_panel(figure, _SPLIT, bottom, width, height, sharex=axes[0] if axes else None))
    draw(learning_chart(learned), axes)
    for panel in axes:
        panel.yaxis.set_label_coords(-0.62 / width, 0.5)
    space_bottom = bottom + (_BARS + 0.25 if block.bars else -0.35)
    plot_track(_space(figure, 0.2, space_bottom, _SPLIT - 1.15, top - _HEADER + 0.35 - space_bottom), learned)
    if learned.counts:
        plot_counts(_panel(figure, 0.45, bottom - 0.05, 1.15, _BARS - 0.1), learned)
    if block.bars:
        plot_kinds(_panel(figure, 2.3 if learned.counts else 0.95, bottom - 0.05, 1.25, _BARS - 0.1), learned)
    for number, line in enumerate(block.words):
        _write(figure, bottom - _AXIS - _LINE * (number + 0.5), line, fontsize=9, color=PANEL_INK, va="center")


def _write(figure: Figure, height: float, text: str, **look: Any) -> None:
    figure.text(_LEFT / WIDTH, height / figure.get_figheight(), text, **look)


def _axes(figure: Figure, left: float, bottom: float, width: float, height: float, **options: Any) -> Any:
    total = figure.get_figheight()
    return figure.add_axes((left / WIDTH, bottom / total, width / WIDTH, height / total), **options)


def _panel(figure: Figure, left: float, bottom: float, width: float, height: float, **options: Any) -> Axes:
    axes: Axes = _axes(figure, left, bottom, width, height, **options)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(MUTED)
    axes.tick_params(labelsize=9, color=MUTED, labelcolor=PANEL_INK)
    return axes


def _space(figure: Figure, left: float, bottom: float, width: float, height: float) -> Any:
    with rc_context({"grid.color": GRID, "grid.linewidth": 0.5}):  # its axes take these when they are made, or never
        axes = _axes(figure, left, bottom, width, height, projection="3d")
    axes.patch.set_alpha(0.0)
    return axes


_MOST_KINDS = 5
_ZOOM, _ZOOM_ON_FLAT = 0.86, 0.76
_FAR = 2.5
"""A centre farther away than this many track sizes is not drawn: it would shrink the track to a dot."""


def plot_track(space: Any, learned: RunPicture) -> None:
    """The part's positions in the frame of its parent, and the joints of its segments, one of a kind and colour."""
    size = max(float(np.linalg.norm(np.ptp(learned.position, axis=0))), 1e-3)
    segmented = np.zeros(len(learned.rows), dtype=bool)
    for stretch in learned.stretches:
        is_row = np.isin(learned.rows, stretch.rows)
        segmented |= is_row
        edge = INK if fits_no_joint(stretch.segment) else "none"
        space.scatter(
            *learned.position[is_row].T, s=17, color=stretch.colored.color, edgecolors=edge, linewidths=0.5,
            depthshade=False,
        )  # fmt: skip
    if not segmented.all():
        space.scatter(*learned.position[~segmented].T, s=9, color=MUTED, depthshade=False)
    points = [learned.position]
    for stretch in {s.colored.color: s for s in reversed(learned.stretches)}.values():
        if not fits_no_joint(stretch.segment):
            points += _plot_joint(space, stretch, size)
    _finish(space, np.concatenate(points), learned.position, "" if learned.in_base else f" in {learned.edge.parent}")


def plot_plain_track(space: Any, recording: Recording) -> None:
    """The measured positions of a recording of which nothing was learned."""
    space.scatter(*recording.position.T, s=9, color=MUTED, depthshade=False)
    _finish(space, recording.position, recording.position, "")


def _plot_joint(space: Any, stretch: Stretch, size: float) -> list[Floats]:
    """Draw a joint in ink; returns the points (k, 3) that must be in sight."""
    joint = stretch.segment.joint
    curve = joint_curve(joint, *stretch.segment.configuration_range)
    if not joint.moves:
        space.plot(*curve[:1].T, "o", ms=15, mfc="none", mec=INK, mew=1.4)
        return [curve]
    space.plot(*curve.T, color=INK, lw=1.6)
    if joint.slides:
        # The arrow's head: the direction in which the configuration grows.
        space.quiver(*curve[0], *(1.12 * (curve[1] - curve[0])), color=INK, lw=1.6, arrow_length_ratio=0.08)
        return [curve]
    center = np.array(joint.center)
    axis = joint_axis(joint, 0.55 * size)
    if axis is None or float(np.linalg.norm(center - curve.mean(axis=0))) > _FAR * size:
        return [curve]
    space.plot(*axis.T, color=INK, lw=1.3, ls=(0, (5, 2, 1, 2)))
    space.text(*axis[int(axis[:, 2].argmax())], " axis", color=INK, fontsize=9, va="bottom")
    space.plot(*center[:, None], "o", ms=4.5, color=INK)
    space.text(*center, "centre  ", color=INK, fontsize=9, va="top", ha="right")
    for end in (curve[0], curve[-1]):
        space.plot(*np.stack([center, end]).T, color=MUTED, lw=0.8)
    return [curve, axis, center[None]]


def _finish(space: Any, points: Floats, motion: Floats, frame: str) -> None:
    """Equal scales on all axes, few ticks, no boxes, and a view that sees the motion spread out."""
    toward = viewing_direction(motion, motion.mean(axis=0), 1.0)
    azimuth = np.degrees(np.arctan2(toward[1], toward[0]))
    space.view_init(elev=float(np.degrees(np.arcsin(toward[2]))), azim=float(azimuth))
    low, high = points.min(axis=0), points.max(axis=0)
    half = 1.06 * (high - low) / 2
    half = np.maximum(half, max(0.3 * float(half.max()), 1e-3))  # a flat motion still gets a box with a height
    middle = (low + high) / 2
    low, high = middle - half, middle + half
    space.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    # A long or flat box reaches further to the sides than a cube of the same volume.
    space.set_box_aspect(half, zoom=_ZOOM if float(half.min()) > 0.5 * float(half.max()) else _ZOOM_ON_FLAT)
    for axis, name, length in zip((space.xaxis, space.yaxis, space.zaxis), "xyz", half, strict=True):
        axis.set_label_text(f"{name}{frame} [m]", fontsize=9, color=INK)
        axis.labelpad = 3.0 if name == "z" else 3.0 + 6.0 * float(length / half.max())
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor(GRID)
        # As many ticks as a side of this length has room for.
        most = max(2, round(4.4 * float(length / half.max())))
        axis.set_major_locator(MaxNLocator(nbins=most, steps=[1, 2, 5, 10], min_n_ticks=1))
        axis.line.set_color(MUTED)
    space.tick_params(labelsize=8, pad=1, colors=INK)


def plot_counts(axes: Axes, learned: RunPicture) -> None:
    """The posterior over the number of changepoints; the number that the segments have is dark."""
    counts = shown_counts(learned)
    chosen = len(learned.stretches) - 1
    colors = [INK if number == chosen else GRID for number in range(len(counts))]
    axes.bar(range(len(counts)), counts, width=0.78, color=colors)
    for number, probability in enumerate(counts):
        axes.text(number, probability + 0.03, percent(probability, 0), ha="center", va="bottom", fontsize=8, color=INK)
    axes.set(ylim=(0.0, 1.15), yticks=[], xticks=range(len(counts)))
    axes.spines["left"].set_visible(False)
    axes.tick_params(length=0, labelsize=8.5)
    axes.set_xlabel("number of changepoints", fontsize=8.5, color=PANEL_INK, labelpad=2)


def plot_kinds(axes: Axes, learned: RunPicture) -> None:
    """The probability of each kind of joint, one bar per segment; the largest is named in it, the next beside it."""
    assessed = [stretch for stretch in learned.stretches if stretch.segment.certainty is not None][:_MOST_KINDS]
    for number, stretch in enumerate(assessed):
        _plot_kind(axes, -number, stretch)
    axes.set(xlim=(0.0, 1.0), ylim=(-max(len(assessed), 2) + 0.5, 0.5), xticks=[])
    axes.set_yticks(
        [-number for number in range(len(assessed))],
        [f"{s.segment.start}–{s.segment.end}" for s in assessed], fontsize=8.5,
    )  # fmt: skip
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_xlabel("kind of joint, by rows", fontsize=8.5, color=PANEL_INK, labelpad=2)


def _plot_kind(axes: Axes, place: float, stretch: Stretch) -> None:
    ranked = [probability for _, probability in probability_words(stretch.segment)]
    left = np.cumsum([0.0, *ranked[:-1]])
    colors = [stretch.colored.color] + [GRID] * (len(ranked) - 1)
    axes.barh([place] * len(ranked), ranked, left=left, height=0.66, color=colors, edgecolor="white", lw=0.8)
    box = {"facecolor": "white", "alpha": 0.82, "edgecolor": "none", "pad": 1.2}
    first, following = kind_words(stretch.segment)
    axes.text(0.03, place, first, va="center", fontsize=8, weight="bold", color=INK, bbox=box)
    axes.text(1.04, place, following, va="center", fontsize=8.5, color=PANEL_INK)
