"""Maximum-a-posteriori fits of many hypotheses at once, and their evidence by Laplace's method.

Fisher scoring on exact log densities with difference quotients of innovations and variances, and in each round a line
search in every single parameter, which also works at kinks and plateaus (thresholds). The evidence is Laplace's
approximation; the evidence of a group of runs under the parameters of the others comes from one Newton step without it.

Sources: Segal and Weinstein, "A new method for evaluating the log-likelihood gradient, the Hessian, and the Fisher
information matrix for linear dynamic systems", IEEE Trans. Inf. Theory 1989; Kass and Raftery, "Bayes factors", JASA
1995 (Laplace); Rad and Maleki, JRSS B 2020 (approximate leave-one-out).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from micah_plan.arrays import ROUND_OFF, Booleans, Floats, Ints
from micah_plan.residual.candidates import Model, columns
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.filtering import NOISE, STDS, ModelBatch, Rows, filtered, of_rows

# Step of a difference quotient, and of the search along each parameter at first, in units of what is large for it.
_SLOPE_STEP, _FIRST_STEP = 0.01, 0.02
# From so many parameters on a quotient is one-sided, and there is no search along each.
_MANY = 10
# Parts of a step that are tried: thresholds need the short ones, and noise that is much too large the long one, though
# innovations tell it too (`_Climb._along`): without it four of 17 machines (`benchmarks machines`) end in other optima.
_LINE = np.array([1.0, 4.0, 0.3, 0.08])
NORMAL = 60.0
"""Degrees of freedom of noise without outliers."""
# Gains [nats] below which a round has failed, and below which it was the last.
_FAILED, _DONE = 0.02, 0.1
_MOST_FAILURES = 2
# Gains of later rounds together, over that of the last: steps of Fisher scoring get shorter.
_FORESEEN = 5.0
# Other values of a parameter that are tried at the end of a climb, in shares of its large value.
_JUMPS = np.concatenate([side * 0.5 ** np.arange(1, 10) for side in (1.0, -1.0)])
ENOUGH_INDEPENDENT = 5
"""Runs, or motions of the only run, from which on what rows show is evidence."""
# Groups of runs, or of rows of few runs, that are held out.
_GROUPS_OF_RUNS, _GROUPS_OF_ROWS = 12, 10


@dataclass(frozen=True, eq=False)
class Free:
    """Free entries of a hypothesis (k,): those of the model first, then the noise.

    Attributes:
        at: columns of the values with the noise behind them.
        scale: a large value. low, high: bounds. centre, std: of a normal prior.
        of_model: how many are of the model.
        odds: log odds against the model beforehand [nats].
    """

    at: Ints
    scale: Floats
    low: Floats
    high: Floats
    centre: Floats
    std: Floats
    of_model: int
    odds: float = 0.0


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis with its free entries and loss.

    Attributes:
        model: terms. vector: values of the terms, then the noise.
        free: fitted parameters. freedom: degrees of freedom of the t distribution.
        loss: negative log density of all rows and of the prior [nats].
    """

    model: Model
    vector: Floats
    free: Free
    freedom: float
    loss: float = np.inf

    @property
    def values(self) -> Floats:
        """(1, columns) parameter values of the terms."""
        return self.vector[None, : columns(self.model)]

    @property
    def noise(self) -> Floats:
        """Noise parameters, in the order of `filtering.NOISE`."""
        return self.vector[-len(NOISE) :]

    def without(self, number: int) -> Fit:
        """The fit without one of the stds of `filtering.NOISE`; its variance is added to the white noise."""
        first, first_of_noise = len(self.vector) - len(NOISE), self.free.of_model
        vector, kept = self.vector.copy(), np.delete(np.arange(len(self.free.at)), first_of_noise + number)
        vector[first] = 0.5 * np.logaddexp(2.0 * vector[first], 2.0 * vector[first + number])
        vector[first + number] = -np.inf
        free = {name: getattr(self.free, name)[kept] for name in ("at", "scale", "low", "high", "centre", "std")}
        return replace(self, vector=vector, free=replace(self.free, **free), loss=np.inf)

    def with_noise(self, logs: Floats) -> Fit:
        """The fit with other log stds (`filtering.STDS`), within their bounds."""
        entries, first = slice(self.free.of_model, self.free.of_model + len(STDS)), len(self.vector) - len(NOISE)
        vector = self.vector.copy()
        vector[first : first + len(STDS)] = np.clip(logs, self.free.low[entries], self.free.high[entries])
        return replace(self, vector=vector, loss=np.inf)

    def hypotheses(self, vectors: Floats) -> ModelBatch:
        """The model's hypotheses for vectors (B, ...)."""
        count = columns(self.model)
        return ModelBatch(self.model, vectors[:, :count], vectors[:, count:], np.full(len(vectors), self.freedom))

    def penalty(self, vectors: Floats) -> Floats:
        """(B,) negative log prior, up to its constant."""
        away = (vectors[:, self.free.at] - self.free.centre) / self.free.std
        return np.asarray(0.5 * (away**2).sum(axis=1))

    def moved(self, jumps: Floats) -> Floats:
        """(B, ...) vectors with the free entries displaced by jumps (B, k), within their bounds."""
        vectors = np.repeat(self.vector[None], len(jumps), axis=0)
        k = jumps.shape[1]
        at = self.free.at[:k]
        vectors[:, at] = np.clip(self.vector[at] + jumps, self.free.low[:k], self.free.high[:k])
        return vectors


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Rows of one hypothesis, and their difference quotients by its first k free entries.

    Attributes:
        tried: vectors whose losses were needed for the quotients, its own first; losses: of these.
        gradient: (k,) of the log density of all rows.
        scores: (k, 2 N) quotients of innovations, then of the logs of variances, each times the root of its Fisher
            information.
        root: (N,) of that information of innovations.
        innovations, variance: (N,) themselves. freedom: of the t distribution.
        rows: of all tried vectors; at: indices of those in `tried`.
        below: (k,) indices in `tried` that the quotients start from; per_width: (k,) inverses of the differences.
    """

    tried: Floats
    losses: Floats
    gradient: Floats
    scores: Floats
    root: Floats
    innovations: Floats
    variance: Floats
    freedom: float
    rows: Rows
    at: slice
    below: Ints
    per_width: Floats

    def by_row(self) -> tuple[Floats, Floats]:
        """(k, N) gradients of each row's log density, and (N,) the log density."""
        density = self.rows.density(self.at)
        return (density[1 : len(self.below) + 1] - density[self.below]) * self.per_width[:, None], density[0]

    def spread(self, jump: Floats | None = None) -> float:
        """Log root mean square of normalised innovations, here or after a jump of the first entries."""
        if jump is None:
            return _spread(self.innovations, self.variance, self.freedom)
        changed = (jump @ self.scores[: len(jump), : len(self.root)]) / self.root
        return _spread(self.innovations + changed, self.variance, self.freedom)

    @cached_property
    def information(self) -> Floats:
        """(k, k) Fisher information of all rows."""
        return np.asarray(self.scores @ self.scores.T)

    def information_of(self, rows: Booleans) -> Floats:
        """(k, k) Fisher information of some rows (N,)."""
        scores = self.scores[:, np.concatenate([rows, rows])]
        return np.asarray(scores @ scores.T)


class Fitting:
    """Fits hypotheses to the rows of a coordinate.

    Attributes:
        group: (S,) of each segment: groups are held out from each other.
    """

    def __init__(self, data: CoordinateData, group: Ints | None = None) -> None:
        self.data = data
        self.group = groups(data) if group is None else group
        self._without_each: dict[Weighed, Floats] = {}

    @cached_property
    def group_of_rows(self) -> Ints:
        """(N,) group of each row that counts."""
        return of_rows(self.data, self.group)

    def losses(self, fits: Sequence[Fit], vectors: Sequence[Floats]) -> list[Floats]:
        """Losses of vectors (b, ...) for each fit."""
        if not fits:
            return []
        batches = [fit.hypotheses(tried) for fit, tried in zip(fits, vectors, strict=True)]
        rows = filtered(self.data, batches, [0] * len(fits))
        sums = np.split(-rows.total, np.cumsum([len(tried) for tried in vectors])[:-1])
        return [fit.penalty(tried) + total for fit, tried, total in zip(fits, vectors, sums, strict=True)]

    def started(self, fits: Sequence[Fit]) -> list[Fit]:
        """The fits with their losses evaluated."""
        losses = self.losses(fits, [fit.vector[None] for fit in fits])
        return [replace(fit, loss=float(loss[0])) for fit, loss in zip(fits, losses, strict=True)]

    def with_jumps(self, fit: Fit, count: int) -> list[Fit]:
        """The `count` likeliest fits among those with one model parameter displaced by small or large jumps."""
        k = fit.free.of_model
        if not k:
            return []
        jumps = (_JUMPS[:, None, None] * np.diag(fit.free.scale[:k])).reshape(-1, k)
        vectors = fit.moved(jumps)
        (losses,) = self.losses([fit], [vectors])
        return [replace(fit, vector=vectors[i]) for i in np.argsort(losses, kind="stable")[:count]]

    def improved(
        self, fits: Sequence[Fit], rounds: int, *, is_noise_free: bool = True, within: float = np.inf
    ) -> list[Fit]:
        """Fits improved by at most `rounds` iterations, over model and noise or over the model only.

        Args:
            within: a fit that would stay so far behind the best if all its rounds were like its last is left [nats].
        """
        climbs = [_Climb(fit, len(fit.free.at) if is_noise_free else fit.free.of_model) for fit in fits]
        live = [climb for climb in climbs if climb.count and rounds]
        for further in range(rounds, -1, -1):
            if not live:
                break
            asked = [climb.asked() for climb in live]
            slopes, losses = self._slopes(
                [climb.fit for climb in live], [climb.steps for climb in live], asked, [climb.line for climb in live]
            )
            live = [
                climb for climb, slope, line in zip(live, slopes, losses, strict=True) if climb.advance(slope, line)
            ]
            best = min(climb.fit.loss for climb in climbs)
            live = [climb for climb in live if climb.fit.loss - min(further, _FORESEEN) * climb.gain < best + within]
        return [climb.fit for climb in climbs]

    def weighed(self, fits: Sequence[Fit]) -> list[Weighed]:
        """The fits with their evidence and what held-out predictions need."""
        if not fits:
            return []
        none = [fit.vector[None][:0] for fit in fits]
        steps, vectors = [_SLOPE_STEP * fit.free.scale for fit in fits], [fit.vector for fit in fits]
        slopes, _ = self._slopes(fits, steps, vectors, none)
        return [self._weighed(fit, of_fit) for fit, of_fit in zip(fits, slopes, strict=True)]

    def _weighed(self, fit: Fit, slopes: _Slopes) -> Weighed:
        group = self.group_of_rows
        every = [group == number for number in range(int(self.group.max()) + 1)]
        gradient, density = slopes.by_row()
        information = np.array([slopes.information_of(rows) for rows in every])
        free = fit.free
        hessian = information.sum(axis=0) + np.diag(1.0 / free.std**2)
        loss = float(slopes.losses[0])
        determinant = float(np.linalg.slogdet(hessian)[1]) + 2.0 * float(np.log(free.std).sum())
        return Weighed(
            fit=replace(fit, loss=loss),
            evidence=-loss - 0.5 * determinant - free.odds,
            hessian=hessian,
            information=information,
            pull=np.array([gradient[:, rows].sum(axis=1) for rows in every]),
            density=np.array([density[rows].sum() for rows in every]),
        )

    def without_each(self, weighed: Weighed) -> Floats:
        """(G, ...) vectors after one Newton step that removes each group, accepted as far as the other groups allow."""
        if weighed not in self._without_each:
            self._without_each[weighed] = self._newton_step(weighed)
        return self._without_each[weighed]

    def _newton_step(self, weighed: Weighed) -> Floats:
        """(G, P) vectors after one Newton step without each group of runs."""
        fit, free = weighed.fit, weighed.fit.free
        if not len(free.at):
            return np.repeat(fit.vector[None], len(weighed.pull), axis=0)
        x = fit.vector[free.at]
        is_inside = (x > free.low) & (x < free.high)
        damped = weighed.hessian - weighed.information + 1e-6 * np.diag(1.0 / free.scale**2)
        pull = weighed.pull.mean(axis=0) - weighed.pull
        jumps = np.linalg.solve(damped, pull[:, :, None])[:, :, 0] * is_inside
        jumps = np.clip(jumps, -free.scale, free.scale)
        tried = np.concatenate([fit.moved(jumps), fit.moved(0.3 * jumps), fit.moved(0.0 * jumps)])
        count = len(jumps)
        rows = filtered(self.data, [fit.hypotheses(tried[: 2 * count])])
        density = rows.density()
        sums = np.stack([density[:, self.group_of_rows == g].sum(axis=1) for g in range(count)], axis=1)
        sums = np.concatenate([sums, np.repeat(weighed.density[None], count, axis=0)]).reshape(3, count, count)
        each = np.arange(count)
        rest = sums.sum(axis=2) - sums[:, each, each] - fit.penalty(tried).reshape(3, count)
        return np.asarray(tried.reshape(3, count, -1)[rest.argmax(axis=0), each])

    def held_out(self, weighed: Weighed, without: int | None = None) -> Floats:
        """(N,) log density of each row under the parameters of the other groups [nats].

        Args:
            without: column of a gate that is closed: the contribution of its effect is left out, with everything else
                unchanged.
        """
        vectors = self.without_each(weighed).copy()
        if without is not None:
            vectors[:, without] = np.inf
        rows, group = filtered(self.data, [weighed.fit.hypotheses(vectors)]), self.group_of_rows
        return np.asarray(rows.density()[group, np.arange(len(group))])

    def _slopes(
        self,
        fits: Sequence[Fit],
        steps: Sequence[Floats],
        at: Sequence[Floats],
        more: Sequence[Floats],
    ) -> tuple[list[_Slopes], list[Floats]]:
        """Difference quotients of each fit at a vector, and the losses of additional vectors."""
        tried = []
        for fit, step, vector in zip(fits, steps, at, strict=True):
            k = len(step)
            up, down = np.diag(step), -np.diag(step)[: _two_sided(fit, k)]
            tried.append(replace(fit, vector=vector).moved(np.concatenate([np.zeros((1, k)), up, down])))
        every = [np.concatenate(pair) for pair in zip(tried, more, strict=True)]
        batches = [fit.hypotheses(around) for fit, around in zip(fits, every, strict=True)]
        rows = filtered(self.data, batches, [len(around) for around in tried])
        slopes, losses, first, of_rows = [], [], 0, 0
        for fit, around, with_jumps, step in zip(fits, tried, more, steps, strict=True):
            middle, last = first + len(around), first + len(around) + len(with_jumps)
            at_rows = slice(of_rows, of_rows + len(around))
            slopes.append(_quotients(fit, around, rows, at_rows, rows.total[first:middle], len(step)))
            losses.append(fit.penalty(with_jumps) - rows.total[middle:last])
            first, of_rows = last, of_rows + len(around)
        return slopes, losses


def _two_sided(fit: Fit, k: int) -> int:
    """Number of the first k quotients that are two-sided."""
    return min(fit.free.of_model, k) if fit.free.of_model < _MANY else 0


@dataclass(frozen=True, eq=False)
class Weighed:
    """A fit with its evidence.

    Attributes:
        evidence: log probability of the rows, marginalised over the parameters [nats].
        hessian: (k, k) of the loss. information: (G, k, k) Fisher information of each group's rows.
        pull: (G, k) gradient of each group's density; density: (G,) of each group.
    """

    fit: Fit
    evidence: float
    hessian: Floats
    information: Floats
    pull: Floats
    density: Floats


def groups(data: CoordinateData) -> Ints:
    """(S,) group of each segment for cross-validation: its run or, with few runs, its part of the recording."""
    runs, number = np.unique(data.run, return_inverse=True)
    if len(runs) >= ENOUGH_INDEPENDENT:
        return np.asarray(number % _GROUPS_OF_RUNS)
    order = np.argsort(np.argsort(data.order[:, 0], kind="stable"), kind="stable")
    return np.asarray(order * min(_GROUPS_OF_ROWS, len(order)) // len(order))


def _quotients(fit: Fit, tried: Floats, rows: Rows, at_rows: slice, total: Floats, k: int) -> _Slopes:
    two = _two_sided(fit, k)
    error, variance = rows.error[at_rows], rows.variance[at_rows]
    below = np.concatenate([1 + k + np.arange(two), np.zeros(k - two, dtype=np.int64)])
    at, up = fit.free.at[:k], np.arange(1, k + 1)
    width = tried[up, at] - tried[below, at]
    per_width = 1.0 / np.where(np.abs(width) > 1e-300, width, 1e-300)
    freedom, count = fit.freedom, error.shape[1]
    root = np.sqrt((freedom + 1.0) / (freedom + 3.0) / variance[0])
    scores = np.empty((k, 2 * count))
    for values, weight, half in (
        (error, root, scores[:, :count]),
        (variance, np.sqrt(0.5 * freedom / (freedom + 3.0)) / variance[0], scores[:, count:]),
    ):
        np.subtract(values[1 : k + 1], values[below], out=half)
        half *= per_width[:, None]
        half *= weight
    return _Slopes(
        tried=tried,
        losses=fit.penalty(tried) - total,
        gradient=(total[1 : k + 1] - total[below]) * per_width,
        scores=scores,
        root=root,
        innovations=error[0],
        variance=variance[0],
        freedom=freedom,
        rows=rows,
        at=at_rows,
        below=below,
        per_width=per_width,
    )


def _spread(error: Floats, variance: Floats, freedom: float) -> float:
    """Log root mean square of normalised errors, robust (one EM step of Student's t)."""
    squared = error**2 / variance
    mean = float(np.mean((freedom + 1.0) / (freedom + squared) * squared))
    return 0.5 * float(np.log(max(mean, ROUND_OFF)))


def _is_std(fit: Fit) -> Booleans:
    """(m,) whether each free noise entry is a log std."""
    return np.asarray(fit.free.at[fit.free.of_model :] < len(fit.vector) - len(NOISE) + len(STDS))


class _Climb:
    """State of a fit's optimisation.

    Attributes:
        fit: the best so far. count: number of its first entries that are free.
        steps: of the quotients, and of the search along each entry.
        line: (b, ...) vectors that are evaluated together with the one whose quotients are computed.
        gain: of the better of the last two rounds [nats].
    """

    def __init__(self, fit: Fit, count: int) -> None:
        self.fit, self.count = fit, count
        self.steps = _FIRST_STEP * fit.free.scale[:count]
        self.line = fit.vector[None][:0]
        self.gain = self._gain = np.inf
        self._full: Floats | None = None
        self._damping, self._failures = 1e-3, 0
        self._slopes: _Slopes | None = None

    def asked(self) -> Floats:
        """The next vector for difference quotients: a full step ahead or, without one, the present one."""
        return self.fit.vector if self._full is None else self._full

    def advance(self, slopes: _Slopes, losses: Floats) -> bool:
        """Move to the best evaluated point; returns whether further iterations may help."""
        if self._slopes is None:
            self.fit = replace(self.fit, loss=float(slopes.losses[0]))
            if self._full is None and not len(losses):
                self._slopes = slopes
                self._request_step(slopes)
                return True
        before = self.fit.loss
        tried = np.concatenate([slopes.losses, losses, [] if self._slopes is None else self._slopes.losses[1:]])
        best = int(tried.argmin())
        gain = before - float(tried[best])
        self.gain, self._gain = max(gain, self._gain), gain
        if gain < _FAILED:
            self._failures += 1
            if self._failures >= _MOST_FAILURES:
                return False
            self._damping, self.steps = min(10.0 * self._damping, 1e3), 0.2 * self.steps
            source, self._slopes, self._full = self._slopes or slopes, None, None
            self.line = self._along(source)
            return True
        vectors = [slopes.tried, self.line, *([] if self._slopes is None else [self._slopes.tried[1:]])]
        self._failures = 0
        self.fit = replace(self.fit, vector=np.concatenate(vectors)[best], loss=float(tried[best]))
        if gain <= _DONE:
            return False
        if best == 0:
            self._damping, self._slopes = max(0.3 * self._damping, 1e-6), slopes
            self._request_step(slopes)
            return True
        self._damping = min(3.0 * self._damping, 1e3)
        self._slopes, self._full, self.line = None, None, self.line[:0]
        return True

    def _request_step(self, slopes: _Slopes) -> None:
        """Request derivatives at the full step and losses at shorter ones."""
        whole, *shorter = self._along(slopes)
        self._full, self.line = whole, np.array(shorter)

    def _along(self, slopes: _Slopes) -> Floats:
        """(b, ...) vectors along the Fisher scoring step, with the noise matched to the innovations."""
        free, k = self.fit.free, self.count
        hessian = slopes.information + np.diag(1.0 / free.std[:k] ** 2)
        away = (self.fit.vector[free.at[:k]] - free.centre[:k]) / free.std[:k] ** 2
        # Quotients over many standard deviations do not approximate the slope here.
        self.steps = np.minimum(self.steps, np.maximum(1.0 / np.sqrt(np.diag(hessian)), 1e-7 * free.scale[:k]))
        damped = hessian + np.diag(self._damping * np.diag(hessian) + 1e-8 / free.scale[:k] ** 2)
        jump = np.linalg.solve(damped, slopes.gradient - away)
        jumps = np.zeros((len(_LINE) + 2, len(free.at)))
        jumps[: len(_LINE), :k] = _LINE[:, None] * jump
        # All noise as much larger or smaller as the innovations are, and as they would be after the step.
        of_model, is_std = min(k, free.of_model), free.of_model + np.flatnonzero(_is_std(self.fit))
        jumps[-2, is_std] = slopes.spread()
        jumps[-1, :of_model], jumps[-1, is_std] = jump[:of_model], slopes.spread(np.asarray(jump[:of_model]))
        return self.fit.moved(jumps)
