"""What a form of effect is: parameters, units, a sentence, a source, and one formula that NumPy and CasADi both
evaluate.

A formula is written with the functions of an `Operations` namespace. `numpy` is one; `symbolic.effects` has the one for
CasADi expressions. So the identification, the transition of the automaton and the compiled functions cannot disagree.

A step of a coordinate c with command v = (B u) of its mode runs through the hooks of `EffectForm` in their order; each
form changes one of them and leaves the others as they are. What moves guards or joints is taken into the automaton
itself, once, when the effect is added (`rebuilt`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError

Layer = Literal["frame", "place", "memory", "command", "force", "guard", "sensor", "geometry"]
LAYERS: tuple[Layer, ...] = ("frame", "place", "memory", "command", "force", "guard", "sensor", "geometry")
REMEMBERING: tuple[Layer, ...] = ("place", "memory")
"""Layers whose forms have a memory of earlier commands."""
Value = Any
"""A float, a NumPy array or a CasADi expression."""
Values = Sequence[Value]
Memory = tuple[Value, ...]

# Layers by the hook that they use; what changes the automaton itself is of ends or joints.
_HOOKS: dict[str, tuple[Layer, ...]] = {
    "frame_command": ("frame",),
    "respond": ("place",),
    "remember": ("memory",),
    "command": ("command",),
    "force": ("force",),
    "stops": ("guard",),
    "release": ("guard",),
    "measured": ("sensor",),
    "rebuilt": ("guard", "geometry"),
}
# What `check_form` tries a form at: commands, and places of the coordinate.
_COMMANDS = np.array([-0.3, -0.02, 0.0, 0.001, 0.04, 0.5])
_PLACES = np.array([-0.7, 0.0, 0.1, 0.4, 1.1, 2.0])


class Operations(Protocol):
    """The functions that formulas may use, with NumPy's names and meanings."""

    def where(self, condition: Value, yes: Value, no: Value, /) -> Value: ...
    def minimum(self, a: Value, b: Value, /) -> Value: ...
    def maximum(self, a: Value, b: Value, /) -> Value: ...
    def sign(self, a: Value, /) -> Value: ...
    def abs(self, a: Value, /) -> Value: ...
    def exp(self, a: Value, /) -> Value: ...
    def sin(self, a: Value, /) -> Value: ...
    def cos(self, a: Value, /) -> Value: ...


@dataclass(frozen=True)
class Parameter:
    """A parameter of a form.

    Attributes:
        unit: ``"1"``, ``"step"``, ``"rad"``, or ``"coordinate"`` for the coordinate's own unit (rad or m), which may
            be combined: ``"coordinate/s"``, ``"m/coordinate"``.
        neutral: value at which the form has no effect whatever the others are; None if another one's decides.
        lower, upper: bounds of a sensible value.
    """

    name: str
    unit: str
    neutral: float | None = None
    lower: float = -float("inf")
    upper: float = float("inf")

    def unit_for(self, coordinate_unit: str) -> str:
        """The unit for a coordinate in rad or m."""
        return self.unit.replace("coordinate", coordinate_unit)


class EffectForm:
    """Base of all forms: every hook passes on what it gets. Subclasses are final and hold no state.

    Class attributes:
        name: unique in the registry.
        layer: which hook it uses.
        sentence: what it does, in plain words.
        source: where the formula comes from.
        parameters: in order.
    """

    name: ClassVar[str]
    layer: ClassVar[Layer]
    sentence: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]

    def frame_command(self, ops: Operations, action: Values, direction: Values, p: Values) -> Value:
        """Command of an action (3 components) along a direction (3 components, divided by its squared length)."""
        return action[0] * direction[0] + action[1] * direction[1] + action[2] * direction[2]

    def at_rest(self, p: Values) -> Memory:
        """The memory at the start of a run."""
        return ()

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        """(command that comes out, memory after) of a command v."""
        return v, memory

    def at_rest_in(self, c: Value, p: Values) -> Memory:
        """The memory at the start of a run in configuration c; only forms of the layer ``place`` depend on c."""
        return self.at_rest(p)

    def respond(self, ops: Operations, c: Value, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        """(command that comes out, memory after) at configuration c of a command that leads to the place c + v."""
        return self.remember(ops, v, memory, p)

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        """The part of a command v that reaches the joint."""
        return v

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        """Displacement per step that is added at configuration c to a command v."""
        return 0.0

    def stops(self, ops: Operations, lower: Value, upper: Value, p: Values) -> tuple[Value, Value]:
        """The ends of the coordinate's range."""
        return lower, upper

    def release(self, p: Values) -> Value:
        """Size of a command that leaves an end."""
        return 0.0

    def measured(self, ops: Operations, c: Value, time: Value, p: Values) -> Value:
        """The reading at configuration c, `time` s after the start of the run."""
        return c

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        """The automaton with what the effect changes in its guards and joints; itself if that is nothing."""
        return automaton


def check_form(form: EffectForm) -> None:
    """Refuse a form whose description is incomplete or whose formulas do not behave.

    Checked: layer, sentence and source; that the hooks which it overrides are those of its layer; that the formulas
    give one finite value per state and command, for arrays as for numbers; that a memory keeps its shape; that with all
    neutral values nothing changes; that a reading is a straight line in the configuration, as it is taken out of logs.

    Raises:
        InputError: says what is wrong with the form.
    """
    if form.layer not in LAYERS or not form.parameters or not form.sentence.endswith(".") or not form.source:
        raise InputError(f"effect {form.name}: must have a known layer, parameters, a sentence and a source")
    _check_hooks(form)
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


def _check_hooks(form: EffectForm) -> None:
    own = [hook for hook in _HOOKS if getattr(type(form), hook) is not getattr(EffectForm, hook)]
    for hook in own:
        if form.layer not in _HOOKS[hook]:
            wanted = " or ".join(_HOOKS[hook])
            raise InputError(
                f"effect {form.name}: it overrides {hook}, which its layer {form.layer} never calls",
                remedy=f"make its layer {wanted}, or use the hook of {form.layer}",
            )
    if not own:
        raise InputError(f"effect {form.name}: it overrides no hook, so it does nothing")
    if form.layer == "sensor":
        p = [_sensible(q.lower, q.upper) for q in form.parameters]
        at = [form.measured(np, c, 1.0, p) for c in (0.0, 1.0, 3.0)]
        if abs((at[2] - at[0]) - 3.0 * (at[1] - at[0])) > 1e-9 * max(map(abs, at)):
            raise InputError(
                f"effect {form.name}: a reading must be a straight line in the configuration, and this one is curved",
                remedy="a sensor's curve is taken out of the recording before, not by an effect",
            )


def _sensible(lower: float, upper: float) -> float:
    low, high = max(lower, 0.5), min(upper, 1.0)
    return low if low <= high else high


def _outputs(
    form: EffectForm, p: list[float], c: float | np.ndarray, v: float | np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(value, what it is without the effect) of every hook that maps states and commands."""
    memory = form.at_rest_in(c, p)
    out, after = form.respond(np, c, v, memory, p)
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
