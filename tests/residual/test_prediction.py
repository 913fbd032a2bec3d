"""Predictions of planted motion: exact where the model is true, and off by what was planted where it is not."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest
from reference.hybrid_step import step
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import prismatic, revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.tracks import tracks
from micah_plan.errors import InputError
from micah_plan.recording.value import Recording
from micah_plan.residual.prediction import predict_recording, rmse

SHUT = 1.0
SWING = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.1))
SWING_LONG = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
SLIDE = prismatic((0.0, 1.0, 0.0), (0.1, 0.0, 0.0))


def _segment(joint, start, end, rows):
    return Segment(joint, 0, *rows, start, end, (start, end), 0.001, 0.003, 0.0, 1.0)


def _door_edge():
    shut = forward(SWING, SHUT)[0]
    held = rigid(shut.translation, shut.rotation.as_quat(), SHUT)
    return KinematicEdge(BASE, "door", (_segment(SWING, 0.0, SHUT, (0, 9)), _segment(held, SHUT, SHUT, (10, 19))))


@pytest.fixture
def door():
    """Swings from 0 to 1 rad and is rigid there."""
    return build_automaton(KinematicGraph((_door_edge(),)))


@pytest.fixture
def oven():
    """The door, and a tray that slides in the frame of the door."""
    tray = KinematicEdge("door", "tray", (_segment(SLIDE, 0.0, 0.2, (0, 19)),))
    return build_automaton(KinematicGraph((_door_edge(), tray)))


def executed(automaton, inputs, gain=1.0, run=0):
    """Perfectly measured rows of the automaton's first link under inputs of which the plant realises a share."""
    mode, x = "revolute", np.zeros(1)
    poses, actions = [], []
    for u in [*inputs, None]:
        pose = forward(automaton.mode(mode).joints[0], x)[0]
        poses.append(pose)
        if u is None:
            actions.append(np.full(3, np.nan))
            break
        actions.append(np.cross((0.0, 0.0, 1.0), pose.translation) * u)  # J u, written out for the vertical hinge
        reached = step(automaton, mode, x, np.array([gain * u]))
        mode, x = reached.mode, reached.x
    return Recording(
        time=np.arange(len(poses)) * 0.1,
        position=np.array([pose.translation for pose in poses]),
        quaternion=np.array([pose.rotation.as_quat() for pose in poses]),
        action=np.array(actions),
        run=np.full(len(poses), run),
        has_run=True,
    )


def joined(first, second):
    return Recording(
        **{
            name: np.concatenate([getattr(first, name), getattr(second, name)])
            for name in ("time", "position", "quaternion", "action", "run")
        },
        has_run=True,
    )


@pytest.mark.parametrize("inputs", [[0.1] * 8, [0.15] * 10, [0.3, 0.3, 0.3, 0.3, 0.3, -0.2, -0.2]])
def test_a_true_model_predicts_perfect_measurements_exactly(door, inputs):
    (run,) = predict_recording(door, executed(door, inputs))
    # The pose in which the door is rigid has six digits, so it lies so much beside where it swings to.
    swings = np.cumsum([mode == "rigid" for mode in run.one_step.modes]) == 0
    assert swings.any()
    for error in (run.one_step, run.rollout):
        assert error.position[swings] == pytest.approx(0.0, abs=1e-9)
        assert error.rotation[swings] == pytest.approx(0.0, abs=1e-7)
        assert error.configuration[swings] == pytest.approx(0.0, abs=1e-9)
        for whole in (error.position, error.rotation, error.configuration):
            assert whole == pytest.approx(0.0, abs=2e-6)
    assert len(run.one_step.modes) == len(inputs)


def test_mode_changes_are_predicted(door):
    (run,) = predict_recording(door, executed(door, [0.3, 0.3, 0.3, 0.3, 0.3, -0.2]))
    expected = ("revolute", "revolute", "revolute", "rigid", "rigid", "revolute")
    assert run.rollout.modes == expected
    assert run.one_step.modes == expected


def test_a_planted_gain_shows_in_each_step_and_adds_up_in_the_rollout(door):
    recording = executed(door, [0.1] * 6, gain=0.8)
    (run,) = predict_recording(door, recording)
    assert run.one_step.configuration[:, 0] == pytest.approx(0.02, abs=1e-9)
    assert run.rollout.configuration[:, 0] == pytest.approx(0.02 * np.arange(1, 7), abs=1e-3)
    chord = 2 * np.hypot(0.3, 0.0) * np.sin(0.01)
    assert run.one_step.position[:, 0] == pytest.approx(chord, abs=1e-9)
    assert run.one_step.rotation[:, 0] == pytest.approx(0.02, abs=1e-9)


def test_runs_are_predicted_apart(door):
    recording = joined(executed(door, [0.1] * 4, run=3), executed(door, [0.2] * 3, gain=0.5, run=7))
    first, second = predict_recording(door, recording)
    assert (first.run, second.run) == (3, 7)
    assert rmse([first.one_step.configuration]) == pytest.approx(0.0, abs=1e-9)
    assert rmse([second.one_step.configuration]) == pytest.approx(0.1, abs=1e-9)


def test_positions_alone_can_be_predicted(door):
    full = executed(door, [0.1] * 4)
    (run,) = predict_recording(door, Recording(time=full.time, position=full.position, action=full.action))
    assert run.one_step.rotation is None
    assert run.one_step.configuration == pytest.approx(0.0, abs=1e-9)


def test_parts_that_hang_on_parts_are_seen_in_their_parents_frame(oven):
    turn, slid = np.array([0.2, 0.5, 0.9]), np.array([0.0, 0.05, 0.15])
    door = forward(SWING, turn)
    tray = door * forward(SLIDE, slid)
    both = RigidTransform.concatenate([door, tray])
    ahead = door.rotation.apply([0.0, 0.01, 0.0])
    recording = Recording(
        time=np.tile(np.arange(3.0), 2),
        position=both.translation,
        quaternion=both.rotation.as_quat(),
        action=np.concatenate([np.zeros((3, 3)), ahead]),
        part=("door",) * 3 + ("tray",) * 3,
        has_part=True,
    )
    (track,) = tracks(oven, recording)
    assert track.x == pytest.approx(np.stack([turn, slid], axis=1), abs=1e-9)
    assert track.u == pytest.approx(np.tile([0.0, 0.01], (2, 1)), abs=1e-9)
    assert Rotation.from_quat(track.quaternion[:, 1]).magnitude() == pytest.approx(0.0, abs=1e-7)


def test_an_unknown_part_names_both_sides(oven):
    recording = Recording(time=[0.0], position=np.zeros((1, 3)), part=("lid",), has_part=True)
    with pytest.raises(InputError, match=r"door, tray .* found lid"):
        tracks(oven, recording)


def test_parts_must_be_measured_together(oven):
    recording = Recording(time=[0.0, 1.0], position=np.zeros((2, 3)), part=("door", "tray"), has_part=True)
    with pytest.raises(InputError, match=r"'tray' was not measured at the same times"):
        tracks(oven, recording)


def test_without_actions_nothing_can_be_predicted(door):
    full = executed(door, [0.1] * 4)
    with pytest.raises(InputError, match="expected actions"):
        predict_recording(door, Recording(time=full.time, position=full.position))


def test_a_start_that_no_mode_allows_is_reported_with_the_measured_and_the_allowed(door):
    turned = Rotation.from_euler("z", 1.5)  # beyond the end at which the door is rigid
    full = executed(door, [0.1] * 4)
    elsewhere = Recording(
        time=full.time,
        position=turned.apply(full.position.copy()),
        quaternion=(turned * full.poses().rotation).as_quat(),
        action=full.action,
    )
    with pytest.raises(
        InputError, match=r"does not fit .* door = 1\.5 rad .*, .* door 0 to 1 rad .*; take the model"
    ) as caught:
        predict_recording(door, elsewhere)
    assert "name a mode" not in str(caught.value)


def test_a_single_row_cannot_be_predicted(door):
    with pytest.raises(InputError, match="at least 2 rows"):
        predict_recording(door, executed(door, []))


def test_noise_beyond_an_end_does_not_cost_the_command():
    """A drawer is pulled from its end and pushed back into it again and again, measured with a millimetre of noise."""
    edge = KinematicEdge(BASE, "drawer", (_segment(SLIDE, 0.0, 0.3, (0, 19)),))
    drawer, rng = build_automaton(KinematicGraph((edge,))), np.random.default_rng(0)
    inputs = np.tile([0.03, 0.03, -0.03, -0.04, -0.03, 0.0], 20)
    x = [0.0]
    for u in inputs:
        x.append(step(drawer, "prismatic", [x[-1]], [u]).x[0])
    measured = np.array(x) + 0.001 * rng.standard_normal(len(x))
    assert (measured < 0.0).sum() > 20
    pose = forward(SLIDE, measured)
    action = np.append(inputs, np.nan)[:, None] * np.array(SLIDE.axis)
    recording = Recording(
        time=np.arange(len(x)) * 0.1,
        position=pose.translation,
        quaternion=pose.rotation.as_quat(),
        action=action,
    )
    (run,) = predict_recording(drawer, recording)
    assert rmse([run.one_step.configuration]) < 0.0015  # two rows' noise is 0.0014
    assert rmse([run.rollout.configuration]) < 0.0012


@pytest.mark.parametrize(
    ("plant", "effect"),
    [
        (plants.stretched, Effect("sensor_scale", "door", (("scale", 1.1),))),
        (plants.drifting, Effect("drift", "door", (("rate", 0.01),))),
    ],
    ids=["scale", "drift"],
)
def test_poses_are_predicted_as_the_sensor_reads_them(plant, effect):
    segments = (_segment(SWING_LONG, 0.0, plants.LENGTH, (0, 9)),)
    door = build_automaton(KinematicGraph((KinematicEdge(BASE, "door", segments),)))
    log = plants.door_recording(plants.runs_of(plant, 4, 40, 3, goals=(0.4, 1.6)))
    before, after = (predict_recording(model, log) for model in (door, with_effect(door, effect)))
    rolled = [rmse([run.rollout.position for run in runs]) for runs in (before, after)]
    assert rolled[1] < 0.3 * rolled[0]
    # A position is as far off as the configuration says, on its arc.
    assert rolled[1] == pytest.approx(
        plants.RADIUS * rmse([run.rollout.configuration for run in after]), rel=0.15, abs=1e-4
    )
