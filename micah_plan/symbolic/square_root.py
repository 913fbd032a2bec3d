"""Gaussian arithmetic on lower Cholesky factors, as CasADi SX expressions without a matrix inverse.

The factor itself is the state (Maybeck, "Stochastic Models, Estimation and Control", vol. 1, ch. 7: square-root
filtering; Carlson, AIAA Journal 1973, for the triangular update). The factor is never squared and decomposed again, so
no pivot can become negative by rounding, at any scale of the belief.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from micah_plan.arrays import SMALLEST_STD
from micah_plan.automaton.hybrid import Pin


def norm(vector: ca.SX) -> ca.SX:
    """Euclidean norm of a column, smoothed at zero."""
    return ca.sqrt(ca.sumsqr(vector) + SMALLEST_STD**2)


def lower_factor(matrix: ca.SX) -> ca.SX:
    """Lower triangular L with positive diagonal and L L' = M M', for M (n, k): LQ decomposition by Givens rotations."""
    n, k = matrix.shape
    columns = [[matrix[i, j] for i in range(n)] for j in range(k)]
    for row in range(n):
        filled = [column for column in columns[row:] if not column[row].is_zero()]
        if not filled:
            # The coordinate is exactly known: it gets its own column, uncorrelated with the state.
            columns.insert(row, [ca.SX(0)] * n)
            filled = [columns[row]]
        at = next(j for j in range(row, len(columns)) if columns[j] is filled[0])
        columns[row], columns[at] = columns[at], columns[row]
        sign = ca.if_else(columns[row][row] < 0, -1, 1)
        columns[row] = [sign * entry for entry in columns[row]]
        for second in filled[1:] or [[ca.SX(0)] * n]:
            _rotate(columns[row], second, row)
    return _lower(columns, n)


def add_noise(factor: ca.SX, std: Sequence[float | ca.SX]) -> ca.SX:
    """Factor of L L' + diag(std²): one rank-one update per coordinate that has noise."""
    n = factor.shape[0]
    columns = [[factor[i, j] for i in range(n)] for j in range(n)]
    for start, deviation in enumerate(std):
        if not isinstance(deviation, ca.SX) and deviation == 0.0:
            continue
        added = [ca.SX(deviation) if i == start else ca.SX(0) for i in range(n)]
        for row in range(start, n):
            if not added[row].is_zero():
                _rotate(columns[row], added, row)
    return _lower(columns, n)


def observe(
    mean: ca.SX,
    factor: ca.SX,
    index: int,
    std: float | ca.SX,
    value: ca.SX | float | None = None,
    above: int | None = None,
) -> tuple[ca.SX, ca.SX]:
    """Mean and factor after a measurement of coordinate `index` with that std; value None: the most likely one.

    With v the coordinate's row of L and α = v'v + std², the posterior factor is L chol(I - v v'/α), and that Cholesky
    factor is known in closed form: partial sums of v² from the last entry to the first (Carlson 1973).

    Args:
        above: another coordinate; the measurement is the height of `index` above it.
    """
    n = factor.shape[0]
    noise = std if isinstance(std, ca.SX) else max(std, SMALLEST_STD)
    row, at = factor[index, :], mean[index]
    if above is not None:
        row, at = row - factor[above, :], at - mean[above]
    last = index if above is None else max(index, above)
    sums: list[ca.SX] = [ca.SX(0)] * (last + 2)
    sums[last + 1] = ca.SX(noise**2)
    for j in range(last, -1, -1):
        sums[j] = sums[j + 1] + row[j] ** 2
    shrink = ca.SX.eye(n)
    for j in range(last + 1):
        shrink[j, j] = ca.sqrt(sums[j + 1] / sums[j])
        for i in range(j + 1, last + 1):
            shrink[i, j] = -(row[i] / ca.sqrt(sums[j + 1])) * (row[j] / ca.sqrt(sums[j]))
    innovation = ca.SX(0) if value is None else value - at
    gain = ca.mtimes(factor, row.T) / sums[0]
    return mean + gain * innovation, ca.tril(ca.mtimes(factor, shrink))


def put_at(mean: ca.SX, factor: ca.SX, pins: Sequence[Pin]) -> tuple[ca.SX, ca.SX]:
    """The belief with pinned coordinates replaced.

    They become independent of the others, except for the coordinate that one follows, which adds to its value.
    """
    if not pins:
        return mean, factor
    mean, spread = ca.SX(mean), ca.SX(factor.shape[0], len(pins))
    others = ca.SX(factor)
    for column, pin in enumerate(pins):
        mean[pin.coordinate] = pin.value if pin.follows is None else pin.value + mean[pin.follows]
        others[pin.coordinate, :] = 0 if pin.follows is None else factor[pin.follows, :]
        spread[pin.coordinate, column] = pin.std
    return mean, lower_factor(ca.sparsify(ca.horzcat(others, spread)))


def _rotate(column: list[ca.SX], second: list[ca.SX], row: int) -> None:
    """Rotate two columns so that `second` vanishes in that row; column[row] >= 0 and the rows above are zero in both.

    column[row] is floored smoothly, not the radius, so that the map stays a rotation (loses no variance) at zero.
    """
    floored = ca.sqrt(column[row] ** 2 + SMALLEST_STD**2)
    radius = ca.sqrt(floored**2 + second[row] ** 2)
    cosine, sine = floored / radius, second[row] / radius
    for i in range(row + 1, len(column)):
        column[i], second[i] = cosine * column[i] + sine * second[i], cosine * second[i] - sine * column[i]
    column[row], second[row] = radius, ca.SX(0)


def _lower(columns: list[list[ca.SX]], n: int) -> ca.SX:
    """(n, n) lower triangular matrix of columns."""
    factor = ca.SX(ca.Sparsity.lower(n))
    for j in range(n):
        for i in range(j, n):
            factor[i, j] = columns[j][i]
    return factor
