"""Held-out predictions of fitted models, and the error that noise alone would cause.

Every group of runs is predicted by the parameters to which one Newton step without it leads (`fitting.without_each`).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from micah_plan.arrays import INTERVAL, NEAR_STDS, Floats, earlier_rows
from micah_plan.residual.competition import Competition
from micah_plan.residual.contenders import Contender, has_onset
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.filtering import NOISE, Kind, ModelBatch, errors
from micah_plan.residual.likelihood import independent_share
from micah_plan.residual.residual_test import LAGS, Circumstances, ResidualTest, lagged_commands, whiteness_test

# The profile of a parameter is bracketed by steps that double, up to four times what is large for it, then read on a
# grid; loss [nats] above the least at which a value is out of question.
_DOUBLINGS = np.arange(-18.0, 3.0)
_GRID, _OUT = 61, 8.0
_WANDER = NOISE.index("wander")
_ROUNDS = 12  # in which the other noise takes its place


class HeldOut:
    """Held-out predictions of the models of one coordinate, cached.

    Attributes:
        competition: that fitted them. data: of the coordinate. nominal: the model as it is.
        as_written: the data with commands as they were written, of which steps and roll-outs are predicted.
    """

    def __init__(self, data: CoordinateData, as_written: CoordinateData | None = None) -> None:
        self.competition = Competition(data)
        self.data, self.nominal = self.competition.data, self.competition.nominal
        self.as_written = self.data if as_written is None else as_written
        self._errors: dict[tuple[Contender, Kind], tuple[Floats, Floats]] = {}
        self._innovation_tests: dict[Contender, ResidualTest | None] = {}

    def errors(self, model: Contender, kind: Kind) -> Floats:
        """(S, T) measured minus predicted [rad or m], each segment under parameters fitted without its group."""
        return self._predicted(model, kind)[0]

    def _predicted(self, model: Contender, kind: Kind) -> tuple[Floats, Floats]:
        """(errors, variances) of all rows, each predicted without its own group [rad or m]."""
        if (model, kind) not in self._errors:
            every = errors(self.data if kind == "filter" else self.as_written, [self._without_each(model)], kind)
            group, rows = self.competition.fitting.group, np.arange(len(self.data.run))
            self._errors[model, kind] = every[0][group, rows], every[1][group, rows]
        return self._errors[model, kind]

    def _without_each(self, model: Contender) -> ModelBatch:
        """A model with the parameters of each leave-one-group-out fit."""
        return model.fit.hypotheses(self.competition.fitting.without_each(model.weighed))

    def rollout_errors(self, model: Contender) -> Floats:
        """(N,) measured minus predicted in roll-outs from each run's first row, under held-out parameters."""
        whole = self.as_written.whole
        if whole is None or whole.segment is None:
            return self.errors(model, "rollout")[self.data.counted]
        every = errors(whole, [self._without_each(model)], "rollout")[0]
        runs, rows = np.nonzero(whole.counted)
        return np.asarray(every[self.competition.fitting.group[whole.segment[runs, rows]], runs, rows])

    def spread(self, model: Contender) -> Floats:
        """(S, T) std of each innovation relative to the root mean square over counted rows."""
        variance = errors(self.data, [model.fit.hypotheses(model.fit.vector[None])], "filter")[1][0]
        return np.asarray(np.sqrt(variance / np.mean(variance[self.data.counted])))

    def noise_floor(self, model: Contender) -> float:
        """Root mean square one-step error due to noise if this model is true [rad or m].

        At most the actual error: with few rows, uncertain tails could make it larger.
        """
        unpredicted = float(np.sqrt(np.mean(self.errors(model, "one_step")[self.data.counted] ** 2)))
        return min(_floor(model, self.data, "one_step", self.as_written), unpredicted)

    def rollout_floor(self, model: Contender) -> float:
        """Root mean square roll-out error due to noise if this model is true [rad or m].

        Process noise accumulates from the first row on, except where ends or commanded places bound it.
        """
        return _floor(model, self.data.whole or self.data, "rollout", self.as_written.whole or self.as_written)

    def floors_without_explained_part(self) -> tuple[float, float]:
        """Noise floors (one step, roll-out) of the nominal model without the explained part of its errors."""
        nominal, starts = self.nominal, self.data.counted_starts
        step, rolled = self.noise_floor(nominal), self.rollout_floor(nominal)
        one_step = earlier_rows(self.errors(nominal, "one_step"), -1)[starts][:, None]
        innovations, steps = (
            self.innovation_test(nominal),
            whiteness_test(one_step, replace(self._circumstances, errors=None)),
        )
        if innovations is None or not innovations.is_more or steps is None:
            return step, rolled
        return float(steps.floor[0]), float(steps.floor[0]) * rolled / step

    def correlations_of(self, model: Contender) -> tuple[tuple[str, ...], Floats]:
        """(names of the fitted parameters (k), correlation (k, k) of their errors)."""
        count = model.fit.free.of_model
        labels = [f"{part.name}, later" if has_onset(part) else part.name for part in model.parts]
        names = [
            f"{part.term.form.parameters[j].name} of {label}"
            for part, label in zip(model.parts, labels, strict=True)
            for j in part.free
        ]
        if not count:
            return (), np.zeros((0, 0))
        covariance = np.linalg.inv(model.weighed.hessian)[:count, :count]
        std = np.sqrt(np.diag(covariance))
        return tuple(names), np.asarray(covariance / np.outer(std, std))

    def intervals(self, model: Contender) -> Floats:
        """(k, 3) lower end, median and upper end at `INTERVAL` of each free parameter, in the order of the parts.

        The likelihood of a threshold is a staircase: between two commands of the recording it is constant, and beyond
        the next one a row is on the wrong side. Its slope does not give an interval. But with a flat prior the
        normalised likelihood is the posterior, and its quantiles have the stated coverage, for parabolas and for
        staircases. The other parameters follow along the covariance. Rows with correlated innovations count as fewer.

        Sources: Ibragimov and Has'minskii, Statistical Estimation: Asymptotic Theory, 1981, ch. I.9 and V (flat priors
        where densities jump); Barndorff-Nielsen and Cox, Inference and Asymptotics, 1994, ch. 4 (profile likelihood).
        """
        share = independent_share(self._correlations(model)[0][0])
        return np.array([self._interval(model, j, share) for j in range(model.fit.free.of_model)]).reshape(-1, 3)

    def _interval(self, model: Contender, j: int, share: float) -> Floats:
        """(2,) quantiles of the posterior of a parameter by its profile."""
        fit, free = model.fit, model.fit.free
        value = float(fit.vector[free.at[j]])
        steps = free.scale[j] * 2.0**_DOUBLINGS
        tried = np.unique(np.clip([*(value - steps), value, *(value + steps)], free.low[j], free.high[j]))
        loss = share * self._profile(model, j, tried)
        able = np.flatnonzero(loss < loss.min() + _OUT)
        grid = np.linspace(tried[max(able[0] - 1, 0)], tried[min(able[-1] + 1, len(tried) - 1)], _GRID)
        loss = share * self._profile(model, j, grid)
        density = np.exp(loss.min() - loss)
        below = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
        tail = 0.5 * (1.0 - INTERVAL)
        return np.asarray(np.interp([tail, 0.5, 1.0 - tail], below / below[-1], grid))

    def _profile(self, model: Contender, j: int, values: Floats) -> Floats:
        """(G,) profile loss [nats] of parameter j at each value, with the others fixed or refitted."""
        fit, free = model.fit, model.fit.free
        others = np.delete(np.arange(len(free.at)), j)
        hessian = model.weighed.hessian
        follow = -np.linalg.solve(hessian[np.ix_(others, others)], hessian[others, j])
        away = values - fit.vector[free.at[j]]
        alone, together = np.zeros((len(values), len(free.at))), np.zeros((len(values), len(free.at)))
        alone[:, j] = together[:, j] = away
        together[:, others] = np.clip(away[:, None] * follow, -free.scale[others], free.scale[others])
        vectors = np.concatenate([fit.moved(alone), fit.moved(together)])
        (losses,) = self.competition.fitting.losses([fit], [vectors])
        return np.asarray(losses.reshape(2, -1).min(axis=0))

    def whiteness(self, model: Contender) -> tuple[float, float]:
        """Largest autocorrelation of the innovations at lags 1 to 4, and its probability if they were white.

        Source: Ljung and Box, Biometrika 1978, for residuals of a fitted model.
        """
        correlations = [correlation for correlation in self._correlations(model) if correlation[1] > 10]
        if not correlations:
            return 0.0, 1.0
        statistic = sum(r * r * count for r, count in correlations)
        return max((r for r, _ in correlations), key=abs), float(chdtrc(len(correlations), statistic))

    def _correlations(self, model: Contender) -> list[tuple[float, int]]:
        """(autocorrelation of the innovations, number of pairs) at lags 1 to 4."""
        counted = self.data.counted
        error, variance = self._predicted(model, "filter")
        error = error / np.sqrt(variance) * counted
        mean_square = float((error**2).sum()) / counted.sum()
        findings = []
        for lag in range(1, 5):
            pairs = counted[:, lag:] & counted[:, :-lag]
            product = float((error[:, lag:] * error[:, :-lag])[pairs].sum())
            count = int(pairs.sum())
            findings.append((product / count / mean_square if count and mean_square > 0 else 0.0, count))
        return findings

    def innovation_test(self, model: Contender) -> ResidualTest | None:
        """Test of the innovations against commands, places, time and earlier innovations; cached."""
        if model not in self._innovation_tests:
            self._innovation_tests[model] = self._innovation_test(model)
        return self._innovation_tests[model]

    @cached_property
    def _circumstances(self) -> Circumstances:
        data = self.data
        # A place that the innovation's own measurements have no part in: from the row before.
        before = np.concatenate([data.z[:, :1], (data.z + data.u)[:, :-1]], axis=1)
        starts = data.counted_starts
        return Circumstances(
            place=before[starts],
            command=lagged_commands(data.u)[starts],
            time=data.time[starts],
            order=data.order[starts],
            away=_commands_away_from_ends(data, before)[starts],
        )

    def innovations(self, model: Contender) -> tuple[Floats, Floats]:
        """(S, T) innovations [rad or m] without drift of the sensor, and their relative stds.

        A wandering error would follow a part that lags behind: the missing effect would be taken as noise.
        """
        fit = self.competition.fitting.improved([model.fit.without(_WANDER)], _ROUNDS)[0]
        error, variance = (values[0] for values in errors(self.data, [fit.hypotheses(fit.vector[None])], "filter"))
        return error, np.asarray(np.sqrt(variance / np.mean(variance[self.data.counted])))

    def _innovation_test(self, model: Contender) -> ResidualTest | None:
        """The less significant of two innovation tests: a drifting error is noise, and may mask a missing effect."""
        wandering = self.errors(model, "filter"), self.spread(model)
        size = float(np.sqrt(np.mean(self._predicted(model, "filter")[1][self.data.counted])))
        tests = [self._tested_innovations(*innovations, size) for innovations in (self.innovations(model), wandering)]
        decided = [test for test in tests if test is not None]
        return max(decided, key=lambda test: min(test.probability, test.least), default=None)

    def _tested_innovations(self, error: Floats, spread: Floats, size: float) -> ResidualTest | None:
        """Innovation test of errors (S, T); its share is reduced where they are smaller than the model's std `size`."""
        starts = self.data.counted_starts
        innovations = error / spread
        past = np.stack([earlier_rows(innovations, k) for k in range(LAGS)], axis=-1)
        past[:, :LAGS] = 0.0
        under = replace(self._circumstances, errors=past[starts], spread=earlier_rows(spread, -1)[starts])
        test = whiteness_test(earlier_rows(innovations, -1)[starts][:, None], under)
        mean_square = float(np.mean(innovations[self.data.counted] ** 2))
        return test and replace(test, share=test.share * min(mean_square / size**2, 1.0))


def _floor(model: Contender, data: CoordinateData, kind: Kind, as_written: CoordinateData) -> float:
    """Root mean square of the predicted error [rad or m], with the variance of the t distribution.

    The difference between predictions from recorded and from averaged commands also counts as an error.
    """
    hypothesis, freedom = [model.fit.hypotheses(model.fit.vector[None])], model.fit.freedom
    error, variance = errors(data, hypothesis, kind)
    square = freedom / (freedom - 2.0) * float(np.mean(variance[0, data.counted]))
    if as_written is not data:
        changed = errors(as_written, hypothesis, kind)[0] - error
        square += float(np.mean(changed[0, data.counted] ** 2))
    return float(np.sqrt(square))


def _commands_away_from_ends(data: CoordinateData, place: Floats) -> Floats:
    """(S, T, 2) commands away from the lower and the upper end, where the part is close to it."""
    reach = NEAR_STDS * data.blur * np.sqrt(data.noise)
    at_low, at_high = place < data.lower + reach, place > data.upper - reach
    return np.stack([at_low * np.maximum(data.u, 0.0), at_high * np.minimum(data.u, 0.0)], axis=-1)
