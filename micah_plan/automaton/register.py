"""Memory of an effect as part of the state."""

from __future__ import annotations

from dataclasses import dataclass

from micah_plan.automaton.effects.value import Effect


@dataclass(frozen=True)
class Register:
    """The memory of one effect.

    Attributes:
        effect: what acts on the input.
        input: number of the input that passes through.
        scale: command of the effect's coordinate per unit of that input.
        first, size: where its values are in the state.
    """

    effect: Effect
    input: int
    scale: float
    first: int
    size: int
