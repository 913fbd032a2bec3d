"""What a model keeps of how sure learning was, how well thresholds are known, and where no joint fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import SPLIT, chain, segment
from certain_edges import CHANNEL, NO_SINGLE_JOINT, sure_door, unfit
from hypothesis import given
from hypothesis import strategies as st

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.certainty import EvidenceTrace, RowPosterior, SegmentCertainty
from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.graph import KinematicEdge, KinematicGraph
from micah_plan.automaton.hybrid import Pin
from micah_plan.automaton.joint import prismatic, rigid
from micah_plan.automaton.local_models import local_models
from micah_plan.errors import InputError

SHARP = RowPosterior((20,), (1.0,))
SPEED = 1.2 / 19  # of the door of `sure_door` [rad per row]
OBSERVATION_STD = 0.01


def guard_stds(graph: KinematicGraph) -> dict[str, float]:
    return {edge.name: edge.threshold_std for edge in build_automaton(graph).edges}


@given(data=st.data())
def test_the_interval_of_rows_is_the_narrowest_that_holds_enough(data: st.DataObject) -> None:
    rows = sorted(data.draw(st.sets(st.integers(0, 30), min_size=1, max_size=8)))
    weights = np.array([data.draw(st.integers(1, 50)) for _ in rows], dtype=float)
    weights /= weights.sum()
    first, last = RowPosterior(tuple(rows), tuple(weights)).interval(0.8)
    holds = {(a, b): weights[i : j + 1].sum() for i, a in enumerate(rows) for j, b in enumerate(rows) if i <= j}
    assert holds[first, last] >= 0.8 - 1e-9
    assert all(b - a >= last - first for (a, b), held in holds.items() if held > 0.8 + 1e-9)


class TestThresholds:
    def test_without_a_posterior_nothing_is_claimed(self) -> None:
        graph = KinematicGraph((chain("door", [0, 1.2, 1.2], ["revolute", "rigid"]),))
        assert set(guard_stds(graph).values()) == {0.0}
        assert build_automaton(graph).learned == ()

    def test_a_sharp_changepoint_is_known_as_well_as_a_measurement(self) -> None:
        automaton = build_automaton(sure_door(SHARP))
        assert automaton.edges[0].threshold_std == OBSERVATION_STD
        assert automaton.mode("rigid").pins == (Pin(0, 1.2, OBSERVATION_STD),)

    def test_rows_become_configurations_with_the_speed_of_the_motion(self) -> None:
        """Two equally probable rows of the moving segment are a row's way apart: half of it is the std."""
        graph = sure_door(RowPosterior((18, 19), (0.5, 0.5)))
        expected = np.hypot(SPEED / 2, OBSERVATION_STD)
        stds = guard_stds(graph)
        assert stds["revolute -> rigid"] == pytest.approx(expected, rel=1e-5)
        assert stds["rigid -> revolute"] == stds["revolute -> revolute"] == 0.0
        assert build_automaton(graph).mode("rigid").pins[0].std == pytest.approx(expected, rel=1e-5)

    def test_rows_at_rest_do_not_blur_the_threshold(self) -> None:
        graph = sure_door(RowPosterior((20, 25, 30), (0.4, 0.3, 0.3)))
        assert guard_stds(graph)["revolute -> rigid"] == pytest.approx(OBSERVATION_STD)

    def test_between_two_slides_both_ways_have_the_same_std(self) -> None:
        edge = chain("drawer", [0, SPLIT, 2 * SPLIT], ["prismatic", "prismatic"])
        first, second = edge.segments
        posterior = RowPosterior((19, 20, 21), (0.25, 0.5, 0.25))
        second = replace(second, certainty=SegmentCertainty(posterior, (("prismatic", 1.0),)))
        stds = guard_stds(KinematicGraph((replace(edge, segments=(first, second)),)))
        expected = np.hypot(SPLIT / 19 * np.sqrt(0.5), OBSERVATION_STD)
        assert (
            stds["prismatic_1 -> prismatic_2"]
            == stds["prismatic_2 -> prismatic_1"]
            == pytest.approx(expected, rel=1e-5)
        )

    def test_switches_average_but_the_tracker_stays(self) -> None:
        slide, stop = prismatic([1, 0, 0], [0, 0, 0]), rigid([0.4, 0, 0], fixed_at=0.4)
        sure = SegmentCertainty(RowPosterior((20, 21), (0.5, 0.5)), (("rigid", 1.0),))
        again = SegmentCertainty(RowPosterior((38, 39, 40), (0.25, 0.5, 0.25)), (("prismatic", 1.0),))
        segments = (
            segment(slide, (0, 20), 0.0, 0.4),
            replace(segment(stop, (21, 39), 0.4, 0.4), certainty=sure),
            replace(segment(slide, (40, 60), 0.4, 0.0), certainty=again),
        )
        models = local_models(KinematicEdge("base", "drawer", segments))
        assert [(m.lower_std, m.upper_std) for m in models] == [(0.0, models[0].upper_std), (models[1].lower_std, 0.0)]
        rows = (0.02 / 2) / 2  # the rows of the second switch are all at rest
        assert models[0].upper_std == models[1].lower_std == pytest.approx(np.hypot(rows, OBSERVATION_STD))

    def test_a_segment_that_returns_is_as_fast_as_its_whole_way(self) -> None:
        slide, stop = prismatic([1, 0, 0], [0, 0, 0]), rigid([0.0, 0, 0])
        sure = SegmentCertainty(RowPosterior((40, 41), (0.5, 0.5)), (("rigid", 1.0),))
        there_and_back = replace(segment(slide, (0, 40), 0.0, 0.0), configuration_range=(0.0, 0.4))
        edge = KinematicEdge(
            "base", "drawer", (there_and_back, replace(segment(stop, (41, 60), 0.0, 0.0), certainty=sure))
        )
        assert max(m.lower_std for m in local_models(edge)) == pytest.approx(np.hypot(0.02 / 2, OBSERVATION_STD))

    def test_a_std_that_is_no_number_is_refused(self) -> None:
        graph = sure_door(SHARP)
        automaton = build_automaton(graph)
        for std in (-0.1, float("inf"), float("nan")):
            edges = (replace(automaton.edges[0], threshold_std=std), *automaton.edges[1:])
            with pytest.raises(InputError, match="revolute -> rigid: threshold_std must be a finite number >= 0"):
                check_automaton(replace(automaton, edges=edges))


class TestLearned:
    def test_a_model_keeps_the_certainty_of_learning(self) -> None:
        graph = sure_door(RowPosterior((19, 20, 21), (0.1, 0.8, 0.1)))
        (edge,) = build_automaton(graph).learned
        assert (edge.parent, edge.child) == ("base", "door")
        assert [(s.kind, s.run, s.start, s.end) for s in edge.segments] == [
            ("revolute", 0, 0, 19),
            ("rigid", 0, 20, 39),
        ]
        assert edge.segments[0].certainty == graph.edges[0].segments[0].certainty
        assert edge.segments[1].certainty == graph.edges[0].segments[1].certainty
        assert edge.certainty == graph.edges[0].certainty
        assert edge.certainty.channel == CHANNEL

    def test_the_trace_and_what_rounding_leaves_are_not_kept(self) -> None:
        graph = sure_door(RowPosterior((19, 20), (1e-9, 1.0000000001)))
        trace = EvidenceTrace((0,), ("free",), ((0.0,),), (0.0,))
        edge = graph.edges[0]
        traced = replace(edge, certainty=replace(edge.certainty, trace=trace, changepoint_counts=((1 / 3, 2 / 3),)))
        (kept,) = build_automaton(KinematicGraph((traced,))).learned
        assert kept.certainty.trace is None
        assert kept.certainty.changepoint_counts == ((0.333333, 0.666667),)
        assert kept.segments[1].certainty.start == SHARP


class TestMisfit:
    def test_no_automaton_is_built_across_rows_that_no_joint_explains(self) -> None:
        edge = unfit(chain("door", [0, 0.6, 1.2, 1.2], ["revolute", "revolute", "rigid"]), 1)
        with pytest.raises(InputError) as caught:
            build_automaton(KinematicGraph((edge,)))
        line = str(caught.value)
        assert len(line.splitlines()) == 1
        assert line.startswith(
            "no single-joint model fits rows 20 to 39 of part 'door' (run 0): the best, revolute, misses them by 23 mm "
            "and 0.31 rad where the measurement alone would leave 2 mm and 0.012 rad; check that the part is stiff"
        )

    def test_positions_alone_have_no_angle(self) -> None:
        bare = replace(NO_SINGLE_JOINT, rotation=None, rotation_noise=None)
        edge = unfit(chain("door", [0, 1.2], ["revolute"]), 0, bare)
        with pytest.raises(InputError, match=r"misses them by 23 mm where the measurement alone would leave 2 mm;"):
            build_automaton(KinematicGraph((edge,)))

    def test_further_stretches_are_counted(self) -> None:
        edge = chain("door", [0, 0.6, 1.2, 1.2], ["revolute", "revolute", "rigid"])
        with pytest.raises(InputError, match=r"2 mm and 0.012 rad \(and 1 more such stretch\);"):
            build_automaton(KinematicGraph((unfit(unfit(edge, 0), 1),)))
