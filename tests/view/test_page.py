"""Pages as values: every text is escaped wherever it stands, markup not twice, and numbers stay with their units."""

from __future__ import annotations

import dataclasses
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micah_plan.summaries import Table
from micah_plan.view.chart import Chart, Curve, Panel, Words
from micah_plan.view.page import (
    Band,
    Bar,
    Bars,
    Block,
    LegendEntry,
    ScenePage,
    Timeline,
    glued,
    render,
    render_scene,
)
from micah_plan.view.scene import DrawnScene

WORD = "zebra"
HOSTILE = "</script></style><img src=x onerror=alert(1)>\"'&{{ 7 * 7 }}{% raw %}"
CAMERA = {"position": [1.0, 1.0, 1.0], "target": [0.0, 0.0, 0.0], "near": 0.1, "far": 10.0, "angle": 36.0}


class Elements(HTMLParser):
    """Tags with their attributes, and all text outside of scripts and styles."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.text = ""
        self._raw = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        self._raw = tag in ("script", "style")

    def handle_endtag(self, tag: str) -> None:  # noqa: ARG002
        self._raw = False

    def handle_data(self, data: str) -> None:
        self.text += "" if self._raw else data


def chart_of(text: str) -> Chart:
    """A chart that has a text in every place that takes one."""
    marks = Curve(np.arange(3.0), np.ones(3), color=text, label=text), Words(text, 0.5, color=text)
    return Chart(text, text, 0.0, 1.0, (Panel(text, 0.0, 1.0, 90.0, marks),), ((0.0, text),))


def scene_page(text: str) -> str:
    """A page that has a text in every place that takes one."""
    bars = Bars(text, (Bar(text, text, 0.5, text),))
    block = Block(text, (text,), chart_of(text), (bars,), (text,), alarm=True, keyframes=((0.0, 1.0),))
    page = ScenePage(
        text, text, CAMERA, (text, "good"), text, text, [(text, text)], [(text, text)], [(text, text, text)],
        [(text, [text])],
        [LegendEntry(text, text, "layer", key="x", key_label=text)],
        Timeline(1.0, (Band(0.0, 1.0, text, text),), ((0.0, (text,)),)), charts=[block],
    )  # fmt: skip
    return render_scene(page, DrawnScene())


def report(text: str) -> dict[str, object]:
    """What the template of a calibration takes."""
    table = Table((text,), ((text,),), numeric=(0,))
    effect = {"name": text, "sentences": text, "source": text, "ambiguity": text}
    charts = {
        "correlation": table,
        "motion": [chart_of(text)],
        "pairs": [(chart_of(text), chart_of(text))],
        "ranking": Bars("", ()),
        "runs": table,
    }
    coordinate = {"name": text, "summary": text, **charts}
    return {
        "title": text, "kind": text, "badge": (text, "good"), "message": text, "notes": [text], "modes": [text],
        "parameters": table, "effects": [effect], "errors": table, "poses": table, "unexplained": text,
        "coordinates": [coordinate], "experiment": text, "headline": text, "first": [chart_of(text)], "scene": text,
    }  # fmt: skip


@pytest.mark.parametrize("make", [scene_page, lambda text: render("calibration.html.j2", page=report(text))])
def test_no_text_becomes_markup_anywhere(make) -> None:
    plain, hostile = Elements(make(WORD)), Elements(make(HOSTILE))
    assert hostile.tags == plain.tags
    assert len(hostile.attributes) == len(plain.attributes)
    assert hostile.text.count(HOSTILE) == plain.text.count(WORD)
    assert plain.text.count(WORD) > 8
    assert "49" not in hostile.text, "texts are no templates"


@pytest.mark.parametrize("make", [scene_page, lambda text: render("calibration.html.j2", page=report(text))])
def test_every_page_forbids_the_browser_to_connect(make) -> None:
    policy = next(value for name, value in Elements(make(WORD)).attributes if name == "content" and value)
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy


@pytest.mark.slow
@given(st.text())
def test_a_chart_carries_its_texts_as_they_are(text: str) -> None:
    """Whatever is in them, the element ends where it should and the script reads the same."""
    page = render("calibration.html.j2", page=report(text))
    carried = re.findall(r'<div class="chart" [^>]*><script type="application/json">(.*?)</script></div>', page)
    assert len(carried) == 4
    for value in map(json.loads, carried):
        assert value == chart_of(text).encoded() | {"places": [[0.0, text]]}


def test_numbers_stay_with_their_units() -> None:
    assert glued("5 mm and 1.20 ± 0.03 rad (68.8 ± 1.7°) at 95 % of 3 metres") == (
        "5\xa0mm and 1.20\xa0±\xa00.03\xa0rad (68.8\xa0±\xa01.7°) at 95\xa0% of 3 metres"
    )


def test_lanes_of_a_timeline() -> None:
    bands = (Band(0, 1, "", "a"), Band(0, 1, "", "b", 2), Band(1, 2, "", "c"))
    assert [[band.label for band in lane] for lane in Timeline(2.0, bands).lanes] == [["a", "c"], [], ["b"]]
    assert Timeline().lanes == ((),)


def test_what_a_template_lacks_is_an_error_not_a_gap() -> None:
    with pytest.raises(Exception, match="title"):
        render("calibration.html.j2", page={key: value for key, value in report("x").items() if key != "title"})


def test_pages_are_values() -> None:
    page = ScenePage("a", "b", CAMERA)
    assert dataclasses.replace(page, title="c").title == "c"
    assert render_scene(page, DrawnScene()) == render_scene(dataclasses.replace(page), DrawnScene())
