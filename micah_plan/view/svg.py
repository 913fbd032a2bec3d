"""Small charts as SVG: a panel with its scales, and marks in it. Colours follow the page, light or dark.

Numbers are pixels of the drawing, which the page scales to its column. `element` escapes every text.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats

_MOST_POINTS = 600
_TICK_ROOM, _LABEL_ROOM, _AXIS_ROOM = 15.0, 31.0, 38.0


class Svg(str):
    """Markup: what has gone through `element` is not escaped again, there or in a template."""

    __slots__ = ()

    def __html__(self) -> str:
        """The markup as it is; template engines ask for it."""
        return str(self)


def element(tag: str, *inside: str, kind: str = "", color: str = "", **attributes: str | float) -> Svg:
    """An element of markup.

    Args:
        inside: elements, or texts, which are escaped.
        kind: its class of the style sheet.
        color: that the style sheet finds as ``--tint``.
        attributes: numbers are rounded to a tenth; an underscore in a name stands for a hyphen.
    """
    named: dict[str, str | float] = {"class": kind, **attributes, "style": f"--tint:{color}" if color else ""}
    texts = (
        f' {name.replace("_", "-")}="{escape(value) if isinstance(value, str) else f"{value:.1f}"}"'
        for name, value in named.items()
        if value != ""
    )
    content = "".join(part if isinstance(part, Svg) else escape(part) for part in inside)
    return Svg(f"<{tag}{''.join(texts)}>{content}</{tag}>" if content else f"<{tag}{''.join(texts)}/>")


@dataclass(frozen=True)
class Panel:
    """A rectangle of the drawing and the data that it shows: x from x0 to x1, y from y0 (below) to y1 (above)."""

    left: float
    top: float
    width: float
    height: float
    x0: float
    x1: float
    y0: float
    y1: float

    def below(self, gap: float, height: float, y0: float, y1: float) -> Panel:
        """A panel of another height and y further down, over the same x."""
        return replace(self, top=self.bottom + gap, height=height, y0=y0, y1=y1)

    def x(self, value: float) -> float:
        return self.left + self.width * (value - self.x0) / (self.x1 - self.x0)

    def y(self, value: float) -> float:
        return self.top + self.height * (self.y1 - value) / (self.y1 - self.y0)

    @property
    def bottom(self) -> float:
        return self.top + self.height

    @property
    def right(self) -> float:
        return self.left + self.width

    @property
    def frame(self) -> Svg:
        return rectangle(self.left, self.top, self.width, self.height, "frame")

    def band(self, start: float, end: float, kind: str, color: str = "") -> Svg:
        """A stretch of x over the whole height."""
        left, right = self.x(max(start, self.x0)), self.x(min(end, self.x1))
        return rectangle(left, self.top, max(right - left, 0.0), self.height, kind, color)

    def level_band(self, low: float, high: float, kind: str, color: str = "") -> Svg:
        """A stretch of y over the whole width."""
        top, bottom = self.y(min(high, self.y1)), self.y(max(low, self.y0))
        return rectangle(self.left, top, self.width, max(bottom - top, 0.0), kind, color)

    def vertical(self, value: float, kind: str) -> Svg:
        x = self.x(value)
        return element("line", kind=kind, x1=x, x2=x, y1=self.top, y2=self.bottom)

    def level(self, value: float, kind: str) -> Svg:
        y = self.y(value)
        return element("line", kind=kind, x1=self.left, x2=self.right, y1=y, y2=y)

    def area(self, x: Floats, low: Floats, high: Floats, kind: str, color: str = "") -> Svg:
        """The area between two curves (k,) over x (k,)."""
        edges = zip(np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]]), strict=True)
        path = "L".join(f"{self.x(float(a)):.1f} {self.y(float(b)):.1f}" for a, b in edges)
        return element("path", kind=kind, color=color, d=f"M{path}Z")

    def curve(
        self, x: NDArray[Any], y: Floats, kind: str, color: str = "", *, dots: bool = False, data_run: str = ""
    ) -> Svg:
        """A line through points (k,), (k,); or a dot at each. `data_run`: the run that it belongs to."""
        points = [f"{self.x(float(x[i])):.1f} {self.y(float(y[i])):.1f}" for i in evenly(len(x), _MOST_POINTS)]
        path = "".join(f"M{point}h0" for point in points) if dots else "M" + "L".join(points)
        return element("path", kind=kind, color=color, d=path, data_run=data_run) if points else Svg()

    def y_axis(self, label: str, most: int = 4) -> Svg:
        """Ticks with numbers, and the label up the side."""
        marks = ticks(self.y0, self.y1, most)
        parts = [text(self.left - 6, self.y(value) + 4, tick_text(value, marks), "number end") for value in marks]
        middle = self.top + self.height / 2
        for number, line in enumerate(label.split("\n")):
            x = 11.0 + 13 * number
            turned = f"rotate(-90 {x:g} {middle:.1f})"
            parts.append(element("text", line, kind="label mid", x=x, y=middle, transform=turned))
        return Svg("".join(parts))

    def x_axis(self, label: str, most: int = 6, *, whole: bool = True) -> Svg:
        """Ticks with numbers, whole ones only where x counts something, and the label below."""
        marks = [value for value in ticks(self.x0, self.x1, most) if not whole or value == round(value)]
        return self.named_x_axis(label, [(value, tick_text(value, marks)) for value in marks])

    def named_x_axis(self, label: str, named: Sequence[tuple[float, str]]) -> Svg:
        """Ticks with texts, and the label below."""
        parts = [text(self.x(value), self.bottom + _TICK_ROOM, words, "number mid") for value, words in named]
        return Svg("".join([*parts, text(self.left + self.width / 2, self.bottom + _LABEL_ROOM, label, "label mid")]))


_COLUMN, _MOST_ENLARGED = 560.0, 2.2  # pixels of a drawing that fill the column beside a scene of 900 pixels


def enlarged(total: float) -> float:
    """Times which panels of this height together are drawn higher, so that few of them fill the column."""
    return min(max(_COLUMN / max(total, 1.0), 1.0), _MOST_ENLARGED)


def drawing(width: float, panels: Sequence[Panel], parts: Sequence[Svg], label: str) -> Svg:
    """The SVG of parts in panels below each other; `label` describes it to screen readers."""
    box = f"0 0 {width:.0f} {panels[-1].bottom + _AXIS_ROOM:.0f}"
    return element("svg", *parts, kind="chart", viewBox=box, role="img", aria_label=label)


def played(width: float, panels: Sequence[Panel], parts: Sequence[Svg], x_label: str, label: str) -> Svg:
    """A drawing whose panels share an axis, with the line through them that follows the player of the page."""
    top, bottom = panels[0].top, panels[-1].bottom
    line = element("line", kind="cursor", x1=0.0, x2=0.0, y1=top, y2=bottom, visibility="hidden")
    frames = [panel.frame for panel in panels]
    return drawing(width, panels, [*parts, *frames, panels[-1].x_axis(x_label), line], label)


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """At most `most` of the numbers below `count`, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, most)).astype(np.int64))


def rectangle(left: float, top: float, width: float, height: float, kind: str, color: str = "") -> Svg:
    return element("rect", kind=kind, color=color, x=left, y=top, width=width, height=height)


def text(x: float, y: float, words: str, kind: str) -> Svg:
    return element("text", words, kind=kind, x=x, y=y)


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers (1, 2 or 5 times a power of ten apart) within a range, at least two and at most about `most`."""
    if not high > low:
        return [low]
    step = rounded_up((high - low) / most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    if first >= last:  # one number is no scale
        return ticks(low, high, 2 * most)
    return [round(step * i, 12) for i in range(first, last + 1)]


def rounded_up(length: float) -> float:
    """The next round number: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= length * 0.999)


def tick_text(value: float, among: Sequence[float]) -> str:
    """A tick with as many decimals as tell it from the other ticks of its axis; alone, with all that it has."""
    if len(among) < 2:
        return f"{value:g}".replace("-", "\N{MINUS SIGN}")
    gap = min((b - a for a, b in itertools.pairwise(among)))
    digits = max(0, -math.floor(math.log10(gap) + 1e-9))
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")
