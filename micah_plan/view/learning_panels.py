"""The panels of the learning figure: the track in 3-D, and learned values over the rows with probabilities."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from micah_plan.arrays import Floats
from micah_plan.quantities import percent
from micah_plan.recording.value import Recording
from micah_plan.view.camera import viewing_direction
from micah_plan.view.figures import PANEL_INK
from micah_plan.view.learned import RunPicture, Stretch, fits_no_joint
from micah_plan.view.learned_words import kind_words, probability_words, shown_counts
from micah_plan.view.palette import GRID, INK, MUTED
from micah_plan.view.placement import joint_axis, joint_curve

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
    """Plot the measured positions of a recording without a learned model."""
    space.scatter(*recording.position.T, s=9, color=MUTED, depthshade=False)
    _finish(space, recording.position, recording.position, "")


def _plot_joint(space: Any, stretch: Stretch, size: float) -> list[Floats]:
    """Draw a joint in ink; returns points (k, 3) that must be visible."""
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
    """Plot the posterior over the number of changepoints; the chosen number is dark."""
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
    """Plot the probability of each kind of joint, one bar per segment, with the two likeliest named."""
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
    """Draw the probabilities of a segment\'s kinds as one bar, the likeliest first, with its name inside."""
    ranked = [probability for _, probability in probability_words(stretch.segment)]
    left = np.cumsum([0.0, *ranked[:-1]])
    colors = [stretch.colored.color] + [GRID] * (len(ranked) - 1)
    axes.barh([place] * len(ranked), ranked, left=left, height=0.66, color=colors, edgecolor="white", lw=0.8)
    box = {"facecolor": "white", "alpha": 0.82, "edgecolor": "none", "pad": 1.2}
    first, following = kind_words(stretch.segment)
    axes.text(0.03, place, first, va="center", fontsize=8, weight="bold", color=INK, bbox=box)
    axes.text(1.04, place, following, va="center", fontsize=8.5, color=PANEL_INK)
