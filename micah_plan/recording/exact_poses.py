"""Exact poses: written by a simulator, or computed from the joint that moves the part.

They have no errors, or only along the motion. Rounding does not count as an error.
"""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import ROUND_OFF, Floats

_MOST_DIGITS = 6
"""Behind the point; no tracker reads so well, in m and of a quaternion."""
_OF_A_DIGIT = 0.5
"""What errs by less repeats by itself; rounding errs by 0.29."""
_FEWEST = 8
"""Poses: three lie on a circle whatever they are, and a few may by chance."""


def are_exact(position: Floats, quaternion: Floats | None) -> bool:
    """Whether poses lie on a line or a circle to their last digits, turned about one axis at most.

    Args:
        position: (n, 3) [m]; quaternion: (n, 4) unit, written with as many digits, or None.
    """
    if len(position) < _FEWEST:
        return False
    exact = _OF_A_DIGIT * 10.0 ** -_digits(position)
    if quaternion is not None:
        # Turns about one axis are a great circle of quaternions, of which those of a sign are as good as the others.
        spread = np.linalg.eigvalsh(quaternion.T @ quaternion / len(quaternion))
        if spread[1] > exact**2:
            return False
    away = position - position.mean(axis=0)
    _, sizes, axes = np.linalg.svd(away, full_matrices=False)
    stds = sizes / np.sqrt(len(position))
    if stds[1] < exact:
        return True
    if stds[2] > exact:
        return False
    # In their plane, x² + y² is linear in x and y on a circle (Coope, J. Optimization Theory and Applications 1993).
    plane = away @ axes[:2].T
    rows = np.column_stack([plane, np.ones(len(plane))])
    solved = np.linalg.lstsq(rows, (plane**2).sum(axis=1), rcond=None)[0]
    distance = np.linalg.norm(plane - 0.5 * solved[:2], axis=1)
    return bool(distance.std() < exact)


def _digits(position: Floats) -> int:
    """Number of decimals of varying positions, at most `_MOST_DIGITS`."""
    varies = position[:, np.ptp(position, axis=0) > 0.0]
    digits = range(1, _MOST_DIGITS) if varies.size else ()
    return next((k for k in digits if np.abs(varies - np.round(varies, k)).max() < ROUND_OFF), _MOST_DIGITS)
