"""Conformance check of effect forms, evaluated by NumPy and by CasADi."""

from __future__ import annotations

import casadi as ca
import numpy as np

from micah_plan.arrays import TINY, Floats
from micah_plan.automaton.effects.form import EffectForm, Operations, Value, Values
from micah_plan.errors import InputError
from micah_plan.symbolic.casadi_operations import CasadiOperations
from micah_plan.symbolic.straight_line import straight_line

# What a form is tried at: commands, and places of the coordinate.
_COMMANDS = np.array([-0.3, -0.02, 0.0, 0.001, 0.04, 0.5])
_PLACES = np.array([-0.7, 0.0, 0.1, 0.4, 1.1, 2.0])
_ENDS, _TIME = (-0.2, 1.3), 1.0
# Components of an action besides the command, and of the direction that it is projected on.
_ACROSS, _DIRECTION = (0.03, -0.07), (0.6, 0.5, -0.3)


def check_form(form: EffectForm) -> None:
    """Refuse a form with an incomplete description or inconsistent formulas.

    Checked: sentence and source; that the hooks which it overrides are those of one layer, and that `calibrate` tries
    that layer; that the formulas give one finite value per state and command, for arrays as for numbers, and the same
    when CasADi evaluates them; that a memory keeps its shape, and is at rest without motion; that neutral values have
    no effect; that a reading is linear in the configuration, since it is inverted for logs.

    Raises:
        InputError: with the fault of the form.
    """
    if not form.parameters or not form.sentence.endswith(".") or not form.source:
        raise InputError(f"effect {form.name}: must have parameters, a sentence and a source")
    _check_layer(form)
    neutral = [_sensible(q.lower, q.upper) if q.neutral is None else q.neutral for q in form.parameters]
    acting = [_sensible(q.lower, q.upper) for q in form.parameters]
    if any(q.neutral is not None for q in form.parameters):
        unchanged = _outputs(EffectForm(), np, neutral, _PLACES, _COMMANDS)
        for name, values in _checked(form, neutral).items():
            if not np.allclose(values, unchanged[name], atol=TINY):
                raise InputError(f"effect {form.name}: {name} must have no effect at the neutral parameters")
    _checked(form, acting)
    if form.layer == "sensor":
        at = [form.measured(np, c, _TIME, acting) for c in (0.0, 1.0, 3.0)]
        if abs((at[2] - at[0]) - 3.0 * (at[1] - at[0])) > 1e-9 * max(map(abs, at)):
            raise InputError(
                f"effect {form.name}: a reading must be a straight line in the configuration, and this one is curved",
                remedy="a sensor's curve is taken out of the recording before, not by an effect",
            )


def _check_layer(form: EffectForm) -> None:
    if not form.layers:
        raise InputError(f"effect {form.name}: it overrides no hook, so it has no effect")
    if len(form.layers) > 1:
        raise InputError(
            f"effect {form.name}: it overrides hooks of the layers {' and '.join(form.layers)}, and only one is called",
            remedy="write one effect for each",
        )
    if form.layer in ("geometry", "place") and form.in_library:
        raise InputError(
            f"effect {form.name}: calibrate tries no forms of the layer {form.layer} but its own",
            remedy="set in_library = False: it is then added by hand, with with_effect",
        )


def _checked(form: EffectForm, p: list[float]) -> dict[str, Floats]:
    """Values of all hooks; refused where numbers, arrays and CasADi disagree."""
    try:
        with np.errstate(all="ignore"):
            outputs = _outputs(form, np, p, _PLACES, _COMMANDS)
            single = [_outputs(form, np, p, float(c), float(v)) for c, v in zip(_PLACES, _COMMANDS, strict=True)]
    except InputError:
        raise
    except Exception as error:  # a user's formula may fail in any way
        raise InputError(f"effect {form.name}: its formula fails: {error}") from error
    for name, values in outputs.items():
        if values.shape != _COMMANDS.shape or not np.isfinite(values).all():
            raise InputError(f"effect {form.name}: {name} must give one finite value per state and command")
    symbolic = _by_casadi(form, p)
    for name, values in outputs.items():
        alone = np.array([np.ravel(output[name])[0] for output in single])
        if not np.allclose(alone, values, atol=TINY):
            raise InputError(f"effect {form.name}: {name} must mean the same for numbers as for arrays")
        if not all(np.allclose(read[name], values, atol=TINY) for read in symbolic):
            raise InputError(
                f"effect {form.name}: {name} must mean the same to CasADi, which plans with it, as to NumPy",
                remedy="write it with the functions of ops",
            )
    return outputs


def _by_casadi(form: EffectForm, p: list[float]) -> list[dict[str, Floats]]:
    """Values of all hooks with numeric parameters, as in plans, and symbolic ones, as in calibrations.

    Delays are numbers throughout: calibrations use the formula of the command in force.
    """
    c, v = ca.SX.sym("c"), ca.SX.sym("v")
    symbols = [ca.SX.sym(parameter.name) for parameter in form.parameters]
    every = []
    try:
        fitted = [
            value if k == form.late_by else symbol for k, (value, symbol) in enumerate(zip(p, symbols, strict=True))
        ]
        for given in (list[Value](p), fitted):
            read = {name: ca.SX(value) for name, value in _outputs(form, CasadiOperations(), given, c, v).items()}
            straight_line([c, v], symbols, list(read.values()))
            function = ca.Function("read", [c, v, *symbols], list(read.values()))
            rows = [[float(value) for value in function(*at, *p)] for at in zip(_PLACES, _COMMANDS, strict=True)]
            every.append(dict(zip(read, np.array(rows).T, strict=True)))
    # NumPy's functions refuse expressions in many ways, as does an `if` on one.
    except Exception as error:
        raise InputError(
            f"effect {form.name}: CasADi, which plans with it, cannot read its formula: {error}",
            remedy="write it with the functions of ops, and without an if on values or parameters",
        ) from error
    return every


def _sensible(lower: float, upper: float) -> float:
    """A value within bounds, near 1 if possible."""
    low, high = max(lower, 0.5), min(upper, 1.0)
    return low if low <= high else high


def _outputs(form: EffectForm, ops: Operations, p: Values, c: Value, v: Value) -> dict[str, Value]:
    """Outputs of all hooks for a configuration and a command; arrays for NumPy."""
    memory = form.at_rest_in(c, p)
    out, after = form.respond(ops, c, v, memory, p)
    if len(after) != len(memory):
        raise InputError(f"effect {form.name}: remember must keep {len(memory)} values. Got {len(after)}")
    begun = form.in_motion(c, 0.0, p)
    if len(begun) != len(memory) or (ops is np and not all(map(np.allclose, begun, memory))):
        raise InputError(f"effect {form.name}: in_motion must equal at_rest where the part moved by 0")
    action: Values = (v, *_ACROSS)
    low, high = form.stops(ops, *_ENDS, p)
    nothing = 0.0 * c + 0.0 * v
    outputs = {
        "frame_command": form.frame_command(ops, action, _DIRECTION, p),
        "remember": out,
        "command": form.command(ops, v, p),
        "force": form.force(ops, c, v, p) + nothing,
        "stops": low + 2.0 * high + nothing,
        "release": form.release(p) + nothing,
        "measured": form.measured(ops, c, _TIME, p) + nothing,
    }
    return outputs if ops is not np else {name: np.asarray(value, dtype=float) for name, value in outputs.items()}
