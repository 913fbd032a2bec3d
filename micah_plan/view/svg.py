"""Small charts as SVG text: a panel with its scales, and marks in it. Colours follow the page, light or dark.

Numbers are pixels of the drawing, which the page scales to its column. Texts are escaped here.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_MOST_POINTS = 600


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

    def x(self, value: float) -> float:
        return self.left + self.width * (value - self.x0) / (self.x1 - self.x0)

    def y(self, value: float) -> float:
        return self.top + self.height * (self.y1 - value) / (self.y1 - self.y0)

    @property
    def bottom(self) -> float:
        return self.top + self.height

    def band(self, start: float, end: float, kind: str, color: str = "") -> str:
        """A stretch of x over the whole height."""
        left, right = self.x(max(start, self.x0)), self.x(min(end, self.x1))
        return rectangle(left, self.top, max(right - left, 0.0), self.height, kind, color)

    def vertical(self, value: float, kind: str) -> str:
        x = self.x(value)
        return f'<line class="{kind}" x1="{x:.1f}" x2="{x:.1f}" y1="{self.top:.1f}" y2="{self.bottom:.1f}"/>'

    def level(self, value: float, kind: str) -> str:
        y = self.y(value)
        return (
            f'<line class="{kind}" x1="{self.left:.1f}" x2="{self.left + self.width:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>'
        )

    def level_band(self, low: float, high: float, kind: str, color: str = "") -> str:
        """A stretch of y over the whole width."""
        top, bottom = self.y(min(high, self.y1)), self.y(max(low, self.y0))
        return rectangle(self.left, top, self.width, max(bottom - top, 0.0), kind, color)

    def area(self, x: Floats, low: Floats, high: Floats, kind: str, color: str = "") -> str:
        """What lies between two curves (k,) over x (k,)."""
        edges = zip(np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]]), strict=True)
        path = "L".join(f"{self.x(float(a)):.1f} {self.y(float(b)):.1f}" for a, b in edges)
        return f'<path class="{kind}" d="M{path}Z"{_tint(color)}/>'

    def curve(
        self, x: NDArray[np.float64 | np.int64], y: Floats, kind: str, color: str = "", *, dots: bool = False
    ) -> str:
        """A line through points (k,), (k,); or a dot at each."""
        chosen = np.unique(np.linspace(0, max(len(x) - 1, 0), min(len(x), _MOST_POINTS)).astype(int))
        points = [f"{self.x(float(x[i])):.1f} {self.y(float(y[i])):.1f}" for i in chosen]
        path = "".join(f"M{point}h0" for point in points) if dots else "M" + "L".join(points)
        return f'<path class="{kind}" d="{path}"{_tint(color)}/>' if points else ""

    def y_axis(self, label: str, most: int = 4) -> str:
        """Ticks with numbers, and the label up the side."""
        found = ticks(self.y0, self.y1, most)
        parts = [text(self.left - 6, self.y(value) + 4, _number(value, found), "number end") for value in found]
        middle = self.top + self.height / 2
        for number, line in enumerate(label.split("\n")):
            x = 11 + 13 * number
            words = f'<text class="label mid" x="{x}" y="{middle:.1f}" transform="rotate(-90 {x} {middle:.1f})">'
            parts.append(f"{words}{escape(line)}</text>")
        return "".join(parts)

    def x_axis(self, label: str, most: int = 6) -> str:
        found = [value for value in ticks(self.x0, self.x1, most) if value == round(value)]
        parts = [text(self.x(value), self.bottom + 15, f"{value:.0f}", "number mid") for value in found]
        return "".join(parts) + text(self.left + self.width / 2, self.bottom + 31, label, "label mid")


def rectangle(left: float, top: float, width: float, height: float, kind: str, color: str = "") -> str:
    place = f'x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}"'
    return f'<rect class="{kind}" {place}{_tint(color)}/>'


def text(x: float, y: float, words: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{escape(words)}</text>'


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers (1, 2 or 5 times a power of ten apart) within a range, at most about so many."""
    if not high > low:
        return [low]
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(step * i, 12) for i in range(first, last + 1)]


def _number(value: float, among: list[float]) -> str:
    gap = min((b - a for a, b in itertools.pairwise(among)), default=1.0)
    digits = max(0, -math.floor(math.log10(gap) + 1e-9))
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def _tint(color: str) -> str:
    return f' style="--tint:{escape(color)}"' if color else ""
