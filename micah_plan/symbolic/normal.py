"""log Φ, the logarithm of the standard normal distribution, as a CasADi expression that has a slope in the tails.

log(0.5 (1 + erf(t / √2))) is -inf below t = -8, where 1 + erf cancels. Below -5 the reciprocal of Mills' ratio is taken
from Laplace's continued fraction instead, 1 / (x + 1 / (x + 2 / (x + 3 / ...))), which converges for x = -t > 0.

Source: Abramowitz and Stegun, "Handbook of Mathematical Functions", 26.2.14. NumPy twin: `scipy.special.log_ndtr`.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

_TAIL = -5.0
# Of the continued fraction; at x = 5 that many leave a relative error of 1e-12.
_LEVELS = 24


def log_ndtr(t: ca.SX) -> ca.SX:
    """log Φ(t), element by element, with finite derivatives of all orders for |t| up to 1e100.

    The relative error of Φ is below 1e-9.
    """
    # Both branches are evaluated, so each sees only what it can bear; fmin would halve the slope at the seam.
    x, near = ca.if_else(t < _TAIL, -t, -_TAIL), ca.if_else(t < _TAIL, _TAIL, t)
    fraction = x
    for level in range(_LEVELS, 0, -1):
        fraction = x + level / fraction
    tail = -0.5 * x**2 - 0.5 * np.log(2 * np.pi) - ca.log(fraction)
    return ca.if_else(t < _TAIL, tail, ca.log(0.5 * (1 + ca.erf(near / np.sqrt(2)))))
