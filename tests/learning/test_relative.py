"""A part seen from another: poses, times, actions and rows, against planted truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_parts import CARRIAGE, TRAY, PlantedPart, arm, cabinet, recorded_parts, sweep
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.certainty import EdgeCertainty, EvidenceTrace, RowPosterior, SegmentCertainty
from micah_plan.automaton.graph import BASE, KinematicEdge, Segment
from micah_plan.automaton.joint import rigid
from micah_plan.automaton.kinematics import forward, inverse
from micah_plan.errors import InputError
from micah_plan.learning.parts.relative import RelativeRows, displacements_within, in_whole_recording, relative_rows
from micah_plan.recording.value import Recording

EXACT = {"position": 0.0, "rotation": 0.0}


def seen(recording: Recording, parent: str, child: str) -> RelativeRows:
    found = relative_rows(recording, parent, child)
    assert found is not None
    return found


def test_on_its_parent_a_part_only_does_what_its_own_joint_does() -> None:
    parts = arm(together=True)
    relative = seen(recorded_parts(parts, 0, **EXACT), "upper", "lower")
    expected = forward(parts["lower"].joint, parts["lower"].configurations)
    assert relative.recording.position == pytest.approx(expected.translation, abs=1e-12)
    apart = expected.rotation.inv() * Rotation.from_quat(relative.recording.quaternion.copy())
    assert apart.magnitude() == pytest.approx(0.0, abs=1e-9)
    assert relative.recording.parts == ("lower",)


def test_the_base_sees_what_was_recorded() -> None:
    recording = recorded_parts(cabinet(), 0, actions=True)
    relative = seen(recording, BASE, "drawer")
    expected = recording.select(part="drawer")
    assert relative.recording.digest() == expected.digest()
    assert [recording.part[row] for row in relative.rows] == ["drawer"] * len(relative)


def test_rows_are_those_of_the_child_in_the_whole_recording() -> None:
    recording = recorded_parts(cabinet(), 0, dropped=0.2)
    relative = seen(recording, "door", "knob")
    assert {recording.part[row] for row in relative.rows} == {"knob"}
    assert relative.recording.time == pytest.approx(recording.time[relative.rows])


@pytest.mark.parametrize("late", [0.004, 0.02])
def test_other_times_and_missing_rows_are_bridged(late: float) -> None:
    """The tray stays at rest in a carriage that moves evenly, so a line between its rows is exact."""
    parts = {
        "carriage": PlantedPart(BASE, CARRIAGE, np.linspace(0.0, 0.5, 100)),
        "tray": PlantedPart("carriage", TRAY, np.zeros(100)),
    }
    exact = recorded_parts(parts, 3, **EXACT, dropped=0.1)
    here = np.array([name == "tray" for name in exact.part])
    # The tray is measured later and has moved on by then.
    moved = exact.position + here[:, None] * late * 18.0 * np.array(CARRIAGE.axis) * 0.5 / 99
    recording = replace(exact, time=exact.time + late * here, position=moved)
    relative = seen(recording, "carriage", "tray")
    assert relative.recording.position == pytest.approx(np.tile(TRAY.position, (len(relative), 1)), abs=1e-9)
    assert len(relative) > 70


def test_orientations_between_rows_lie_on_the_way_between_them() -> None:
    turn = np.linspace(0.0, 1.5, 20)
    poses = RigidTransform.from_components(np.zeros((20, 3)), Rotation.from_rotvec(turn[:, None] * [0.6, 0.0, 0.8]))
    recording = Recording(
        time=np.concatenate([np.arange(20.0), np.arange(19) + 0.3]),
        position=np.zeros((39, 3)),
        quaternion=np.concatenate([poses.rotation.as_quat(), np.tile([0.0, 0.0, 0.0, 1.0], (19, 1))]),
        part=("lid",) * 20 + ("mark",) * 19,
    )
    relative = seen(recording, "lid", "mark")
    assert relative.frames.rotation.magnitude() == pytest.approx(turn[:-1] + 0.3 * 1.5 / 19, abs=1e-12)


def test_nothing_is_extrapolated() -> None:
    recording = recorded_parts(cabinet(), 0, **EXACT)
    middle = recording.time[np.array([name == "door" for name in recording.part])][30:100]
    keep = [
        name != "door" or middle[0] <= t <= middle[-1] for name, t in zip(recording.part, recording.time, strict=True)
    ]
    relative = seen(recording.rows(np.array(keep)), "door", "knob")
    assert (relative.recording.time[0], relative.recording.time[-1]) == (middle[0], middle[-1])


def test_a_long_gap_of_the_parent_is_not_bridged() -> None:
    recording = recorded_parts(cabinet(), 0, **EXACT)
    lost = np.array([name == "door" and 2.0 < t < 3.0 for name, t in zip(recording.part, recording.time, strict=True)])
    relative = seen(recording.rows(~lost), "door", "knob")
    assert not ((relative.recording.time > 2.0) & (relative.recording.time < 3.0)).any()
    knob = recording.select(part="knob").time
    assert len(relative) == np.sum((knob <= 2.0) | (knob >= 3.0))


def test_every_run_is_seen_on_its_own_and_runs_without_the_parent_are_left_out() -> None:
    once = recorded_parts(cabinet(), 0, **EXACT)
    again = once.rows(np.array([name != "door" for name in once.part]))
    both = Recording(
        time=np.concatenate([once.time, again.time, once.time]),
        position=np.concatenate([once.position, again.position, once.position]),
        quaternion=np.concatenate([once.quaternion, again.quaternion, once.quaternion]),
        run=np.repeat([1, 2, 5], [len(once), len(again), len(once)]),
        part=once.part + again.part + once.part,
    )
    relative = seen(both, "door", "knob")
    assert relative.recording.runs == (1, 5)
    assert len(relative) == 300
    assert relative_rows(again, "drawer", "knob") is not None
    assert relative_rows(both.rows(np.arange(12)), "door", "knob") is None


def test_the_command_of_a_part_is_relative_to_its_carrier() -> None:
    """A perfect hand: the relative actions add up to the relative motion, whatever the parent does meanwhile."""
    for parts in (arm(together=True), arm(together=False)):
        recording = recorded_parts(parts, 0, **EXACT, actions=True)
        relative = seen(recording, "upper", "lower").recording
        assert relative.action is not None
        assert relative.action[:-1] == pytest.approx(np.diff(relative.position, axis=0), abs=1e-12)
        assert np.isnan(relative.action[-1]).all()


def test_a_knob_that_moves_with_its_door_has_no_command() -> None:
    recording = recorded_parts(cabinet(), 0, **EXACT, actions=True)
    relative = seen(recording, "door", "knob").recording
    assert relative.action is not None
    assert np.nanmax(np.abs(relative.action)) < 1e-12


def test_pulling_on_a_part_whose_parent_rests_is_pulling_in_the_parents_frame() -> None:
    frame = RigidTransform.from_components([0.1, 0.2, 0.3], Rotation.from_rotvec([0.0, 0.0, np.pi / 2]))
    frames = RigidTransform.concatenate([frame] * 3)
    asked = displacements_within(frames, np.ones((3, 3)), np.tile([0.0, 0.01, 0.0], (3, 1)))
    assert asked[:-1] == pytest.approx(np.tile([0.01, 0.0, 0.0], (2, 1)), abs=1e-12)


def test_forces_are_turned() -> None:
    recording = recorded_parts(arm(together=True), 0, **EXACT)
    force = recording.poses().rotation.apply(np.tile([0.0, 0.0, 2.0], (len(recording), 1)))
    relative = seen(replace(recording, force=force), "upper", "lower")
    expected = Rotation.from_quat(relative.recording.quaternion.copy()).apply([0.0, 0.0, 2.0])
    assert relative.recording.force == pytest.approx(expected, abs=1e-9)


def test_given_poses_stand_for_the_parents_measured_ones() -> None:
    parts = arm(together=True)
    noisy = recorded_parts(parts, 1)
    exact = recorded_parts(parts, 1, **EXACT)
    measured = seen(noisy, "upper", "lower")
    placed = relative_rows(noisy, "upper", "lower", exact.poses())
    assert placed is not None
    truth = seen(exact, "upper", "lower").recording.position
    spread = [np.std(found.recording.position - truth) for found in (placed, measured)]
    assert spread[0] == pytest.approx(0.0015, rel=0.15)
    assert spread[1] > 1.4 * spread[0]


def test_segments_and_posteriors_are_mapped_back() -> None:
    recording = recorded_parts(cabinet(), 0, dropped=0.3)
    relative = seen(recording, "door", "knob")
    joint = rigid((0, 0, 0))
    certainty = SegmentCertainty(RowPosterior((40, 41), (0.3, 0.7)), (("rigid", 1.0),))
    segments = (
        Segment(joint, 0, 0, 40, 0.0, 0.0, (0.0, 0.0), 0.0, 0.01, 0.0, 1.0),
        Segment(joint, 0, 41, len(relative) - 1, 0.0, 0.0, (0.0, 0.0), 0.0, 0.01, 0.0, 1.0, certainty),
    )
    trace = EvidenceTrace((0, 41), ("rigid",), ((0.0,), (0.0,)), (0.0, 1.0))
    edge = in_whole_recording(
        KinematicEdge(BASE, "anything", segments, EdgeCertainty(-3.0, ((0.0, 1.0),), trace=trace)), relative, "knob"
    )
    assert (edge.parent, edge.child) == ("door", "knob")
    assert [(s.start, s.end) for s in edge.segments] == [
        (relative.rows[0], relative.rows[40]),
        (relative.rows[41], relative.rows[-1]),
    ]
    assert edge.segments[1].certainty is not None
    assert edge.segments[1].certainty.start == RowPosterior((relative.rows[40], relative.rows[41]), (0.3, 0.7))
    assert edge.certainty is not None
    assert edge.certainty.trace is not None
    assert edge.certainty.trace.rows == (relative.rows[0], relative.rows[41])


def test_configurations_are_those_of_the_joint_between_the_two() -> None:
    parts = {
        "carriage": PlantedPart(BASE, CARRIAGE, sweep(80, 5, 70, 0.4)),
        "tray": PlantedPart("carriage", TRAY, sweep(80, 20, 60, 0.2)),
    }
    relative = seen(recorded_parts(parts, 0, **EXACT), "carriage", "tray")
    assert inverse(TRAY, relative.recording.position) == pytest.approx(sweep(80, 20, 60, 0.2), abs=1e-12)


def test_parts_that_do_not_exist_and_frames_that_were_not_measured() -> None:
    recording = recorded_parts(cabinet(), 0)
    with pytest.raises(InputError, match=r"unknown part 'lid'; choose one of door, drawer, knob"):
        relative_rows(recording, "lid", "knob")
    with pytest.raises(InputError, match="unknown part 'base'"):
        relative_rows(recording, "door", "base")
    with pytest.raises(InputError, match="whose orientation was not measured"):
        relative_rows(replace(recording, quaternion=None), "door", "knob")
    assert relative_rows(replace(recording, quaternion=None), BASE, "knob") is not None
