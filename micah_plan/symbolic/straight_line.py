"""A CasADi function as instructions on numbered registers, for evaluation in a compiled loop.

Operations on parameters alone are separate from those of every row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import casadi as ca
import numpy as np

from micah_plan.arrays import Floats, Ints

Instruction = tuple[int, int, int, int]
"""`Operation`, then the registers of its result and of its two arguments."""


class Operation(IntEnum):
    """Operations of instructions: CasADi's scalar ones by name, and four additional ones.

    Their numbers are fixed: compiled code that is cached on disk contains them, and outlives a release of CasADi.
    `SELECT` leaves its result unchanged where the first argument is 0, and otherwise takes the second. `IN_MODES` is
    whether the row's mode is one of a set of modes, whose number is its first argument. `KEEP` writes a value into a
    delay line, whose first register is its result; `EARLIER` is the value of a delay line (its first argument) so many
    rows ago.
    """

    ASSIGN = 0
    ADD = 1
    SUB = 2
    MUL = 3
    DIV = 4
    NEG = 5
    EXP = 6
    LOG = 7
    POW = 8
    CONSTPOW = 9
    SQRT = 10
    SQ = 11
    TWICE = 12
    SIN = 13
    COS = 14
    TAN = 15
    ASIN = 16
    ACOS = 17
    ATAN = 18
    LT = 19
    LE = 20
    EQ = 21
    NE = 22
    NOT = 23
    AND = 24
    OR = 25
    FLOOR = 26
    CEIL = 27
    FMOD = 28
    FABS = 29
    SIGN = 30
    IF_ELSE_ZERO = 31
    FMIN = 32
    FMAX = 33
    INV = 34
    SINH = 35
    COSH = 36
    TANH = 37
    ATAN2 = 38
    SELECT = 39
    IN_MODES = 40
    KEEP = 41
    EARLIER = 42


_OF_CASADI = {
    getattr(ca, f"OP_{operation.name}"): operation
    for operation in Operation
    if operation not in (Operation.SELECT, Operation.IN_MODES, Operation.KEEP, Operation.EARLIER)
}


@dataclass(frozen=True, eq=False)
class StraightLine:
    """Instructions on registers: inputs of the row, parameters, kept values, results, temporaries.

    Attributes:
        once: (n, 4) instructions that are evaluated once for the parameters. each: (m, 4), in every row.
        inputs, parameters, kept, results, passing: how many registers of each kind there are, in this order.
        constants: (c, 2) register and value of constants.
    """

    once: Ints
    each: Ints
    inputs: int
    parameters: int
    kept: int
    results: int
    passing: int
    constants: Floats


def straight_line(
    inputs: Sequence[ca.SX], parameters: Sequence[ca.SX], results: Sequence[ca.SX | float]
) -> StraightLine:
    """Instructions for scalar results of a row's inputs and of symbolic parameters.

    Raises:
        ValueError: for a function that is none of `Operation`.
    """
    function = ca.Function("line", [*inputs, *parameters], [ca.SX(result) for result in results], {"cse": True})
    return _Reading(function, len(inputs), len(parameters)).read()


class _Reading:
    """Conversion state of a CasADi function, whose work registers are reused.

    Values are numbered in order of appearance, inputs and parameters first; registers are assigned at the end.
    """

    def __init__(self, function: ca.Function, inputs: int, parameters: int) -> None:
        self.function, self.inputs, self.parameters = function, inputs, parameters
        self.once, self.each = list[Instruction](), list[Instruction]()
        self.constants = list[tuple[int, float]]()
        # Numbers of values; those of `lasting` do not depend on the row's inputs.
        self.count = inputs + parameters
        self.lasting = set(range(inputs, self.count))

    def read(self) -> StraightLine:
        """The instructions with their registers."""
        given = self.inputs + self.parameters
        at, results = dict[int, int](), list[tuple[int, int]]()
        for k in range(self.function.n_instructions()):
            operation = self.function.instruction_id(k)
            read, written = self.function.instruction_input(k), self.function.instruction_output(k)
            if operation == ca.OP_INPUT:
                at[written[0]] = read[0]
            elif operation == ca.OP_OUTPUT:
                results.append((written[0], at[read[0]]))
            elif operation == ca.OP_CONST:
                at[written[0]] = self._new(lasting=True)
                self.constants.append((at[written[0]], self.function.instruction_constant(k)))
            elif operation in _OF_CASADI:
                a, b = (at[place] for place in (read if len(read) == 2 else [*read, *read]))
                is_lasting = {a, b} <= self.lasting
                at[written[0]] = self._new(lasting=is_lasting)
                (self.once if is_lasting else self.each).append((_OF_CASADI[operation], at[written[0]], a, b))
            else:
                raise ValueError(f"instructions have no operation for number {operation} of CasADi")
        return self._placed(given, results)

    def _new(self, *, lasting: bool) -> int:
        """The number of a new value; lasting ones keep their register."""
        number = self.count
        self.count += 1
        if lasting:
            self.lasting.add(number)
        return number

    def _placed(self, given: int, results: list[tuple[int, int]]) -> StraightLine:
        """Register allocation for all values; registers of dead values are reused."""
        kept = sorted(number for number in self.lasting if number >= given)
        register = {number: number for number in range(given)}
        register |= {number: given + k for k, number in enumerate(kept)}
        first_result = given + len(kept)
        first_passing = first_result + len(results)
        last = {number: k for k, (_, _, a, b) in enumerate(self.each) for number in (a, b)}
        last |= {number: len(self.each) for _, number in results}
        unused, passing, each = list[int](), 0, list[Instruction]()
        for k, (operation, out, a, b) in enumerate(self.each):
            of_a, of_b = register[a], register[b]
            # Not into the registers that it reads: such loops would not be vectorised.
            if not unused:
                unused.append(first_passing + passing)
                passing += 1
            register[out] = unused.pop()
            unused += [register[n] for n in {a, b} if n not in self.lasting and n >= given and last[n] == k]
            each.append((operation, register[out], of_a, of_b))
        each += [(Operation.ASSIGN, first_result + k, register[n], register[n]) for k, n in sorted(results)]
        once = [(operation, register[out], register[a], register[b]) for operation, out, a, b in self.once]
        return StraightLine(
            once=as_code(once),
            each=as_code(each),
            inputs=self.inputs,
            parameters=self.parameters,
            kept=len(kept),
            results=len(results),
            passing=passing,
            constants=np.array([(register[n], value) for n, value in self.constants], dtype=float).reshape(-1, 2),
        )


def as_code(instructions: Sequence[Instruction]) -> Ints:
    """(n, 4) instructions."""
    return np.array(instructions, dtype=np.int64).reshape(-1, 4)
