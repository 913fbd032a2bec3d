"""Shifts of rows, against the index of each entry."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from micah_plan.arrays import earlier_rows


@given(st.integers(-5, 5), st.integers(1, 4))
def test_earlier_rows_are_those_of_a_shift_without_wrapping(by: int, columns: int) -> None:
    rows = np.arange(1.0, 1.0 + 3 * columns).reshape(3, columns)
    for axis in (0, 1):
        moved = earlier_rows(rows, by, axis)
        for index in np.ndindex(rows.shape):
            at = list(index)
            at[axis] -= by
            is_there = 0 <= at[axis] < rows.shape[axis]
            assert moved[index] == (rows[tuple(at)] if is_there else 0.0)
    assert earlier_rows(rows > 0, by).dtype == bool
