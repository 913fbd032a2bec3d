"""What every form of effect must satisfy; run it on your own form before registering it."""

from __future__ import annotations

import numpy as np

from micah_plan.automaton.effects.form import LAYERS, EffectForm
from micah_plan.errors import InputError

_COMMANDS = np.array([-0.3, -0.02, 0.0, 0.001, 0.04, 0.5])
_PLACES = np.array([-0.7, 0.0, 0.1, 0.4, 1.1, 2.0])


def check_form(form: EffectForm) -> None:
    """Refuse a form whose description is incomplete or whose formulas do not behave.

    Checked: layer, sentence and source; that the formulas give one finite value per state and command, for arrays as
    for numbers; that a memory keeps its shape; that with all neutral values nothing changes.

    Raises:
        InputError: says what is wrong with the form.
    """
    if form.layer not in LAYERS or not form.parameters or not form.sentence.endswith(".") or not form.source:
        raise InputError(f"effect {form.name}: must have a known layer, parameters, a sentence and a source")
    p = [_sensible(q.lower, q.upper) if q.neutral is None else q.neutral for q in form.parameters]
    outputs = _outputs(form, p, _PLACES, _COMMANDS)
    for name, (values, unchanged) in outputs.items():
        if values.shape != _COMMANDS.shape or not np.isfinite(values).all():
            raise InputError(f"effect {form.name}: {name} must give one finite value per state and command")
        is_neutral = any(q.neutral is not None for q in form.parameters)
        if is_neutral and not np.allclose(values, unchanged, atol=1e-12):
            raise InputError(f"effect {form.name}: {name} must change nothing at the neutral parameters")
    single = [_outputs(form, p, float(c), float(v)) for c, v in zip(_PLACES, _COMMANDS, strict=True)]
    for name, (values, _) in outputs.items():
        alone = np.array([np.ravel(one[name][0])[0] for one in single])
        if not np.allclose(alone, values, atol=1e-12):
            raise InputError(f"effect {form.name}: {name} must mean the same for numbers as for arrays")


def _sensible(lower: float, upper: float) -> float:
    low, high = max(lower, 0.5), min(upper, 1.0)
    return low if low <= high else high


def _outputs(
    form: EffectForm, p: list[float], c: float | np.ndarray, v: float | np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(value, what it is without the effect) of every hook that maps states and commands."""
    memory = form.at_rest(p)
    out, after = form.remember(np, v, memory, p)
    if len(after) != len(memory):
        raise InputError(f"effect {form.name}: remember must keep {len(memory)} values. Got {len(after)}")
    nothing = 0.0 * np.asarray(v)
    pairs = {
        "remember": (out, v),
        "command": (form.command(np, v, p), v),
        "force": (form.force(np, c, v, p) + nothing, nothing),
        "measured": (form.measured(np, c, 1.0, p) + nothing, c + nothing),
    }
    return {name: (np.asarray(a, dtype=float), np.asarray(b, dtype=float)) for name, (a, b) in pairs.items()}
