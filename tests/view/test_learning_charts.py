"""The charts on the page of a recording: in place, in colour, escaped, and in step with the player."""

from __future__ import annotations

import dataclasses
import json
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from learned_objects import assessed_door, cabinet_runs, no_joint
from view_objects import measured, words_of

from micah_plan.automaton.graph import KinematicGraph
from micah_plan.quantities import percent
from micah_plan.recording.value import Recording
from micah_plan.view.learned import FLOOR, EvidenceLine, learned_runs, line_labels, segment_labels
from micah_plan.view.learning_charts import learning_chart
from micah_plan.view.palette import MISFIT, category
from micah_plan.view.recording_page import recording_page
from micah_plan.view.svg import Panel, ticks

Element = ElementTree.Element


def block(
    recording: Recording, graph: KinematicGraph, number: int = 0
) -> tuple[Element, str, list[tuple[float, float]]]:
    """The drawing, all words around it, and the keyframes of its cursor."""
    run = learned_runs(recording, graph)[number]
    made = learning_chart(recording, run, np.asarray(recording.time), several_runs=False)
    parsed = ElementTree.fromstring(made.drawing)  # noqa: S314 (our own drawing)
    return parsed, words_of(made), list(made.keyframes)


def of_class(drawing: Element, name: str) -> list[Element]:
    return [element for element in drawing.iter() if element.get("class") == name]


def tint(element: Element) -> str:
    return element.get("style", "").removeprefix("--tint:")


def dots(element: Element) -> np.ndarray:
    return np.array(re.findall(r"M([-\d.]+) ([-\d.]+)h0", element.get("d", "")), dtype=float)


def test_rows_lie_where_the_cursor_says_and_have_their_colour() -> None:
    recording, graph = assessed_door()
    drawing, _, keyframes = block(recording, graph)
    first, second = of_class(drawing, "dots")
    assert [tint(first), tint(second)] == [category(0), category(1)]
    assert [len(dots(first)), len(dots(second))] == [40, 20]
    np.testing.assert_allclose([time for time, _ in keyframes], recording.time)
    np.testing.assert_allclose(np.concatenate([dots(first), dots(second)])[:, 0], [x for _, x in keyframes], atol=0.06)
    assert (np.diff(dots(first)[::5, 1]) < 0).all(), "opening goes up"


def test_the_interval_is_drawn_at_its_rows_in_every_panel() -> None:
    recording, graph = assessed_door()
    low, high = graph.edges[0].segments[1].certainty.start.interval()
    drawing, words, keyframes = block(recording, graph)
    bands = of_class(drawing, "interval")
    assert len(bands) == 3
    x = dict(enumerate(x for _, x in keyframes))
    row = x[1] - x[0]
    for band in bands:
        left = float(band.get("x", "nan"))
        assert left == pytest.approx(x[low] - row / 2, abs=0.1)
        assert left + float(band.get("width", "nan")) == pytest.approx(x[high] + row / 2, abs=0.2)
    assert f"95 %: {low} to {high}" in words


def test_the_posterior_is_in_bars_and_words() -> None:
    recording, graph = assessed_door()
    drawing, words, _ = block(recording, graph)
    posterior = np.array(graph.edges[0].certainty.trace.changepoint)
    heights = np.array([float(bar.get("height", "nan")) for bar in of_class(drawing, "bar")])
    shown = posterior[posterior >= 1e-4]
    np.testing.assert_allclose(heights / heights.max(), shown / shown.max(), atol=0.01)
    for text in ("96 %", "revolute 93 %, then screw 6 %", "rigid 88 %, then revolute 9 %", "0.92 ± 0.02"):
        assert text in words


def test_every_model_has_a_line_and_a_name() -> None:
    drawing, words, _ = block(*assessed_door(noise=0.002))
    colored = {tint(line): line for line in of_class(drawing, "line")}
    assert set(colored) == {category(0), category(1)}
    assert len(of_class(drawing, "line other")) == 3
    for name in ("rigid (2)", "ruled out:", "free motion", "best single [nats]", "configuration [rad]"):
        assert name in words


def test_no_joint_fits_is_said_in_words_and_colour() -> None:
    page = recording_page(*no_joint())
    assert '<p class="badge bad">no single-joint model fits</p>' in page
    assert '<h3 class="misfit">part: no single-joint model fits</h3>' in page
    drawing, words, _ = block(*no_joint())
    assert [tint(element) for element in of_class(drawing, "shade misfit")] == [MISFIT]
    assert "misses by 58 mm (noise alone: 2 mm)" in words
    assert "fitted joints:" not in page, "a joint that does not fit is not drawn"


def test_only_some_rows_without_a_joint() -> None:
    recording, graph = assessed_door()
    lost = no_joint()[1].edges[0].segments[0].certainty
    segments = (graph.edges[0].segments[0], dataclasses.replace(graph.edges[0].segments[1], certainty=lost))
    changed = KinematicGraph((dataclasses.replace(graph.edges[0], segments=segments),))
    assert '<p class="badge bad">no single-joint model fits some rows</p>' in recording_page(recording, changed)


def test_pages_have_a_block_per_part_and_only_when_something_was_learned() -> None:
    recording, graph = cabinet_runs()
    page = recording_page(recording, graph)
    assert re.findall(r"<h3>(.*?)</h3>", page) == ["door: rigid → revolute → rigid", "drawer: prismatic"]
    data = json.loads(re.search(r'id="page-data">(.*?)</script>', page)[1])
    assert [len(frames) for frames in data["charts"]] == [80, 40]
    assert "charted" not in re.search(r"<body[^>]*>", recording_page(recording))[0]


def test_names_are_escaped() -> None:
    recording, graph = measured()
    name = "<script>alert(1)</script>&\"'"
    renamed = dataclasses.replace(recording, part=(name,) * len(recording))
    changed = KinematicGraph((dataclasses.replace(graph.edges[0], child=name),))
    drawing, words, _ = block(renamed, changed)
    assert "<script>alert" not in recording_page(renamed, changed)
    assert len(of_class(drawing, "dots")) == 2
    assert "&lt;script&gt;" in recording_page(renamed, changed)
    assert name in words


@pytest.mark.parametrize("rows", [1, 2, 2400])
def test_recordings_of_any_length_have_charts(rows: int) -> None:
    recording, graph = measured(max(rows, 3))
    if rows < 3:
        segment = dataclasses.replace(graph.edges[0].segments[0], end=rows - 1)
        graph = KinematicGraph((dataclasses.replace(graph.edges[0], segments=(segment,)),))
        recording = recording.rows(np.arange(rows))
    page = recording_page(recording, graph)
    assert "nan" not in re.search(r"<svg class=\"chart\".*?</svg>", page)[0]
    assert len(re.search(r"<svg class=\"chart\".*?</svg>", page)[0]) < 40_000


@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e4), st.integers(2, 8))
def test_ticks_are_few_even_and_inside(low: float, span: float, most: int) -> None:
    found = ticks(low, low + span, most)
    # Where one round number is inside, the next finer ones are up to five: 600, 800, ... 1400 between 501 and 1499.
    assert 2 <= len(found) <= max(most + 1, 5)
    assert all(low - 1e-6 * span <= value <= low + span + 1e-6 * span for value in found)
    if len(found) > 2:
        np.testing.assert_allclose(np.diff(found), found[1] - found[0], rtol=1e-6)


def test_scales() -> None:
    panel = Panel(10, 20, 100, 50, 0, 4, -1, 1)
    assert (panel.x(0), panel.x(4), panel.y(-1), panel.y(1)) == (10, 110, 70, 20)


def test_names_of_segments_do_not_overlap() -> None:
    door, _ = learned_runs(*cabinet_runs())
    labels = segment_labels(door, 0.15)
    for i, a in enumerate(labels):
        for b in labels[:i]:
            assert a.level != b.level or abs(a.time - b.time) >= 0.15 * (len(a.text) + len(b.text)) / 2
    assert [label.level for label in segment_labels(door, 0.025)] == [0, 0, 0]


def test_names_of_lines_keep_their_distance() -> None:
    ends = [5.0, 5.2, FLOOR, FLOOR, 0.0]
    lines = [EvidenceLine(f"m{i}", None, np.array([end])) for i, end in enumerate(ends)]
    places = sorted(place for place, _, _ in line_labels(lines, 1.5))
    assert (np.diff(places) >= 1.5 - 1e-9).all()
    assert {text for _, text, _ in line_labels(lines, 1.5)} == {"m0", "m1", "m4", "ruled out:", "m2, m3"}


@pytest.mark.parametrize(
    ("p", "text"), [(0.0, "0 %"), (0.001, "<1 %"), (0.5, "50 %"), (0.999, ">99 %"), (1.0, "100 %")]
)
def test_percents_never_claim_certainty(p: float, text: str) -> None:
    assert percent(p, 0) == text


def test_a_gap_in_time_is_a_gap_on_the_chart() -> None:
    """Rows are evenly spread over a recording that pauses for ten seconds; moments are not."""
    recording, graph = assessed_door()
    late = dataclasses.replace(recording, time=recording.time + 10.0 * (np.arange(len(recording)) >= 30))
    drawing, _, keyframes = block(late, graph)
    x = np.concatenate([dots(one)[:, 0] for one in of_class(drawing, "dots")])
    steps = np.diff(x)
    assert steps.argmax() == 29
    assert steps.max() > 0.5 * (x[-1] - x[0])
    np.testing.assert_allclose(x, [at for _, at in keyframes], atol=0.06)
    labels = [element.text for element in of_class(drawing, "label mid")]
    assert "time [s]" in labels
