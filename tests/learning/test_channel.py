"""The action channel: planted frames, gains and delays are found, with spreads that hold the truth."""

from dataclasses import replace

import numpy as np
import pytest
from planted_channel import CASES, Case, believed_angle, planted
from scipy.spatial.transform import Rotation
from true_channel import TrueChannel, misses

from micah_plan.automaton.joint import prismatic, revolute, rigid
from micah_plan.automaton.kinematics import forward, inverse_jacobian
from micah_plan.learning.actions.channel import estimate_channel
from micah_plan.learning.actions.channel_search import Quadratic, climb, integrate
from micah_plan.learning.actions.command_path import command_of, with_delayed_actions
from micah_plan.learning.actions.configuration_steps import configuration_steps, fit_noise, step_noise_of
from micah_plan.learning.joints.quaternions import rotation_matrix, rotation_quaternion, times
from micah_plan.learning.track import PartTrack


def estimated(truth, track=None):
    track = track or truth.track
    return estimate_channel(truth.joint, [(0, len(track) - 1)], track, truth.white_std)


def with_motion_as_actions(truth):
    """The recording with its measured displacements as actions: the identity channel."""
    step = np.diff(truth.track.position, axis=0, append=truth.track.position[-1:])
    return replace(truth.track, action=truth.track.rotation.inv().apply(step))


def steps_and_command(case, seed=0):
    truth = planted(case, np.random.default_rng(seed))
    everything = np.ones(len(truth.track), dtype=bool)
    pieces = [(0, 70), (71, len(truth.track) - 1)]
    return configuration_steps(truth.joint, pieces, truth.track, everything, truth.white_std**2, None), command_of(
        truth.track
    )


def test_ideal_actions_are_the_identity_channel():
    for kind in ("prismatic", "revolute"):
        truth = planted(Case(kind, arc=1.0, noise=1e-5), np.random.default_rng(1))
        found = estimated(truth, with_motion_as_actions(truth))
        assert found.gain == pytest.approx(1.0, abs=0.03)
        assert np.linalg.norm(found.frame_rotation) < 0.2
        assert abs(found.delay) < 0.01
        assert found.explained > 0.99


def stepped_on(joint, rng, noise, rows=56):
    """A hand that steps on from what it measures, so that its actions point where the tracker's noise points."""
    wanted = rng.uniform(0.015, 0.035, rows)
    measured = np.cumsum(wanted) - wanted + noise * rng.standard_normal(rows)
    poses, meant = forward(joint, measured), forward(joint, measured + wanted)
    action = poses.rotation.inv().apply(meant.translation - poses.translation)
    action[-1] = 0.0
    return PartTrack(np.arange(rows), 0.1 * np.arange(rows), poses.translation, poses.rotation.as_quat(), action)


def test_directions_that_follow_the_noise_are_no_turned_frame():
    joint = revolute((0, 0, 1), (-0.33, 0.03, 0.0), (0, 0, 0))
    worst = []
    for seed, noise in enumerate([0.002, 0.005, 0.01] * 3):
        track = stepped_on(joint, np.random.default_rng(seed), noise)
        found = estimate_channel(joint, [(0, len(track) - 1)], track, noise)
        off = np.array([*found.frame_rotation, found.gain - 1.0, found.delay])
        worst.append(float(off @ np.linalg.solve(found.covariance, off)))
    assert sum(miss > 11.1 for miss in worst) <= 1  # chi squared with 5 degrees of freedom, 95 %


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_a_reversed_frame_is_a_rotation_not_a_negative_gain(kind):
    truth = planted(Case(kind, arc=1.2, noise=3e-4), np.random.default_rng(4), np.pi - 0.05)
    found = estimated(truth)
    assert found.gain == pytest.approx(truth.gain, rel=0.25)
    error = misses(truth, found)
    assert error["angle error"] < 3 * error["angle std"]
    assert np.linalg.norm(found.frame_rotation) > 1.5


def test_what_a_prismatic_joint_does_not_determine_keeps_its_prior_spread():
    truth = planted(Case("prismatic", across=2.0, noise=3e-4), np.random.default_rng(2), 0.3)
    covariance = np.array(estimated(truth).covariance)[:3, :3]
    axis = np.array(truth.joint.axis)
    values, vectors = np.linalg.eigh(covariance)
    assert 0.7 < np.sqrt(axis @ covariance @ axis) < 1.5
    assert abs(vectors[:, 2] @ axis) > 0.99
    assert np.sqrt(values[1]) < 0.15


def pushed_noisily(rng, rows=200):
    """A slide that is pushed on and on, with pauses, of which a log holds every push with an error of its own."""
    meant = 0.002 * (np.arange(rows) % 50 < 35) * (1 + 0.3 * np.sin(np.arange(rows) / 9))
    moved = np.concatenate([[0.0], np.cumsum(meant * (1 + 0.1 * rng.standard_normal(rows)))[:-1]])
    position = np.outer(moved, [1.0, 0.0, 0.0]) + 5e-4 * rng.standard_normal((rows, 3))
    action = np.outer(meant, [1.0, 0.0, 0.0]) * (1 + 0.5 * rng.standard_normal((rows, 1)))
    return PartTrack(np.arange(rows), 0.1 * np.arange(rows), position, None, action)


def test_errors_of_actions_do_not_look_like_a_delay_of_half_a_row():
    joint = prismatic((1, 0, 0), (0, 0, 0))
    held = 0
    for seed in range(20):
        track = pushed_noisily(np.random.default_rng(seed))
        found = estimate_channel(joint, [(0, len(track) - 1)], track, 5e-4)
        held += abs(found.delay) < 1.96 * np.sqrt(found.covariance[4][4])
    assert held >= 14


def test_the_unit_of_time_only_scales_the_delay():
    truth = planted(Case("revolute"), np.random.default_rng(3))
    seconds, other = estimated(truth), estimated(truth, replace(truth.track, time=60.0 * truth.track.time + 5.0))
    assert other.delay == pytest.approx(60.0 * seconds.delay, rel=1e-6)
    assert other.gain == pytest.approx(seconds.gain, rel=1e-6)
    assert np.allclose(other.frame_rotation, seconds.frame_rotation, atol=1e-6)
    scale = np.array([1, 1, 1, 1, 60.0])
    expected = np.array(seconds.covariance) * np.outer(scale, scale)
    assert np.allclose(other.covariance, expected, rtol=1e-4, atol=1e-9)


def test_sampling_more_often_changes_little():
    slow, fast = (
        planted(Case("prismatic", rows=r, rate=0.12 * r, across=1.0), np.random.default_rng(7), 1.0)
        for r in (150, 1200)
    )
    for truth in (slow, fast):
        found = estimated(truth)
        stds = np.sqrt(np.diag(found.covariance))
        assert abs(found.gain - truth.gain) < 3 * stds[3]
        assert abs(found.delay - truth.delay) < 3 * stds[4]


def test_without_a_reason_there_is_no_channel():
    truth = planted(Case("prismatic"), np.random.default_rng(5))
    n = len(truth.track)
    still = replace(truth.track, position=np.tile(truth.joint.position, (n, 1)))
    assert estimated(truth) is not None
    assert estimated(truth, replace(truth.track, action=None)) is None
    assert estimated(truth, replace(truth.track, action=np.zeros((n, 3)))) is None
    assert estimated(truth, still) is None
    assert estimate_channel(truth.joint, [(3, 8)], truth.track, truth.white_std) is None
    assert estimate_channel(rigid((0, 0, 0)), [(0, n - 1)], truth.track, truth.white_std) is None


@pytest.mark.slow
def test_unrelated_actions_seldom_make_a_channel():
    found = 0
    for trial in range(20):
        rng = np.random.default_rng([8, trial])
        truth = planted(Case("prismatic"), rng)
        action = 0.003 * rng.standard_normal((len(truth.track), 3))
        found += estimated(truth, replace(truth.track, action=action)) is not None
    assert found <= 2


def test_rows_that_do_not_count_do_no_harm():
    truth = planted(Case("prismatic", across=1.0), np.random.default_rng(6))
    wrong = np.random.default_rng(0).random(len(truth.track)) < 0.1
    position = truth.track.position + wrong[:, None] * 0.4
    spoiled = replace(truth.track, position=position)
    pieces = [(0, len(truth.track) - 1)]
    kept = estimate_channel(truth.joint, pieces, spoiled, truth.white_std, ~wrong)
    assert kept.gain == pytest.approx(estimated(truth).gain, rel=0.1)
    assert kept.delay == pytest.approx(estimated(truth).delay, abs=0.05)


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_without_a_row_that_counts_there_is_no_channel(kind):
    truth = planted(Case(kind), np.random.default_rng(6))
    none = np.zeros(len(truth.track), dtype=bool)
    assert estimate_channel(truth.joint, [(0, 20)], truth.track, truth.white_std, none) is None


def test_predictors_are_the_inverse_jacobian_of_turned_actions():
    steps, command = steps_and_command(Case("revolute"))
    rotation, gain, delay = Rotation.from_rotvec([0.3, -0.8, 0.5]), 0.7, 0.013
    given = command.at(steps.end - delay) - command.at(steps.start - delay)
    predicted = steps.predictors(command, np.array([delay]))[0].T @ (gain * rotation.as_matrix().ravel())
    assert np.allclose(predicted, gain * np.sum(steps.leverage * rotation.apply(given), axis=1))
    joint = planted(Case("revolute"), np.random.default_rng(0)).joint
    at_zero = inverse_jacobian(joint, np.zeros(3), np.eye(3))
    assert np.allclose(steps.leverage[0], at_zero, atol=0.1 * np.abs(at_zero).max())


def test_the_covariance_of_steps_is_that_of_the_model():
    steps, _ = steps_and_command(Case("prismatic"))
    walk, white, m = 0.02, 3e-6, len(steps)
    noise = step_noise_of(steps, steps.size, np.zeros(m), walk, white)
    dense = np.diag(walk * (steps.end - steps.start) + 2 * white)
    for i in np.flatnonzero(steps.linked):
        dense[i, i + 1] = dense[i + 1, i] = -white
    assert not steps.linked[69]
    assert steps.linked.sum() == m - 2
    assert np.allclose(noise.solve(steps.size[None])[0], np.linalg.solve(dense, steps.size), rtol=1e-5)
    density = -0.5 * (steps.size @ np.linalg.solve(dense, steps.size) + np.linalg.slogdet(2 * np.pi * dense)[1])
    prior = -0.5 * (np.log(white / steps.white) / 0.4) ** 2
    assert noise.log_density == pytest.approx(density + prior, rel=1e-6)


def test_noise_is_found_again():
    steps, _ = steps_and_command(Case("prismatic", rows=2000, rate=240.0))
    rng = np.random.default_rng(3)
    span = steps.end - steps.start
    error = np.concatenate([1e-3 * rng.standard_normal(len(steps)), [0.0]])
    left = np.sqrt(0.004 * span) * rng.standard_normal(len(steps)) + np.diff(error)
    found = fit_noise(replace(steps, white=1e-6), left, np.zeros(len(steps)))
    assert found.walk == pytest.approx(0.004, rel=0.3)
    assert found.white == pytest.approx(1e-6, rel=0.15)


def test_rotations_compose_as_scipy_says():
    rng = np.random.default_rng(0)
    vector, rotation = rng.standard_normal((5, 3)), Rotation.random(5, rng=rng)
    turned = times(rotation_quaternion(vector), rotation.as_quat())
    assert np.allclose(rotation_matrix(turned), (Rotation.from_rotvec(vector) * rotation).as_matrix())


def test_a_sharp_posterior_is_normal_with_its_information():
    rng = np.random.default_rng(1)
    design = rng.standard_normal((60, 9))
    rotation, gain = Rotation.from_rotvec([0.4, 0.2, -0.7]), 0.8
    measured = design @ (gain * rotation.as_matrix().ravel())
    quadratic = Quadratic(1e4 * (design.T @ design)[None], 1e4 * (design.T @ measured)[None])
    channels, information = climb(quadratic, np.array([[0.0, 0, 0, 1]]), np.zeros(1), 30)
    assert np.allclose(rotation_matrix(channels.rotation)[0], rotation.as_matrix(), atol=1e-3)
    assert np.exp(channels.log_gain[0]) == pytest.approx(gain, abs=1e-3)
    covariance = np.linalg.inv(information[0])
    center, log_gain = channels.rotation[0], float(channels.log_gain[0])
    posterior = integrate(quadratic, np.zeros(1), center, log_gain, covariance[:3, :3], 1, 0)
    assert posterior.effective > 50
    assert np.allclose(posterior.square, covariance, atol=0.15 * np.diag(covariance).max())


def test_delayed_actions_move_the_command_in_time():
    truth = planted(Case("prismatic", uneven=True), np.random.default_rng(2))
    later = with_delayed_actions(truth.track, 0.3)
    before, after = command_of(truth.track), command_of(later)
    share = 0.3 / truth.track.duration
    inside = before.time[before.time > share]
    assert np.allclose(after.path[before.time > share], before.at(inside - share), atol=1e-12)
    assert with_delayed_actions(truth.track, 0.0) is truth.track
    found = estimated(truth)
    remaining = estimated(truth, with_delayed_actions(truth.track, found.delay))
    assert abs(remaining.delay) < 0.05
    assert remaining.gain == pytest.approx(found.gain, rel=0.1)


def served(kind, lag, rng, late=0, rows=200, count=5e-4):
    """A servo of first order on a goal at drawn speeds, read by an encoder; actions are the steps of the goal.

    The log holds them some rows late.
    """
    joint = prismatic((0, 1, 0), (0, 0, 0)) if kind == "prismatic" else revolute((0, 0, 1), (-0.3, 0.0, 0.0), (0, 0, 0))
    goal = np.interp(np.arange(rows), np.linspace(0, rows, 8), np.concatenate([[0.0], rng.uniform(0.0, 1.0, 7)]))
    c = np.zeros(rows)
    for k in range(1, rows):
        c[k] = c[k - 1] + (goal[k - 1] - c[k - 1]) * (1.0 - np.exp(-1.0 / lag))
    poses, meant = forward(joint, count * np.round(c / count)), forward(joint, goal)
    action = np.diff(meant.translation, axis=0, append=meant.translation[-1:])
    action = np.concatenate([np.zeros((late, 3)), action[: rows - late]])
    action = poses.rotation.inv().apply(action)
    return joint, PartTrack(np.arange(rows), 0.1 * np.arange(rows), poses.translation, poses.rotation.as_quat(), action)


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
@pytest.mark.parametrize(("lag", "late"), [(3.0, 0), (6.0, 0), (3.0, 6)])
def test_the_lag_of_a_servo_is_a_delay_and_no_other_frame(kind, lag, late):
    missed = []
    for seed in range(5):
        joint, track = served(kind, lag, np.random.default_rng(seed), late)
        found = estimate_channel(joint, [(0, len(track) - 1)], track, 2e-4)
        # On average a step is made so many rows later: the mean of a geometric distribution.
        truth = TrueChannel(joint, Rotation.identity(), 1.0, 0.1 / (1.0 - np.exp(-1.0 / lag)) - 0.1 * late)
        errors = misses(truth, found)
        missed.append([errors["angle error"], errors["gain error"], errors["delay error"]])
    frame, gain, delay = np.median(missed, axis=0)
    assert frame < 0.2
    assert gain < 0.05
    assert delay < 0.02


def covered(trials):
    """Shares of intervals that hold the truth over all cases, and how many channels were found."""
    counts = {"all": [], "gain": [], "delay": []}
    for number, case in enumerate(CASES):
        for trial in range(trials):
            rng = np.random.default_rng([11, number, trial])
            truth = planted(case, rng, believed_angle(rng))
            found = estimated(truth)
            if found is not None:
                result = misses(truth, found)
                for name, values in counts.items():
                    values.append(result[name])
    return {name: float(np.mean(values)) for name, values in counts.items()}, len(counts["gain"])


@pytest.mark.slow
def test_intervals_hold_the_truth():
    shares, found = covered(6)
    assert found >= 66
    assert min(shares.values()) > 0.82


@pytest.mark.evidence
def test_intervals_hold_the_truth_often_enough():
    shares, found = covered(40)
    assert found >= 450
    for name in ("gain", "delay"):
        assert 0.90 <= shares[name] <= 0.985, name
    assert 0.87 <= shares["all"] <= 0.98
