"""The charts of a recording: in place, in colour, escaped, and in step with the player."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest
from learned_objects import assessed_door, cabinet_runs, no_joint
from view_objects import marks, measured, words_of

from micah_plan.automaton.graph import KinematicGraph
from micah_plan.quantities import percent
from micah_plan.recording.value import Recording
from micah_plan.view.chart import Columns, Curve, Span
from micah_plan.view.learned import FLOOR, EvidenceLine, learned_runs
from micah_plan.view.learned_words import line_labels, segment_labels
from micah_plan.view.learning_charts import learning_block
from micah_plan.view.page import Block
from micah_plan.view.palette import NO_SINGLE_JOINT, category
from micah_plan.view.recording_page import recording_page


def block(recording: Recording, graph: KinematicGraph, number: int = 0) -> Block:
    run = learned_runs(recording, graph)[number]
    return learning_block(recording, run, np.asarray(recording.time), several_runs=False)


def dots(made: Block) -> list[Curve]:
    return [curve for curve in marks(made.chart, Curve, 0) if curve.look == "dots"]


def test_rows_lie_where_the_cursor_says_and_have_their_colour() -> None:
    recording, graph = assessed_door()
    made = block(recording, graph)
    first, second = dots(made)
    assert [first.color, second.color] == [category(0), category(1)]
    assert [len(first.x), len(second.x)] == [40, 20]
    times, places = np.array(made.keyframes).T
    np.testing.assert_allclose(times, recording.time)
    np.testing.assert_allclose(np.concatenate([first.x, second.x]), places)
    assert (np.diff(first.y[::5]) > 0).all()


def test_the_interval_is_drawn_at_its_rows_in_every_panel() -> None:
    recording, graph = assessed_door()
    low, high = graph.edges[0].segments[1].certainty.start.interval()
    made = block(recording, graph)
    bands = [span for span in marks(made.chart, Span) if span.look == "interval"]
    assert len(bands) == 3
    x = np.array(made.keyframes)[:, 1]
    row = x[1] - x[0]
    for band in bands:
        assert (band.start, band.end) == pytest.approx((x[low] - row / 2, x[high] + row / 2))
    assert f"95 %: {low} to {high}" in words_of(made)


def test_the_posterior_is_in_bars_and_words() -> None:
    recording, graph = assessed_door()
    made = block(recording, graph)
    posterior = np.array(graph.edges[0].certainty.trace.changepoint)
    (columns,) = marks(made.chart, Columns)
    np.testing.assert_allclose(columns.height, posterior[posterior >= 1e-4])
    for text in ("96 %", "revolute 93 %, then screw 6 %", "rigid 88 %, then revolute 9 %", "0.92 ± 0.02"):
        assert text in words_of(made)


def test_every_model_has_a_line_and_a_name() -> None:
    made = block(*assessed_door(noise=0.002))
    lines = marks(made.chart, Curve, 1)
    assert {line.color for line in lines if line.look == "line"} == {category(0), category(1)}
    assert sum(line.look == "other" for line in lines) == 3
    for name in ("rigid (2)", "ruled out:", "free motion", "best single [nats]", "configuration [rad]"):
        assert name in words_of(made)


def test_no_joint_fits_is_reported_in_words_and_colour() -> None:
    page = recording_page(*no_joint())
    assert '<p class="badge bad">no single-joint model fits</p>' in page
    assert '<h3 class="alarm">part: no single-joint model fits</h3>' in page
    made = block(*no_joint())
    assert [span.color for span in marks(made.chart, Span) if span.look == "hatched"] == [NO_SINGLE_JOINT]
    assert "misses by 58 mm (noise alone: 2 mm)" in words_of(made)
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
    made = block(renamed, changed)
    assert "<script>alert" not in recording_page(renamed, changed)
    assert len(dots(made)) == 2
    assert "&lt;script&gt;" in recording_page(renamed, changed)
    assert name in words_of(made)


@pytest.mark.parametrize("rows", [1, 2, 2400])
def test_recordings_of_any_length_have_charts(rows: int) -> None:
    recording, graph = measured(max(rows, 3))
    if rows < 3:
        segment = dataclasses.replace(graph.edges[0].segments[0], end=rows - 1)
        graph = KinematicGraph((dataclasses.replace(graph.edges[0], segments=(segment,)),))
        recording = recording.rows(np.arange(rows))
    (written,) = re.findall(r'<div class="chart".*?</div>', recording_page(recording, graph), re.DOTALL)
    assert "NaN" not in written
    assert "Infinity" not in written
    assert len(written) < 40_000


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
    made = block(late, graph)
    x = np.concatenate([curve.x for curve in dots(made)])
    steps = np.diff(x)
    assert steps.argmax() == 29
    assert steps.max() > 0.5 * (x[-1] - x[0])
    np.testing.assert_allclose(x, [at for _, at in made.keyframes])
    assert made.chart.x_label == "time [s]"
