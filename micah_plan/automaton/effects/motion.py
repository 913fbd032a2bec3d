"""Displacement of one step with the effects of a mode, for floats, arrays or CasADi expressions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import DIFFERENCE, Floats
from micah_plan.automaton.effects.form import EffectForm, Operations, Value
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.memo import memoised


@dataclass(frozen=True)
class CoordinateMotion:
    """The motion that a command of one coordinate causes in a step: effects on the command, then forces.

    Attributes:
        commands, forces: (form, parameters) in the order in which they were added.
    """

    commands: tuple[tuple[EffectForm, tuple[float, ...]], ...]
    forces: tuple[tuple[EffectForm, tuple[float, ...]], ...]

    def commanded(self, ops: Operations, v: Value) -> Value:
        """The part of the mode's command v = (B u) that reaches the joint."""
        for command_form, p in self.commands:
            v = command_form.command(ops, v, p)
        return v

    def displacement(self, ops: Operations, c: Value, v: Value) -> Value:
        """Displacement at configuration c under the command v."""
        v = self.commanded(ops, v)
        added = v
        for force_form, p in self.forces:
            added = added + force_form.force(ops, c, v, p)
        return added


@memoised
def motions(automaton: HybridAutomaton, mode: Mode) -> dict[int, CoordinateMotion]:
    """Motions of the free coordinates (by index) that memoryless effects change in a mode."""
    gains = {}
    for index in np.flatnonzero(mode.free).tolist():
        name = automaton.coordinate_names[index]
        forms = [(form(e.name), e.values) for e in automaton.effects if e.coordinate == name and e.acts_in(mode.name)]
        commands = tuple(pair for pair in forms if pair[0].layer == "command")
        forces = tuple(pair for pair in forms if pair[0].layer == "force")
        if commands or forces:
            gains[index] = CoordinateMotion(commands, forces)
    return gains


def displaced(automaton: HybridAutomaton, mode: Mode, x: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Motion d (..., n) of a mode's whole step from x (..., n) under u (..., m), and its slope 1 + ∂d/∂x (..., n)."""
    moved = u @ mode.B.T
    slope = np.ones_like(moved)
    if not automaton.effects:
        return np.asarray(moved), slope
    d = moved.copy()
    for i, motion in motions(automaton, mode).items():
        d[..., i] = motion.displacement(np, x[..., i], moved[..., i])
        ahead = motion.displacement(np, x[..., i] + DIFFERENCE, moved[..., i])
        slope[..., i] += (ahead - motion.displacement(np, x[..., i] - DIFFERENCE, moved[..., i])) / (2 * DIFFERENCE)
    return d, slope
