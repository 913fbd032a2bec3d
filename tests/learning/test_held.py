"""A part that is held several times, and one that is not: what actions asked of it tells both apart."""

from __future__ import annotations

from dataclasses import replace

import cycles
import numpy as np
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.learning.learn import learn_graph
from micah_plan.learning.segmenting.held import JointTrace, held_rows, held_steps
from micah_plan.recording.value import Recording

STD = 0.002


def along(steps: list[float], held: list[tuple[int, int]], seed: int = 0) -> JointTrace:
    """Steps that are asked, of which those of some stretches [first, last) are not done."""
    rng = np.random.default_rng(seed)
    asked, done = np.array(steps), np.array(steps)
    for first, last in held:
        done[first:last] = 0.0
    configuration = np.concatenate([[0.0], np.cumsum(done)]) + STD * rng.standard_normal(len(steps) + 1)
    action = np.zeros((len(steps) + 1, 3))
    action[:-1, 1] = 2.0 * asked
    return JointTrace(configuration, action, STD**2, 0.0)


@pytest.mark.parametrize("held", [[], [(40, 60)], [(0, 20)], [(20, 40), (60, 80)], [(20, 40), (60, 80), (100, 120)]])
def test_rests_are_where_commands_were_not_carried_out(held: list[tuple[int, int]]) -> None:
    """However often, at the beginning, on the way or at the end."""
    rests = held_rows(along([0.01] * 120, held))
    assert len(rests) == len(held)
    for rows, (first, last) in zip(rests, held, strict=True):
        inside = np.flatnonzero(rows)
        assert abs(inside[0] - first) <= 3
        assert abs(inside[-1] - last) <= 3


def test_a_hand_without_commands_is_no_evidence_on_rests() -> None:
    """A pause is no rest: nothing was asked, and nothing was done."""
    assert not len(held_rows(along([0.01] * 40 + [0.0] * 30 + [0.01] * 40, [])))
    assert not held_steps(along([0.0] * 60, [])).any()


def test_a_slip_of_the_tracker_is_no_rest() -> None:
    one = along([0.01] * 100, [])
    one.configuration[50:] -= 0.03
    assert not len(held_rows(one))


@pytest.mark.sweep
@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_part_opened_and_shut_several_times_has_a_stop_each_time(kind: str, number: int) -> None:
    one = cycles.counted(kind, number, cycles.Variant(), 40 + number)
    assert (one.found, one.many) == (one.stops, 0), one.answer
    assert one.stops == 2 * number


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "number", "variant", "missed"),
    [
        ("revolute", 6, "3 mm", 1),
        pytest.param("prismatic", 24, "plain", 0, marks=pytest.mark.evidence),
        pytest.param("prismatic", 12, "late by 2 rows", 0, marks=pytest.mark.evidence),
    ],
)
def test_a_long_run_has_its_stops_too(kind: str, number: int, variant: str, missed: int) -> None:
    """How often something happens does not matter: a long run is learned in windows that show its joint each."""
    count = cycles.counted(kind, number, cycles.VARIANTS[variant], 12)
    assert count.stops == 2 * number
    assert count.found >= count.stops - missed, count.answer
    assert count.many == 0
    assert not count.wrong


@pytest.mark.sweep
@pytest.mark.parametrize("columns", ["poses", "positions"])
@pytest.mark.parametrize(("kind", "number", "seed"), [("revolute", 1, 40), ("revolute", 3, 42), ("prismatic", 2, 41)])
def test_the_model_has_the_stops_that_were_learned(kind: str, number: int, seed: int, columns: str) -> None:
    """Where a motion ends is known to a row, so its joint reaches a little beyond the rest."""
    recording, _ = cycles.recording_of(kind, number, cycles.Variant(), seed)
    recording = recording if columns == "poses" else replace(recording, quaternion=None)
    graph = learn_graph(recording)
    assert [mode.name for mode in build_automaton(graph).modes] == ["rigid_1", kind, "rigid_2"]
    segments = graph.edges[0].segments
    for before, rest in zip(segments[::2], segments[1::2], strict=True):
        away = abs(rest.joint.fixed_at - before.configuration_end)
        assert away < 4 * before.observation_std + (before.configuration_range[1] - before.configuration_range[0]) / 40


@pytest.mark.slow
@pytest.mark.parametrize("alone", [(1000, 0, 0), (0, 1000, 0), (0, 0, 1000), (300, 300, 300)])
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_however_long_a_part_is_left_alone_its_stops_are_the_same(kind: str, alone: tuple[int, int, int]) -> None:
    """A tracker is switched on long before a motion: rests take no steps from it."""
    count = cycles.counted(kind, 1, cycles.Variant(alone=alone), 4)
    assert (count.found, count.stops, count.many) == (2, 2, 0), count.answer
    assert count.modelled
    still = cycles.counted(kind, 1, cycles.Variant(pushed=False, alone=alone), 4)
    assert still.answer.split()[0].startswith(kind[:4])
    assert not still.wrong


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_part_opened_slowly_and_shut_quickly_has_its_stops(kind: str) -> None:
    count = cycles.counted(kind, 1, cycles.Variant(slow=6), 5)
    assert (count.found, count.many) == (2, 0), count.answer


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_step_in_which_a_part_is_caught_or_let_go_need_not_be_led(kind: str) -> None:
    """A few large steps there and many small ones back: each rest begins and ends within one of the large ones."""
    count = cycles.counted(kind, 3, cycles.VARIANTS["opened 8 times slower"], 50)
    assert (count.found, count.stops, count.many) == (6, 6, 0), count.answer
    assert count.modelled
    unpushed = cycles.counted(kind, 3, cycles.Variant(slow=8, pushed=False), 50)
    assert (unpushed.many, unpushed.wrong) == (0, False), unpushed.answer


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_push_that_is_slower_than_the_motion_indicates_a_stop_too(kind: str) -> None:
    """A hand slows down where it meets an end: how far it asks for counts, not how fast."""
    count = cycles.counted(kind, 1, cycles.VARIANTS["pushed a fifth as fast"], 5)
    assert (count.found, count.many) == (2, 0), count.answer


def test_a_push_of_many_rows_is_one_stop() -> None:
    recording, (stop, shut) = cycles.recording_of("prismatic", 1, cycles.Variant(), 5)
    at, more = stop + 5, 600
    index = np.concatenate([np.arange(at), np.full(more, at), np.arange(at, len(recording))])
    shaken = (
        0.001 * np.random.default_rng(0).standard_normal((len(index), 3)) * (np.diff(index, prepend=-1) == 0)[:, None]
    )
    time = np.arange(len(index)) / 20
    columns = recording.position[index] + shaken, recording.quaternion[index], recording.action[index]
    starts = [s.start for s in learn_graph(Recording(time, *columns)).edges[0].segments if s.joint.kind == "rigid"]
    assert len(starts) == 2
    assert np.abs(np.array(starts) - (stop, shut + more)).max() <= cycles.NEAR


@pytest.mark.slow
def test_a_long_rest_before_many_motions_hides_none() -> None:
    count = cycles.counted("revolute", 6, cycles.VARIANTS["1,000 rows before"], 30)
    assert (count.found, count.many) == (12, 0), count.answer


def test_nothing_but_rest_is_a_rest() -> None:
    recording, _ = cycles.recording_of("revolute", 1, cycles.VARIANTS["1,000 rows before"], 30)
    assert [s.joint.kind for s in learn_graph(recording.rows(np.arange(1000))).edges[0].segments] == ["rigid"]


@pytest.mark.slow
def test_a_row_between_a_rest_and_a_motion_is_no_rest_elsewhere() -> None:
    """A drawer's step on the way out lay on the pose of the other end, as far as a tracker's drift may say it."""
    count = cycles.counted("prismatic", 5, cycles.VARIANTS["plain"], 1)
    assert count.found == count.stops, count.answer
    assert not count.wrong


@pytest.mark.slow
def test_a_part_that_is_moved_many_times_and_never_pushed_has_no_stop() -> None:
    recording, _ = cycles.recording_of("revolute", 6, cycles.VARIANTS["not pushed"], 3)
    (edge,) = learn_graph(recording).edges
    assert [segment.joint.kind for segment in edge.segments] == ["revolute"]


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_part_moved_there_and_back_between_its_ends_has_none(kind: str) -> None:
    recording, stops = cycles.recording_of(kind, 2, cycles.VARIANTS["not pushed"], 5)
    assert stops == []
    (edge,) = learn_graph(recording).edges
    assert [segment.joint.kind for segment in edge.segments] == [kind]


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("kind", "number", "seed"), [("revolute", 1, 60), ("revolute", 2, 61), ("prismatic", 1, 66), ("prismatic", 2, 63)]
)
def test_actions_that_were_not_logged_hide_no_stop(kind: str, number: int, seed: int) -> None:
    """A part that moves once without being asked is no part that actions do not lead."""
    count = cycles.counted(kind, number, cycles.VARIANTS["1 of 25 actions lost"], seed)
    assert (count.found, count.many) == (2 * number, 0), count.answer
