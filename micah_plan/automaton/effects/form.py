"""Forms of effects: parameters, units, description, source, and one formula for NumPy and CasADi.

A formula is written with the functions of an `Operations` namespace. `numpy` is one; `symbolic.compiled` has the one
for CasADi expressions. So the identification, the transition of the automaton and the compiled functions cannot
disagree.

A step of a coordinate c with command v = (B u) of its mode runs through the hooks of `EffectForm` in their order; each
form implements one of them. Effects on guards or joints change the automaton itself, once, when the effect is added
(`rebuilt`). A form also defines where calibration begins to fit it, its complexity, and experiments that separate it
from others: everything about an effect is in one class.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol

from micah_plan.automaton.hybrid import HybridAutomaton

if TYPE_CHECKING:
    pass
from micah_plan.automaton.effects.fit_start import CoordinateSeries, EquivalentEffect, FitStart

Layer = Literal["frame", "place", "memory", "command", "force", "guard", "sensor", "geometry"]
REMEMBERING: tuple[Layer, ...] = ("place", "memory")
"""Layers whose forms have a memory of earlier commands."""
Value = Any
"""A float, a NumPy array or a CasADi expression."""
Values = Sequence[Value]
Memory = tuple[Value, ...]

# The layer that each hook is of. A form that only changes the automaton itself (`rebuilt`) is of geometry.
_HOOKS: dict[str, Layer] = {
    "frame_command": "frame",
    "respond": "place",
    "remember": "memory",
    "command": "command",
    "force": "force",
    "stops": "guard",
    "release": "guard",
    "measured": "sensor",
}
_HIGHEST_RANK = 19
# What is large for a parameter that is no displacement.
_LARGE = 0.3


class InForce(NamedTuple):
    """Delayed commands in force during a step.

    Attributes:
        newer, older: displacements or places; `late` of the step has the older one, and then the newer.
    """

    newer: Value
    older: Value
    late: Value


class Operations(Protocol):
    """The functions that formulas may use, with NumPy's names and meanings."""

    def where(self, condition: Value, yes: Value, no: Value, /) -> Value: ...
    def minimum(self, a: Value, b: Value, /) -> Value: ...
    def maximum(self, a: Value, b: Value, /) -> Value: ...
    def sign(self, a: Value, /) -> Value: ...
    def abs(self, a: Value, /) -> Value: ...
    def sqrt(self, a: Value, /) -> Value: ...
    def exp(self, a: Value, /) -> Value: ...
    def sin(self, a: Value, /) -> Value: ...
    def cos(self, a: Value, /) -> Value: ...


@dataclass(frozen=True)
class Parameter:
    """A parameter of a form.

    Attributes:
        unit: ``"1"``, ``"step"``, ``"rad"``, or ``"coordinate"`` for the coordinate's own unit (rad or m), which may
            be combined: ``"coordinate/s"``, ``"m/coordinate"``.
        neutral: value at which the form has no effect for any values of the others; None if another parameter decides
            that. Infinite for a limit.
        lower, upper: bounds of a sensible value.
        is_optional: whether it may be left out, which means the neutral value.
    """

    name: str
    unit: str
    neutral: float | None = None
    lower: float = -float("inf")
    upper: float = float("inf")
    is_optional: bool = False

    @property
    def is_limit(self) -> bool:
        """Whether the parameter is an optional limit."""
        return self.neutral == float("inf")

    def unit_for(self, coordinate_unit: str) -> str:
        """The unit for a coordinate in rad or m."""
        return self.unit.replace("coordinate", coordinate_unit)


class EffectForm:
    """Base of all forms, with identity hooks; subclasses are final and stateless.

    Class attributes:
        name: unique in the registry.
        sentence: its effect in plain words.
        source: reference of the formula.
        parameters: in order.
        layers: of the hooks that it overrides; one, for a form that can be used, and that is its `layer`.
        complexity_rank: order among the forms that a recording cannot separate: the smallest is named first.
        experiments: (name of another effect, experiment that separates the two).
        in_library: whether `calibrate` tries it; False for effects that are found in another way, or added by hand
            only.
        late_by: index of the parameter with the delay of a command in steps; None: it acts at once. Such a form keeps
            its last commands behind the rest of its memory, `commanded_at_rest` before the first, and its formula is
            `remember_late` or `respond_late`.
    """

    name: ClassVar[str]
    sentence: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    layers: ClassVar[tuple[Layer, ...]] = ()
    layer: ClassVar[Layer]
    complexity_rank: ClassVar[int] = _HIGHEST_RANK
    experiments: ClassVar[tuple[tuple[str, str], ...]] = ()
    in_library: ClassVar[bool] = True
    late_by: ClassVar[int | None] = None

    def __init_subclass__(cls) -> None:
        hooks = {layer: None for hook, layer in _HOOKS.items() if getattr(cls, hook) is not getattr(EffectForm, hook)}
        changes = cls.rebuilt is not EffectForm.rebuilt and "guard" not in hooks
        cls.layers = (*hooks, "geometry") if changes else tuple(hooks)
        if cls.layers:
            cls.layer = cls.layers[0]

    @classmethod
    def options(cls) -> dict[str, float]:
        """Optional parameters with their default values."""
        return {each.name: each.neutral for each in cls.parameters if each.is_optional and each.neutral is not None}

    @classmethod
    def stated(cls, values: Iterable[tuple[str, float]]) -> list[str]:
        """Names of the parameters (name, value) to write: all but neutral options."""
        options = cls.options()
        return [name for name, value in values if name not in options or value != options[name]]

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        """Starting values of a fit to a recording; None if it cannot show the effect."""
        return self.guess_from_neutral(data)

    def guess_from_neutral(self, data: CoordinateSeries) -> FitStart:
        """Start at the neutral values or the middle of the bounds, with scales from the commands, else 0.3."""
        values, scale = [], []
        for parameter in self.parameters:
            large = data.command_size if parameter.unit.startswith("coordinate") else _LARGE
            low, high = max(parameter.lower, -large), min(parameter.upper, large)
            values.append(parameter.neutral if parameter.neutral is not None else 0.5 * (low + high))
            scale.append(large)
        return FitStart([values], tuple(range(len(values))), scale)

    def equivalent_effect(self, data: CoordinateSeries) -> EquivalentEffect | None:
        """An equivalent effect on such a recording, which is fitted instead; None if there is none."""
        return None

    def frame_command(self, ops: Operations, action: Values, direction: Values, p: Values) -> Value:
        """Command of an action (3 components) along a direction (3 components, divided by its squared length)."""
        return action[0] * direction[0] + action[1] * direction[1] + action[2] * direction[2]

    def at_rest(self, p: Values) -> Memory:
        """The memory at the start of a run."""
        return ()

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        """(output command, next memory) for a command v."""
        return v, memory

    def at_rest_in(self, c: Value, p: Values) -> Memory:
        """The memory at the start of a run in configuration c; only forms of the layer ``place`` depend on c."""
        return self.at_rest(p)

    def in_motion(self, c: Value, step: Value, p: Values) -> Memory:
        """The memory of a part that has just moved by a step to configuration c, as far as it is determined."""
        return self.at_rest_in(c - step, p)

    def respond(self, ops: Operations, c: Value, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        """(output command, next memory) at configuration c for a command to the position c + v."""
        return self.remember(ops, v, memory, p)

    def commanded_at_rest(self, c: Value, p: Values) -> Value:
        """The earlier command if the part rests in configuration c: a displacement, or a position."""
        return 0.0

    def remember_late(self, ops: Operations, sent: InForce, memory: Memory, p: Values) -> tuple[Value, Memory]:
        """(output command, next memory) of delayed commands, without the delay line."""
        return sent.newer, memory

    def respond_late(self, ops: Operations, c: Value, sent: InForce, memory: Memory, p: Values) -> tuple[Value, Memory]:
        """`remember_late` at configuration c, of places."""
        return self.remember_late(ops, sent, memory, p)

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
        """The automaton with the effect on guards and joints applied; unchanged if there is none."""
        return automaton
