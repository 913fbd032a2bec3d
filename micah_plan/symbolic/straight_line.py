"""A CasADi function as a list of instructions on numbered registers, for a loop that evaluates it on many numbers.

What depends on parameters alone is apart from what has to be evaluated in every row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import casadi as ca
import numpy as np

from micah_plan.arrays import Floats, Ints

Code = Ints
"""(n, 4) instructions: `Operation`, then the registers of its result and of its two arguments."""


@dataclass(frozen=True, eq=False)
class StraightLine:
    """Instructions on registers: of the row's inputs, of parameters, of what is kept, of results, and of what passes.

    Attributes:
        once: evaluated once for its parameters. each: evaluated in every row.
        inputs, parameters, kept, results, passing: how many registers of each kind there are, in this order.
        constants: (c, 2) register and value of what is kept and is a number.
    """

    once: Code
    each: Code
    inputs: int
    parameters: int
    kept: int
    results: int
    passing: int
    constants: Floats


def straight_line(
    inputs: Sequence[ca.SX], parameters: Sequence[ca.SX], results: Sequence[ca.SX | float]
) -> StraightLine:
    """Instructions for some results (scalars) of a row's inputs and of parameters (symbols).

    Raises:
        NotImplementedError: for a function that is not one of the elementary ones.
    """
    function = ca.Function("line", [*inputs, *parameters], [ca.SX(result) for result in results], {"cse": True})
    return _Reading(function, len(inputs), len(parameters)).read()


class Operation(IntEnum):
    """Operations of instructions: those of CasADi on scalars with its numbers, and two that programs have beside them.

    `SELECT` leaves its result as it is where the first argument is 0, and else takes the second. `IN_MODES` says
    whether the row's mode is one of a set of modes, whose number is its first argument.
    """

    ASSIGN = ca.OP_ASSIGN
    ADD = ca.OP_ADD
    SUB = ca.OP_SUB
    MUL = ca.OP_MUL
    DIV = ca.OP_DIV
    NEG = ca.OP_NEG
    EXP = ca.OP_EXP
    LOG = ca.OP_LOG
    POW = ca.OP_POW
    CONSTPOW = ca.OP_CONSTPOW
    SQRT = ca.OP_SQRT
    SQ = ca.OP_SQ
    TWICE = ca.OP_TWICE
    SIN = ca.OP_SIN
    COS = ca.OP_COS
    TAN = ca.OP_TAN
    ASIN = ca.OP_ASIN
    ACOS = ca.OP_ACOS
    ATAN = ca.OP_ATAN
    LT = ca.OP_LT
    LE = ca.OP_LE
    EQ = ca.OP_EQ
    NE = ca.OP_NE
    NOT = ca.OP_NOT
    AND = ca.OP_AND
    OR = ca.OP_OR
    FLOOR = ca.OP_FLOOR
    CEIL = ca.OP_CEIL
    FMOD = ca.OP_FMOD
    FABS = ca.OP_FABS
    SIGN = ca.OP_SIGN
    IF_ELSE_ZERO = ca.OP_IF_ELSE_ZERO
    FMIN = ca.OP_FMIN
    FMAX = ca.OP_FMAX
    INV = ca.OP_INV
    SINH = ca.OP_SINH
    COSH = ca.OP_COSH
    TANH = ca.OP_TANH
    ATAN2 = ca.OP_ATAN2
    SELECT = 200
    IN_MODES = 201


_ELEMENTARY = frozenset(Operation)


class _Reading:
    """The way through the instructions of a CasADi function, whose work places are used again and again.

    Values are numbered as they come up: ("input", k), ("kept", k), or ("passing", k), a register that others may use
    later.
    """

    def __init__(self, function: ca.Function, inputs: int, parameters: int) -> None:
        self.function, self.inputs, self.parameters = function, inputs, parameters
        self.once, self.each = list[tuple[int, int, int, int]](), list[tuple[int, int, int, int]]()
        self.constants = list[tuple[int, float]]()
        # Values by number: of inputs and parameters first. Those of `lasting` do not depend on the row's inputs.
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
            elif operation in _ELEMENTARY:
                a, b = (at[place] for place in (read if len(read) == 2 else [*read, *read]))
                is_lasting = {a, b} <= self.lasting
                at[written[0]] = self._new(lasting=is_lasting)
                (self.once if is_lasting else self.each).append((operation, at[written[0]], a, b))
            else:
                raise NotImplementedError(f"CasADi's operation {operation}")
        return self._placed(given, results)

    def _new(self, *, lasting: bool) -> int:
        number = self.count
        self.count += 1
        if lasting:
            self.lasting.add(number)
        return number

    def _placed(self, given: int, results: list[tuple[int, int]]) -> StraightLine:
        """Registers for all values; what is needed no more leaves its own to others."""
        kept = sorted(number for number in self.lasting if number >= given)
        register = {number: number for number in range(given)}
        register |= {number: given + k for k, number in enumerate(kept)}
        first_result = given + len(kept)
        first_passing = first_result + len(results)
        last = {number: k for k, (_, _, a, b) in enumerate(self.each) for number in (a, b)}
        last |= {number: len(self.each) for _, number in results}
        unused, passing, each = list[int](), 0, list[tuple[int, int, int, int]]()
        for k, (operation, out, a, b) in enumerate(self.each):
            of_a, of_b = register[a], register[b]
            # Not into the registers that it reads: such loops would not be vectorised.
            if not unused:
                unused.append(first_passing + passing)
                passing += 1
            register[out] = unused.pop()
            unused += [register[n] for n in {a, b} if n not in self.lasting and n >= given and last[n] == k]
            each.append((operation, register[out], of_a, of_b))
        each += [(ca.OP_ASSIGN, first_result + k, register[n], register[n]) for k, n in sorted(results)]
        once = [(operation, register[out], register[a], register[b]) for operation, out, a, b in self.once]
        return StraightLine(
            once=_code(once),
            each=_code(each),
            inputs=self.inputs,
            parameters=self.parameters,
            kept=len(kept),
            results=len(results),
            passing=passing,
            constants=np.array([(register[n], value) for n, value in self.constants], dtype=float).reshape(-1, 2),
        )


def _code(instructions: Sequence[tuple[int, int, int, int]]) -> Code:
    return np.array(instructions, dtype=np.int64).reshape(-1, 4)
