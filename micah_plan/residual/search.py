"""Models of one coordinate compared by what they predict of rows that they were not fitted to.

**Candidates.** The forms of effects as candidates in a coordinate's data, where each form says that its search begins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.special import chdtrc

from micah_plan.arrays import NEAR_STDS, Booleans, Floats, Ints
from micah_plan.automaton.effects.forces import SMOOTH_BUMPS
from micah_plan.automaton.effects.form import EffectForm, FitStart
from micah_plan.automaton.effects.registry import form, forms
from micah_plan.automaton.effects.value import Effect
from micah_plan.residual.compared_runs import acts
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.fit import (
    Fit,
    FitProblem,
    held_out,
    independent_share,
    intervals,
    measurement_share,
    optimise,
    process_share,
)
from micah_plan.residual.likelihood import TIE, log_density
from micah_plan.residual.residual_test import LAGS, Circumstances, ResidualTest, lagged, whiteness_test
from micah_plan.residual.simulation import GATES, Kind, Model, Term, columns, simulate_terms

FOLDS = 5
_ROUNDS = 12
_KEPT_STARTS = 2
# Likelihood that a part must add to be cross-validated [nats].
_HOPELESS = 1.5
_FOLD_ROUNDS = 4
_POLISH_ROUNDS = 5
_START_SHARES = (-1.0, 2.0)
_FREEDOMS = (60.0, 10.0, 4.0)
_MOTION_NOISES = (0.0, 0.6, 0.97)
# Half of a difference quotient, as a share of what is large for a parameter.
_SLOPE_STEP = 0.01
# The prior of a parameter is this many times wider than what is large for it: it only keeps searches from wandering.
_LOOSE = 20.0


@dataclass(frozen=True, eq=False)
class Scored:
    """A model, fitted to everything and, for its score, to each fold's other segments.

    Attributes:
        parts: its candidates; the starts of each are what was fitted to all segments, (1, size).
        fit: to all segments; folds: (K fits) to all but one fold's.
        density: (S,) log predictive density of each segment, held out [nats].
        without_last: (S,) the same without what the last part does, all else being equal; with it without parts.
        squared: sum of squared innovations, held out, each by its precision under the model as it is.
        is_idle: whether it fits hardly better than a simpler model; folds and density are then that one's.
    """

    parts: tuple[TermCandidate, ...]
    fit: Fit
    folds: Fit
    density: Floats
    without_last: Floats
    squared: float
    is_idle: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.parts)

    def over(self, rival: Scored) -> tuple[float, float]:
        """By how much it predicts better than another, and the standard error of that over segments [nats]."""
        gain = self.density - rival.density
        error = float(np.std(gain, ddof=1) * np.sqrt(len(gain))) if len(gain) > 1 else 0.0
        return float(gain.sum()), error


class Search:
    """Fits models to a coordinate's data, each once.

    Attributes:
        nominal: the model that effects are added to: as it is, or with commands that are places (see `trace`).
        given: the effects that the model has already, with their values; no part of what is scored here.
        smoothed: models with the smooth correction, by those without: each is fitted once.
    """

    def __init__(self, data: CoordinateData) -> None:
        self.data = data
        self.given: Model = tuple(Term(form(effect.name), effect.modes) for effect in data.effects)
        self._given = np.array([v for effect in data.effects for v in (*effect.values, *gates_of(effect, data))])[None]
        self.freedom = _FREEDOMS[0]
        self._rolled: dict[Scored, Floats] = {}
        self.smoothed: dict[Scored, Scored] = {}
        self._left: dict[Scored, ResidualTest | None] = {}
        runs = {run: number for number, run in enumerate(np.unique(data.run).tolist())}
        count = len(data.run)
        self.folds = min(FOLDS, count)
        by_run = len(runs) >= FOLDS
        number = np.array([runs[run] for run in data.run.tolist()]) if by_run else np.arange(count)
        self.fold: Ints = number % self.folds
        self.data, self.freedom = self._suited_noise()
        self._spread = self._precision()
        self.nominal = self.score(())

    def _precision(self) -> Floats:
        """(S, T) relative stds of innovations under the model as it is."""
        problem = self.problem(())
        fit = optimise(problem, self._starts(()), np.full(1, _START_SHARES[0]), self._all(1), _ROUNDS)
        return _spread(problem, fit)

    def leads_to_places(self, scored: Scored) -> bool:
        """Whether commands are places to the model."""
        terms = (*self.given, *(part.term for part in scored.parts))
        return any(term.form.layer == "place" for term in terms)

    def score(self, parts: Sequence[TermCandidate], base: Scored | None = None) -> Scored:
        """Fit a model from all starts of its last part with the first start of the others.

        Args:
            base: a simpler model; one that fits hardly better than it is not looked at further and scores as it does.
        """
        problem = self.problem(parts)
        start = self._starts(parts)
        share = float(base.fit.share[0]) if base is not None else _START_SHARES[0]
        first = optimise(problem, start, np.full(len(start), share), self._all(len(start)), _ROUNDS // 4)
        kept = first.best(_KEPT_STARTS)
        fit = optimise(problem, kept.parameters, kept.share, self._all(len(kept.loss)), _ROUNDS).best()
        if base is not None and float(base.fit.loss[0] - fit.loss[0]) < _HOPELESS:
            fitted = self._fitted(parts, fit)
            return Scored(fitted, fit, base.folds, base.density, base.density, base.squared, is_idle=True)
        # Once more from other shares of noise: what is process and what measurement noise has several optima.
        again = np.repeat(fit.parameters, len(_START_SHARES) + 1, axis=0)
        shares = np.array([float(fit.share[0]), *_START_SHARES])
        fit = optimise(problem, again, shares, self._all(len(again)), _POLISH_ROUNDS).best()
        return self._cross_validated(problem, parts, fit)

    def _all(self, count: int) -> Booleans:
        return np.ones((count, len(self.data.run)), dtype=bool)

    def errors(self, scored: Scored, kind: Kind) -> Floats:
        """(S, T) measured minus predicted, each segment with the parameters fitted without its fold."""
        _, errors = held_out(self.problem(scored.parts), scored.folds, kind)
        return np.asarray(errors[self.fold, np.arange(len(self.fold))])

    def rollout_errors(self, scored: Scored) -> Floats:
        """(N,) measured minus predicted from each run's first row on, by parameters fitted without a row's fold."""
        whole = self.data.whole
        if whole is None or whole.segment is None:
            return self.errors(scored, "rollout")[self.data.counted]
        if scored not in self._rolled:
            problem = replace(self.problem(scored.parts), data=whole)
            _, errors = held_out(problem, scored.folds, "rollout")
            runs, rows = np.nonzero(whole.counted)
            self._rolled[scored] = np.asarray(errors[self.fold[whole.segment[runs, rows]], runs, rows])
        return self._rolled[scored]

    def innovations(self, scored: Scored) -> Floats:
        """(S, T) innovations, held out as in `errors`."""
        return self.errors(scored, "filter")

    def spread(self, scored: Scored) -> Floats:
        """(S, T) std of an innovation over that of all rows that count: what makes innovations equally precise."""
        return _spread(self.problem(scored.parts), scored.fit)

    def one_step_squares(self, scored: Scored) -> float:
        """Sum of squared one-step errors, held out, each by its row's precision under the model as it is."""
        return float(np.sum((self.errors(scored, "one_step") / self._spread) ** 2))

    def noise_floor(self, scored: Scored) -> float:
        """Root mean square of a one-step error that noise alone would leave, if this model were true.

        The noise is what no regression takes out of the model's innovations; an error from one measured row to the next
        contains the measurement noise twice, the innovation of a filter less than that.
        """
        innovations = self.innovations(scored)[self.data.counted]
        residual = self.left_by(scored)
        innovation = float(np.mean(innovations**2)) * (1.0 - (residual.share if residual is not None else 0.0))
        r = float(measurement_share(scored.fit.share)[0])
        q = (1.0 - r) * float(np.mean(self.data.process_profile[self.data.counted_starts]))
        p = steady_variance(q, r)
        return float(np.sqrt(innovation * (q + 2.0 * r) / (p + r)))

    def rollout_floor(self, scored: Scored, one_step: float) -> float:
        """Root mean square of a roll-out's error that noise alone would leave, given that of one step.

        What moves the part adds up from the first row on, as far as the model lets it: ends and places bring it back.
        """
        problem, data = self.problem(scored.parts), self.data.whole or self.data
        simulation = simulate_terms(
            data, problem.model, scored.fit.parameters, process_share(scored.fit.share), "rollout"
        )
        share = process_share(scored.fit.share)[0]
        step = 2.0 * (1.0 - share) + share * float(np.mean(self.data.process_profile[self.data.counted_starts]))
        return one_step * float(np.sqrt(np.mean(simulation.variance[0][data.counted]) / step))

    def correlations_of(self, scored: Scored) -> tuple[tuple[str, ...], Floats]:
        """Names of the fitted parameters (k) of a model, and the correlation (k, k) of their errors.

        From the slopes of the innovations, each in units of its std; the priors count as they do in the fit.
        """
        problem, k = self.problem(scored.parts), len(self.problem(scored.parts).free)
        labels = [part.name if np.isneginf(part.starts[0, -GATES]) else f"{part.name}, later" for part in scored.parts]
        names = [
            f"{part.term.form.parameters[j].name} of {label}"
            for part, label in zip(scored.parts, labels, strict=True)
            for j in part.free
        ]
        if not k:
            return (), np.zeros((0, 0))
        rows = np.repeat(scored.fit.parameters, 2 * k, axis=0)
        for j, column in enumerate(problem.free):
            rows[2 * j : 2 * j + 2, column] += _SLOPE_STEP * problem.scale[j] * np.array([1.0, -1.0])
        simulation = simulate_terms(self.data, problem.model, rows, np.repeat(process_share(scored.fit.share), 2 * k))
        errors = (simulation.error / np.sqrt(simulation.variance) / float(scored.fit.scale[0])).reshape(
            k, 2, self.data.z.size
        )
        slopes = (errors[:, 0] - errors[:, 1]) / (2.0 * _SLOPE_STEP)
        covariance = np.linalg.inv(slopes @ slopes.T + np.eye(k) / problem.looseness**2)
        std = np.sqrt(np.diag(covariance))
        return tuple(names), np.asarray(covariance / np.outer(std, std))

    def begins(self, scored: Scored) -> tuple[float, float]:
        """The place in the recording, and the time in every run, since when the last part of a model acts most likely.

        Rows before are as likely as without it, those after it as with it (Hinkley, Biometrika 1970). That something
        changed between two runs is as likely beforehand as that it did within one.
        """
        problem, data = self.problem(scored.parts), self.data
        always_and_never = np.repeat(scored.fit.parameters, 2, axis=0)
        always_and_never[:, -GATES:] = [[-np.inf, -np.inf], [np.inf, -np.inf]]
        share, scale = process_share(np.repeat(scored.fit.share, 2)), np.repeat(scored.fit.scale, 2)
        density = log_density(simulate_terms(data, problem.model, always_and_never, share), scale, problem.freedom)
        # A step starts in the row before the one whose likelihood tells.
        starts = data.counted_starts
        gain = np.roll(density[0] - density[1], -1, axis=1)[starts]
        run = np.broadcast_to(data.run[:, None], starts.shape)[starts]
        prior, first = np.zeros(len(run)), np.unique(run, return_index=True)[1]
        prior[first] = np.log(len(run) / len(first))
        return _most_gained_since(data.order[starts], gain, prior), _most_gained_since(data.time[starts], gain)

    def intervals(self, scored: Scored) -> Floats:
        """(k, 3) interval and median of each free parameter, in the order of the parts; see `fit.intervals`."""
        correlation = self._correlations(scored)[0][0]
        return intervals(self.problem(scored.parts), scored.fit, independent_share(correlation))

    def problem(self, parts: Sequence[TermCandidate]) -> FitProblem:
        """What there is to fit of a model."""
        free, scale, center, lower, upper = [], [], [], [], []
        at = columns(self.given)
        for part in parts:
            for column, large in zip(part.free, part.scale, strict=True):
                parameter = part.term.form.parameters[column]
                free.append(at + column)
                scale.append(large)
                center.append(part.starts[0, column] if parameter.neutral is None else parameter.neutral)
                low, high = part.bounds.get(column, (-np.inf, np.inf))
                lower.append(max(parameter.lower, low))
                upper.append(min(parameter.upper, high))
            at += part.term.size
        tight = any(part.name == UNNAMED for part in parts)
        return FitProblem(
            data=self.data,
            model=(*self.given, *(part.term for part in parts)),
            free=np.array(free, dtype=np.int64),
            scale=np.array(scale),
            center=np.array(center),
            lower=np.array(lower),
            upper=np.array(upper),
            looseness=1.0 if tight else _LOOSE,
            freedom=self.freedom,
        )

    def _starts(self, parts: Sequence[TermCandidate]) -> Floats:
        before = [self._given, *(part.starts[:1] for part in parts[:-1])]
        last = parts[-1].starts if parts else np.zeros((1, 0))
        return np.hstack([*(np.repeat(row, len(last), axis=0) for row in before), last])

    def whiteness(self, scored: Scored) -> tuple[float, float]:
        """Largest autocorrelation of the innovations at lags 1 to 4, and its probability if they were white.

        Source: Ljung and Box, Biometrika 1978, for residuals of a fitted model.
        """
        correlations = [correlation for correlation in self._correlations(scored) if correlation[1] > 10]
        if not correlations:
            return 0.0, 1.0
        statistic = sum(r * r * count for r, count in correlations)
        return max((r for r, _ in correlations), key=abs), float(chdtrc(len(correlations), statistic))

    def _correlations(self, scored: Scored) -> list[tuple[float, int]]:
        """Autocorrelation of the innovations and number of pairs at each of the lags 1 to 4."""
        counted = self.data.counted
        error = self.innovations(scored) / self.spread(scored) * counted
        mean_square = float((error**2).sum()) / counted.sum()
        findings = []
        for lag in range(1, 5):
            pairs = counted[:, lag:] & counted[:, :-lag]
            product = float((error[:, lag:] * error[:, :-lag])[pairs].sum())
            count = int(pairs.sum())
            findings.append((product / count / mean_square if count and mean_square > 0 else 0.0, count))
        return findings

    def left_by(self, scored: Scored) -> ResidualTest | None:
        """What the innovations follow: commands, places, time, and innovations before them."""
        if scored not in self._left:
            self._left[scored] = self._left_by(scored)
        return self._left[scored]

    def _left_by(self, scored: Scored) -> ResidualTest | None:
        data = self.data
        # A place that the innovation's own measurements have no part in: from the row before.
        before = np.concatenate([data.z[:, :1], (data.z + data.u)[:, :-1]], axis=1)
        starts = data.counted_starts
        spread = self.spread(scored)
        innovations = self.innovations(scored) / spread
        past = np.stack([np.roll(innovations, k, axis=1) for k in range(LAGS)], axis=-1)
        past[:, :LAGS] = 0.0
        under = Circumstances(
            place=before[starts],
            command=lagged(data.u)[starts],
            time=data.time[starts],
            order=data.order[starts],
            errors=past[starts],
            away=_away(data, before)[starts],
            spread=np.roll(spread, -1, axis=1)[starts],
        )
        return whiteness_test(np.roll(innovations, -1, axis=1)[starts][:, None], under)

    def residual_is_white(self, scored: Scored) -> bool:
        """Whether the innovations neither follow anything nor are correlated: then nothing can be added."""
        residual = self.left_by(scored)
        return residual is not None and residual.is_noise

    def _cross_validated(self, problem: FitProblem, parts: Sequence[TermCandidate], fit: Fit) -> Scored:
        trained = self.fold[None, :] != np.arange(self.folds)[:, None]
        if not trained.any(axis=1).all():
            trained = np.ones_like(trained)
        start = np.repeat(fit.parameters, self.folds, axis=0)
        folds = optimise(problem, start, np.repeat(fit.share, self.folds), trained, _FOLD_ROUNDS)
        density, errors = held_out(problem, folds)
        rows = np.arange(len(self.fold))
        squared = float(((errors[self.fold, rows] / self._spread) ** 2).sum())
        without = density
        if parts:
            size = parts[-1].term.size
            fewer = replace(folds, parameters=folds.parameters[:, :-size])
            without = held_out(replace(problem, model=problem.model[:-1]), fewer)[0]
        held_density, without = density[self.fold, rows], without[self.fold, rows]
        return Scored(self._fitted(parts, fit), fit, folds, held_density, without, squared)

    def density_by_run(self, scored: Scored) -> Floats:
        """(R,) log predictive density of each run, by parameters fitted to the other runs alone [nats]."""
        runs = np.unique(self.data.run)
        of_run = self.data.run[None, :] == runs[:, None]
        start = np.repeat(scored.fit.parameters, len(runs), axis=0)
        fits = optimise(
            self.problem(scored.parts), start, np.repeat(scored.fit.share, len(runs)), ~of_run, _FOLD_ROUNDS
        )
        return np.asarray(np.sum(held_out(self.problem(scored.parts), fits)[0] * of_run, axis=1))

    def _fitted(self, parts: Sequence[TermCandidate], fit: Fit) -> tuple[TermCandidate, ...]:
        fitted, at = [], columns(self.given)
        for part in parts:
            fitted.append(replace(part, starts=fit.parameters[:, at : at + part.term.size]))
            at += part.term.size
        return tuple(fitted)

    def _suited_noise(self) -> tuple[CoordinateData, float]:
        """The data with the kind of noise, and the degrees of freedom, that suit what a smooth correction leaves."""
        best: tuple[float, CoordinateData, float] | None = None
        part = smooth(self.data)
        problem = self.problem((part,))
        share, start, rounds = np.zeros(1), self._starts((part,)), 4
        noisy = [self.data.with_noise(motion) for motion in _MOTION_NOISES]
        if np.ptp(self.data.noise):  # something else than the model's sensor may have measured
            noisy.append(self.data.with_noise(0.0, is_alike=True))
        for data, freedom in product(noisy, _FREEDOMS):
            suited = replace(problem, data=data, freedom=freedom)
            fit = optimise(suited, start, share, self._all(1), rounds)
            share, start, rounds = fit.share, fit.parameters, 2  # the next kind of noise changes little
            if best is None or fit.loss[0] < best[0] - TIE:
                best = float(fit.loss[0]), data, freedom
        return (self.data, self.freedom) if best is None else best[1:]


def _most_gained_since(at: Floats, gain: Floats, prior: float | Floats = 0.0) -> float:
    """From which of the values (n,) on the gains (n,) add up to most, with a log prior of each value."""
    order = np.argsort(-at, kind="stable")
    last = np.append(np.diff(at[order]) < 0.0, True)
    total = np.cumsum(gain[order]) + np.broadcast_to(prior, at.shape)[order]
    return float(at[order][last][np.argmax(total[last])])


def steady_variance(q: float, r: float) -> float:
    """The variance before a measurement, in the long run, of a sum of steps of variance q measured with variance r.

    The positive root of the scalar Riccati equation p = p r / (p + r) + q.
    """
    return float(0.5 * (q + np.sqrt(q * q + 4.0 * q * r)))


def _spread(problem: FitProblem, fit: Fit) -> Floats:
    variance = simulate_terms(problem.data, problem.model, fit.parameters, process_share(fit.share)).variance[0]
    return np.asarray(np.sqrt(variance / np.mean(variance[problem.data.counted])))


def _away(data: CoordinateData, place: Floats) -> Floats:
    """(S, T, 2) commands that lead away from the lower and the upper end, where a part is within the blur of it."""
    reach = NEAR_STDS * data.blur * np.sqrt(data.noise)
    at_low, at_high = place < data.lower + reach, place > data.upper - reach
    return np.stack([at_low * np.maximum(data.u, 0.0), at_high * np.minimum(data.u, 0.0)], axis=-1)


def gated(part: TermCandidate, since_order: Sequence[float], since_time: Sequence[float]) -> TermCandidate:
    """A candidate that acts only since a place or a time, each of its starts since each of them."""
    gates = [(order, NEVER_GATED[1]) for order in since_order] + [(NEVER_GATED[0], time) for time in since_time]
    starts = np.repeat(part.starts, len(gates), axis=0)
    starts[:, -GATES:] = np.tile(gates, (len(part.starts), 1))
    return replace(part, starts=starts)


NEVER_GATED = (-np.inf, -np.inf)


def gates_of(effect: Effect, data: CoordinateData) -> tuple[float, float]:
    """From which place in a recording and which time in a run an effect of the model acts."""
    since = effect.since
    if since is None:
        return NEVER_GATED
    if since.run is None:
        return -np.inf, since.time
    acting = np.stack([acts(since, run, time) for run, time in zip(data.run.tolist(), data.time, strict=True)])
    return float(data.order[acting & data.counted_starts].min(initial=np.inf)), -np.inf


# The form of a correction without a name.
UNNAMED = "unexplained"


@dataclass(frozen=True, eq=False)
class TermCandidate:
    """A term with starts for its parameters.

    Attributes:
        starts: (M, size) parameters with gates; those that are not free differ between starts only.
        free: columns within the term that are fitted.
        scale: (k,) what a large value of each of those is.
        bounds: (lower, upper) of columns that the data bound more than the form does: beyond them it would be another
            effect (a spring whose rest position is far away is a bias).
    """

    term: Term
    starts: Floats
    free: tuple[int, ...]
    scale: Floats
    bounds: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.term.form.name


def candidates(data: CoordinateData) -> tuple[TermCandidate, ...]:
    """All forms that the data can show, each acting always and everywhere."""
    possible = []
    for effect_form in forms():
        made = effect_form.begun(data) if effect_form.is_sought and effect_form.same_as(data) is None else None
        if made is not None:
            possible.append(_candidate(effect_form, made))
    return tuple(possible)


def untried(name: str, data: CoordinateData) -> TermCandidate:
    """A form that was not tried since it would do the same as another (`indistinguishable`)."""
    return _candidate(form(name), form(name).from_neutral(data))


def _candidate(effect_form: EffectForm, made: FitStart) -> TermCandidate:
    starts = np.atleast_2d(made.values)
    full = np.hstack([starts, np.tile(NEVER_GATED, (len(starts), 1))])
    return TermCandidate(Term(effect_form), full, made.free, np.asarray(made.scale, dtype=float), made.bounds)


def indistinguishable(part: TermCandidate, data: CoordinateData) -> tuple[str, ...]:
    """Forms that were not tried because in these data they would do exactly the same as another; plainest first."""
    same = []
    for effect_form in sorted(forms(), key=lambda effect_form: effect_form.complexity_rank):
        equivalent = effect_form.same_as(data) if effect_form.is_sought else None
        if equivalent is not None and equivalent.name == part.name and abs(part.starts[0, 0]) < equivalent.below:
            same.append(effect_form.name)
    return tuple(same)


def smooth(data: CoordinateData, *, is_lean: bool = False) -> TermCandidate:
    """The correction without a name: a smooth function of configuration, direction and speed of the command.

    Args:
        is_lean: fit only what depends on the command alone.
    """
    low, high = data.visited
    margin = 0.02 * (high - low) + 1e-6
    size = data.command_size
    start = [low - margin, high - low + 2 * margin, size, *(0.0,) * (3 + 2 * SMOOTH_BUMPS), *NEVER_GATED]
    free = tuple(range(3, 6 if is_lean else 6 + 2 * SMOOTH_BUMPS))
    scale = [0.3, 0.5, 0.5 * size, *(0.5 * size,) * SMOOTH_BUMPS, *(0.5,) * SMOOTH_BUMPS]
    return TermCandidate(Term(form(UNNAMED)), np.array([start]), free, np.array(scale[: len(free)]))
