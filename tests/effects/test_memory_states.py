"""Effects with a memory as states: against devices that share nothing with them, through events, in every function."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from effect_devices import DeviceChannel
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.form import EffectForm, Parameter
from micah_plan.automaton.effects.registry import form, register, unregister
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import Reset
from micah_plan.automaton.input_memory import (
    InputChannel,
    effects_left_out,
    memory_at_rest,
    with_memory_states,
    without_memory_states,
)
from micah_plan.automaton.joint import revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.transition import simulate, step
from micah_plan.belief import filter as batch_filter
from micah_plan.belief.filter import initial_belief, predict_belief, update
from micah_plan.symbolic.compiled import compiled_edge, compiled_mode

SHUT = 1.0
SWING = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.1))
EFFECTS = {
    "delay": ("delay", (2.0,)),
    "fractional delay": ("delay", (1.3,)),
    "short delay": ("delay", (0.4,)),
    "lag": ("lag", (1.7,)),
    "ramp": ("ramp", (0.025,)),
    "backlash": ("backlash", (0.06, 1.0)),
    "stick-slip": ("stick_slip", (0.0735,)),
    "open backlash": ("backlash", (0.06, -0.5)),
    "drive": ("drive", (0.9, 1.6, 1.3, 0.01, 0.02, 0.8, 2.0, 0.05)),
    "valve": ("drive", (1.1, 0.7, 0.0, 0.0, 0.03, 1.0, -4.0, np.inf)),
}


def _segment(joint, start, end, rows):
    return Segment(joint, 0, *rows, start, end, (start, end), 0.001, 0.003, 0.0, 1.0)


@pytest.fixture(scope="module")
def door():
    """A door with a latch at 1 rad: shut by moving there, left by pulling."""
    shut = forward(SWING, SHUT)[0]
    held = rigid(shut.translation, shut.rotation.as_quat(), SHUT)
    segments = _segment(SWING, 0.0, SHUT, (0, 9)), _segment(held, SHUT, SHUT, (10, 19))
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", segments),)))


def with_input_memory(automaton, *names):
    for key in names:
        name, values = EFFECTS[key]
        parameters = tuple(zip([p.name for p in form(name).parameters], values, strict=True))
        automaton = with_effect(automaton, Effect(name, "door", parameters))
    return automaton


def twin(automaton, mode, x, inputs):
    """Modes and states, by sending every input through the devices."""
    channel, modes, states = DeviceChannel(automaton), [mode], [np.array(x)]
    for u in inputs:
        after = step(automaton, modes[-1], states[-1], channel.pass_on(u, modes[-1]))
        modes.append(after.mode)
        states.append(after.x)
    return tuple(modes), np.array(states)


INPUTS = st.lists(st.integers(-200, 200), min_size=1, max_size=25).map(lambda u: 1e-3 * np.array(u)[:, None])


@settings(max_examples=60)
@given(inputs=INPUTS, names=st.lists(st.sampled_from(sorted(EFFECTS)), min_size=1, max_size=2), mode=st.booleans())
def test_a_step_of_the_larger_state_is_what_the_devices_do(door, inputs, names, mode) -> None:
    automaton = with_input_memory(door, *names)
    whole, start = with_memory_states(automaton), ("rigid", SHUT) if mode else ("revolute", 0.8)
    modes, states = twin(automaton, start[0], [start[1]], inputs)
    run = simulate(whole, start[0], [start[1], *memory_at_rest(whole)], inputs)
    assert run.modes == modes
    np.testing.assert_allclose(run.states[:, 0], states[:, 0], atol=1e-12)


def test_an_effect_of_one_mode_remembers_what_was_sent_in_the_other(door) -> None:
    delay = replace(with_input_memory(door, "delay").effects[0], modes=("revolute",))
    automaton = with_effect(door, delay)
    inputs = np.array([0.1, 0.2, -0.05, -0.1, 0.0, -0.1, 0.03])[:, None]
    modes, states = twin(automaton, "revolute", [0.8], inputs)
    run = simulate(with_memory_states(automaton), "revolute", [0.8, 0.0, 0.0], inputs)
    assert set(modes) == {"revolute", "rigid"}
    assert run.modes == modes
    np.testing.assert_allclose(run.states[:, 0], states[:, 0], atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize("name", EFFECTS)
def test_compiled_functions_have_the_memory(door, name) -> None:
    whole, rng = with_memory_states(with_input_memory(door, name)), np.random.default_rng(0)
    mode, compiled = whole.mode("revolute"), compiled_mode(whole, "revolute")
    opened = next(i for i, edge in enumerate(whole.edges) if edge.source == "rigid")
    x, u, factor = ca.SX.sym("x", whole.n), ca.SX.sym("u", 1), np.zeros((whole.n, whole.n))
    moved = compiled.step(x, u)
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(moved, x), ca.jacobian(moved, u)])
    factor[0, 0] = 0.02
    for _ in range(20):
        memory = rng.uniform(-0.03, 0.03, whole.n - 1)
        place, command = np.array([0.3, *memory]), rng.uniform(-0.1, 0.1, 1)
        after = step(whole, mode.name, place, command).x
        np.testing.assert_allclose(np.array(compiled.step(place, command)).ravel(), after, atol=1e-13)
        by_differences = [
            (step(whole, mode.name, place + d, command).x - step(whole, mode.name, place - d, command).x) / 2e-7
            for d in 1e-7 * np.eye(whole.n)
        ]
        np.testing.assert_allclose(np.array(slopes(place, command)[0]), np.array(by_differences).T, atol=1e-6)
        leaves = float(compiled_edge(whole, opened).guard(np.array([SHUT, *memory]), command)[0]) > 0
        assert leaves == (step(whole, "rigid", [SHUT, *memory], command).mode == "revolute")
        _, spread = compiled.belief_step(place, factor, command)
        covariance = np.array(spread) @ np.array(spread).T
        assert np.all(np.linalg.eigvalsh(covariance) > -1e-15)
        assert 0 < covariance[0, 0] < 0.02**2 + whole.noise.process_std[0] ** 2
        np.testing.assert_allclose(covariance[1:], 0.0, atol=1e-16)


@pytest.mark.parametrize("name", EFFECTS)
def test_the_filter_knows_the_memory_exactly(door, name) -> None:
    whole, rng = with_memory_states(with_input_memory(door, name)), np.random.default_rng(1)
    inputs = np.concatenate([np.full(5, 0.09), rng.uniform(-0.1, 0.1, 12)])[:, None]
    run = simulate(whole, "revolute", [0.7, *memory_at_rest(whole)], inputs)
    belief = initial_belief(whole, [0.7, *memory_at_rest(whole)], [0.01] + [0.0] * (whole.n - 1), "revolute")
    many = batch_filter.repeated_belief(whole, belief, 3)
    for u, x in zip(inputs, run.states[1:], strict=True):
        z = np.array([x[0] + 0.003 * rng.standard_normal(), *[np.nan] * (whole.n - 1)])
        belief = update(whole, predict_belief(whole, belief, u), z)
        many = batch_filter.update(
            whole, batch_filter.predict_belief(whole, many, np.tile(u, (3, 1))), np.tile(z, (3, 1))
        )
        np.testing.assert_allclose(belief.means[:, 1:], np.tile(x[1:], (2, 1)), atol=1e-12)
        np.testing.assert_allclose(belief.covariance[1:], 0.0, atol=1e-15)
        assert np.all(np.linalg.eigvalsh(belief.covariance) > -1e-15)
        number = belief.most_likely
        np.testing.assert_allclose(many.weights, np.tile(belief.weights, (3, 1)), atol=1e-9)
        np.testing.assert_allclose(many.means[:, number], np.tile(belief.means[number], (3, 1)), atol=1e-9)
    assert abs(belief.means[belief.most_likely, 0] - run.states[-1, 0]) < 0.02


@settings(max_examples=50)
@given(name=st.sampled_from(sorted(EFFECTS)), inputs=INPUTS)
def test_devices_forms_and_channels_pass_on_the_same(door, name, inputs) -> None:
    own, values, automaton = form(EFFECTS[name][0]), EFFECTS[name][1], with_input_memory(door, name)
    devices, channel, memory = DeviceChannel(automaton), InputChannel(automaton), own.at_rest(values)
    for u in inputs:
        out, memory = own.remember(np, u[0], memory, values)
        assert out == pytest.approx(devices.pass_on(u)[0], abs=1e-12)
        assert channel.pass_on(u)[0] == pytest.approx(out, abs=1e-15)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_channel_goes_on_from_what_is_remembered(door, name) -> None:
    automaton, inputs = with_input_memory(door, name), np.random.default_rng(4).normal(scale=0.05, size=(12, 1))
    whole = with_memory_states(automaton)
    (known,) = whole.input_memories
    first, memory = InputChannel(automaton), memory_at_rest(whole)
    for u in inputs[:6]:
        first.pass_on(u)
        _, memory = form(known.effect.name).remember(np, u[0], memory, known.effect.values)
    second = InputChannel(automaton, {known.effect: memory})
    for u in inputs[6:]:
        np.testing.assert_allclose(second.pass_on(u), first.pass_on(u), atol=1e-14)


def test_a_channel_of_many_runs_is_many_channels(door) -> None:
    automaton = with_effect(door, replace(with_input_memory(door, "lag").effects[0], modes=("revolute",)))
    inputs, modes = np.random.default_rng(2).normal(size=(6, 4, 1)), np.random.default_rng(3).integers(0, 2, (6, 4))
    names, together = [mode.name for mode in automaton.modes], InputChannel(automaton)
    alone = [InputChannel(automaton) for _ in range(4)]
    for u, at in zip(inputs, modes, strict=True):
        passed = together.pass_on(u, at)
        each = [channel.pass_on(own, names[q]) for channel, own, q in zip(alone, u, at, strict=True)]
        np.testing.assert_allclose(passed, each, atol=1e-14)


def test_a_users_effect_with_a_memory_becomes_states(door) -> None:
    class Mean(EffectForm):
        name = "mean"
        sentence = "The mean of the last two commands arrives."
        source = "a filter"
        parameters = (Parameter("share", "1", 0.0),)

        def at_rest(self, p):
            return (0.0,)

        def remember(self, ops, v, memory, p):
            return (1.0 - p[0]) * v + p[0] * memory[0], (v,)

    register(Mean())
    try:
        automaton = with_effect(door, Effect("mean", "door", (("share", 0.5),)))
        inputs = np.array([[0.1], [0.0], [0.06]])
        run = simulate(with_memory_states(automaton), "revolute", [0.1, 0.0], inputs)
        np.testing.assert_allclose(run.states[:, 0], [0.1, 0.15, 0.2, 0.23], atol=1e-14)
        np.testing.assert_allclose(twin(automaton, "revolute", [0.1], inputs)[1][:, 0], run.states[:, 0], atol=1e-14)
    finally:
        unregister("mean")


def test_states_are_made_once_and_can_be_taken_out(door) -> None:
    automaton = with_input_memory(door, "delay", "lag")
    whole = with_memory_states(automaton)
    assert whole is with_memory_states(automaton)
    assert with_memory_states(whole) is whole
    assert [c.name for c in whole.coordinates] == ["door", "door delay 1", "door delay 2", "door lag 1"]
    assert without_memory_states(whole) == automaton
    assert with_memory_states(door) is door


def test_only_what_cannot_be_a_state_is_left_out(door) -> None:
    assert effects_left_out(with_input_memory(door, "delay", "backlash")) == ()
    assert len(effects_left_out(with_input_memory(door, "delay", "backlash"), memory=True)) == 2
    (edge, *rest), push = door.edges, Reset(B=((1.0,),))
    pushed = replace(door, edges=(replace(edge, reset=push), *rest))
    (told,) = effects_left_out(with_input_memory(pushed, "delay"))
    assert told == "planner, filter and nominal plant leave out the delay of door: it depends on earlier inputs"
    assert with_memory_states(with_input_memory(pushed, "delay")).input_memories == ()
