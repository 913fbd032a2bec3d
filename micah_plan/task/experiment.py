"""An experiment: motions in open loop whose record is to tell apart what a model may lack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start


@dataclass(frozen=True)
class Motion:
    """A start, and what is commanded from there on, whatever is measured.

    Attributes:
        commands: (K, m) input of each control step [rad or m].
    """

    start: Start
    commands: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Experiment:
    """Motions, each of which is made several times.

    Attributes:
        automaton: the model; plants of the package are made of it.
        motions: one or more, in their order.
        repetitions: of all of them.
        plant: physical parameters for MuJoCo.
    """

    automaton: HybridAutomaton
    motions: tuple[Motion, ...]
    repetitions: int = 1
    plant: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.motions or self.repetitions < 1:
            raise InputError("an experiment needs a motion and a repetition. Got none")
        if any(len(row) != self.automaton.m for motion in self.motions for row in motion.commands):
            raise InputError(f"commands must have {self.automaton.m} inputs each")

    def problem(self, number: int) -> Problem:
        """What a plant is made of for a motion: there is no goal."""
        return Problem(self.automaton, self.motions[number].start, Goal(()), plant=self.plant)
