"""The figure of learning: for each part and run the track, configuration, evidence and changepoints.

Sizes are in inches: panels have fixed places, so that every block looks the same for any content.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from micah_plan.automaton.graph import KinematicGraph
from micah_plan.quantities import count
from micah_plan.recording.value import Recording
from micah_plan.view.figures import PANEL_INK, draw, empty_figure
from micah_plan.view.learned import RunPicture, learned_runs
from micah_plan.view.learned_words import NO_BREAK, any_fits_no_joint, block_notes, block_title, block_words, wrapped
from micah_plan.view.learning_charts import learning_chart
from micah_plan.view.learning_panels import plot_counts, plot_kinds, plot_plain_track, plot_track
from micah_plan.view.palette import GRID, INK, MUTED, NO_SINGLE_JOINT

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

    Missing estimates of learning (evidence over time, posteriors, the action channel) have no panel. Without a graph:
    the track and its coordinates.

    Args:
        recording: at least one row.
        graph: learned from it.
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
    """Draw the block: finding, changepoints with parameters, panels, notes."""
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
