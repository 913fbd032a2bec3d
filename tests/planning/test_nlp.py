"""The one file that knows the solver: what it makes of programmes whose optimum is known, and of those without one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import micah_plan
from micah_plan.planning.nlp import FEASIBLE, Programme, Solver

LIMIT_S = 20.0


def programme(
    cost: Callable[[ca.MX], ca.MX],
    rows: Callable[[ca.MX], ca.MX],
    row_bounds: tuple[float, float],
    start: tuple[float, float] = (0.5, 0.5),
) -> Programme:
    w, open_ = ca.MX.sym("w", 2), np.full(2, np.inf)
    lower, upper = (np.array([bound]) for bound in row_bounds)
    return Programme(w, cost(w), rows(w), np.array(start), (-open_, open_), (lower, upper))


def nearest_on_line() -> Programme:
    """The point of x + y = 2 next to (3, 1) is (2, 0)."""
    return programme(lambda w: (w[0] - 3) ** 2 + (w[1] - 1) ** 2, ca.sum1, (2.0, 2.0))


def test_an_optimum_in_closed_form() -> None:
    stated = nearest_on_line()
    found = Solver(stated, LIMIT_S).solve()
    np.testing.assert_allclose(found.w, [2.0, 0.0], atol=1e-7)
    assert found.cost == pytest.approx(2.0)
    assert found.is_feasible
    assert found.has_converged
    assert not found.is_out_of_time
    assert found.status == "locally optimal"
    cost, rows = stated.values(found.w)
    assert (cost, rows[0]) == pytest.approx((found.cost, found.rows[0]))


def test_expanded_or_not_the_answer_is_the_same() -> None:
    both = [Solver(nearest_on_line(), LIMIT_S, expand=expand).solve().w for expand in (True, False)]
    np.testing.assert_allclose(*both, atol=1e-8)


def test_bounds_and_rows_may_be_others_each_time() -> None:
    solver = Solver(nearest_on_line(), LIMIT_S)
    free = np.full(2, np.inf)
    open_row = -np.full(1, np.inf), np.full(1, np.inf)
    np.testing.assert_allclose(solver.solve(row_bounds=open_row).w, [3.0, 1.0], atol=1e-7)
    np.testing.assert_allclose(solver.solve(bounds=(-free, np.array([1.5, np.inf]))).w, [1.5, 0.5], atol=1e-6)
    np.testing.assert_allclose(solver.solve().w, [2.0, 0.0], atol=1e-7)


def test_a_warm_start_needs_fewer_iterations() -> None:
    cold = Solver(programme(lambda w: ca.exp(w[0]) + w[1] ** 4, ca.sum1, (1.0, np.inf)), LIMIT_S, warm_start=True)
    first = cold.solve()
    again = cold.solve(first.w, before=first)
    np.testing.assert_allclose(again.w, first.w, atol=1e-6)
    assert again.iterations < first.iterations


def test_contradicting_rows_are_infeasible_and_reported_in_words() -> None:
    found = Solver(programme(ca.sumsqr, lambda w: ca.sumsqr(w) + 1.0, (0.0, 0.5)), LIMIT_S).solve()
    assert not found.is_feasible
    assert found.rows[0] > 0.5 + FEASIBLE
    assert "_" not in found.status


def test_a_start_that_is_not_a_number_is_not_tried() -> None:
    found = Solver(programme(ca.sumsqr, lambda w: ca.log(w[0]), (0.0, np.inf), start=(-1.0, 0.0)), LIMIT_S).solve()
    assert not found.is_number
    assert not found.is_feasible
    assert found.iterations == 0
    np.testing.assert_array_equal(found.w, [-1.0, 0.0])


def test_the_time_limit_ends_it_and_has_its_own_status() -> None:
    found = Solver(nearest_on_line(), 1e-9).solve()
    assert found.is_out_of_time
    assert "time limit" in found.status


def test_no_other_file_knows_the_solver() -> None:
    root = Path(micah_plan.__file__).parent
    texts = {file.relative_to(root).as_posix(): file.read_text(encoding="utf-8") for file in root.rglob("*.py")}
    assert {name for name, text in texts.items() if "nlpsol" in text or '"ipopt"' in text} == {"planning/nlp.py"}
