"""Parameters of models by maximum likelihood: many starts and training sets at once, one simulation per iteration.

Gauss-Newton on the whitened innovations with a compass search beside it, which also works where a formula has kinks
or plateaus (thresholds). The share of process noise is searched along with the parameters.

Sources: Ljung, System Identification, 2nd ed., ch. 7 and 10 (prediction error method, Gauss-Newton); Kolda, Lewis and
Torczon, SIAM Review 2003 (compass search).

**Intervals** of fitted parameters come from the likelihood itself: its profile over each one, read as a distribution.

The likelihood of a threshold is a staircase: between two commands of the recording nothing changes, and past the next
one a row is on the wrong side. No slope says how far that may go, and twice the loss is not chi-squared there. But with
a flat prior the normalised profile (the other parameters fitted anew at each value) is the posterior, and its quantiles
hold the truth as often as they say, both where the likelihood is a parabola and where it is a staircase: in the limit
both are shifts of one fixed law. Rows whose innovations are correlated count as fewer.

Sources: Ibragimov and Has'minskii, Statistical Estimation: Asymptotic Theory, 1981, ch. I.9 and V (flat priors where
densities jump); Barndorff-Nielsen and Cox, Inference and Asymptotics, 1994, ch. 4 (profile likelihood).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import INTERVAL, ROUND_OFF, Booleans, Floats, Ints
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.likelihood import Fitness, fitness, log_density
from micah_plan.residual.simulation import Kind, Model, columns, simulate_terms

# Shares of process noise are searched on a logistic scale, in steps that halve, within these bounds.
_SHARE_STEP = 1.0
_FIRST_STEP = 0.25
_SHARE_BOUND = 5.0
_LINE = (1.0, 0.4, 0.1)
_SMALLEST_STEP = 2e-2
_DERIVATIVE = 1e-3
# Share of rows that may lie anywhere.
_ANYWHERE = 1e-3


@dataclass(frozen=True, eq=False)
class FitProblem:
    """A model to be fitted to a coordinate's data.

    Attributes:
        free: columns of the parameters that are fitted.
        scale: (k,) what a large value of each free parameter is; their prior std is this times `looseness`.
        center: (k,) where the prior is centred.
        lower, upper: (k,) bounds.
        looseness: of the prior; infinite for none.
    """

    data: CoordinateData
    model: Model
    free: Ints
    scale: Floats
    center: Floats
    lower: Floats
    upper: Floats
    looseness: float
    freedom: float


@dataclass(frozen=True, eq=False)
class Fit:
    """M fits.

    Attributes:
        parameters: (M, columns) and share: (M,) of process noise on the logistic scale.
        loss: (M,) negative log likelihood with the prior [nats]; scale: (M,) of the noise.
    """

    parameters: Floats
    share: Floats
    loss: Floats
    scale: Floats

    def best(self, count: int = 1) -> Fit:
        """Those with the smallest losses, best first."""
        i = np.argsort(self.loss, kind="stable")[:count]
        return Fit(self.parameters[i], self.share[i], self.loss[i], self.scale[i])


def optimise(
    problem: FitProblem, start: Floats, share: Floats, trained: Booleans, rounds: int, step: float = _FIRST_STEP
) -> Fit:
    """Improve M starts, each on its own training rows.

    Args:
        start: (M, columns); share: (M,) logistic share of process noise; trained: (M, S) segments to fit.
        step: of the compass search at first, in units of what is large for a parameter.
    """
    state = _State(problem, start.copy(), share.copy(), trained, step)
    for _ in range(rounds):
        if not state.improve():
            break
    return Fit(state.x, state.share, state.loss, state.scale)


def held_out(problem: FitProblem, fit: Fit, kind: Kind = "filter") -> tuple[Floats, Floats]:
    """(M, S) log predictive density per segment under each fit, and (M, S, T) errors [nats, rad or m].

    A row may lie anywhere in the range now and then: where a threshold is known but for a hair, a row on its other side
    must not count as hundreds of standard deviations (contaminated normal, Box and Tiao, Biometrika 1968).
    """
    prediction = simulate_terms(problem.data, problem.model, fit.parameters, process_share(fit.share), kind)
    density = log_density(prediction, fit.scale, problem.freedom)
    low, high = problem.data.visited
    anywhere = np.log(_ANYWHERE / max(high - low, ROUND_OFF))
    density = np.logaddexp(density + np.log1p(-_ANYWHERE), anywhere) * problem.data.counted
    return np.asarray(density.sum(axis=2)), prediction.error


def measurement_share(share: Floats) -> Floats:
    """Variance of the measurement noise in units of the noise scale, of logistic shares of process noise."""
    return np.asarray(1.0 - process_share(share))


def process_share(value: Floats) -> Floats:
    """Share of process noise of its logistic scale."""
    return np.asarray(1.0 / (1.0 + np.exp(-value)))


class _State:
    """Where the search is: parameters, steps and losses of M fits."""

    def __init__(self, problem: FitProblem, x: Floats, share: Floats, trained: Booleans, step: float) -> None:
        self.problem, self.x, self.share, self.trained = problem, x, share, trained
        self.count, self.k = len(x), problem.free.size
        if columns(problem.model) != x.shape[1]:
            raise ValueError(f"expected {columns(problem.model)} columns, found {x.shape[1]}")
        self.step = np.full(self.count, step)
        self.share_step = np.full(self.count, _SHARE_STEP)
        self.smooth = self.k > 8
        self.loss = np.full(self.count, np.inf)
        self.scale = np.ones(self.count)

    def improve(self) -> bool:
        """One iteration over all fits; whether any still moves."""
        trial, shares, owner = self._neighbours()
        error, fitness = self._evaluate(trial, shares, owner)
        size = trial.shape[0] // self.count
        losses = self._losses(trial, shares, fitness).reshape(self.count, size)
        self.loss, self.scale = losses[:, 0], fitness.scale.reshape(self.count, size)[:, 0]
        jumps = self._gauss_newton(trial, error, fitness, size)
        line, line_share, line_owner = self._line(jumps, self._better_share(losses, shares, size))
        _, ended = self._evaluate(line, line_share, line_owner)
        line_losses = self._losses(line, line_share, ended).reshape(self.count, len(_LINE))
        return self._move(
            np.concatenate([losses, line_losses], axis=1),
            np.concatenate(
                [
                    trial.reshape(self.count, size, self.x.shape[1]),
                    line.reshape(self.count, len(_LINE), self.x.shape[1]),
                ],
                axis=1,
            ),
            np.concatenate([shares.reshape(self.count, size), line_share.reshape(self.count, len(_LINE))], axis=1),
            np.concatenate([fitness.scale.reshape(self.count, size), ended.scale.reshape(self.count, len(_LINE))], 1),
            size,
        )

    def _neighbours(self) -> tuple[Floats, Floats, Ints]:
        """Centre, both neighbours in every free parameter, and both in the share, for every fit."""
        free, scale = self.problem.free, self.problem.scale
        per = 3 + 2 * self.k
        trial = np.repeat(self.x[:, None], per, axis=1)
        shares = np.repeat(self.share[:, None], per, axis=1)
        for j, column in enumerate(free):
            by = (_DERIVATIVE if self.smooth else self.step) * scale[j]
            up, down = self.x[:, column] + by, self.x[:, column] - by
            trial[:, 1 + 2 * j, column] = np.minimum(up, self.problem.upper[j])
            trial[:, 2 + 2 * j, column] = np.maximum(down, self.problem.lower[j])
        shares[:, -2] = np.minimum(self.share + self.share_step, _SHARE_BOUND)
        shares[:, -1] = np.maximum(self.share - self.share_step, -_SHARE_BOUND)
        owner = np.repeat(np.arange(self.count), per)
        return trial.reshape(self.count * per, self.x.shape[1]), shares.ravel(), owner

    def _evaluate(self, trial: Floats, shares: Floats, owner: Ints) -> tuple[Floats, Fitness]:
        data = self.problem.data
        prediction = simulate_terms(data, self.problem.model, trial, process_share(shares))
        rows = self.trained[owner][:, :, None] & data.counted[None]
        return prediction.error, fitness(prediction, rows, self.problem.freedom)

    def _losses(self, trial: Floats, shares: Floats, fitness: Fitness) -> Floats:
        away = (trial[:, self.problem.free] - self.problem.center) / (self.problem.scale * self.problem.looseness)
        return np.asarray(fitness.loss + 0.5 * (away**2).sum(axis=1) + 0.02 * shares**2)

    def _gauss_newton(self, trial: Floats, error: Floats, fitness: Fitness, size: int) -> Floats:
        """(M, k) steps of the free parameters."""
        if not self.k:
            return np.zeros((self.count, 0))
        free, problem = self.problem.free, self.problem
        errors = error.reshape(self.count, size, *error.shape[1:])
        weight = fitness.weight.reshape(self.count, size, *error.shape[1:])[:, 0]
        values = trial.reshape(self.count, size, -1)
        slopes = np.empty((self.count, self.k, *error.shape[1:]))
        for j, column in enumerate(free):
            width = values[:, 1 + 2 * j, column] - values[:, 2 + 2 * j, column]
            width = np.where(np.abs(width) > 1e-300, width, 1.0)
            slopes[:, j] = (errors[:, 1 + 2 * j] - errors[:, 2 + 2 * j]) / width[:, None, None]
        flat = slopes.reshape(self.count, self.k, -1)
        w = weight.reshape(self.count, 1, -1)
        prior = 1.0 / (problem.scale * problem.looseness) ** 2
        hessian = (flat * w) @ flat.transpose(0, 2, 1) + np.diag(prior)
        residual = errors[:, 0].reshape(self.count, -1, 1)
        away = (self.x[:, free] - problem.center) * prior
        gradient = ((flat * w) @ residual)[:, :, 0] + away
        damped = hessian + 1e-9 * np.eye(self.k) * np.trace(hessian, axis1=1, axis2=2)[:, None, None]
        damped = damped + np.diag(1e-6 / problem.scale**2)
        return np.asarray(-np.linalg.solve(damped, gradient[:, :, None])[:, :, 0])

    def _better_share(self, losses: Floats, shares: Floats, size: int) -> Floats:
        """(M,) the best of the shares tried."""
        rows, of_fit = np.arange(self.count), shares.reshape(self.count, size)
        tried = [0, size - 2, size - 1]
        return np.asarray(of_fit[:, tried][rows, np.argmin(losses[:, tried], axis=1)])

    def _line(self, jumps: Floats, share: Floats) -> tuple[Floats, Floats, Ints]:
        line = np.repeat(self.x[:, None], len(_LINE), axis=1)
        for i, part in enumerate(_LINE):
            moved = self.x[:, self.problem.free] + part * jumps
            line[:, i, self.problem.free] = np.clip(moved, self.problem.lower, self.problem.upper)
        owner = np.repeat(np.arange(self.count), len(_LINE))
        return line.reshape(owner.size, self.x.shape[1]), np.repeat(share, len(_LINE)), owner

    def _move(self, losses: Floats, trial: Floats, shares: Floats, scales: Floats, size: int) -> bool:
        chosen = np.argmin(losses, axis=1)
        rows = np.arange(self.count)
        gained = losses[:, 0] - losses[rows, chosen]
        stays = gained < 1e-3
        in_share = (chosen >= size - 2) & (chosen < size)
        kept = shares[rows, chosen] == self.share
        self.x, self.share = trial[rows, chosen], shares[rows, chosen]
        self.loss, self.scale = losses[rows, chosen], scales[rows, chosen]
        self.step = np.where(stays, 0.2 * self.step, np.where(in_share, self.step, 0.6 * self.step))
        self.share_step = np.where(kept, 0.6 * self.share_step, self.share_step)
        return bool((~stays | (self.step > _SMALLEST_STEP)).any()) if not self.smooth else bool((~stays).any())


# The profile is bracketed by steps that double, up to four times what is large for the parameter, then read on a grid.
_DOUBLINGS = np.arange(-18.0, 3.0)
_GRID = 61
# Loss [nats] above the least at which a value is out of question, and rounds in which the other parameters follow.
_OUT = 8.0
_PROFILE_ROUNDS = 3
# Step of the search for the other parameters, in units of what is large: they are near.
_STEP = 0.02


def independent_share(correlation: float) -> float:
    """Which share of rows counts, where each is correlated so much with the next: (1 - r) / (1 + r) (Bartlett 1935)."""
    r = max(correlation, 0.0)
    return (1.0 - r) / (1.0 + r)


def intervals(problem: FitProblem, fit: Fit, share_of_rows: float) -> Floats:
    """(k, 3) lower end, median and upper end at `INTERVAL` of the free parameters of one fit to all rows.

    Args:
        share_of_rows: which count as independent, 0 to 1.
    """
    return np.array([_interval(problem, fit, j, share_of_rows) for j in range(problem.free.size)]).reshape(-1, 3)


def _interval(problem: FitProblem, fit: Fit, j: int, share_of_rows: float) -> Floats:
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
    tail = 0.5 * (1.0 - INTERVAL)
    return np.asarray(np.interp([tail, 0.5, 1.0 - tail], below / below[-1], grid))


def _profile(problem: FitProblem, fit: Fit, j: int, values: Floats) -> Floats:
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
    trained = np.ones((len(values), len(problem.data.run)), dtype=bool)
    return optimise(others, start, np.repeat(fit.share, len(values)), trained, _PROFILE_ROUNDS, _STEP).loss
