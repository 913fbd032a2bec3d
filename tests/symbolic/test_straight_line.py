"""Instructions give what CasADi gives, whatever the expression, and do once what needs doing once."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from micah_plan.automaton.effects.registry import forms
from micah_plan.symbolic.formula_lines import command_line, force_line, memory_line
from micah_plan.symbolic.straight_line import Operation, straight_line

UNARY = (
    *(ca.exp, ca.sin, ca.cos, ca.tanh, ca.fabs, ca.sign, ca.floor, ca.ceil, ca.atan, ca.sinh, ca.cosh, ca.tan),
    *(ca.sqrt, ca.log, ca.asin, ca.acos, ca.logic_not, lambda x: -x, lambda x: x * x, lambda x: x + x, lambda x: 1 / x),
)
BINARY = (
    *(lambda x, y: x + y, lambda x, y: x - y, lambda x, y: x * y, lambda x, y: x / y, lambda x, y: x**y),
    *(ca.fmin, ca.fmax, ca.atan2, ca.fmod, ca.logic_and, ca.logic_or),
    *(lambda x, y: x < y, lambda x, y: x <= y, lambda x, y: x == y, lambda x, y: x != y),
    lambda x, y: ca.if_else(x < y, x, y),
)
_BY_PYTHON = {
    Operation.ASSIGN: lambda a, _: a,
    Operation.ADD: lambda a, b: a + b,
    Operation.SUB: lambda a, b: a - b,
    Operation.MUL: lambda a, b: a * b,
    Operation.NEG: lambda a, _: -a,
    Operation.SQ: lambda a, _: a * a,
}


def expression(rng, symbols, depth):
    """A random expression of positive numbers below 1, at which all functions are defined."""
    if depth == 0:
        return symbols[rng.integers(len(symbols))] if rng.random() < 0.8 else ca.SX(float(rng.uniform(0.1, 0.9)))
    if rng.random() < 0.4:
        made = UNARY[rng.integers(len(UNARY))](expression(rng, symbols, depth - 1))
    else:
        made = BINARY[rng.integers(len(BINARY))](*(expression(rng, symbols, depth - 1) for _ in range(2)))
    return 0.1 + 0.8 / (1.0 + ca.fabs(made))


def evaluated(line, inputs, parameters):
    """Results of the instructions by the compiled loop, for arrays (k, B) of inputs and parameters."""
    from micah_plan.residual.row_loop import evaluate

    r = np.zeros((line.inputs + line.parameters + line.kept + line.results + line.passing, inputs.shape[1]))
    r[: line.inputs], r[line.inputs : line.inputs + line.parameters] = inputs, parameters
    for register, value in line.constants:
        r[int(register)] = value
    for code in (line.once, line.each):
        evaluate(code, r, np.zeros((0, 1), dtype=bool), np.zeros(r.shape[1], dtype=np.int64), 0)
    first = line.inputs + line.parameters + line.kept
    return r[first : first + line.results]


@pytest.mark.parametrize("seed", range(40))
def test_random_expressions_give_what_casadi_gives(seed) -> None:
    rng = np.random.default_rng(seed)
    inputs, parameters = ([ca.SX.sym(f"{name}{k}") for k in range(3)] for name in ("x", "p"))
    results = [expression(rng, [*inputs, *parameters], depth) for depth in (0, 2, 4, 6)]
    line = straight_line(inputs, parameters, results)
    at = rng.uniform(0.1, 0.9, (6, 5))
    function = ca.Function("f", [*inputs, *parameters], results)
    expected = np.array([[float(value) for value in function(*column)] for column in at.T]).T
    np.testing.assert_allclose(evaluated(line, at[:3], at[3:]), expected, rtol=1e-13, atol=1e-15)


def test_what_depends_on_parameters_alone_is_done_once() -> None:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    line = straight_line([x], [p], [x * ca.exp(-1.0 / p)])
    assert Operation.EXP in line.once[:, 0]
    assert Operation.EXP not in line.each[:, 0]


def test_results_may_be_inputs_numbers_or_each_other() -> None:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    line = straight_line([x], [p], [x, p, 2.5, x + p, x + p, 0.0])
    values = evaluated(line, np.array([[1.0, 2.0]]), np.array([[10.0, 20.0]]))
    np.testing.assert_array_equal(values, [[1, 2], [10, 20], [2.5, 2.5], [11, 22], [11, 22], [0, 0]])


def test_a_register_is_used_again_only_when_nothing_needs_it() -> None:
    """By hand, instruction after instruction, with a list for the registers."""
    x = [ca.SX.sym(f"x{k}") for k in range(4)]
    total = x[0] * x[1] + x[2] * x[3]
    line = straight_line(x, [], [total * total, total - x[0] * x[1], -total])
    r = [2.0, 3.0, 5.0, 7.0] + [np.nan] * (line.kept + line.results + line.passing)
    for operation, out, a, b in line.each.tolist():
        r[out] = _BY_PYTHON[Operation(operation)](r[a], r[b])
    assert r[4 + line.kept :][: line.results] == [41.0**2, 35.0, -41.0]


def test_what_the_loop_cannot_do_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="no operation for number"):
        straight_line([x], [], [ca.erf(x)])


@pytest.mark.parametrize("form", [form for form in forms() if form.layer in ("command", "force", "memory")])
def test_slopes_are_those_of_the_formulas(form) -> None:
    """Against central differences, away from kinks."""
    lines = {"command": command_line, "force": force_line, "memory": memory_line}
    line, rng = lines[form.layer](form, (False,) * len(form.parameters)), np.random.default_rng(5)
    # Of a command that acts late, the line has one parameter more: the share of a step that has the older one.
    p = np.full((line.parameters, 50), 0.37)
    p[: len(form.parameters)] = [[np.clip(0.37, q.lower, q.upper)] * 50 for q in form.parameters]
    at = rng.uniform(-0.9, 0.9, (line.inputs, 50))
    value, *slopes = evaluated(line, at, p)[: 3 if form.layer == "force" else 2]
    for k, slope in enumerate(slopes):
        step = np.zeros_like(at)
        step[k] = 1e-6
        above, below = evaluated(line, at + step, p)[0], evaluated(line, at - step, p)[0]
        is_smooth = np.abs(above - 2.0 * value + below) < 1e-9
        assert is_smooth.mean() > 0.9
        np.testing.assert_allclose(slope[is_smooth], ((above - below) / 2e-6)[is_smooth], atol=1e-5)


@pytest.mark.parametrize("form", [form for form in forms() if form.layer in ("command", "force")])
def test_what_is_neutral_gives_the_same_as_a_number(form) -> None:
    """Each parameter alone, with values and slopes of the whole formula at its neutral value."""
    line_of = {"command": command_line, "force": force_line}[form.layer]
    none, rng = (False,) * len(form.parameters), np.random.default_rng(6)
    p = np.array([np.clip(rng.uniform(0.1, 0.6, 40), q.lower, q.upper) for q in form.parameters])
    for k, parameter in enumerate(form.parameters):
        if parameter.neutral is None:
            continue
        p[k] = parameter.neutral
        whole, less = (line_of(form, own) for own in (none, (*none[:k], True, *none[k + 1 :])))
        at = rng.uniform(-0.9, 0.9, (whole.inputs, 40))
        np.testing.assert_allclose(evaluated(less, at, p), evaluated(whole, at, p), atol=1e-15)
        assert len(less.each) <= len(whole.each)
