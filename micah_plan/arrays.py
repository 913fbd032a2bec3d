"""Names for the arrays of all signatures, whose docstrings give shapes and units; equal numbers in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Booleans = NDArray[np.bool_]


def alike(numbers: Ints) -> list[tuple[int, Ints]]:
    """Each of the numbers (k,) that occurs, with the places (c,) where it does."""
    counts = np.bincount(numbers)
    return [(number, np.flatnonzero(numbers == number)) for number in np.flatnonzero(counts).tolist()]
