"""Learning finds what was planted, whatever the frame and the signs of the quaternions."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted import AXIS, JOINTS, START, TRAVEL, Noise, moving_then_held, recorded
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.graph import KinematicEdge
from micah_plan.automaton.joint import prismatic, radius, revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.errors import InputError
from micah_plan.learning.learn import learn_graph
from micah_plan.learning.settings import LearnSettings
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording

DATA = Path(os.environ.get("MICAH_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"shared data not found at {DATA}")


def edge(recording: Recording, **options: object) -> KinematicEdge:
    (only,) = learn_graph(recording, **options).edges  # type: ignore[arg-type]
    return only


def kinds(found: KinematicEdge) -> list[str]:
    return [segment.joint.kind for segment in found.segments]


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["prismatic", "revolute", "screw"])
def test_moving_then_rigid_is_found_with_its_parameters(kind: str) -> None:
    c = moving_then_held(kind)
    found = edge(recorded([(JOINTS[kind], c)], np.random.default_rng(1)), method="champ")
    assert kinds(found) == [kind, "rigid"]
    assert abs(found.changepoints[0] - 70) <= 2
    moving, rigid = found.segments
    truth = JOINTS[kind]
    assert np.dot(moving.joint.axis, AXIS) > np.cos(0.03)
    assert radius(moving.joint) == pytest.approx(radius(truth), abs=0.01)
    assert moving.joint.pitch == pytest.approx(truth.pitch, abs=0.01)
    assert moving.configuration_start == pytest.approx(0.0, abs=1e-6)
    assert rigid.joint.fixed_at == pytest.approx(c[-1], abs=0.01)
    assert moving.configuration_end == pytest.approx(rigid.joint.fixed_at, abs=0.03)
    assert (moving.start, moving.end + 1, rigid.end) == (0, rigid.start, len(c) - 1)


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_positions_alone_are_enough(kind: str) -> None:
    recording = recorded([(JOINTS[kind], moving_then_held(kind))], np.random.default_rng(2), orientation=False)
    found = edge(recording, method="champ")
    assert kinds(found) == [kind, "rigid"]
    assert abs(found.changepoints[0] - 70) <= 3
    assert abs(np.dot(found.segments[0].joint.axis, AXIS)) > np.cos(0.05)
    assert radius(found.segments[0].joint) == pytest.approx(radius(JOINTS[kind]), abs=0.03)


def test_a_stop_is_seen_through_noise_of_a_step_and_a_half() -> None:
    recording = recorded(
        [(JOINTS["prismatic"], moving_then_held("prismatic"))], np.random.default_rng(15), Noise(0.005, 0.03)
    )
    found = edge(recording, method="champ")
    assert kinds(found) == ["prismatic", "rigid"]
    assert abs(found.changepoints[0] - 70) <= 8


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_ten_percent_outliers_change_nothing(kind: str) -> None:
    recording = recorded([(JOINTS[kind], moving_then_held(kind))], np.random.default_rng(3), Noise(outliers=0.1))
    found = edge(recording, method="champ")
    assert kinds(found) == [kind, "rigid"]
    assert abs(found.changepoints[0] - 70) <= 4
    assert np.dot(found.segments[0].joint.axis, AXIS) > np.cos(0.03)


@pytest.mark.sweep
@pytest.mark.parametrize("method", ["champ", "act-champ"])
def test_a_pushed_door_that_stops_is_shut(method: str) -> None:
    c = moving_then_held("revolute")
    push = np.concatenate([np.diff(c[:70]), np.full(41, 0.012)])
    recording = recorded([(JOINTS["revolute"], c)], np.random.default_rng(4), commanded=[push])
    found = edge(recording, method=method)
    assert kinds(found) == ["revolute", "rigid"]
    assert abs(found.changepoints[0] - 70) <= 2


def test_a_drawer_without_pushes_for_a_while_stays_a_drawer() -> None:
    c = np.concatenate([np.linspace(0, 0.15, 50), np.full(45, 0.15), np.linspace(0.15, 0.3, 50)])
    push = np.append(np.diff(c), 0.0)
    recording = recorded([(JOINTS["prismatic"], c)], np.random.default_rng(5), commanded=[push])
    assert kinds(edge(recording, method="act-champ")) == ["prismatic"]


def test_rest_before_the_motion_starts_is_no_rigid_model() -> None:
    c = np.concatenate([np.zeros(30), np.linspace(0, 0.25, 70)])
    recording = recorded([(JOINTS["prismatic"], c)], np.random.default_rng(6), commanded=[np.append(np.diff(c), 0.0)])
    assert kinds(edge(recording)) == ["prismatic"]


def test_a_part_that_never_moves_is_one_rigid_segment() -> None:
    noisy = recorded([(JOINTS["prismatic"], np.zeros(60))], np.random.default_rng(7))
    exact = recorded([(JOINTS["prismatic"], np.zeros(60))], np.random.default_rng(7), Noise(0.0, 0.0))
    for recording in (noisy, exact):
        found = edge(recording)
        assert kinds(found) == ["rigid"]
        assert found.segments[0].joint.fixed_at == 0.0
        assert np.allclose(found.segments[0].joint.position, JOINTS["prismatic"].position, atol=2e-3)


def test_two_joints_follow_each_other_on_one_coordinate() -> None:
    slide = prismatic((0, 0, 1), (0.4, 0, 0))
    top = forward(slide, 0.3)[0]
    hinge = revolute((0, 1, 0), (0, 0, 0.3), top.translation, top.rotation.as_quat())
    recording = recorded([(slide, np.linspace(0, 0.3, 60)), (hinge, np.linspace(0, 0.9, 60))], np.random.default_rng(8))
    found = edge(recording, method="champ")
    assert kinds(found) == ["prismatic", "revolute"]
    assert abs(found.changepoints[0] - 60) <= 2
    first, second = found.segments
    assert second.configuration_start == pytest.approx(first.configuration_end, abs=0.02)
    assert second.configuration_end == pytest.approx(0.3 + 0.9, abs=0.03)
    meeting = [forward(s.joint, second.configuration_start).translation[0] for s in found.segments]
    assert np.linalg.norm(meeting[0] - meeting[1]) < 0.005


def test_another_base_frame_changes_only_the_frame() -> None:
    recording = recorded([(JOINTS["revolute"], moving_then_held("revolute"))], np.random.default_rng(9))
    turn = RigidTransform.from_components([1.0, -2.0, 0.5], Rotation.from_rotvec([1.0, 0.7, -2.0]))
    poses = turn * recording.poses()
    turned = replace(recording, position=poses.translation, quaternion=poses.rotation.as_quat())
    before, after = edge(recording, method="champ"), edge(turned, method="champ")
    assert kinds(before) == kinds(after)
    assert before.changepoints == after.changepoints
    expected = turn.rotation.apply(before.segments[0].joint.axis)
    assert np.dot(expected, after.segments[0].joint.axis) > np.cos(0.01)


def test_signs_of_quaternions_do_not_matter() -> None:
    rng = np.random.default_rng(10)
    recording = recorded([(JOINTS["revolute"], moving_then_held("revolute"))], rng)
    assert recording.quaternion is not None
    signs = rng.choice([-1.0, 1.0], size=(len(recording), 1))
    flipped = replace(recording, quaternion=recording.quaternion * signs)
    before, after = edge(recording), edge(flipped)
    assert (kinds(before), before.changepoints) == (kinds(after), after.changepoints)


def test_the_same_rows_give_the_same_graph() -> None:
    recording = recorded([(JOINTS["screw"], moving_then_held("screw", 40, 20))], np.random.default_rng(11))
    assert learn_graph(recording) == learn_graph(recording)


def test_later_runs_are_counted_along_the_first() -> None:
    rng = np.random.default_rng(12)
    opening = recorded([(JOINTS["prismatic"], np.linspace(0, 0.2, 60))], rng)
    closing = recorded([(JOINTS["prismatic"], np.linspace(0.2, 0.05, 60))], rng)
    both = Recording(
        time=np.concatenate([opening.time, closing.time]),
        position=np.vstack([opening.position, closing.position]),
        quaternion=np.vstack([opening.poses().rotation.as_quat(), closing.poses().rotation.as_quat()]),
        run=np.repeat([0, 1], 60),
    )
    found = edge(both, method="champ")
    assert kinds(found) == ["prismatic", "prismatic"]
    assert [s.run for s in found.segments] == [0, 1]
    assert found.segments[1].start == 60
    assert found.segments[1].configuration_start == pytest.approx(0.2, abs=0.01)
    assert found.segments[1].configuration_end == pytest.approx(0.05, abs=0.01)


@pytest.mark.slow
def test_parts_become_edges_of_their_own() -> None:
    rng = np.random.default_rng(13)
    door = recorded([(JOINTS["revolute"], np.linspace(0, 0.8, 60))], rng)
    drawer = recorded([(JOINTS["prismatic"], np.linspace(0, 0.3, 60))], rng)
    both = Recording(
        time=np.concatenate([door.time, drawer.time]),
        position=np.vstack([door.position, drawer.position]),
        quaternion=np.vstack([door.poses().rotation.as_quat(), drawer.poses().rotation.as_quat()]),
        part=("door",) * 60 + ("drawer",) * 60,
    )
    graph = learn_graph(both, method="champ")
    assert [(e.parent, e.child, kinds(e)) for e in graph.edges] == [
        ("base", "door", ["revolute"]),
        ("base", "drawer", ["prismatic"]),
    ]
    assert graph.edges[1].segments[0].start == 60


@pytest.mark.parametrize("rows", [1, 2, 4])
def test_too_few_rows_are_refused_with_a_remedy(rows: int) -> None:
    recording = Recording(time=np.arange(float(rows)), position=np.zeros((rows, 3)))
    with pytest.raises(InputError, match=f"run 0, part 'part': .* at least 5 rows, found {rows}; record"):
        learn_graph(recording)


def test_a_part_cannot_have_the_name_of_the_base() -> None:
    recording = Recording(time=np.arange(8.0), position=np.zeros((8, 3)), part=("base",) * 8)
    with pytest.raises(InputError, match=r"column 'part': a part is named 'base'.*another name"):
        learn_graph(recording)


def test_unknown_methods_and_settings_are_refused() -> None:
    recording = Recording(time=np.arange(8.0), position=np.zeros((8, 3)))
    with pytest.raises(InputError, match="method must be among"):
        learn_graph(recording, method="magic")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="resolution must be positive"):
        LearnSettings(resolution=0)


@pytest.mark.parametrize("rows", [5, 6, 8])
def test_the_shortest_recordings_give_an_answer(rows: int) -> None:
    found = edge(recorded([(JOINTS["prismatic"], np.linspace(0, 0.2, rows))], np.random.default_rng(14)))
    assert found.segments[0].start == 0
    assert found.segments[-1].end == rows - 1


def assert_door_shuts(recording: Recording, method: str) -> None:
    found = edge(recording, method=method)
    assert kinds(found) == ["revolute", "rigid"]
    assert abs(found.changepoints[0] - 81) <= 3
    assert 0.19 < radius(found.segments[0].joint) < 0.25


@needs_data
@pytest.mark.parametrize("method", ["champ", "act-champ"])
def test_the_recorded_microwave_door_is_revolute_then_rigid_where_it_stops(method: str) -> None:
    assert_door_shuts(read_recording(DATA / "demonstrations" / "microwave_with_grasp.csv"), method)


@needs_data
def test_the_recorded_stapler_is_revolute_until_it_latches() -> None:
    found = edge(read_recording(DATA / "demonstrations" / "stapler.csv"), method="champ")
    assert kinds(found) == ["revolute", "rigid"]
    assert abs(found.changepoints[0] - 100) <= 6


PHASE = np.linspace(0.0, 1.0, 70)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
@pytest.mark.parametrize(
    "progress",
    [(1 - np.cos(2 * np.pi * PHASE)) / 2, np.interp(PHASE, [0, 0.5, 1], [0, 0.75, 1]), PHASE**2],
    ids=["out and back", "fast then slow", "accelerating"],
)
@pytest.mark.parametrize("position_noise", [0.0, 0.0005])
def test_how_a_part_is_moved_does_not_split_its_joint(kind: str, progress: np.ndarray, position_noise: float) -> None:
    noise = Noise(position_noise, 6 * position_noise)
    recording = recorded([(JOINTS[kind], TRAVEL[kind] * progress)], np.random.default_rng(3), noise)
    found = edge(recording, method="champ")
    assert kinds(found) == [kind]


def test_different_joints_of_one_kind_stay_apart() -> None:
    along, across = JOINTS["prismatic"], prismatic((0.8, -0.6, 0.0), (0.5, 0.1, 0.3), START.as_quat())
    travel = np.linspace(0.0, 0.25, 60)
    corner = forward(along, travel[-1:])[0].translation
    onward = prismatic(across.axis, tuple(corner), START.as_quat())
    recording = recorded([(along, travel), (onward, travel)], np.random.default_rng(4), Noise(0.001, 0.006))
    found = edge(recording, method="champ")
    assert kinds(found) == ["prismatic", "prismatic"]
    assert abs(found.changepoints[0] - 60) <= 2


@pytest.mark.sweep
@pytest.mark.parametrize("position_noise", [0.0, 0.0005])
def test_a_push_that_does_not_follow_the_arc_indicates_a_stop(position_noise: float) -> None:
    """Clean actions say nothing of most directions of the action channel; it must not use them to explain the stop."""
    joint, swing = JOINTS["revolute"], np.linspace(0.0, 0.9, 70)
    held = np.full(40, 0.9)
    recording = recorded(
        [(joint, swing), (joint, held)],
        np.random.default_rng(5),
        Noise(position_noise, 6 * position_noise),
        commanded=[np.append(np.diff(swing), 0.0), np.zeros(40)],
    )
    middle = forward(joint, np.array([0.44, 0.46])).translation
    action = recording.action.copy()
    action[69:-1] = middle[1] - middle[0]
    found = edge(replace(recording, action=action), method="act-champ")
    assert kinds(found) == ["revolute", "rigid"]
    assert abs(found.changepoints[0] - 70) <= 2
