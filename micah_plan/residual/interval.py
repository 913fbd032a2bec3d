"""Intervals of fitted parameters from the likelihood itself: its profile over each one, read as a distribution.

The likelihood of a threshold is a staircase: between two commands of the recording nothing changes, and past the next
one a row is on the wrong side. No slope says how far that may go, and twice the loss is not chi-squared there. But with
a flat prior the normalised profile (the other parameters fitted anew at each value) is the posterior, and its quantiles
hold the truth as often as they say, both where the likelihood is a parabola and where it is a staircase: in the limit
both are shifts of one fixed law. Rows whose innovations are correlated count as fewer.

Sources: Ibragimov and Has'minskii, Statistical Estimation: Asymptotic Theory, 1981, ch. I.9 and V (flat priors where
densities jump); Barndorff-Nielsen and Cox, Inference and Asymptotics, 1994, ch. 4 (profile likelihood).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.residual.fit import Fit, Problem, optimise

# Probability inside, half of the rest on each side.
CONFIDENCE = 0.95
# The profile is bracketed by steps that double, up to four times what is large for the parameter, then read on a grid.
_DOUBLINGS = np.arange(-18.0, 3.0)
_GRID = 61
# Loss [nats] above the least at which a value is out of question, and rounds in which the other parameters follow.
_OUT = 8.0
_ROUNDS = 3
# Step of the search for the other parameters, in units of what is large: they are near.
_STEP = 0.02


def independent_share(correlation: float) -> float:
    """Which share of rows counts, where each is correlated so much with the next: (1 - r) / (1 + r) (Bartlett 1935)."""
    r = max(correlation, 0.0)
    return (1.0 - r) / (1.0 + r)


def intervals(problem: Problem, fit: Fit, share_of_rows: float) -> Floats:
    """(k, 3) lower end, median and upper end at `CONFIDENCE` of the free parameters of one fit to all rows.

    Args:
        share_of_rows: which count as independent, 0 to 1.
    """
    return np.array([_interval(problem, fit, j, share_of_rows) for j in range(problem.free.size)]).reshape(-1, 3)


def _interval(problem: Problem, fit: Fit, j: int, share_of_rows: float) -> Floats:
    value = float(fit.parameters[0, problem.free[j]])
    steps = problem.scale[j] * 2.0**_DOUBLINGS
    tried = np.concatenate([value - steps[::-1], [value], value + steps])
    tried = np.unique(np.clip(tried, problem.lower[j], problem.upper[j]))
    loss = share_of_rows * _profile(problem, fit, j, tried)
    able = np.flatnonzero(loss < loss.min() + _OUT)
    grid = np.linspace(tried[max(able[0] - 1, 0)], tried[min(able[-1] + 1, len(tried) - 1)], _GRID)
    loss = share_of_rows * _profile(problem, fit, j, grid)
    density = np.exp(loss.min() - loss)
    below = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    tail = 0.5 * (1.0 - CONFIDENCE)
    return np.asarray(np.interp([tail, 0.5, 1.0 - tail], below / below[-1], grid))


def _profile(problem: Problem, fit: Fit, j: int, values: Floats) -> Floats:
    """(G,) least loss [nats] with parameter j at each value."""
    start = np.repeat(fit.parameters, len(values), axis=0)
    start[:, problem.free[j]] = values
    others = replace(
        problem,
        free=np.delete(problem.free, j),
        scale=np.delete(problem.scale, j),
        center=np.delete(problem.center, j),
        lower=np.delete(problem.lower, j),
        upper=np.delete(problem.upper, j),
    )
    trained = np.ones((len(values), len(problem.lane.run)), dtype=bool)
    return optimise(others, start, np.repeat(fit.share, len(values)), trained, _ROUNDS, _STEP).loss
