"""An effect as a value: the name of a form, the coordinate that it acts on, and its parameters."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Effect:
    """One effect of an automaton.

    Attributes:
        name: of its form (`registry.form`).
        coordinate: name of the coordinate that it acts on.
        parameters: (name, value) in the form's order and units.
        std: of each parameter, from the fit; empty if they were not estimated.
        modes: in which it acts; empty: in all.
        note: what a person should know, such as since which run it was seen.
    """

    name: str
    coordinate: str
    parameters: tuple[tuple[str, float], ...]
    std: tuple[float, ...] = ()
    modes: tuple[str, ...] = ()
    note: str = ""

    @property
    def values(self) -> tuple[float, ...]:
        """The parameters without their names."""
        return tuple(value for _, value in self.parameters)

    def acts_in(self, mode: str) -> bool:
        """Whether it acts in the mode of that name."""
        return not self.modes or mode in self.modes
