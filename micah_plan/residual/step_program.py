"""Compilation of a model's step to instructions for the loop over rows, layer by layer.

The uncertainty of a configuration is propagated with the exact slope of each formula (`symbolic.formula_lines`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from micah_plan.automaton.effects.form import EffectForm, Layer
from micah_plan.residual.candidates import GATES, Model, Term, columns, term_columns
from micah_plan.residual.row_loop import (
    COMMAND,
    COMMANDED_PLACE,
    FIRST_OWN,
    FREE,
    HIGH,
    LINE,
    LOW,
    MOVED_ON,
    OFFSET,
    ORDER,
    PLACE_OF_PART,
    SLOPE,
    STEEPNESS,
    TIME,
    Programs,
)
from micah_plan.symbolic.formula_lines import (
    Neutral,
    begun_line,
    command_line,
    force_line,
    is_late,
    memory_line,
    reading_line,
    response_line,
    stops_line,
)
from micah_plan.symbolic.straight_line import Instruction, Operation, StraightLine, as_code


@dataclass(frozen=True)
class ModelProgram:
    """A model's instructions.

    Attributes:
        programs: for the loop over rows.
        mode_sets: names of the modes in which terms act that do not act in all.
    """

    programs: Programs
    mode_sets: tuple[tuple[str, ...], ...]


@lru_cache(maxsize=1024)
def model_program(model: Model, gated: tuple[bool, ...], neutral: tuple[Neutral, ...]) -> ModelProgram:
    """The instructions of a model.

    Args:
        gated: whether each term acts since a place or a time only.
        neutral: which parameters of each term have their neutral values throughout.
    """
    return _Assembly(model, gated, neutral).assembled()


class _TermRegisters(NamedTuple):
    """A term with its registers: parameters, gates, and which options are neutral."""

    term: Term
    values: list[int]
    is_gated: bool
    neutral: Neutral


class _Assembly:
    """Programs under construction."""

    def __init__(self, model: Model, gated: Sequence[bool], neutral: Sequence[Neutral]) -> None:
        self.registers = FIRST_OWN
        self.once, self.constants = list[Instruction](), list[tuple[int, float]]()
        self.begun, self.ends, self.step, self.reading = (list[Instruction]() for _ in range(4))
        self.mode_sets, self.lines = list[tuple[str, ...]](), list[tuple[int, int, int]]()
        self.parameters = self._allocate(columns(model))
        self.one, self.zero = self._allocate(2)
        self.constants += [(self.one, 1.0), (self.zero, 0.0)]
        values = [self.parameters[entries] for entries in term_columns(model)]
        self.terms = list(map(_TermRegisters, model, values, gated, neutral))
        self.follows_places = any(term.form.layer == "place" for term in model)
        # How much the command changes with the configuration, for commanded places.
        self.steepness = self._allocate(1)[0]

    def assembled(self) -> ModelProgram:
        self._emit_step()
        for term, values, is_gated, neutral in self._registers_of("guard"):
            is_active = self._activity_register(self.ends, term, values, is_gated)
            low, high = self._append_formula(self.ends, stops_line(term.form, neutral), (LOW, HIGH), values)
            self._blend(self.ends, LOW, low, is_active)
            self._blend(self.ends, HIGH, high, is_active)
        self.ends.append((Operation.FMAX, HIGH, HIGH, LOW))
        self._emit_reading()
        programs = Programs(
            once=as_code(self.once),
            begun=as_code(self.begun),
            ends=as_code(self.ends),
            step=as_code(self.step),
            reading=as_code(self.reading),
            registers=self.registers,
            constants=np.array(self.constants, dtype=float).reshape(-1, 2),
            parameters=np.array(self.parameters, dtype=np.int64),
            lines=np.array(self.lines, dtype=np.int64).reshape(-1, 3),
        )
        return ModelProgram(programs, tuple(self.mode_sets))

    def _emit_step(self) -> None:
        step, steep = self.step, self.steepness
        step.append(_move(steep, self.zero))
        for term, values, _, neutral in self._registers_of("place"):
            memory, earlier = self._memory_of(term.form, values, neutral)
            sent, given, _ = self._command_in_force(COMMANDED_PLACE, earlier, term.form, values, neutral)
            line = response_line(term.form, neutral)
            out, slope, *after = self._append_formula(step, line, (PLACE_OF_PART, *sent, *memory), given)
            step += [_move(COMMAND, out), _move(steep, slope), *map(_move, memory, after)]
        for term, values, is_gated, neutral in self._registers_of("memory"):
            memory, earlier = self._memory_of(term.form, values, neutral)
            is_active = self._activity_register(step, term, values, is_gated)
            sent, given, is_now = self._command_in_force(COMMAND, earlier, term.form, values, neutral)
            out, slope, *after = self._append_formula(step, memory_line(term.form, neutral), (*sent, *memory), given)
            if is_now is not None:
                step.append((Operation.MUL, slope, slope, is_now))
            self._replace_command(out, slope, is_active)
            step += map(_move, memory, after)
        for term, values, is_gated, neutral in self._registers_of("command"):
            is_active = self._activity_register(step, term, values, is_gated)
            out, slope = self._append_formula(step, command_line(term.form, neutral), (COMMAND,), values)
            self._replace_command(out, slope, is_active)
        step += [(Operation.ADD, FREE, PLACE_OF_PART, COMMAND), (Operation.ADD, SLOPE, self.one, steep)]
        for term, values, is_gated, neutral in self._registers_of("force"):
            is_active = self._activity_register(step, term, values, is_gated)
            added, along, across = self._append_formula(
                step, force_line(term.form, neutral), (PLACE_OF_PART, COMMAND), values
            )
            step += [(Operation.MUL, across, across, steep), (Operation.ADD, along, along, across)]
            for register, change in ((FREE, added), (SLOPE, along)):
                gated_change = [] if is_active is None else [(Operation.IF_ELSE_ZERO, change, is_active, change)]
                step += [*gated_change, (Operation.ADD, register, register, change)]

    def _emit_reading(self) -> None:
        reading = self.reading
        if self._registers_of("sensor"):
            reading += [_move(OFFSET, self.zero), _move(STEEPNESS, self.one)]
        for term, values, is_gated, neutral in self._registers_of("sensor"):
            is_active = self._activity_register(reading, term, values, is_gated)
            offset, steepness = self._append_formula(reading, reading_line(term.form, neutral), (OFFSET, TIME), values)
            reading.append((Operation.MUL, steepness, steepness, STEEPNESS))
            self._blend(reading, OFFSET, offset, is_active)
            self._blend(reading, STEEPNESS, steepness, is_active)

    def _replace_command(self, out: int, slope: int, is_active: int | None) -> None:
        """Replace the command, and its derivative by the configuration."""
        self._blend(self.step, COMMAND, out, is_active)
        if self.follows_places:
            self.step.append((Operation.MUL, slope, slope, self.steepness))
            self._blend(self.step, self.steepness, slope, is_active)

    def _command_in_force(
        self, sent: int, earlier: Sequence[int], form: EffectForm, values: Sequence[int], neutral: Neutral
    ) -> tuple[Sequence[int], Sequence[int], int | None]:
        """(registers of the command in force, parameters, register that says whether the newest command applies).

        Args:
            earlier: register of the command before the first row, if commands act later.
        """
        if not is_late(form, neutral) or form.late_by is None:
            return (sent,), values, None
        delay, size = values[form.late_by], len(form.parameters)
        whole, before, late, is_now, newer, older = self._allocate(6)
        line = self._allocate(LINE)
        self.lines.append((line[0], int(form.layer == "place"), delay))
        self.once += [
            (Operation.FLOOR, whole, delay, delay),
            (Operation.ADD, before, whole, self.one),
            (Operation.SUB, late, delay, whole),
            (Operation.LT, is_now, whole, self.one),
        ]
        self.begun += [_move(place, at_rest) for place in line for at_rest in earlier]
        self.step += [
            (Operation.KEEP, line[0], sent, sent),
            (Operation.EARLIER, newer, line[0], whole),
            (Operation.EARLIER, older, line[0], before),
        ]
        return (newer, older), [*values[:size], late], is_now

    def _memory_of(self, form: EffectForm, values: Sequence[int], neutral: Neutral) -> tuple[list[int], list[int]]:
        """(registers of the memory at the first row, registers of the earlier command if commands are late)."""
        begun = self._append_formula(self.begun, begun_line(form, neutral), (PLACE_OF_PART, MOVED_ON), values)
        size = len(begun) - is_late(form, neutral)
        memory = self._allocate(size)
        self.begun += map(_move, memory, begun)
        return memory, begun[size:]

    def _registers_of(self, layer: Layer) -> list[_TermRegisters]:
        return [acting for acting in self.terms if acting.term.form.layer == layer]

    def _allocate(self, count: int) -> list[int]:
        first, self.registers = self.registers, self.registers + count
        return list(range(first, self.registers))

    def _append_formula(
        self, code: list[Instruction], line: StraightLine, inputs: Sequence[int], values: Sequence[int]
    ) -> list[int]:
        """Append the instructions of a formula and return its result registers."""
        kept, results, passing = self._allocate(line.kept), self._allocate(line.results), self._allocate(line.passing)
        at = [*inputs, *values[: line.parameters], *kept, *results, *passing]
        self.once += [(operation, at[o], at[a], at[b]) for operation, o, a, b in line.once.tolist()]
        code += [(operation, at[o], at[a], at[b]) for operation, o, a, b in line.each.tolist()]
        self.constants += [(at[int(register)], value) for register, value in line.constants.tolist()]
        return results

    def _activity_register(
        self, code: list[Instruction], term: Term, values: Sequence[int], is_gated: bool
    ) -> int | None:
        """Register that says whether a term acts in a row; None: always."""
        parts = []
        if is_gated:
            for gate, passed in zip(values[-GATES:], (ORDER, TIME), strict=True):
                (since,) = self._allocate(1)
                code.append((Operation.LE, since, gate, passed))
                parts.append(since)
        if term.modes:
            (inside,) = self._allocate(1)
            code.append((Operation.IN_MODES, inside, len(self.mode_sets), 0))
            self.mode_sets.append(term.modes)
            parts.append(inside)
        code += [(Operation.AND, parts[0], parts[0], other) for other in parts[1:]]
        return parts[0] if parts else None

    def _blend(self, code: list[Instruction], register: int, changed: int, is_active: int | None) -> None:
        """Use a changed value where the term acts."""
        code.append(_move(register, changed) if is_active is None else (Operation.SELECT, register, is_active, changed))


def _move(register: int, value: int) -> Instruction:
    return (Operation.ASSIGN, register, value, value)
