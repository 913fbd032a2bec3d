"""The HTML document around a scene: panel, legend, timeline and player, all in one file that fetches nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from typing import Any, Literal

from micah_plan.view.scene import Scene, layer_path, viewer_javascript

Status = Literal["good", "bad", "plain"]

# The browser itself refuses every connection: the page can only use what it carries.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src data:; worker-src blob:"
)


_PLAYER_KEYS = (("space", "play, pause"), ("← →", "step"), ("Home End", "first, last"))


@dataclass(frozen=True)
class LegendEntry:
    """A colour and what it means; with a layer, a box to hide it, and a key that does the same if one is named."""

    color: str
    label: str
    layer: str | None = None
    shape: Literal["line", "dot", "area"] = "area"
    key: str = ""
    key_label: str = ""


@dataclass(frozen=True)
class Band:
    """A stretch of the timeline [s] in one colour, in a lane that is counted from 0."""

    start: float
    end: float
    color: str
    label: str
    lane: int = 0


@dataclass(frozen=True)
class Timeline:
    """What the player plays.

    Attributes:
        duration: of the animation [s]; 0 for a still scene.
        bands: the modes or segments along it.
        readouts: (time [s], lines of text shown from then on).
    """

    duration: float = 0.0
    bands: tuple[Band, ...] = ()
    readouts: tuple[tuple[float, tuple[str, ...]], ...] = ()

    @property
    def lanes(self) -> int:
        """How many bars lie below each other; one is empty where there are no bands."""
        return 1 + max((band.lane for band in self.bands), default=0)


@dataclass(frozen=True)
class ChartBlock:
    """Charts with their words.

    Attributes:
        html: ready for the page, its texts escaped.
        keyframes: (time on the player [s], x in the drawing [px]) of the line that follows the player.
    """

    html: str
    keyframes: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Document:
    """Everything on a page except the scene. All texts but those of charts are plain text; they are escaped here.

    Attributes:
        title, kind: name of the thing, and what sort of thing it is.
        badge: the outcome in a few words, with its status.
        message: a sentence below it.
        facts: (label, value) pairs.
        chips: (text, colour), e.g. the mode sequence.
        details: (heading, lines) folded away at first.
        legend, timeline, camera: see their types.
        hidden: layers that are switched off at first.
        charts: shown in a column of their own, below the panel where the window is narrow.
    """

    title: str
    kind: str
    camera: Mapping[str, Any]
    badge: tuple[str, Status] | None = None
    message: str = ""
    facts: Sequence[tuple[str, str]] = ()
    chips: Sequence[tuple[str, str]] = ()
    details: Sequence[tuple[str, Sequence[str]]] = ()
    legend: Sequence[LegendEntry] = ()
    timeline: Timeline = field(default_factory=Timeline)
    hidden: Sequence[str] = ()
    charts: Sequence[ChartBlock] = ()


def render(document: Document, scene: Scene) -> str:
    """The page as HTML text; the same document and scene give the same bytes."""
    assets = resources.files("micah_plan.view") / "assets"
    data = {
        "commands": scene.encoded(),
        "camera": document.camera,
        "duration": document.timeline.duration,
        "readouts": [[time, list(lines)] for time, lines in document.timeline.readouts],
        "layers": {e.layer: layer_path(e.layer) for e in document.legend if e.layer},
        "hidden": list(document.hidden),
        "charts": [[[round(time, 4), round(x, 1)] for time, x in chart.keyframes] for chart in document.charts],
    }
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
            '<meta name="color-scheme" content="light dark">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(document.title)} ({escape(document.kind)})</title>",
            '<link rel="icon" href="data:,">',
            f"<style>\n{(assets / 'page.css').read_text(encoding='utf-8')}</style>",
            "</head>",
            f'<body class="{" ".join(_layout(document))}" style="--lanes:{document.timeline.lanes}">',
            '<main id="view"><div id="meshcat-pane"></div></main>',
            _panel(document),
            _player(document),
            # A '<' in the data could otherwise end the script element.
            f'<script type="application/json" id="page-data">{_json(data)}</script>',
            "<!-- 3-D viewer: MeshCat and three.js (MIT licence) -->",
            f"<script>{viewer_javascript()}</script>",
            f"<script>\n{(assets / 'player.js').read_text(encoding='utf-8')}</script>",
            "</body>",
            "</html>",
            "",
        ]
    )


def _layout(document: Document) -> list[str]:
    still = ["still"] if document.timeline.duration <= 0 else []
    return still + (["charted"] if document.charts else [])


def _panel(document: Document) -> str:
    parts = ['<aside id="panel">', f'<p class="kind">{escape(document.kind)}</p>', f"<h1>{escape(document.title)}</h1>"]
    if document.badge:
        text, status = document.badge
        parts.append(f'<p class="badge {status}">{escape(text)}</p>')
    if document.message:
        parts.append(f'<p class="message">{escape(document.message)}</p>')
    if document.chips:
        chips = "".join(f'<li style="--tint:{escape(color)}">{escape(text)}</li>' for text, color in document.chips)
        parts.append(f'<ol class="chips">{chips}</ol>')
    if document.facts:
        rows = "".join(f"<dt>{escape(label)}</dt><dd>{escape(value)}</dd>" for label, value in document.facts)
        parts.append(f'<dl class="facts">{rows}</dl>')
    if document.legend:
        parts.append(f'<h2>Legend</h2><ul class="legend">{"".join(map(_legend_entry, document.legend))}</ul>')
    for heading, lines in document.details:
        items = "".join(f"<li>{escape(line)}</li>" for line in lines)
        parts.append(f"<details><summary>{escape(heading)}</summary><ul>{items}</ul></details>")
    if document.charts:
        blocks = "".join(f'<section class="block">{chart.html}</section>' for chart in document.charts)
        parts.append(f'<div id="charts">{blocks}</div>')
    parts.append("</aside>")
    return "\n".join(parts)


def _legend_entry(entry: LegendEntry) -> str:
    swatch = f'<i class="{entry.shape}" style="--tint:{escape(entry.color)}"></i><span>{escape(entry.label)}</span>'
    if entry.layer is None:
        return f"<li>{swatch}</li>"
    key = f' data-key="{escape(entry.key)}"' if entry.key else ""
    told = f"show or hide{f' (key {escape(entry.key)})' if entry.key else ''}"
    box = f'<input type="checkbox" checked data-layer="{escape(entry.layer)}"{key} title="{told}">'
    return f"<li><label>{swatch}{box}</label></li>"


def _player(document: Document) -> str:
    timeline = document.timeline
    if timeline.duration <= 0:
        return ""
    lanes = ["".join(_band(b, timeline) for b in timeline.bands if b.lane == lane) for lane in range(timeline.lanes)]
    bands = "".join(f'<div class="lane">{lane}</div>' for lane in lanes)
    keys = [*_PLAYER_KEYS, *((entry.key, entry.key_label) for entry in document.legend if entry.key)]
    told = "".join(
        f"<span>{''.join(f'<kbd>{escape(key)}</kbd> ' for key in names.split())}{escape(does)}</span>"
        for names, does in keys
    )
    return (
        '<footer id="player"><button id="play" type="button" aria-label="play or pause" title="play or pause (space)">'
        f'</button><div id="track"><div id="bands">{bands}</div>'
        f'<input id="time" type="range" min="0" max="{timeline.duration:.4f}" step="any" value="0" aria-label="time">'
        f'<p id="keys">{told}</p></div><output id="readout"></output></footer>'
    )


def _band(band: Band, timeline: Timeline) -> str:
    left, width = 100 * band.start / timeline.duration, 100 * (band.end - band.start) / timeline.duration
    place = f"left:{left:.3f}%;width:{width:.3f}%;--tint:{escape(band.color)}"
    return f'<div style="{place}" title="{escape(band.label)}"><span>{escape(band.label)}</span></div>'


def _json(data: Any) -> str:
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
