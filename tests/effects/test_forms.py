"""Every form of effect: conformance, its NumPy and CasADi readings, files, and the automaton that has it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.form import EffectForm, Parameter
from micah_plan.automaton.effects.registry import form, forms, register, unregister
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.input_memory import InputChannel
from micah_plan.automaton.joint import prismatic, revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.transition import TransitionBatch, simulate, step
from micah_plan.belief.filter import initial_belief, predict_belief
from micah_plan.documents.model import model_text, usable_model
from micah_plan.errors import InputError
from micah_plan.symbolic.casadi_operations import CasadiOperations
from micah_plan.symbolic.compiled import compiled_mode
from micah_plan.symbolic.form_check import check_form

SHUT = 1.0
SWING = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.1))
SAMPLES = {
    "gain": (0.8,),
    "bias": (0.01,),
    "direction_gain": (0.9, 0.6),
    "saturation": (0.05,),
    "dead_zone": (0.02, 1.0),
    "spring": (0.1, 0.2, 0.5),
    "gravity": (0.02, -0.01),
    "latch": (0.03, 0.5, 0.1),
    "unexplained": (0.0, 1.0, 0.1, 0.2, 0.1, 0.01, *np.linspace(-0.02, 0.02, 12), *np.linspace(-0.1, 0.1, 12)),
    "delay": (1.5,),
    "lag": (2.0,),
    "ramp": (0.03,),
    "backlash": (0.03, 1.0),
    "stick_slip": (0.05,),
}


def _segment(joint, start, end, rows):
    return Segment(joint, 0, *rows, start, end, (start, end), 0.001, 0.003, 0.0, 1.0)


@pytest.fixture
def door():
    shut = forward(SWING, SHUT)[0]
    held = rigid(shut.translation, shut.rotation.as_quat(), SHUT)
    segments = _segment(SWING, 0.0, SHUT, (0, 9)), _segment(held, SHUT, SHUT, (10, 19))
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", segments),)))


def effect(name, values=None, **keys):
    values = SAMPLES[name] if values is None else values
    return Effect(name, "door", tuple(zip([p.name for p in form(name).parameters], values, strict=True)), **keys)


@pytest.mark.parametrize("own", forms(), ids=lambda own: own.name)
def test_every_form_conforms(own) -> None:
    check_form(own)


@pytest.mark.parametrize("name", [name for name in SAMPLES if form(name).layer in ("command", "force", "memory")])
@pytest.mark.parametrize(("c", "v"), [(0.3, 0.1), (0.52, -0.06), (0.9, 0.004)])
def test_numpy_and_casadi_read_the_same_formula(name, c, v) -> None:
    own, p = form(name), SAMPLES[name]
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    read = [own.command(CasadiOperations(), u, p), own.force(CasadiOperations(), x, u, p)]
    read.append(own.remember(CasadiOperations(), u, own.at_rest(p), p)[0])
    found = ca.Function("f", [x, u], [ca.SX(e) for e in read])(c, v)
    expected = own.command(np, v, p), own.force(np, c, v, p), own.remember(np, v, own.at_rest(p), p)[0]
    np.testing.assert_allclose([float(f) for f in found], expected, atol=1e-14)


@pytest.mark.parametrize("name", [name for name in SAMPLES if form(name).layer in ("command", "force")])
def test_step_batch_filter_and_compiled_functions_move_alike(door, name) -> None:
    changed = with_effect(door, effect(name))
    c, u = 0.3, 0.08
    expected = c + _displacement(name, c, u)
    assert step(changed, "revolute", [c], [u]).x[0] == pytest.approx(expected, abs=1e-14)
    _, moved = TransitionBatch(changed, np.zeros((1, 0))).step(np.zeros(1, int), *np.array([[[c]], [[u]], [[0.0]]]))
    assert moved[0, 0] == pytest.approx(expected, abs=1e-14)
    compiled = compiled_mode(changed, "revolute")
    assert float(compiled.step(c, u)) == pytest.approx(expected, abs=1e-14)
    belief = predict_belief(changed, initial_belief(changed, [c], [0.01]), [u])
    assert belief.means[0, 0] == pytest.approx(expected, abs=1e-9)
    _, factor = compiled.predict(c, 0.01, u)
    slope = 1 + (_displacement(name, c + 1e-6, u) - _displacement(name, c - 1e-6, u)) / 2e-6
    assert float(factor) ** 2 == pytest.approx((0.01 * slope) ** 2 + 0.001**2, rel=1e-6)
    assert belief.factors[0, 0, 0] == pytest.approx(abs(float(factor)), rel=1e-6)


def _displacement(name, c, u):
    own, p = form(name), SAMPLES[name]
    v = own.command(np, u, p)
    return v + own.force(np, c, v, p)


def test_an_effect_of_one_mode_acts_only_there(door) -> None:
    changed = with_effect(door, effect("gain", modes=("rigid",)))
    assert step(changed, "revolute", [0.3], [0.1]).x[0] == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("name", "p"), [("lag", (3.0,)), ("ramp", (0.01,)), ("drive", (1.0, 3.0, *(0.0,) * 3, 1.0, 0.0, 9.0))]
)
def test_a_part_in_motion_continues_at_the_given_speed(name, p) -> None:
    own = form(name)
    assert own.remember(np, 0.1, own.in_motion(0.4, 0.1, p), p)[0] == pytest.approx(0.1)
    assert own.remember(np, 0.1, own.at_rest_in(0.4, p), p)[0] < 0.05


@pytest.mark.parametrize("name", ["delay", "lag", "ramp", "backlash"])
def test_a_channel_with_memory_ends_where_it_was_sent(door, name) -> None:
    changed = with_effect(door, effect(name))
    channel = InputChannel(changed)
    passed = [channel.pass_on([u])[0] for u in [0.1] * 5 + [0.0] * 40]
    assert sum(passed) == pytest.approx(0.5)
    assert passed[:2] != [0.1, 0.1] or name == "backlash"  # engaged at first: only the reversal loses
    back = sum(channel.pass_on([-0.1])[0] for _ in range(5)) + sum(channel.pass_on([0.0])[0] for _ in range(40))
    assert back == pytest.approx(-0.47 if name == "backlash" else -0.5)


def test_effects_on_ends_and_geometry_change_the_automaton_itself(door) -> None:
    shifted = with_effect(door, effect("guard_shift", (-0.1, 1.0)))
    assert step(shifted, "revolute", [0.8], [0.3]).x[0] == pytest.approx(0.9)
    assert step(shifted, "revolute", [0.8], [0.3]).mode == "rigid"
    np.testing.assert_allclose(shifted.mode("rigid").joints[0].position, forward(SWING, 0.9)[0].translation)
    stopped = with_effect(door, effect("limit", (0.2, -1.0)))
    assert step(stopped, "revolute", [0.3], [-0.3]).x[0] == pytest.approx(0.2)
    sticky = with_effect(door, effect("guard_hysteresis", (0.05,)))
    assert step(sticky, "rigid", [1.0], [-0.04]).x[0] == 1.0
    assert step(sticky, "rigid", [1.0], [-0.06]).x[0] == pytest.approx(0.94)
    pitched = with_effect(door, effect("screw_pitch", (0.02,)))
    assert forward(pitched.mode("revolute").joints[0], 1.0)[0].translation[2] == pytest.approx(0.12)
    assert pitched.mode("rigid").joints[0].position[2] == pytest.approx(0.12)
    moved = with_effect(door, effect("axis_offset", (0.01, 0.0)))
    assert np.linalg.norm(moved.mode("revolute").joints[0].center[:2]) == pytest.approx(0.01)
    for automaton in (shifted, stopped, sticky, pitched, moved):
        check_automaton(automaton)
        assert usable_model(model_text(automaton).encode(), "model") == automaton


def test_a_slide_without_ends_can_get_a_limit() -> None:
    slide = KinematicEdge(BASE, "door", (_segment(prismatic((1.0, 0, 0), (0.0, 0, 0)), 0.0, 0.5, (0, 9)),))
    limited = with_effect(build_automaton(KinematicGraph((slide,))), effect("limit", (0.3, 1.0)))
    run = simulate(limited, limited.modes[0].name, [0.1], [[0.1]] * 4)
    assert run.states[-1, 0] == pytest.approx(0.3)


def test_files_keep_effects_with_spread_modes_and_note(door) -> None:
    automaton = with_effect(door, effect("spring", std=(0.01, 0.02, 0.0), modes=("revolute",), note="since run 3"))
    assert usable_model(model_text(automaton).encode(), "model") == automaton
    bad = model_text(automaton).replace("name: spring", "name: sprung")
    with pytest.raises(InputError, match=r"model, line \d+.*unknown effect 'sprung'.*choose one of gain"):
        usable_model(bad.encode(), "model")
    with pytest.raises(InputError, match="missing value of parameter 'rest'"):
        usable_model(model_text(automaton).replace("      rest: 0.2\n", "").encode(), "model")


def test_effects_that_do_not_fit_are_refused(door) -> None:
    with pytest.raises(InputError, match="must have the parameters gain"):
        with_effect(door, Effect("gain", "door", (("factor", 1.0),)))
    with pytest.raises(InputError, match="unknown coordinate 'lid'"):
        with_effect(door, Effect("gain", "lid", (("gain", 1.0),)))
    with pytest.raises(InputError, match="width must be finite, 0 to inf"):
        with_effect(door, effect("dead_zone", (-0.1, 1.0)))


class Creep(EffectForm):
    """v -> v + creep, a user's own."""

    name = "creep"
    sentence = "It creeps."
    source = "this test"
    parameters = (Parameter("creep", "coordinate", 0.0),)

    def command(self, ops, v, p):
        return v + p[0]


def test_a_form_of_ones_own_is_checked_and_then_known(door) -> None:
    own = Creep()
    check_form(own)
    register(own)
    try:
        moved = step(with_effect(door, effect("creep", (0.05,))), "revolute", [0.3], [0.1])
        assert moved.x[0] == pytest.approx(0.45)
        with pytest.raises(InputError, match="exists already"):
            register(own)
    finally:
        unregister("creep")
    with pytest.raises(InputError, match="unknown effect 'creep'"):
        form("creep")


def test_conformance_refuses_a_form_that_acts_when_neutral() -> None:
    class Wrong(Creep):
        def command(self, ops, v, p):
            return v + p[0] + 0.1

    with pytest.raises(InputError, match="must have no effect at the neutral parameters"):
        check_form(Wrong())


class Stretching(EffectForm):
    """Has a hook, and with others below the hooks of two layers."""

    name, sentence, source = "stretching", "It does something.", "a test"
    parameters = (Parameter("share", "1", 0.0),)

    def command(self, ops, v, p):
        return (1.0 + p[0]) * v


class Reading(Stretching):
    def measured(self, ops, c, time, p):
        return (1.0 + p[0]) * c


class Moving(Stretching):
    def rebuilt(self, automaton, coordinate, p):
        return automaton


class Bent(EffectForm):
    name, sentence, source = "bent", "It reads a curve.", "a test"
    parameters = (Parameter("share", "1", 0.0),)

    def measured(self, ops, c, time, p):
        return c + p[0] * c * c


class Idle(EffectForm):
    name, sentence, source = "idle", "It does nothing.", "a test"
    parameters = (Parameter("share", "1", 0.0),)


class Twisting(EffectForm):
    name, sentence, source = "twisting", "It changes the joint.", "a test"
    parameters = (Parameter("share", "1", 0.0),)

    def rebuilt(self, automaton, coordinate, p):
        return automaton


class OfNumpy(Stretching):
    """NumPy's own function cannot read an expression."""

    def command(self, ops, v, p):
        return v * (1.0 + p[0] * np.tanh(v))


class Deciding(Stretching):
    """An `if` on a value works for numbers alone."""

    def command(self, ops, v, p):
        return v * (1.0 + p[0]) if v > 0 or v < 0 else 0.0 * v


class Counting(Stretching):
    """Decides on a number of its parameter, which calibrations have as a symbol."""

    def command(self, ops, v, p):
        return p[0] * v if p[0] > 0.0 else v


class OfOneSize(Stretching):
    """Gives three values, whatever it is given."""

    def command(self, ops, v, p):
        return np.zeros(3)


class Forgetful(EffectForm):
    """Says of a part at rest that it moves."""

    name, sentence, source = "forgetful", "It forgets.", "a test"
    parameters = (Parameter("share", "1", 0.0),)

    def at_rest(self, p):
        return (0.0,)

    def in_motion(self, c, step, p):
        return (step + 1.0,)

    def remember(self, ops, v, memory, p):
        return v + p[0] * memory[0], (v,)


class Broken(Stretching):
    def command(self, ops, v, p):
        raise RuntimeError("broken")


class Apart(Stretching):
    """Means another thing in plans than in predictions, away from its neutral value only."""

    def command(self, ops, v, p):
        return (1.0 + p[0]) * v if ops is np else (1.0 + 2.0 * p[0]) * v


class Growing(Stretching):
    """Gives no number once it acts."""

    def command(self, ops, v, p):
        return v * ops.exp(5000.0 * p[0])


@pytest.mark.parametrize(
    ("own", "words"),
    [
        (Reading, "hooks of the layers command and sensor"),
        (Moving, "hooks of the layers command and geometry"),
        (Twisting, "calibrate tries no forms of the layer geometry but its own"),
        (OfNumpy, "CasADi, which plans with it, cannot read"),
        (Counting, "cannot read its formula"),
        (Deciding, "its formula fails: The truth value"),
        (OfOneSize, "one finite value per state and command"),
        (Broken, "its formula fails: broken"),
        (Forgetful, "in_motion must equal at_rest"),
        (Apart, "must mean the same to CasADi"),
        (Growing, "one finite value per state and command"),
        (Bent, "this one is curved"),
        (Idle, "overrides no hook"),
    ],
)
def test_conformance_refuses_a_form_without_effect_or_with_another_one(own, words) -> None:
    with pytest.raises(InputError, match=words):
        check_form(own())


def test_the_layer_of_a_form_is_that_of_its_hook() -> None:
    """Whatever its class says: a layer whose hooks it has not would be called, and would do nothing."""
    told = type("Told", (Stretching,), {"layer": "sensor"})
    assert told().layer == "command"
    check_form(told())
    check_form(type("ByHand", (Twisting,), {"in_library": False})())


def test_forms_have_all_that_calibration_needs_of_them() -> None:
    """Places in the order of plainness differ, and experiments tell a form from others that there are."""
    named = [own for own in forms() if own.in_library]
    assert sorted(own.complexity_rank for own in named) == list(range(len(named)))
    for own in forms():
        assert {name for name, _ in own.experiments} <= {other.name for other in forms()} - {own.name}
