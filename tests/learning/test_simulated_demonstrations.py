"""The demonstrations that Table I is judged by: they do what their truth says."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_demonstrations import RATE, ActionChannel, Tracker, demonstration, draw_scene, perform
from simulated_hand import PERFECT
from table1_scoring import axis_basis, ideal_covariance, parameter_errors, score

from micah_plan.automaton.graph import KinematicEdge, Segment
from micah_plan.automaton.joint import rigid
from micah_plan.automaton.kinematics import forward, inverse, shifted

CASES = [(name, way) for name in ("microwave", "drawer") for way in ("with grasp", "no actions", "without grasp")]


def perfect(name, way, seed):
    """A demonstration without noise, by a perfect hand at the tracked origin, with ideal actions."""
    rng = np.random.default_rng(seed)
    scene = draw_scene(name, way, rng)
    lever = float(np.linalg.norm(np.subtract(scene.joint.position, scene.joint.center))) if scene.stops else 1.0
    scene = replace(
        scene,
        tracker=Tracker(),
        channel=ActionChannel(),
        habits=PERFECT,
        handle=0.0,
        lever=lever,
    )
    return perform(scene, rng)


@pytest.mark.parametrize("name", ["microwave", "drawer"])
@pytest.mark.parametrize("way", ["with grasp", "no actions"])
def test_ideal_actions_integrate_to_the_motion(name, way):
    truth = perfect(name, way, 4)
    position, action = truth.recording.position, truth.recording.action
    moving = truth.changepoints[0] if truth.changepoints else len(position) - 1
    travelled = position[0] + np.cumsum(action[:moving], axis=0)
    np.testing.assert_allclose(travelled, position[1 : moving + 1], atol=1e-12)
    assert np.isnan(action[-1]).all()


@pytest.mark.parametrize(("name", "way"), CASES)
def test_without_noise_the_poses_lie_on_the_joint(name, way):
    truth = perfect(name, way, 5)
    poses, joint = truth.recording.poses(), truth.scene.joint
    found = inverse(joint, poses.translation, poses.rotation)
    np.testing.assert_allclose(found, truth.motion.configuration, atol=1e-9)
    np.testing.assert_allclose(forward(joint, found).translation, poses.translation, atol=1e-9)


@pytest.mark.parametrize(("name", "way"), CASES)
def test_every_demonstration_moves_as_its_case_says(name, way):
    for seed in range(20):
        truth = demonstration(name, way, seed)
        c, rows = truth.motion.configuration, len(truth.recording)
        assert 130 <= rows <= 160
        assert c[0] == 0.0
        assert c[-1] == pytest.approx(truth.scene.travel)
        steps = np.diff(c)
        assert steps.min() >= 0.0
        if truth.changepoints:
            shut = truth.changepoints[0]
            assert (c[shut:] == truth.scene.travel).all()
            assert c[shut - 1] < truth.scene.travel
            assert rows - shut >= 25
            assert truth.motion.command[shut:].mean() > 0.3 * steps[:shut].mean()  # the hand goes on pushing
        if way == "no actions":
            stop = truth.changepoints[0] if truth.changepoints else rows - 8
            rests = np.flatnonzero(np.diff(np.flatnonzero(steps[:stop] > 0)) > 12)
            assert len(rests) == 2
            pause = np.flatnonzero(steps[:stop] > 0)[rests[0]] + 1
            asked = np.abs(truth.motion.command[pause : pause + 12])
            assert asked.max() < 0.25 * steps[:stop].max()  # nothing but tremor


def test_without_a_grasp_the_hand_moves_mostly_across_the_joint():
    for name in ("microwave", "drawer"):
        share = []
        for seed in range(20):
            truth = demonstration(name, "without grasp", seed)
            along = np.abs(truth.motion.command) * truth.scene.lever
            share.append(np.mean(np.linalg.norm(truth.motion.across, axis=1) > along))
        assert np.mean(share) > 0.6


def test_the_tracker_errs_as_much_as_it_says():
    tracker = Tracker(scale=(1.0, 2.0, 0.5), memory=1.5)
    rng = np.random.default_rng(0)
    errors = np.stack([tracker.errors(120, 0.003, 0.004, rng) for _ in range(300)])
    np.testing.assert_allclose(errors.std(axis=(0, 1)), 0.005 * np.array(tracker.scale), rtol=0.05)
    steps = np.diff(errors, axis=1)
    wander = 2 * 0.004**2 * (1 - np.exp(-1 / (1.5 * RATE)))
    np.testing.assert_allclose(
        steps.std(axis=(0, 1)), np.sqrt(2 * 0.003**2 + wander) * np.array(tracker.scale), rtol=0.05
    )


def test_the_action_column_is_turned_scaled_and_late():
    rng = np.random.default_rng(0)
    moved = rng.standard_normal((30, 3))
    channel = ActionChannel(rotation=(0.0, 0.0, np.pi / 2), gain=3.0, delay=2)
    action = channel(moved, rng)
    np.testing.assert_allclose(action[2:-1], 3.0 * np.stack([-moved[:-2, 1], moved[:-2, 0], moved[:-2, 2]], axis=1))
    np.testing.assert_array_equal(action[:2], 0.0)


def test_a_seed_is_a_demonstration():
    digests = [demonstration("microwave", "without grasp", seed).recording.digest() for seed in (1, 1, 2)]
    assert digests[0] == digests[1] != digests[2]


def test_the_bound_is_reached_by_least_squares_on_a_drawer():
    """The axis of a drawer that is told its configurations' spread: white noise, so the best line is efficient."""
    scene = draw_scene("drawer", "with grasp", np.random.default_rng(3))
    scene = replace(scene, tracker=Tracker(position_white=0.003, rotation_white=0.01))
    truth = perform(scene, np.random.default_rng(4))
    bound = np.sqrt(np.diag(ideal_covariance(truth))[:2])
    rng = np.random.default_rng(5)
    clean = forward(scene.joint, truth.motion.configuration).translation
    tilts = []
    for _ in range(400):
        noisy = clean + 0.003 * rng.standard_normal(clean.shape)
        direction = np.linalg.svd(noisy - noisy.mean(axis=0))[2][0]
        direction *= np.sign(direction @ scene.joint.axis)
        tilts.append(axis_basis(scene.joint.axis) @ direction)
    np.testing.assert_allclose(np.std(tilts, axis=0), bound, rtol=0.12)


def learned(truth, joint=None, row=None, shut=None):
    """The edge that a learner would return, by default the truth."""
    rows, travel = len(truth.recording), truth.scene.travel
    start = truth.changepoints[0] if row is None else row
    pose = forward(truth.scene.joint, travel)[0]
    held = rigid(pose.translation, pose.rotation.as_quat(), travel if shut is None else shut)

    def segment(one, first, last):
        return Segment(one, 0, first, last, 0.0, travel, (0.0, travel), 0.0, 0.0, 0.0, 1.0)

    moving = segment(joint or truth.scene.joint, 0, start - 1)
    return KinematicEdge("base", "part", (moving, segment(held, start, rows - 1)))


def test_scores_count_correctly():
    truth = demonstration("microwave", "with grasp", 0)
    exact = score(learned(truth), truth)
    assert exact.strict
    assert exact.rows == exact.configuration == 0
    assert max(exact.errors.axis, exact.errors.center, exact.errors.radius) < 1e-12

    late = score(learned(truth, row=truth.changepoints[0] + 3), truth)
    assert late.rows == 3
    halfway = score(learned(truth, shut=truth.scene.travel - 0.06), truth)
    assert halfway.structure
    assert not halfway.correct
    tilted = np.add(truth.scene.joint.axis, 0.2 * axis_basis(truth.scene.joint.axis)[0])
    tilted = replace(truth.scene.joint, axis=tuple(tilted / np.linalg.norm(tilted)))
    found = score(learned(truth, joint=tilted), truth)
    assert (found.correct, found.strict) == (True, False)  # 1 - |cos| forgives 0.2 rad
    assert found.errors.axis == pytest.approx(np.arctan(0.2))
    away = replace(truth.scene.joint, axis=tuple(-v for v in truth.scene.joint.axis))
    assert score(learned(truth, joint=away), truth).errors.axis == pytest.approx(np.pi)
    one = KinematicEdge("base", "part", learned(truth).segments[:1])
    assert not score(one, truth).structure
    turned = shifted(truth.scene.joint, 0.5)  # another origin of the same hinge: the same parameters
    assert parameter_errors(turned, truth.scene.joint).strict(1e-9)
