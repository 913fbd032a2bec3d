"""Learning online: the same as learning the whole where that fits a window, and for longer streams what was planted."""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from planted import JOINTS, START, moving_then_held, recorded
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.kinematics import forward, inverse
from micah_plan.errors import InputError
from micah_plan.learning.learn import learn_graph
from micah_plan.learning.online import OnlineLearner, RowWindow
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import part_track
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording

DATA = Path(os.environ.get("MICAH_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"shared data not found at {DATA}")
SMALL = LearnSettings(resolution=32)

SLIDE = prismatic((0, 0, 1), (0.4, 0, 0), START.as_quat())
TOP = forward(SLIDE, 0.3)[0]
HINGE = revolute((0, 1, 0), (0, 0, 0.3), TOP.translation, TOP.rotation.as_quat())


def kinds(segments: tuple[Segment, ...]) -> list[str]:
    return [segment.joint.kind for segment in segments]


def lifted_and_opened(cycles: int, rows: int = 40, seed: int = 0) -> Recording:
    """A lid that slides up, turns, turns back and slides down, again and again."""
    up, turned = np.linspace(0, 0.3, rows), np.linspace(0, 0.9, rows)
    cycle = [(SLIDE, up), (HINGE, turned), (HINGE, turned[::-1]), (SLIDE, up[::-1])]
    return recorded(cycle * cycles, np.random.default_rng(seed))


def opened_and_held(cycles: int, moving: int, held: int) -> Recording:
    swing = np.linspace(0.0, 0.9, moving)
    cycle = np.concatenate([swing, np.full(held, 0.9), swing[::-1], np.zeros(held)])
    return recorded([(JOINTS["revolute"], np.tile(cycle, cycles))], np.random.default_rng(1))


def learned(recording: Recording, chunk: int, method: str = "champ", settings: LearnSettings = SMALL) -> OnlineLearner:
    learner = OnlineLearner(settings, method)  # type: ignore[arg-type]
    for start in range(0, len(recording), chunk):
        rows = slice(start, start + chunk)
        quaternion = None if recording.quaternion is None else recording.quaternion[rows]
        action = None if recording.action is None else recording.action[rows]
        learner.push(recording.time[rows], recording.position[rows], quaternion, action)
    return learner


def assert_same_segments(recording: Recording, method: str) -> None:
    learner = OnlineLearner(method=method)  # type: ignore[arg-type]
    learner.extend(recording)
    (exact,) = learn_graph(recording, method=method).edges  # type: ignore[arg-type]
    found = learner.edge()
    assert kinds(found.segments) == kinds(exact.segments)
    assert all(abs(a - b) <= 2 for a, b in zip(found.changepoints, exact.changepoints, strict=True))


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["prismatic", "revolute", "screw"])
def test_what_fits_the_window_is_learned_exactly(kind: str) -> None:
    recording = recorded([(JOINTS[kind], moving_then_held(kind))], np.random.default_rng(1))
    learner = OnlineLearner(method="champ")
    learner.extend(recording)
    (exact,) = learn_graph(recording, method="champ").edges
    assert learner.edge() == exact
    assert learner.committed == ()


@pytest.mark.slow
def test_a_part_that_returns_to_a_joint_has_the_same_again() -> None:
    recording = lifted_and_opened(cycles=6)
    segments = learned(recording, len(recording)).segments()
    assert kinds(segments) == ["prismatic", "revolute"] * 6 + ["prismatic"]
    planted = [row for i in range(6) for row in (160 * i + 40, 160 * i + 120)]
    assert all(abs(s.start - row) <= 4 for s, row in zip(segments[1:], planted, strict=True))
    assert len({segment.joint for segment in segments}) == 2
    assert [segment.start for segment in segments[1:]] == [segment.end + 1 for segment in segments[:-1]]


@pytest.mark.slow
@pytest.mark.parametrize(("aside", "joints"), [(0.0, 1), (0.05, 2)])
def test_a_joint_elsewhere_is_another_one(aside: float, joints: int) -> None:
    """The known joint stands for a window's only where it explains its rows: 5 cm further it does not."""
    swings = 0.45 * (1 - np.cos(2 * np.pi * np.arange(480) / 60))
    recording = recorded([(JOINTS["revolute"], swings)] * 2, np.random.default_rng(4))
    position = recording.position.copy()
    position[480:] += aside
    learner = learned(replace(recording, position=position), 960)
    segments = learner.segments()
    assert len({segment.joint for segment in segments}) == joints
    assert segments[-1].end == 959


@pytest.mark.slow
def test_closed_and_open_are_one_model_each_however_often_they_are_held() -> None:
    recording = opened_and_held(cycles=4, moving=60, held=700)
    segments = learned(recording, len(recording), settings=LearnSettings()).segments()
    assert kinds(segments) == ["revolute", "rigid"] * 8
    held = [segment.joint.fixed_at for segment in segments if segment.joint.kind == "rigid"]
    assert np.allclose(held, np.tile([0.9, 0.0], 4), atol=0.02)
    assert len({segment.joint for segment in segments}) <= 4
    stops, starts = segments[1::2], segments[2::2]
    assert all(abs(s.start - (760 * i + 60)) <= 4 for i, s in enumerate(stops))
    # When a part starts is told less well from windows of few steps per motion: a joint may rest before it moves.
    assert all(abs(s.start - 760 * (i + 1)) <= 64 for i, s in enumerate(starts))


@pytest.mark.slow
def test_committed_segments_stay_and_the_others_follow_them() -> None:
    recording = lifted_and_opened(cycles=5, seed=2)
    learner = OnlineLearner(SMALL, "champ")
    before: tuple[Segment, ...] = ()
    for start in range(0, len(recording), 200):
        rows = slice(start, start + 200)
        learner.push(recording.time[rows], recording.position[rows], recording.quaternion[rows])
        assert learner.committed[: len(before)] == before
        assert learner.segments()[: len(before)] == before
        before = learner.committed
    assert len(before) >= 4
    assert learner.take_committed() == before
    assert learner.committed == ()
    rest = learner.segments()
    assert rest[0].start == before[-1].end + 1
    assert rest[-1].end == len(recording) - 1


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [1, 37])
def test_how_rows_are_pushed_does_not_matter(chunk: int) -> None:
    recording = lifted_and_opened(cycles=3)
    assert learned(recording, chunk).segments() == learned(recording, len(recording)).segments()


@pytest.mark.slow
def test_looking_at_the_segments_changes_nothing() -> None:
    recording = lifted_and_opened(cycles=3)
    asked, silent = OnlineLearner(SMALL, "champ"), OnlineLearner(SMALL, "champ")
    for start in range(0, len(recording), 120):
        rows = slice(start, start + 120)
        for learner in (asked, silent):
            learner.push(recording.time[rows], recording.position[rows], recording.quaternion[rows])
        asked.segments()
    assert asked.segments() == silent.segments()


@pytest.mark.slow
def test_a_window_holds_a_bounded_number_of_rows() -> None:
    settings = LearnSettings(window=256, resolution=32)
    learner = OnlineLearner(settings, "champ")
    slow = recorded([(JOINTS["revolute"], np.linspace(0.0, 0.9, 3000))], np.random.default_rng(4))
    most = 0
    for start in range(0, len(slow), 100):
        rows = slice(start, start + 100)
        learner.push(slow.time[rows], slow.position[rows], slow.quaternion[rows])
        held = learner._window.rows()
        most = max(most, 0 if held is None else len(held))
    assert most <= settings.window
    assert kinds(learner.segments()) == ["revolute"]
    assert learner.segments()[0].end == 2999


@pytest.mark.evidence
def test_a_long_run_is_learned_online_as_part_of_a_recording() -> None:
    recording = lifted_and_opened(cycles=20, rows=12)
    (edge,) = learn_graph(recording, method="champ", settings=SMALL).edges
    learner = OnlineLearner(SMALL, "champ")
    learner.extend(recording)
    assert edge.segments == learner.segments()
    assert edge.changepoints == learner.edge().changepoints


@pytest.mark.slow
def test_later_long_runs_are_counted_along_the_first() -> None:
    opening = recorded([(JOINTS["prismatic"], np.linspace(0, 0.25, 60))], np.random.default_rng(5))
    shaken = 0.25 - 0.2 * np.abs(np.sin(np.linspace(0, 8 * np.pi, 700)))
    shaking = recorded([(JOINTS["prismatic"], shaken)], np.random.default_rng(6))
    both = Recording(
        time=np.concatenate([opening.time, shaking.time]),
        position=np.vstack([opening.position, shaking.position]),
        quaternion=np.vstack([opening.quaternion, shaking.quaternion]),
        run=np.repeat([0, 1], [60, 700]),
    )
    (edge,) = learn_graph(both, method="champ", settings=SMALL).edges
    assert kinds(edge.segments) == ["prismatic", "prismatic"]
    assert edge.segments[1].configuration_start == pytest.approx(0.25, abs=0.01)
    assert edge.segments[1].configuration_range == pytest.approx((0.05, 0.25), abs=0.01)
    assert np.dot(edge.segments[0].joint.axis, edge.segments[1].joint.axis) > 0.99


def test_coarser_rows_are_means_and_lose_none() -> None:
    recording = lifted_and_opened(cycles=1)
    track = part_track(recording, 0, recording.parts[0])
    window = RowWindow()
    window.add(track)
    window.coarsen()
    rows = window.rows()
    assert rows is not None
    assert np.allclose(rows.track.position[3], track.position[6:8].mean(axis=0))
    assert [(int(a) + 1) for a in rows.last[:-1]] == [int(b) for b in rows.track.rows[1:]]
    assert rows.last[-1] == track.rows[-1]


def test_rows_that_cannot_be_learned_are_refused() -> None:
    learner = OnlineLearner()
    learner.push(0.0, [0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="at least 5 rows, found 1"):
        learner.segments()
    with pytest.raises(InputError, match="same columns"):
        learner.push(0.1, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
    with pytest.raises(InputError, match="must be finite"):
        learner.push(0.1, [np.nan, 0.0, 0.0])
    with pytest.raises(InputError, match="method must be among"):
        OnlineLearner(method="magic")  # type: ignore[arg-type]


@pytest.mark.sweep
@needs_data
@pytest.mark.parametrize("method", ["champ", "act-champ"])
@pytest.mark.parametrize("name", ["drawer_no_grasp", "microwave_with_grasp", "stapler"])
def test_recorded_demonstrations_are_learned_online_as_exactly(name: str, method: str) -> None:
    assert_same_segments(read_recording(DATA / "demonstrations" / f"{name}.csv"), method)


@pytest.mark.evidence
@needs_data
def test_every_recorded_track_is_learned_online_as_exactly() -> None:
    files = sorted((DATA / "tracks").rglob("*.csv"))
    assert files
    for path in files:
        assert_same_segments(read_recording(path), "champ")


@needs_data
def test_a_recorded_drawer_moved_to_and_fro_for_long_stays_one_joint() -> None:
    """The recorded motion again and again, each time with other ones of the camera's errors, among neighbours."""
    once = read_recording(DATA / "demonstrations" / "drawer_no_grasp.csv")
    assert once.quaternion is not None
    joint = OnlineLearner(method="champ")
    joint.extend(once)
    (drawer,) = joint.segments()
    turned = Rotation.from_quat(once.quaternion)
    ideal = forward(drawer.joint, inverse(drawer.joint, once.position, turned))
    missed, turned = once.position - ideal.translation, turned * ideal.rotation.inv()
    rng, n = np.random.default_rng(0), len(once)
    learner = OnlineLearner(method="champ")
    for cycle in range(12):
        rows = np.arange(n) if cycle % 2 == 0 else np.arange(n)[::-1]
        errors = np.roll(np.arange(n)[:: rng.choice([-1, 1])], rng.integers(n))
        position = ideal.translation[rows] + missed[errors]
        quaternion = (turned[errors] * ideal.rotation[rows]).as_quat()
        learner.push((np.arange(n) + n * cycle) * 0.1, position, quaternion)
    segments = learner.segments()
    moving = [segment for segment in segments if segment.joint.kind != "rigid"]
    assert {segment.joint.kind for segment in moving} == {"prismatic"}
    assert len({segment.joint for segment in moving}) == 1
    assert all(a.end + 1 == b.start for a, b in pairwise(segments))
