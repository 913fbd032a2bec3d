"""The colours of pages and figures: one palette, distinguishable with every common colour-vision deficiency.

Source: Okabe and Ito, "Color Universal Design", 2008.
"""

from __future__ import annotations

from micah_plan.automaton.hybrid import HybridAutomaton

BLUE = "#0072B2"
VERMILLION = "#D55E00"
GREEN = "#009E73"
PINK = "#CC79A7"
SKY = "#56B4E9"
ORANGE = "#E69F00"

OLIVE = "#999933"
SLATE = "#5A5A8A"

CATEGORIES = (SKY, VERMILLION, PINK, OLIVE, SLATE)
"""Segments and modes, in their order of appearance; none is a colour that means something else below."""

NO_SINGLE_JOINT = "#F0C808"
"""What fits no joint: yellow, hatched where an area can be, so that it is not taken for one more joint."""

BELIEF = BLUE
EXECUTED = ORANGE
EXECUTED_BEFORE = PINK
"""Runs that others are compared with."""
GOAL = GREEN
INK = "#1F2933"
MUTED = "#7B8794"
START = "#9AA5B1"
GUARD = "#52606D"
BODY = "#CBD2D9"
GRID = "#C3CCD5"
FRAME_AXES = ("#C0392B", "#27AE60", "#2F6FDE")
"""x, y and z of a coordinate frame."""


def category(index: int) -> str:
    """Colour of segment or mode number `index`; the palette repeats after its last colour."""
    return CATEGORIES[index % len(CATEGORIES)]


def mode_colors(automaton: HybridAutomaton) -> dict[str, str]:
    """The colour of each mode, the same on every page and figure of a model."""
    return {name: category(i) for i, name in enumerate(automaton.mode_names)}
