"""An effect as a value, and its memory as part of an automaton's state."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Since:
    """Onset of an effect in the recording that showed it; plans and executions always include the effect.

    Attributes:
        time: since the start of a run [s].
        run: number of that run; it acts in all later ones too. None: in every run from that time on.
        digest: of the rows of that run (`Recording.digest`): recordings without them were made later. None without run.
    """

    time: float
    run: int | None = None
    digest: str | None = None


@dataclass(frozen=True)
class Effect:
    """One effect of an automaton.

    Attributes:
        name: of its form (`registry.form`).
        coordinate: name of the coordinate that it acts on.
        parameters: (name, value) in the form's order and units.
        std: of each parameter, from the fit; empty if they were not estimated.
        modes: in which it acts; empty: in all.
        note: a remark for people.
        since: from when on; None: always.
        tied: names of other effects that its recording was as likely with in its place.
    """

    name: str
    coordinate: str
    parameters: tuple[tuple[str, float], ...]
    std: tuple[float, ...] = ()
    modes: tuple[str, ...] = ()
    note: str = ""
    since: Since | None = None
    tied: tuple[str, ...] = ()

    @property
    def values(self) -> tuple[float, ...]:
        """The parameter values."""
        return tuple(value for _, value in self.parameters)

    def acts_in(self, mode: str) -> bool:
        """Whether the effect acts in a mode."""
        return not self.modes or mode in self.modes


@dataclass(frozen=True)
class InputMemory:
    """Memory of an effect on one input: `size` consecutive values of a state.

    Attributes:
        effect: acts on the input before the modes.
        input: number of that input.
        coordinate: index of the coordinate that the effect acts on.
        scale: command of the effect's coordinate per unit of the input.
        first, size: its values are the coordinates first to first + size - 1.
    """

    effect: Effect
    input: int
    coordinate: int
    scale: float
    first: int
    size: int

    @property
    def coordinates(self) -> slice:
        """Slice of the memory's values in the state."""
        return slice(self.first, self.first + self.size)
