"""The figure of what learning found: its artists are the data."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from learned_objects import CHANNEL, assessed_door, cabinet_runs, no_joint
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from view_objects import OPEN_AT, measured

from micah_plan.automaton.certainty import SegmentCertainty
from micah_plan.automaton.graph import KinematicGraph
from micah_plan.recording.value import Recording
from micah_plan.view.learned import FLOOR, learned_runs, relative_evidence
from micah_plan.view.learning_figure import MOST_BLOCKS, learning_figure
from micah_plan.view.palette import INK, NO_SINGLE_JOINT, category

GAP = "no single-joint model fits"


def space_of(figure: Figure) -> Axes:
    return next(axes for axes in figure.axes if axes.name == "3d")


def labelled(figure: Figure, start: str) -> Axes:
    """The panel whose y or x label starts so."""
    return next(a for a in figure.axes if a.name != "3d" and (a.get_ylabel() + "|" + a.get_xlabel()).startswith(start))


def words(figure: Figure) -> str:
    """All that is written on the figure, panels included."""
    texts = [text.get_text() for text in figure.texts]
    return "\n".join(texts + [text.get_text() for axes in figure.axes for text in axes.texts])


def dots(axes: Axes) -> list[tuple[str, np.ndarray, np.ndarray]]:
    return [
        (to_hex(line.get_color()).upper(), np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in axes.lines
        if line.get_marker() == "o"
    ]


def intervals(axes: Axes) -> list[tuple[float, float]]:
    spans = [patch for patch in axes.patches if patch.get_label() == "95 % interval"]
    assert all(isinstance(span, Rectangle) for span in spans)
    return [(span.get_x(), span.get_x() + span.get_width()) for span in spans]


def test_track_and_configuration_have_the_colours_of_their_segments() -> None:
    recording, graph = measured()
    figure = learning_figure(recording, graph)
    clouds = {to_rgba(category(i)): i for i in range(2)}
    sizes = {clouds[tuple(c.get_facecolor()[0])]: len(c.get_offsets()) for c in space_of(figure).collections[:2]}
    assert sizes == {0: 40, 1: 20}
    axes = labelled(figure, "configuration [rad]")
    (first, _, moving), (second, times, resting) = dots(axes)
    assert (first, second) == (category(0), category(1))
    np.testing.assert_allclose(moving, np.linspace(0, OPEN_AT, 40), atol=0.03)
    np.testing.assert_allclose(times, recording.time[40:60])
    # At rest the measured configuration is shown, which scatters, not the one that the pose stands for.
    assert 0 < np.std(resting) < 0.03


def test_the_joint_is_drawn_where_it_is() -> None:
    space = space_of(learning_figure(*measured()))
    lines = [np.array(line.get_data_3d()).T for line in space.lines]
    arc = next(line for line in lines if len(line) > 10)
    np.testing.assert_allclose(np.hypot(arc[:, 0], arc[:, 1]), 0.3)
    axis = next(line for line in lines if len(line) == 2 and np.abs(line[:, :2]).max() < 1e-9)
    assert np.ptp(axis[:, 2]) > 0.1
    points = [line[0] for line in lines if len(line) == 1]
    assert any(np.allclose(point, [0, 0, 0.1]) for point in points), "centre"
    assert any(np.isclose(np.hypot(*point[:2]), 0.3) for point in points), "resting place"


@pytest.mark.sweep
@pytest.mark.parametrize("make", [measured, assessed_door, no_joint, cabinet_runs])
def test_space_has_equal_scales_and_units(make) -> None:
    space = space_of(learning_figure(*make()))
    sides = np.array([np.ptp(space.get_xlim()), np.ptp(space.get_ylim()), np.ptp(space.get_zlim())])
    box = np.array(space._box_aspect)
    np.testing.assert_allclose(sides / sides.max(), box / box.max(), rtol=1e-9)
    assert [space.get_xlabel(), space.get_ylabel(), space.get_zlabel()] == ["x [m]", "y [m]", "z [m]"]


def test_the_interval_lies_at_its_rows_in_every_panel() -> None:
    recording, graph = assessed_door()
    start = graph.edges[0].segments[1].certainty.start
    low, high = start.interval()
    figure = learning_figure(recording, graph)
    for label in ("configuration", "evidence", "P(change"):
        (shown,) = intervals(labelled(figure, label))
        np.testing.assert_allclose(shown, [(low - 0.5) / 18, (high + 0.5) / 18])
    assert f"(95 % interval: {low} to {high})" in words(figure)
    assert intervals(labelled(learning_figure(*measured()), "configuration")) == []


def test_the_posterior_of_the_row_is_drawn_as_bars() -> None:
    recording, graph = assessed_door()
    trace = graph.edges[0].certainty.trace
    bars = labelled(learning_figure(recording, graph), "P(change").containers[0]
    shown = np.array(trace.changepoint) >= 1e-4
    np.testing.assert_allclose([bar.get_height() for bar in bars], np.array(trace.changepoint)[shown])
    middles = [bar.get_x() + bar.get_width() / 2 for bar in bars]
    np.testing.assert_allclose(middles, np.array(trace.rows)[shown] / 18, atol=1e-12)


def test_evidence_takes_over_where_the_part_comes_to_rest() -> None:
    recording, graph = assessed_door(noise=0.002)
    axes = labelled(learning_figure(recording, graph), "evidence")
    lines = {line.get_label(): line for line in axes.lines if not line.get_label().startswith("_")}
    assert set(lines) == {"revolute", "prismatic", "rigid", "rigid_2", "free"}
    np.testing.assert_array_equal(lines["revolute"].get_ydata(), 0.0)
    rest = np.asarray(lines["rigid_2"].get_ydata())
    assert rest[30] == FLOOR
    assert rest[-1] > 5.0
    assert (np.diff(rest[41:]) > -2.5).all()
    assert to_hex(lines["rigid_2"].get_color()).upper() == category(1)
    assert to_hex(lines["revolute"].get_color()).upper() == category(0)
    assert "ruled out:" in words(learning_figure(recording, graph))


def test_relative_evidence_by_hand() -> None:
    density = np.array([[0.0, -3.0], [0.0, -30.0], [-1.0, 1.0]])
    np.testing.assert_array_equal(relative_evidence(density), [[0, -3], [0, FLOOR], [0, FLOOR + 2]])
    assert relative_evidence(np.zeros((0, 2))).shape == (0, 2)


def test_posteriors_are_in_figures_and_words() -> None:
    figure = learning_figure(*assessed_door())
    counts = labelled(figure, "|number of changepoints")
    assert [round(bar.get_height(), 3) for bar in counts.containers[0]] == [0.002, 0.961, 0.035]
    said = words(figure)
    for text in ("revolute 93 %", "screw 6 %", "rigid 88 %", "revolute 9 %", "<1 %", "96 %"):
        assert text in said
    assert f"{CHANNEL.gain:.2f} ± 0.02" in said
    assert "delay 0.11 ± 0.01 s" in said
    assert "frame rotation 12.0 ± 1.1°" in said.replace("\n", " ")
    assert "radius 300 mm, axis ± 0.69°, centre ± 3 mm" in said


def test_no_joint_fits_is_reported_in_words_and_colour() -> None:
    figure = learning_figure(*no_joint())
    assert any(text.get_text() == f"part: {GAP}" and text.get_bbox_patch() for text in figure.texts)
    assert "misses by 58 mm (noise alone: 2 mm)" in words(figure)
    axes = labelled(figure, "displacement [m]")
    assert [color for color, _, _ in dots(axes)] == [INK, NO_SINGLE_JOINT], "with a rim"
    assert any(patch.get_hatch() for patch in axes.patches)
    assert NO_SINGLE_JOINT not in {
        color for color, _, _ in dots(labelled(learning_figure(*assessed_door()), "configuration"))
    }


def test_a_joint_that_returns_has_its_colour_again_and_parts_have_their_own() -> None:
    recording, graph = cabinet_runs()
    door, drawer = learned_runs(recording, graph)
    assert [s.colored.color for s in door.stretches] == [category(0), category(1), category(0)]
    assert [s.colored.color for s in drawer.stretches] == [category(2)]
    figure = learning_figure(recording, graph)
    _, times, travelled = dots(labelled(figure, "configuration [m]"))[0]
    np.testing.assert_allclose(times, recording.time[80:120])
    np.testing.assert_allclose(travelled, np.linspace(0, 0.25, 40), atol=0.01)
    assert "door: rigid → revolute → rigid" in words(figure)
    assert "drawer: prismatic" in words(figure)


def test_a_part_on_a_moving_part_is_seen_from_it() -> None:
    recording, graph = cabinet_runs()
    moved = np.asarray(recording.position).copy()
    moved[80:] += moved[:40]  # the drawer is carried by the door's first rows
    carried = dataclasses.replace(recording, position=moved, quaternion=None)
    edges = (graph.edges[0], dataclasses.replace(graph.edges[1], parent="door"))
    drawer = learned_runs(carried, KinematicGraph(edges))[1]
    np.testing.assert_allclose(drawer.position, recording.position[80:], atol=1e-12)
    figure = learning_figure(carried, KinematicGraph(edges))
    spaces = [axes for axes in figure.axes if axes.name == "3d"]
    assert spaces[1].get_xlabel() == "x in door [m]"


def repeated_runs(count: int) -> tuple[Recording, KinematicGraph]:
    one, graph = measured(30)
    recording = one.rows(np.tile(np.arange(30), count))
    recording = dataclasses.replace(recording, run=np.repeat(np.arange(count), 30), has_run=True)
    segments = tuple(
        dataclasses.replace(segment, run=run, start=segment.start + 30 * run, end=segment.end + 30 * run)
        for run in range(count)
        for segment in graph.edges[0].segments
    )
    return recording, KinematicGraph((dataclasses.replace(graph.edges[0], segments=segments),))


def test_every_run_has_a_block_up_to_a_reported_limit() -> None:
    figure = learning_figure(*repeated_runs(3))
    assert sum(axes.name == "3d" for axes in figure.axes) == 3
    assert "part, run 2:" in words(figure)
    figure = learning_figure(*repeated_runs(MOST_BLOCKS + 2))
    assert sum(axes.name == "3d" for axes in figure.axes) == MOST_BLOCKS
    assert "2 more runs not shown" in words(figure)


def test_texts_stay_on_the_figure_and_panels_do_not_overlap() -> None:
    for make in (assessed_door, no_joint, cabinet_runs):
        figure = learning_figure(*make())
        figure.draw_without_rendering()
        renderer = figure.canvas.get_renderer()
        for text in figure.texts + [text for axes in figure.axes if axes.name != "3d" for text in axes.texts]:
            box = text.get_window_extent(renderer)
            assert min(box.x0, box.y0, figure.bbox.x1 - box.x1) >= 0, text.get_text()
        flat = [axes.get_tightbbox(renderer) for axes in figure.axes if axes.name != "3d"]
        for i, a in enumerate(flat):
            for b in flat[:i]:
                across = min(a.x1, b.x1) - max(a.x0, b.x0)
                along = min(a.y1, b.y1) - max(a.y0, b.y0)
                assert across <= 1 or along <= 14, (a, b)


def test_a_recording_without_segments_shows_its_coordinates() -> None:
    recording, _ = measured()
    space, rows = learning_figure(recording).axes
    assert len(space.collections[0].get_offsets()) == len(recording)
    assert [text.get_text() for text in rows.texts] == ["x", "y", "z"]
    assert rows.get_ylabel() == "position [m]"


def test_certainty_without_a_trace_still_shows_what_it_has() -> None:
    recording, graph = assessed_door()
    edge = graph.edges[0]
    bare = dataclasses.replace(edge.certainty, trace=None, channel=None, changepoint_counts=())
    segments = (edge.segments[0], dataclasses.replace(edge.segments[1], certainty=SegmentCertainty(None, ())))
    figure = learning_figure(recording, KinematicGraph((dataclasses.replace(edge, segments=segments, certainty=bare),)))
    assert "they do not explain the motion" in words(figure)
    assert not any(axes.get_ylabel().startswith("evidence") for axes in figure.axes)


def test_a_coarse_trace_has_wide_bars_but_where_a_start_is_known_to_the_row() -> None:
    recording, graph = assessed_door()
    edge = graph.edges[0]
    trace = edge.certainty.trace
    thin = dataclasses.replace(
        trace, rows=trace.rows[::3], log_density=trace.log_density[::3], changepoint=trace.changepoint[::3]
    )
    changed = dataclasses.replace(edge, certainty=dataclasses.replace(edge.certainty, trace=thin))
    axes = labelled(learning_figure(recording, KinematicGraph((changed,))), "P(change")
    bars = {round(18 * (bar.get_x() + bar.get_width() / 2), 6): bar for bar in axes.containers[0]}
    start = edge.segments[1].certainty.start
    for row, probability in zip(start.rows, start.probabilities, strict=True):
        if probability < 1e-4:  # too low to be seen
            assert row not in bars
            continue
        assert bars[row].get_height() == pytest.approx(probability)
        assert bars[row].get_width() == pytest.approx(1 / 18)
    # The first one begins half a row before the first row, which is as far as there is time.
    wide = [bar.get_width() for row, bar in bars.items() if 1 < row < start.rows[0]]
    np.testing.assert_allclose(wide, 3 / 18)


def test_a_trace_of_other_rows_has_no_panels() -> None:
    recording, graph = assessed_door()
    edge = graph.edges[0]
    elsewhere = dataclasses.replace(edge.certainty.trace, rows=tuple(range(1000, 1060)))
    changed = dataclasses.replace(edge, certainty=dataclasses.replace(edge.certainty, trace=elsewhere))
    figure = learning_figure(recording, KinematicGraph((changed,)))
    assert not any(axes.get_ylabel().startswith(("evidence", "P(")) for axes in figure.axes)


def test_names_of_the_axes_in_space_are_not_cut_off() -> None:
    for make in (assessed_door, no_joint, cabinet_runs):
        figure = learning_figure(*make())
        figure.draw_without_rendering()
        renderer = figure.canvas.get_renderer()
        for space in (axes for axes in figure.axes if axes.name == "3d"):
            for axis in (space.xaxis, space.yaxis, space.zaxis):
                assert axis.label.get_window_extent(renderer).x0 >= 0
