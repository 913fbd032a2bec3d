"""The track of a part in 3-D, coloured by segment, with the fitted joints: axis, centre, arc, line or resting place."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from micah_plan.recording.value import Recording
from micah_plan.view.drawing import joint_axis, joint_curve, viewing_direction
from micah_plan.view.learned import LearnedRun, Stretch
from micah_plan.view.palette import GRID, INK, MUTED
from micah_plan.view.segments import is_misfit

Floats = NDArray[np.float64]

_ZOOM, _ZOOM_ON_FLAT = 0.86, 0.76
_FAR = 2.5
"""A centre farther away than this many track sizes is not drawn: it would shrink the track to a dot."""


def plot_track(space: Any, learned: LearnedRun) -> None:
    """The part's positions in the frame of its parent, and the joints of its segments, one of a kind and colour."""
    size = max(float(np.linalg.norm(np.ptp(learned.position, axis=0))), 1e-3)
    segmented = np.zeros(len(learned.rows), dtype=bool)
    for stretch in learned.stretches:
        own = np.isin(learned.rows, stretch.rows)
        segmented |= own
        edge = INK if is_misfit(stretch.segment) else "none"
        space.scatter(
            *learned.position[own].T, s=17, color=stretch.colored.color, edgecolors=edge, linewidths=0.5,
            depthshade=False,
        )  # fmt: skip
    if not segmented.all():
        space.scatter(*learned.position[~segmented].T, s=9, color=MUTED, depthshade=False)
    seen = [learned.position]
    for stretch in {s.colored.color: s for s in reversed(learned.stretches)}.values():
        if not is_misfit(stretch.segment):
            seen += _plot_joint(space, stretch, size)
    _finish(space, np.concatenate(seen), learned.position, "" if learned.in_base else f" in {learned.edge.parent}")


def plot_plain_track(space: Any, recording: Recording) -> None:
    """The measured positions of a recording of which nothing was learned."""
    space.scatter(*recording.position.T, s=9, color=MUTED, depthshade=False)
    _finish(space, recording.position, recording.position, "")


def _plot_joint(space: Any, stretch: Stretch, size: float) -> list[Floats]:
    """Draw a joint in ink; returns the points (k, 3) that must be in sight."""
    joint = stretch.segment.joint
    curve = joint_curve(joint, *stretch.segment.configuration_range)
    if joint.kind == "rigid":
        space.plot(*curve[:1].T, "o", ms=15, mfc="none", mec=INK, mew=1.4)
        return [curve]
    space.plot(*curve.T, color=INK, lw=1.6)
    if joint.kind == "prismatic":
        # The arrow's head: the direction in which the configuration grows.
        space.quiver(*curve[0], *(1.12 * (curve[1] - curve[0])), color=INK, lw=1.6, arrow_length_ratio=0.08)
        return [curve]
    center = np.array(joint.center)
    if float(np.linalg.norm(center - curve.mean(axis=0))) > _FAR * size:
        return [curve]
    axis = joint_axis(joint, 0.55 * size)
    if axis is None:
        return [curve]
    space.plot(*axis.T, color=INK, lw=1.3, ls=(0, (5, 2, 1, 2)))
    space.text(*axis[int(axis[:, 2].argmax())], " axis", color=INK, fontsize=9, va="bottom")
    space.plot(*center[:, None], "o", ms=4.5, color=INK)
    space.text(*center, "centre  ", color=INK, fontsize=9, va="top", ha="right")
    for end in (curve[0], curve[-1]):
        space.plot(*np.stack([center, end]).T, color=MUTED, lw=0.8)
    return [curve, axis, center[None]]


def _finish(space: Any, seen: Floats, motion: Floats, frame: str) -> None:
    """Equal scales on all axes, few ticks, no boxes, and a view that sees the motion spread out."""
    toward = viewing_direction(motion, motion.mean(axis=0), 1.0)
    azimuth = np.degrees(np.arctan2(toward[1], toward[0]))
    space.view_init(elev=float(np.degrees(np.arcsin(toward[2]))), azim=float(azimuth))
    low, high = seen.min(axis=0), seen.max(axis=0)
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
        axis._axinfo["grid"].update(color=GRID, linewidth=0.5)
        axis.set_major_locator(_locator(float(length / half.max())))
        axis.line.set_color(MUTED)
    space.tick_params(labelsize=8, pad=1, colors=INK)


def _locator(share: float) -> Any:
    """As many ticks as a side of this length, relative to the longest, has room for."""
    return MaxNLocator(nbins=max(2, round(4.4 * share)), steps=[1, 2, 5, 10], min_n_ticks=1)
