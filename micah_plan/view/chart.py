"""Charts as values: panels below each other over one axis, and marks in them.

A page draws them with uPlot (`assets/charts.js`), a figure with Matplotlib (`figures.draw`); both draw the same marks.
Numbers are in the units of the axes; heights are pixels of a page's column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats

_MOST_POINTS = 600
_DIGITS = 6  # of a number on a page


@dataclass(frozen=True, eq=False)
class Curve:
    """A line through points (k,), (k,), or dots; values that are not finite are omitted.

    Attributes:
        label: in the legend of a figure.
        run: of the execution that it belongs to; a page may show that one alone.
    """

    x: Floats
    y: Floats
    look: Literal["line", "other", "run", "trend", "dots", "small", "rim"] = "line"
    color: str = ""
    label: str = ""
    run: int | None = None

    def __post_init__(self) -> None:
        points = np.stack([self.x, self.y]).astype(float)
        points = points[:, np.isfinite(points).all(axis=0)]
        points = points[:, evenly(points.shape[1], _MOST_POINTS)]
        object.__setattr__(self, "x", points[0])
        object.__setattr__(self, "y", points[1])


@dataclass(frozen=True, eq=False)
class Area:
    """The area between two curves (k,) over x (k,)."""

    x: Floats
    low: Floats
    high: Floats
    look: Literal["spread", "level"] = "spread"
    color: str = ""
    label: str = ""


@dataclass(frozen=True)
class Span:
    """An interval of x over the whole height."""

    start: float
    end: float
    look: Literal["shade", "hatched", "interval"] = "shade"
    color: str = ""
    label: str = ""


@dataclass(frozen=True)
class Range:
    """An interval of y over the whole width."""

    low: float
    high: float
    color: str
    label: str = ""


@dataclass(frozen=True)
class Level:
    """A horizontal line."""

    value: float
    look: Literal["guard", "zero"] = "guard"
    label: str = ""


@dataclass(frozen=True)
class Change:
    """A vertical line at a change."""

    at: float


@dataclass(frozen=True, eq=False)
class Columns:
    """Bars from 0 up to heights (k,), from left (k,) to right (k,) ends."""

    left: Floats
    right: Floats
    height: Floats


@dataclass(frozen=True)
class Words:
    """A text at a place.

    Attributes:
        y: None: above the panel, in a line that is counted from 0 upwards.
        side: of the place on which the text stands; "edge": behind the right edge of the panel.
        strong: whether it names something, or only explains.
        color: behind it.
    """

    text: str
    x: float
    y: float | None = None
    line: int = 0
    side: Literal["middle", "left", "right", "edge"] = "middle"
    strong: bool = True
    color: str = ""


Mark = Curve | Area | Span | Range | Level | Change | Columns | Words


@dataclass(frozen=True, eq=False)
class Panel:
    """A panel over the chart's x, with y from `low` to `high`; the label's lines are those of its axis."""

    label: str
    low: float
    high: float
    height: float
    marks: tuple[Mark, ...]

    def with_marks(self, *more: Mark) -> Panel:
        """The panel with additional marks behind the others."""
        return replace(self, marks=(*more, *self.marks))


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels in a column over a common x axis.

    Attributes:
        described: its content, for screen readers.
        x_label: of the axis below the last panel; it goes from `first` to `last`.
        places: (place, name) of ticks on that axis; empty: numbers.
        whole: whether these are whole, as of steps.
        lines: of words above the first panel.
        names: whether words stand behind the right edge.
        fills: whether a page draws it higher where it would leave most of its column empty.
    """

    described: str
    x_label: str
    first: float
    last: float
    panels: tuple[Panel, ...]
    places: tuple[tuple[float, str], ...] = ()
    whole: bool = False
    lines: int = 0
    names: bool = False
    fills: bool = False

    def encoded(self) -> dict[str, Any]:
        """The chart as JSON for a page: each mark with its type, numbers rounded."""
        frame = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "panels"}
        panels = [
            {"label": p.label, "low": p.low, "high": p.high, "height": p.height, "marks": [*map(_encoded, p.marks)]}
            for p in self.panels
        ]
        return {**frame, "panels": panels}


def _encoded(mark: Mark) -> dict[str, Any]:
    entries: dict[str, Any] = {"mark": type(mark).__name__.lower()}
    for field in fields(mark):
        value = getattr(mark, field.name)
        if isinstance(value, np.ndarray):
            entries[field.name] = [float(f"{number:.{_DIGITS}g}") for number in value.tolist()]
        elif value not in (None, ""):
            entries[field.name] = value
    return entries


def with_common_ranges(charts: Sequence[Chart]) -> list[Chart]:
    """Charts of equal panels, with a common range of y in each row."""
    rows = [
        (min(panel.low for panel in row), max(panel.high for panel in row))
        for row in zip(*(chart.panels for chart in charts), strict=True)
    ]
    return [
        replace(
            chart,
            panels=tuple(replace(p, low=low, high=high) for p, (low, high) in zip(chart.panels, rows, strict=True)),
        )
        for chart in charts
    ]


def widened(values: Sequence[Floats | float], margin: float = 0.08) -> tuple[float, float]:
    """Limits of a panel that contain all values with a margin."""
    shown = np.concatenate([np.ravel(value) for value in values])
    shown = shown[np.isfinite(shown)]
    low, high = (float(shown.min()), float(shown.max())) if shown.size else (0.0, 0.0)
    room = margin * (high - low) or 1e-3 * max(abs(high), 1.0)
    return low - room, high + room


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """At most `most` indices below `count`, evenly spread, including the first and the last."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, most)).astype(np.int64))
