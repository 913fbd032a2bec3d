"""Pages as values, rendered by jinja2 templates to self-contained HTML files. The only user of jinja2.

`templates/base.html.j2` is the page that all others extend. Values are escaped in the template, except for the assets.
The same value gives the same bytes.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from micah_plan.errors import InputError
from micah_plan.view.chart import Chart
from micah_plan.view.diagram import Diagram

if TYPE_CHECKING:
    from micah_plan.view.scene import DrawnScene

Status = Literal["good", "fair", "bad"]

_ASSETS = Path(__file__).parent / "assets"
_PAGE_DATA = re.compile(r'<script type="application/json" id="page-data">(.*?)</script>', re.DOTALL)
_NO_BREAK = "\N{NO-BREAK SPACE}"
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:%|(?:m|mm|rad|s|min|h|N|nats|σ)\b))")
_PLAYER_KEYS = (("space", "play, pause"), ("← →", "step"), ("p", "panels"), ("w m o", "views"))


@dataclass(frozen=True)
class LegendEntry:
    """A colour with its meaning; with a layer, a checkbox to hide it, and optionally a key."""

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
    """The timeline of the player.

    Attributes:
        duration: of the animation [s]; 0 for a still scene.
        bands: the modes or segments along it.
        readouts: (time [s], lines of text shown from then on).
    """

    duration: float = 0.0
    bands: tuple[Band, ...] = ()
    readouts: tuple[tuple[float, tuple[str, ...]], ...] = ()

    @property
    def lanes(self) -> tuple[tuple[Band, ...], ...]:
        """The bands by lane; one empty lane without bands."""
        count = 1 + max((band.lane for band in self.bands), default=0)
        return tuple(tuple(band for band in self.bands if band.lane == lane) for lane in range(count))


@dataclass(frozen=True)
class Bar:
    """A row of a bar chart: its name, a bar of a given fraction (0 to 1) of the width, and a text."""

    label: str
    words: str
    share: float
    color: str = ""
    faint: bool = False


@dataclass(frozen=True)
class Bars:
    """A small bar chart with its heading."""

    title: str
    rows: tuple[Bar, ...]


@dataclass(frozen=True)
class Block:
    """A chart with its words.

    Attributes:
        title: above it.
        words: sentences below the title.
        chart: None for none.
        bars: small bar charts below it.
        notes: sentences at the end.
        alarm: whether the title reports an error.
        keyframes: (time on the player [s], x of the chart) of the line that follows the player.
    """

    title: str
    words: tuple[str, ...] = ()
    chart: Chart | None = None
    bars: tuple[Bars, ...] = ()
    notes: tuple[str, ...] = ()
    alarm: bool = False
    keyframes: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class RunEntry:
    """One of the runs that a page can show, alone or with others.

    Attributes:
        label: in the list to choose from.
        words: sentences about it, shown while it is chosen.
        layer: of the scene with its own objects; empty: none.
        readouts: as of `Timeline`, shown below these while it is chosen.
        drawn_as: number by which curves of the charts belong to it.
    """

    label: str
    words: tuple[str, ...]
    layer: str
    drawn_as: int
    readouts: tuple[tuple[float, tuple[str, ...]], ...] = ()


@dataclass(frozen=True)
class ScenePage:
    """The content of a page with a 3-D scene, without the scene.

    Attributes:
        title, kind: name of the shown object, and its kind.
        camera: of `view.camera`.
        badge: the outcome in a few words, with its status.
        task: a sentence on the task below the title.
        message: a sentence below the badge.
        facts: (label, value) pairs.
        chips: (text, colour), e.g. the mode sequence.
        reasons: (text, colour, sentence) why some of them are there.
        details: (heading, lines) folded away at first.
        legend, timeline: see their types.
        hidden: layers that are switched off at first.
        shows_all_runs: whether all runs are shown at first, and not the first of them.
        charts: shown in a column of their own, below the panel where the window is narrow.
        runs: to choose from; the first is shown at first.
        pictures: (time on the player [s], JPEG) of a camera, shown next to the scene.
        is_within: whether it is shown within another page, which has its title and its legend of colours.
        open_details: headings of details that are not folded away.
        diagram: of the automaton, whose box of the current mode is filled.
        fade: layers of runs between which a slider fades, e.g. before and after.
        is_tinted: whether the object takes on the colour of the band that plays.
    """

    title: str
    kind: str
    camera: Mapping[str, Any]
    badge: tuple[str, Status] | None = None
    task: str = ""
    message: str = ""
    facts: Sequence[tuple[str, str]] = ()
    chips: Sequence[tuple[str, str]] = ()
    reasons: Sequence[tuple[str, str, str]] = ()
    details: Sequence[tuple[str, Sequence[str]]] = ()
    legend: Sequence[LegendEntry] = ()
    timeline: Timeline = field(default_factory=Timeline)
    hidden: Sequence[str] = ()
    shows_all_runs: bool = False
    charts: Sequence[Block] = ()
    runs: Sequence[RunEntry] = ()
    pictures: Sequence[tuple[float, bytes]] = ()
    is_within: bool = False
    open_details: Sequence[str] = ()
    diagram: Diagram | None = None
    fade: tuple[str, str] | None = None
    is_tinted: bool = False


def render_scene(page: ScenePage, scene: DrawnScene) -> str:
    """The page of a plan, a model or a recording as HTML text."""
    from micah_plan.view.scene import layer_path, viewer_javascript

    data = {
        "title": page.title,
        "commands": scene.encoded(),
        "camera": page.camera,
        "duration": page.timeline.duration,
        "modes": [[round(band.start, 4), band.label, band.color] for band in page.timeline.lanes[0]],
        "tinted": page.is_tinted,
        "readouts": [[time, list(lines)] for time, lines in page.timeline.readouts],
        "layers": {entry.layer: layer_path(entry.layer) for entry in page.legend if entry.layer},
        "hidden": list(page.hidden),
        "fade": list(page.fade or ()),
        "runs": [
            {
                "words": list(run.words),
                "path": layer_path(run.layer) if run.layer else [],
                "drawn": run.drawn_as,
                "readouts": [[round(time, 4), list(lines)] for time, lines in run.readouts],
            }
            for run in page.runs
        ],
        "pictures": [
            [round(time, 4), f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"]
            for time, jpeg in page.pictures
        ],
        "charts": [[[round(time, 4), x] for time, x in block.keyframes] for block in page.charts],
    }
    keys = [
        *_PLAYER_KEYS,
        *([("r", "next run")] if page.runs else []),
        *((entry.key, entry.key_label) for entry in page.legend if entry.key),
    ]
    return render("scene.html.j2", page=page, data=data, keys=keys, viewer=Markup(viewer_javascript()))  # noqa: S704


def bare_scene(page: str) -> str:
    """The scene of a page of `render_scene` alone: MeshCat's viewer with its own controls and no panels."""
    from micah_plan.view.scene import viewer_javascript

    match = _PAGE_DATA.search(page)
    if match is None:
        raise InputError("the page has no scene", remedy="take the page of a recording, a model or a plan")
    data = json.loads(match[1])
    named = {"title": data["title"], "kind": "scene"}
    return render("bare.html.j2", page=named, data=data, viewer=Markup(viewer_javascript()))  # noqa: S704


def render(template: str, **values: object) -> str:
    """HTML of a file in `templates/` with escaped values."""
    environment = Environment(
        loader=PackageLoader("micah_plan", "view/templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False, "sort_keys": False}
    environment.filters["glued"] = glued
    environment.globals["asset"] = _asset
    return environment.get_template(template).render(**values)


def glued(words: str) -> str:
    """The text with no-break spaces within amounts."""
    return _BEFORE_UNIT.sub(_NO_BREAK, words.replace(" ± ", f"{_NO_BREAK}±{_NO_BREAK}"))


def _asset(name: str) -> Markup:
    """A bundled style sheet or script, which needs no escaping."""
    return Markup((_ASSETS / name).read_text(encoding="utf-8"))  # noqa: S704
