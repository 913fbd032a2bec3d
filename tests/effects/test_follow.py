"""Commands that are places: against a servo written here, in steps, states, compiled functions, and roll-outs."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.input_memory import InputChannel, memory_at_rest, towards, with_memory_states
from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.transition import step
from micah_plan.recording.value import Recording
from micah_plan.residual.prediction import predict_recording
from micah_plan.symbolic.compiled import compiled_mode

NAMES = ("share", "offset", "gain", "delay", "momentum", "width")
LIMITS = ("pull", "acceleration", "speed", "friction")
SWING = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.1))
SLIDE = prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def part(joint):
    segment = Segment(joint, 0, 0, 9, -3.0, 3.0, (-3.0, 3.0), 0.001, 0.003, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "part", (segment,)),)))


def following(joint, *values):
    """With six values, or up to ten: with limits and friction."""
    names = (NAMES + LIMITS)[: len(values)]
    return with_effect(part(joint), Effect("follow", "part", tuple(zip(names, values, strict=True))))


def servo(start, places, share, offset, gain, delay, momentum, width, *limits):
    """Where a part goes after places: (K + 1,). Those before the first keep it where it starts.

    The pull of a step is the mean over its instants, in each of which the place is that of `delay` steps before.
    """
    most_pull, acceleration, most, friction = (*limits, 0.0)[:4] if limits else (*(np.inf,) * 3, 0.0)
    c, speed, seen = start, 0.0, [(start - offset) / gain] * 40
    gone = [c]
    for place in places:
        seen.insert(0, place)
        pulls = []
        for instant in (np.arange(1000) + 0.5) / 1000.0:
            away = gain * seen[int(np.ceil(delay - instant))] + offset - c
            beyond = 0.0 if abs(away) <= width else away - width if away > 0 else away + width
            braked = share * beyond
            if np.isfinite(acceleration):  # s + (s - a) + (s - 2 a) + ... are s (s + a) / (2 a)
                most_braked = max(np.roots([1.0, acceleration, -2.0 * acceleration * abs(beyond)]).real)
                braked = np.clip(braked, -most_braked, most_braked)
            pulls.append(np.clip(braked, -most_pull, most_pull))
        wanted = momentum * speed + float(np.mean(pulls))
        # Friction takes as much from a motion, but turns none around.
        wanted = wanted - friction if wanted > friction else wanted + friction if wanted < -friction else 0.0
        wanted = speed + float(np.clip(wanted - speed, -acceleration, acceleration))
        speed = float(np.clip(wanted, -most, most))
        c += speed
        gone.append(c)
    return np.array(gone)


VALUES = st.tuples(
    st.floats(0.05, 1.2),
    st.floats(-0.05, 0.05),
    st.floats(0.8, 1.1),
    st.sampled_from([0.0, 0.4, 1.0, 2.7, 23.0, 29.8]),
    st.floats(0.0, 0.6),
    st.sampled_from([0.0, 0.03]),
)
BOUNDED = st.tuples(*(st.sampled_from([np.inf, 0.3, 0.05]) for _ in LIMITS[:3]), st.sampled_from([0.0, 0.02]))
PLACES = st.lists(st.floats(-0.8, 0.8), min_size=1, max_size=20)


@settings(max_examples=60)
@given(values=VALUES, limits=BOUNDED | st.just(()), places=PLACES, start=st.floats(-0.5, 0.5))
def test_steps_with_the_memory_outside_or_in_the_state_are_those_of_a_servo(values, limits, places, start) -> None:
    values += limits
    automaton = following(SWING, *values)
    whole, channel = with_memory_states(automaton), InputChannel(automaton)
    beside, inside = np.array([start]), np.array([start, *memory_at_rest(whole, [start] + [0.0] * (whole.n - 1))])
    for place, expected in zip(places, servo(start, places, *values)[1:], strict=True):
        beside = step(automaton, "revolute", beside, channel.pass_on([place - beside[0]], "revolute", beside)).x
        inside = step(whole, "revolute", inside, [place - inside[0]]).x
        np.testing.assert_allclose([beside[0], inside[0]], expected, atol=1e-9)


@pytest.mark.parametrize("delay", [3.0, 4.6, 30.0])
def test_a_part_that_rests_next_to_its_goal_stays_until_a_command_arrives(delay) -> None:
    """It hangs 0.1 below its goal, which was given before: only what is commanded now moves it."""
    automaton = following(SWING, 0.4, -0.1, 0.9, delay, 0.3, 0.0)
    channel, x = InputChannel(automaton), np.array([0.2])
    whole = int(delay)
    for _ in range(whole + 1):
        assert x == pytest.approx(0.2)
        x = step(automaton, "revolute", x, channel.pass_on([0.9 - x[0]], "revolute", x)).x
    assert x > 0.2 + 0.05 * (whole + 1 - delay)


@settings(max_examples=30)
@given(values=VALUES, limits=BOUNDED, seed=st.integers(0, 99))
def test_the_compiled_step_is_that_of_the_automaton(values, limits, seed) -> None:
    whole, rng = with_memory_states(following(SWING, *values, *limits)), np.random.default_rng(seed)
    x, u = 0.3 * rng.standard_normal(whole.n), 0.2 * rng.standard_normal(1)
    compiled = compiled_mode(whole, "revolute").step(ca.DM(x), ca.DM(u))
    np.testing.assert_allclose(np.array(compiled).ravel(), step(whole, "revolute", x, u).x, atol=1e-12)


def recording_of(joint, z, places):
    """Actions are the places relative to measured poses."""
    where = SHAPES[joint.kind]
    position = where(np.asarray(z))
    action = np.vstack([where(np.asarray(places)) - position[:-1], np.full((1, 3), np.nan)])
    return Recording(time=0.1 * np.arange(len(z)), position=position, action=action)


SHAPES = {
    "revolute": lambda c: np.stack([0.3 * np.cos(c), 0.3 * np.sin(c), 0.1 + 0 * c], axis=1),
    "prismatic": lambda c: np.stack([c, 0 * c, 0 * c], axis=1),
}


@pytest.mark.sweep
@pytest.mark.parametrize("joint", [SWING, SLIDE], ids=["hinge", "slide"])
def test_a_roll_out_follows_the_places_of_the_log_for_any_measurements(joint) -> None:
    """However bad the measurements in between: places are known, so only the first row's error counts, and fades."""
    rng, values = np.random.default_rng(0), (0.3, 0.01, 0.97, 1.4, 0.4, 0.005)
    places = np.repeat(rng.uniform(-0.9, 0.9, 20), 15)
    true = servo(0.1, places, *values)
    z = true + np.where(np.arange(len(true)) > 0, 0.05, 0.0) * rng.standard_normal(len(true))
    (run,) = predict_recording(following(joint, *values), recording_of(joint, z, places))
    rolled = run.x[1:] + run.rollout.configuration
    np.testing.assert_allclose(rolled[:, 0], true[1:], atol=1e-6)
    assert np.sqrt(np.mean(run.rollout.configuration**2)) < 0.06


def test_displacements_are_the_same_from_anywhere_and_places_are_not() -> None:
    x, at, u = np.array([[0.2], [0.5]]), np.array([[0.3], [0.3]]), np.array([[0.1], [0.1]])
    np.testing.assert_array_equal(towards(part(SWING), at, x, u), u)
    np.testing.assert_allclose(x + towards(following(SWING, 1, 0, 1, 0, 0, 0), at, x, u), 0.4)
