"""A servo is sent to places: what its actions mean, whether a recording says it or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import micah_plan
from micah_plan.automaton.certainty import ActionChannel
from micah_plan.learning.learn import learn_graph
from micah_plan.recording.commands import with_commands, with_targets
from micah_plan.recording.value import Recording
from micah_plan.residual.prediction import rmse

RADIUS, RATE, ROWS, LAG = 0.1, 10.0, 240, 1.8
COUNT = 2.0 * np.pi / 4096  # rad, of an encoder


def lever(angles):
    """(n, 3) places of the end of a lever about the z axis."""
    return RADIUS * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)


def servo(goals, *, late: int = 1) -> Recording:
    """Sent to places (n,) [rad], so many rows late: each row it goes a share of the way, as an encoder reads it."""
    c, goal = np.empty(len(goals)), np.concatenate([np.full(late, goals[0]), goals])
    c[0] = goals[0]
    for k in range(1, len(c)):
        c[k] = c[k - 1] + (goal[k - 1] - c[k - 1]) * (1.0 - np.exp(-1.0 / LAG))
    read = COUNT * np.round(c / COUNT)
    quaternion = Rotation.from_rotvec(np.outer(read, [0.0, 0.0, 1.0])).as_quat()
    return with_targets(Recording(np.arange(len(c)) / RATE, lever(read), quaternion), lever(goals))


def jumps(seed: int):
    rng = np.random.default_rng(seed)
    held = rng.integers(10, 30, ROWS // 10)
    return np.repeat(rng.uniform(-0.4, 0.5, len(held)), held)[:ROWS]


def unsaid(recording: Recording) -> Recording:
    return replace(recording, extra={})


def channel_of(recording: Recording) -> ActionChannel | None:
    (edge,) = learn_graph(recording).edges
    assert edge.certainty is not None
    return edge.certainty.channel


def test_a_long_way_round_is_one_way() -> None:
    """Places alone do not tell in which turn they are."""
    rng = np.random.default_rng(1)
    goals = np.repeat(np.cumsum(rng.choice([-1.0, 1.0], 12) * rng.uniform(2.5, 4.5, 12)), 20)
    found = channel_of(servo(goals))
    assert found is not None
    assert found.gain == pytest.approx(1.0, abs=0.05)
    assert found.explained > 0.97


@pytest.mark.parametrize("is_said", [True, False])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_a_servo_gets_where_it_is_sent_as_late_as_it_is(seed: int, is_said: bool) -> None:
    recording = servo(jumps(seed))
    found = channel_of(recording if is_said else unsaid(recording))
    assert found is not None
    gain_std, delay_std = (np.sqrt(found.covariance[k][k]) for k in (3, 4))
    assert abs(found.gain - 1.0) < 2.5 * gain_std < 0.15
    # From when a place is told to the middle of the motion that it makes.
    late = (1.0 + 1.0 / (1.0 - np.exp(-1.0 / LAG)) - 0.5) / RATE
    assert abs(found.delay - late) < 2.5 * delay_std < 0.05
    assert np.linalg.norm(found.frame_rotation) < 0.05
    assert found.explained > 0.97


def test_ways_along_the_tangent_are_as_long_as_their_arcs() -> None:
    """A log may have the way to a place as an arc, laid along the tangent."""
    goals = jumps(3)
    recording = servo(goals)
    angle = np.arctan2(recording.position[:, 1], recording.position[:, 0])
    tangent = np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
    found = channel_of(unsaid(replace(recording, action=RADIUS * (goals - angle)[:, None] * tangent)))
    assert found is not None
    assert found.gain == pytest.approx(1.0, abs=0.06)
    assert np.linalg.norm(found.frame_rotation) < 0.05


def test_rows_without_a_place_keep_the_one_before() -> None:
    recording = servo(jumps(5))
    action = np.array(recording.action)
    action[::7] = np.nan
    every, some = channel_of(recording), channel_of(replace(recording, action=action))
    assert every is not None
    assert some is not None
    assert some.gain == pytest.approx(every.gain, abs=0.02)
    assert some.delay == pytest.approx(every.delay, abs=0.3 / RATE)


def test_a_place_that_never_changes_explains_no_motion() -> None:
    """The part gets there at a speed of its own."""
    c = np.linspace(0.0, 1.2, 150)
    quaternion = Rotation.from_rotvec(np.outer(c, [0.0, 0.0, 1.0])).as_quat()
    recording = Recording(np.arange(150) / RATE, lever(c), quaternion)
    assert channel_of(with_targets(recording, lever(np.full(150, 1.2)))) is None


def test_displacements_are_none_of_places() -> None:
    """Said to be displacements, or told by leading further with each row."""
    rng = np.random.default_rng(4)
    c = np.interp(np.arange(ROWS), np.linspace(0, ROWS, 9), rng.uniform(0.0, 1.0, 9))
    quaternion = Rotation.from_rotvec(np.outer(c, [0.0, 0.0, 1.0])).as_quat()
    action = np.full((ROWS, 3), np.nan)
    action[:-1] = np.diff(lever(c), axis=0) / 1.3
    noise = 1e-4 * rng.standard_normal((ROWS, 3))
    recording = Recording(np.arange(ROWS) / RATE, lever(c) + noise, quaternion, action)
    told, said = channel_of(recording), channel_of(with_commands(recording, "displacement"))
    assert told is not None
    assert said is not None
    assert told.gain == said.gain == pytest.approx(1.3, rel=0.1)


@pytest.mark.parametrize("is_said", [True, False])
def test_another_run_is_predicted_as_late_as_this_one_was(is_said: bool) -> None:
    recordings = [servo(jumps(seed)) for seed in (5, 9)]
    first, second = recordings if is_said else map(unsaid, recordings)
    model = micah_plan.learn(first).automaton
    sizes = []
    for as_learned in (False, True):
        runs = micah_plan.predict(model, second, actions_as_learned=as_learned).runs
        sizes.append(rmse([run.rollout.configuration for run in runs]))
    assert sizes[1] < 0.6 * sizes[0]
    assert sizes[1] == pytest.approx(0.05, abs=0.01)


def coarse(goals, bits: int, noise: float, seed: int, end: float = np.inf) -> Recording:
    """A servo that rests two counts short of its places, or at an end, read by an encoder with noise [counts]."""
    rng, count = np.random.default_rng(seed), 2.0 * np.pi / 2**bits
    c = np.empty(len(goals))
    c[0] = goals[0]
    for k in range(1, len(c)):
        way = goals[k - 1] - c[k - 1]
        short = np.sign(way) * min(abs(way), 2.0 * count)
        c[k] = min(c[k - 1] + (way - short) * (1.0 - np.exp(-1.0 / LAG)), end)
    read = count * np.round(c / count + noise * rng.standard_normal(len(c)))
    quaternion = Rotation.from_rotvec(np.outer(read, [0.0, 0.0, 1.0])).as_quat()
    return with_targets(Recording(np.arange(len(c)) / RATE, lever(read), quaternion), lever(goals))


@pytest.mark.parametrize(("bits", "noise"), [(12, 0.0), (10, 0.0), (10, 0.5), (10, 1.0)])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_a_servo_that_has_arrived_is_at_no_stop(bits: int, noise: float, seed: int) -> None:
    (edge,) = learn_graph(coarse(jumps(seed), bits, noise, seed)).edges
    assert [segment.joint.kind for segment in edge.segments] == ["revolute"]


@pytest.mark.parametrize(("bits", "noise"), [(12, 0.0), (10, 0.5)])
def test_a_servo_that_is_sent_beyond_an_end_is(bits: int, noise: float) -> None:
    goals = np.repeat([0.0, 0.2, -0.3, 0.9, 0.1], [20, 25, 25, 60, 30])
    (edge,) = learn_graph(coarse(goals, bits, noise, 0, end=0.4)).edges
    # Whether it is held where it rests in the end, nothing tells.
    assert [segment.joint.kind for segment in edge.segments[:3]] == ["revolute", "rigid", "revolute"]
    held = edge.segments[1]
    assert 70 <= held.start <= 76
    assert held.end == pytest.approx(130, abs=2)
