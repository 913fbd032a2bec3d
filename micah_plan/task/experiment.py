"""Experiments: open-loop motions whose recording separates hypotheses about a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from micah_plan.automaton.effects.ends import range_of
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.quantities import quantity
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

SMALLER = "divide the motion into steps that the object can make; are these m and rad?"


@dataclass(frozen=True)
class Motion:
    """A start with commands that do not depend on measurements.

    Attributes:
        commands: (K, m) input of each control step [rad or m].
    """

    start: Start
    commands: tuple[tuple[float, ...], ...]


def too_large(automaton: HybridAutomaton, motion: Motion) -> str:
    """The first command that moves a coordinate beyond its whole range, as a message; empty if there is none."""
    for i, coordinate in enumerate(automaton.coordinates):
        low, high = range_of(automaton, i)
        moving = next((mode for mode in automaton.modes if mode.driven[i]), None)
        if moving is None or not (np.isfinite(high - low) and high > low):
            continue
        moved = np.array(motion.commands).reshape(-1, automaton.m) @ np.array(moving.B[i])
        large = np.flatnonzero(~(np.abs(moved) <= high - low))
        if len(large):
            size, whole = (quantity(value, coordinate.unit) for value in (float(moved[large[0]]), high - low))
            return f"command {large[0]} moves '{coordinate.name}' by {size}, the whole range of the object is {whole}"
    return ""


@dataclass(frozen=True)
class Experiment:
    """Motions with their number of repetitions.

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
        for number, motion in enumerate(self.motions):
            if fault := too_large(self.automaton, motion):
                raise InputError(f"motion {number}: {fault}", remedy=SMALLER)

    def problem(self, number: int) -> Problem:
        """The problem from which a plant of a motion is made; it has no goal."""
        return Problem(self.automaton, self.motions[number].start, Goal(()), plant=self.plant)
