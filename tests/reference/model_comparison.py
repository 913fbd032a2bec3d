"""Which of two state-space models of a logged motion is the likelier one, and by how many nats?

Sources: Kalman 1960 (the filter gives every row's density given the rows before); Schweppe 1965 (their product is the
likelihood); MacKay, "Information Theory, Inference, and Learning Algorithms", 2003, ch. 27 and 28 (Laplace's
approximation of the evidence, and its Occam factor); Kass and Raftery, JASA 1995 (evidence in nats).

    c_{k+1} = c_k + f(u_k, θ) + w,   w ~ N(0, q²)
    z_k     = c_k + e,               e ~ N(0, r²)

    ln p(z | M) ≈ ln p(z | θ̂) + ln p(θ̂) + d/2 ln 2π - 1/2 ln det H,   H the Hessian of -ln p(z | θ) p(θ) at θ̂

One coordinate [rad or m]. The parameters are those of the response, with priors N(neutral, scale²), then ln q and ln r.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

Floats = NDArray[np.float64]
Response = Callable[[float, Floats], float]
"""(u, θ) -> by how much the part moves on [rad or m]."""


@dataclass(frozen=True)
class Model:
    """A response with its parameters.

    Attributes:
        response: how the part moves. neutral, scale: (d,) means and stds of the parameters beforehand.
    """

    response: Response
    neutral: tuple[float, ...] = ()
    scale: tuple[float, ...] = ()


AS_TOLD = Model(lambda u, _: u)
GAIN = Model(lambda u, theta: theta[0] * u, (1.0,), (1.0,))
BIAS = Model(lambda u, theta: u + theta[0], (0.0,), (0.05,))


def log_likelihood(model: Model, runs: Sequence[tuple[Floats, Floats]], theta: Floats, q: float, r: float) -> float:
    """ln p(z | θ, q, r) of runs of measurements and commands (T,) each: of all rows but the first of each run."""
    total = 0.0
    for z, u in runs:
        c, p = z[0], r**2  # a run begins where it was measured
        for k in range(1, len(z)):
            c = c + model.response(u[k - 1], theta)
            p = p + q**2
            innovation, s = z[k] - c, p + r**2
            total += -0.5 * (innovation**2 / s + np.log(2 * np.pi * s))
            gain = p / s
            c, p = c + gain * innovation, (1 - gain) * p
    return float(total)


@dataclass(frozen=True)
class Fit:
    """The likeliest parameters (d,) with their stds (d,), and the evidence [nats]."""

    theta: Floats
    std: Floats
    evidence: float


def fitted(model: Model, runs: Sequence[tuple[Floats, Floats]], noise: float) -> Fit:
    """The parameters of a model, those of its noise included, and ln p(z | M).

    Args:
        noise: of what order the measurement's noise is [rad or m].
    """
    d = len(model.neutral)
    neutral = np.array([*model.neutral, np.log(noise), np.log(noise)])
    scale = np.array([*model.scale, 2.0, 2.0])

    def loss(x: Floats) -> float:
        y = neutral + scale * x  # x ~ N(0, 1) beforehand
        likelihood = log_likelihood(model, runs, y[:d], np.exp(y[d]), np.exp(y[d + 1]))
        return -likelihood + 0.5 * float(x @ x) + 0.5 * len(x) * float(np.log(2 * np.pi))

    found = minimize(loss, np.zeros(d + 2), method="BFGS", options={"gtol": 1e-4})
    best = minimize(loss, found.x, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-6}).x
    hessian = _hessian(loss, best)
    evidence = -loss(best) + 0.5 * len(best) * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(hessian)[1]
    std = scale * np.sqrt(np.diag(np.linalg.inv(hessian)))
    return Fit((neutral + scale * best)[:d], std[:d], float(evidence))


def _hessian(f: Callable[[Floats], float], x: Floats, h: float = 1e-3) -> Floats:
    """Second differences of a function at x (n,)."""
    unit = h * np.eye(len(x))
    return np.array(
        [[(f(x + a + b) - f(x + a - b) - f(x - a + b) + f(x - a - b)) / (4 * h * h) for b in unit] for a in unit]
    )
