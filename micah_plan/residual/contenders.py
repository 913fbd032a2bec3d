"""Models of effects with their evidence, and the criterion by which one replaces another.

Hypotheses are ranked by their evidence (Laplace), and a better one must be so in more than one run.

Sources: Kass and Raftery, "Bayes factors", JASA 1995; Stone, JRSS B 1974 (cross-validation).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.effects.form import EffectForm
from micah_plan.automaton.effects.memories import is_as_commanded
from micah_plan.automaton.effects.registry import form, forms
from micah_plan.residual.candidates import (
    FOLLOW,
    GATES,
    MEMORY,
    UNNAMED,
    Model,
    Term,
    TermCandidate,
    at_commanded_places,
    columns,
    gates_of,
)
from micah_plan.residual.command_meaning import regularity
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.filtering import NOISE, STDS, of_rows
from micah_plan.residual.fitting import NORMAL, Fit, Fitting, Free, Weighed
from micah_plan.residual.likelihood import EVIDENCE_PER_ROW, TIE

# Evidence [nats] that whatever is added must have, what two dozen rivals take to be safe. It is less than for what is
# judged by held-out rows alone (`likelihood.LEAST_EVIDENCE`), since it pays for its parameters itself.
_LEAST = 6.0
# The prior of a parameter is so many times as wide as what is large for it; of corrections as wide.
_LOOSE = 6.0
# Log of the noise's parts over the blur of a reading, and how uncertain that is.
_NOISE_CENTRE, _NOISE_STD, _NOISE_FAR = np.array([-0.35, -1.5, -2.5, -2.0]), np.array([3.0, 3.0, 3.0, 3.0]), 12.0
_NOISE_START = np.array([-0.35, -1.5, -2.0, -2.0])
# No reading is more precise than this share of the range.
_FINEST = 1e-5
# The most that an end's std is, as a share of the range, how many of these it may be beside, and where a recording gets
# to it.
_BESIDE, _ENDS_FAR, _NEAR_AN_END = 0.002, 3.0, 0.03
_LOW, _HIGH = NOISE.index("low"), NOISE.index("high")
_FREEDOMS = (NORMAL, 4.0, 12.0)
_NORMAL = 2.0  # nats by which heavy tails must be ahead
# What was meant is more regular than what a measurement's noise is in, the displacements or the places; so much of the
# log density counts, since rows are no independent witnesses, up to so much: goals may be stored late, or as they came.
_REGULARITY_WEIGHT, _LARGEST_REGULARITY = 0.25, 20.0
# Logs of the noise's parts over the largest, where readings, motion or what wanders have most of it; fits that try all.
_SPLITS = ((-0.3, -2.5, -3.0, -2.5), (-2.0, -0.3, -2.0, -2.5), (-2.5, -2.5, -3.0, -0.3))
RESTARTED, TO_THE_END = 5, 20
# How often at most a fit goes on from where one parameter is elsewhere, and from how many such places.
_PROBED, _JUMPS_KEPT = 5, 8
# Logs by which the noise of a start may be less than that of the model that it begins with.
_QUIETER = (0.0, 2.0, 4.0, 6.0, 8.0)
# Rows of a long recording that are searched; models that are then fitted to all, and in how many rounds.
_SCREENED_ROWS, _VERIFIED, _ON_ALL_ROUNDS = 600, 10, 4
# A fit that is so many times what an effect must add behind the best has no chance of a tie.
_LEFT_BEHIND = 5.0
# A parameter is at a bound within so much of what is large for it, or within so many stds, if these are less.
_AT_BOUND, _CERTAIN_STDS = 0.05, 3.0
# Odds against an onset at one of some dozen rows [nats], in addition to those of the profile itself.
_BEGINS = 3.0
# Likelihood that an effect must add to be looked at further [nats].
_HOPELESS = 1.0
# What held-out groups must gain together [nats]: they only have to agree with the evidence.
_CHANCE = 2.0


SPECIAL_CASES = {"direction_gain": "gain"}
"""Effects that are others if their parameters are alike."""
NO_MENTION = 1.0
"""Evidence "not worth more than a bare mention" [nats] (Kass and Raftery, JASA 1995)."""


@dataclass(frozen=True, eq=False)
class Contender:
    """A model of effects with its evidence.

    Attributes:
        parts: its effects; the starts of each are its fitted parameters, (1, size).
    """

    parts: tuple[TermCandidate, ...]
    weighed: Weighed

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.parts)

    @property
    def fit(self) -> Fit:
        return self.weighed.fit

    def over(self, rival: Contender) -> tuple[float, float]:
        """(log Bayes factor over a rival, its standard error over groups of runs) [nats]."""
        gain = self.weighed.density - rival.weighed.density
        error = float(np.std(gain, ddof=1) * np.sqrt(len(gain))) if len(gain) > 1 else 0.0
        return self.evidence - rival.evidence, error

    @property
    def evidence(self) -> float:
        return self.weighed.evidence - _BEGINS * sum(map(has_onset, self.parts))

    @property
    def rank(self) -> tuple[int, int, int, bool]:
        """Order of simplicity: numbers of parameters and effects, ranks of the forms, order in the library."""
        size, order = sum(len(part.free) for part in self.parts), [each.name for each in forms()]
        at = [order.index(name) if name in order else -1 for name in self.names]
        ranks = sum(part.term.form.complexity_rank for part in self.parts)
        return size, len(self.parts), ranks, at != sorted(at)

    def is_special_case_of(self, other: Contender) -> bool:
        """Whether another model has this one as a special case, or as the same effects in an unusual order.

        If two orders fit equally well (a gain of a bias, and a bias of a gain), they only differ in the size of their
        parameters.
        """
        if len(self.names) != len(other.names) or self.rank >= other.rank:
            return False
        if sorted(self.names) == sorted(other.names) and self.rank[:3] == other.rank[:3]:
            return self.fit.loss < other.fit.loss + NO_MENTION
        return self.names != other.names and all(
            name in (general, SPECIAL_CASES.get(general)) for name, general in zip(self.names, other.names, strict=True)
        )


def _is_gated(part: TermCandidate) -> bool:
    """Whether gates can disable an effect; places, frames and the release of an end ignore them."""
    form_of_part = part.term.form
    return form_of_part.layer not in ("place", "frame") and type(form_of_part).release is EffectForm.release


def has_onset(part: TermCandidate) -> bool:
    """Whether an effect has an onset, in the recording or in every run."""
    return bool(np.isfinite(part.starts[0, -GATES:]).any())


@dataclass(frozen=True, eq=False)
class Option:
    """A model to fit.

    Attributes:
        starts: (M, columns) values of its terms, without the terms of the model.
        base: a simpler model, whose noise it begins with; one that fits hardly better than it is not looked at further.
    """

    parts: tuple[TermCandidate, ...]
    starts: Floats
    base: Contender | None = None


class Contenders:
    """Fits and compares models of one coordinate."""

    def __init__(self, data: CoordinateData) -> None:
        self.data = data
        effects = [effect for effect in data.effects if not is_as_commanded(effect)]
        self.given: Model = tuple(Term(form(effect.name), effect.modes) for effect in effects)
        self._given = np.array([v for effect in effects for v in (*effect.values, *gates_of(effect, data))])
        self.as_told = (at_commanded_places(),) if len(effects) < len(data.effects) else ()
        self.has_places = any(term.form.layer == "place" for term in self.given)
        self.least = max(_LEAST, EVIDENCE_PER_ROW * int(data.counted.sum()))
        # Places relative to the belief contain no measurement, so they have no measurement noise.
        is_open = data.meaning is None and not data.is_outside
        from_regularity = (
            np.clip(_REGULARITY_WEIGHT * regularity(data), -_LARGEST_REGULARITY, _LARGEST_REGULARITY)
            if is_open
            else 0.0
        )
        self.odds_of_places = -float(from_regularity)
        self._densities: dict[Contender, Floats] = {}
        self._fitted_to_the_end: dict[Contender, Contender] = {}
        self.nominal = self._initialise(data)
        if np.ptp(data.noise[data.is_measured]):  # another sensor than the model's may have measured
            as_modelled = self.nominal
            self.nominal = self._initialise(data.measured_alike())
            if self.nominal.evidence <= as_modelled.evidence:
                self.nominal = self._initialise(data)

    def within(self, searched: Fitting) -> float:
        """The distance [nats] behind the best at which a fit is abandoned; scaled for subsets of the rows."""
        share = searched.data.counted.sum() / self.data.counted.sum()
        return _LEFT_BEHIND * max(_LEAST, float(share) * self.least)

    def _initialise(self, data: CoordinateData) -> Contender:
        """Initialise the noise from these data and return the fitted nominal model."""
        self.data, self.fitting = data, Fitting(data)
        few = _subset_of_segments(data, _SCREENED_ROWS)
        self.screening = self.fitting if few is None else Fitting(few)
        self._blur = float(np.log(max(data.blur, 1e-7)))
        finest = float(np.log(max(data.resolution, _FINEST * float(np.ptp(data.visited)), ROUND_OFF)))
        self._finest = (finest, *(finest - 2.0,) * (len(STDS) - 1), -np.inf, -np.inf)
        self.noise, self.freedom = np.array([*(self._blur + _NOISE_START), 0.0, 0.0]), NORMAL
        if data.resolution:  # nothing is likelier than rests that are seen better than digits allow: none begins there
            self.noise = np.maximum(self.noise, self._finest)
        return self._nominal()

    # -- fits

    def _fit(self, option: Option, start: Floats) -> Fit:
        """A fit that starts at parameters of all parts, with their priors, bounds and steps."""
        parts, base = option.parts, option.base
        noise = self.noise if base is None else base.fit.noise
        freedom = self.freedom if base is None else base.fit.freedom
        model = (*self.given, *(part.term for part in parts))
        at, scale, low, high, centre, std = [], [], [], [], [], []
        first, odds = columns(self.given), 0.0
        for part in parts:
            loose = 1.0 if part.name in (UNNAMED, MEMORY) else _LOOSE
            of_part = start[first - columns(self.given) :][: part.term.size]
            for column, large in zip(part.free, part.scale, strict=True):
                parameter = part.term.form.parameters[column]
                bounds = part.bounds.get(column, (-np.inf, np.inf))
                at.append(first + column)
                scale.append(float(large))
                low.append(max(parameter.lower, bounds[0]))
                high.append(min(parameter.upper, bounds[1]))
                neutral = parameter.neutral if not parameter.is_limit else None
                centre.append(float(of_part[column]) if neutral is None else neutral)
                std.append(loose * float(large))
            first += part.term.size
            odds += self.odds_of_places if part.name == FOLLOW else 0.0
        count = len(at)
        for k, centre_of, std_of, large in self._priors():
            far = _NOISE_FAR if k < len(STDS) else _ENDS_FAR * std_of
            at.append(first + k)
            scale.append(large)
            low.append(max(centre_of - far, self._finest[k]))
            high.append(centre_of + far)
            centre.append(centre_of)
            std.append(std_of)
        free = Free(
            at=np.array(at),
            scale=np.array(scale),
            low=np.array(low),
            high=np.array(high),
            centre=np.array(centre),
            std=np.array(std),
            of_model=count,
            odds=odds,
        )
        return Fit(model, np.concatenate([self._given, start, noise]), free, freedom)

    def _priors(self) -> list[tuple[int, float, float, float]]:
        """(entry, centre, std, scale) of the priors of log noise, and of the ends that the recording reaches.

        Ends are as uncertain as one measurement: a model's ends were measured once.
        """
        of_noise = zip(self._blur + _NOISE_CENTRE, _NOISE_STD, strict=True)
        entries = [(k, float(centre), float(std), 0.5) for k, (centre, std) in enumerate(of_noise)]
        low, high = self.data.visited
        near = _NEAR_AN_END * (high - low)
        reading = min(float(np.exp(self._blur)), _BESIDE * (high - low))
        for k, is_visited in ((_LOW, low < self.data.lower + near), (_HIGH, high > self.data.upper - near)):
            entries += [(k, 0.0, reading, reading)] if is_visited else []
        return entries

    def _contender(self, parts: Sequence[TermCandidate], weighed: Weighed) -> Contender:
        fitted, at = [], columns(self.given)
        for part in parts:
            fitted.append(replace(part, starts=weighed.fit.vector[None, at : at + part.term.size]))
            at += part.term.size
        return Contender(tuple(fitted), weighed)

    def fitted(
        self,
        options: Sequence[Option],
        first: int = 3,
        keep: int = 2,
        most: int | None = None,
        restarted: int = 0,
        rounds: int = TO_THE_END,
    ) -> list[Contender]:
        """The best fit of each option; options that hardly improve on their base are dropped.

        In a long recording the search uses some of the rows; the best candidates are then fitted to all rows.

        Args:
            first: rounds with the noise of the base, of the `keep` best starts.
            most: options of each base that go on; None: all.
            restarted: number of the best candidates that continue from other noise parameters as well, as do all that
                take commands as places.
            rounds: of those that continue.
        """
        if not options:
            return []
        is_screened = self.screening is not self.fitting and first > 0
        searched = self.screening if is_screened else self.fitting
        every = [[self._fit(option, start) for start in option.starts] for option in options]
        kept = _best_starts(searched, every, keep)
        bases = {id(option.base): option.base for option in options if option.base is not None}
        at = dict(zip(bases, searched.started([base.fit for base in bases.values()]), strict=True))
        pairs = [(option, fit) for option, fits in zip(options, kept, strict=True) for fit in fits]
        rest = [list[Fit]() for _ in pairs]
        if first:
            begun, ready = pairs, searched.improved([fit for _, fit in pairs], first, is_noise_free=False)
            pairs = _best_of_each(zip((option for option, _ in pairs), ready, strict=True), most)
            ended = [(option, fit) for (option, _), fit in zip(begun, ready, strict=True)]
            rest = [
                [fit for of_option, fit in ended if of_option is option and fit is not best] for option, best in pairs
            ]
        again = set(sorted(range(len(pairs)), key=lambda k: pairs[k][1].loss)[:restarted])
        if restarted:
            again |= {k for k, (option, _) in enumerate(pairs) if _is_first_of_places(option)}
        ready = self._with_noise_restarts(searched, [fit for _, fit in pairs], rest, again, rounds)
        chosen = [
            (option, fit)
            for (option, _), fit in zip(pairs, ready, strict=True)
            if option.base is None or fit.loss < at[id(option.base)].loss - _HOPELESS
        ]
        if is_screened:
            chosen = sorted(chosen, key=lambda pair: pair[1].loss)[:_VERIFIED]
            ready = self.fitting.improved([fit for _, fit in chosen], _ON_ALL_ROUNDS, within=self.within(self.fitting))
            chosen = [(option, fit) for (option, _), fit in zip(chosen, ready, strict=True)]
        weighed = self.fitting.weighed([fit for _, fit in chosen])
        return [self._contender(option.parts, fit) for (option, _), fit in zip(chosen, weighed, strict=True)]

    def _with_noise_restarts(
        self, searched: Fitting, fits: Sequence[Fit], rest: Sequence[Sequence[Fit]], again: Collection[int], rounds: int
    ) -> list[Fit]:
        """The fits at convergence; the best also restarted with other splits of the noise.

        Args:
            rest: further starts of each. again: indices of those that are restarted with other noise.
        """
        owners, tried = list(range(len(fits))), list(fits)
        for k, others in enumerate(rest):
            owners += [k] * len(others)
            tried += others
        for k in sorted(again):
            others = with_other_noise(fits[k])
            others += [replace(fits[k], freedom=NORMAL)] if fits[k].freedom < NORMAL else []
            owners += [k] * len(others)
            tried += others
        best = dict[int, Fit]()
        for k, fit in zip(owners, searched.improved(tried, rounds, within=self.within(searched)), strict=True):
            best[k] = min(best.get(k, fit), fit, key=_loss_with_tail_prior)
        return [best[k] for k in range(len(fits))]

    def polished(self, contender: Contender) -> Contender:
        """The model fitted to convergence, including the tails of its noise.

        Thresholds and delays make steps and kinks in the density that its slope does not show, and a threshold that is
        slightly wrong is absorbed by the noise. So the fit continues from other values of single parameters, and from
        other noise, until nothing is likelier.
        """
        if contender not in self._fitted_to_the_end:
            better = self._refitted(contender)
            self._fitted_to_the_end |= {contender: better, better: better}
        return self._fitted_to_the_end[contender]

    def _refitted(self, contender: Contender) -> Contender:
        tried = [replace(contender.fit, freedom=freedom) for freedom in _FREEDOMS]
        best = min(self.screening.improved(tried, TO_THE_END), key=_loss_with_tail_prior)
        for _ in range(_PROBED):
            with_jumps = [*self.screening.with_jumps(best, _JUMPS_KEPT), *with_other_noise(best)]
            further = min(self.screening.improved(with_jumps, TO_THE_END), key=_loss_with_tail_prior)
            if _loss_with_tail_prior(further) > _loss_with_tail_prior(best) - NO_MENTION:
                break
            best = further
        if self.screening is not self.fitting:
            (best,) = self.fitting.improved([best], TO_THE_END)
            best = min(
                best, contender.fit, key=_loss_with_tail_prior
            )  # what is best in some rows need not be so in all
        return self._contender(contender.parts, self.fitting.weighed([best])[0])

    def _nominal(self) -> Contender:
        start = np.hstack([np.zeros((1, 0)), *(part.starts for part in self.as_told)])[0]
        begun = self._fit(Option(self.as_told, start[None]), start)
        tried = [replace(fit, freedom=freedom) for fit in (begun, *with_other_noise(begun)) for freedom in _FREEDOMS]
        best = min(
            self.screening.improved(tried, TO_THE_END, within=self.within(self.screening)), key=_loss_with_tail_prior
        )
        if self.screening is not self.fitting:
            (best,) = self.fitting.improved([best], TO_THE_END)
        self.noise, self.freedom = best.noise, best.freedom
        return self._contender(self.as_told, self.fitting.weighed([best])[0])

    # -- what is worth it

    def held_out(self, contender: Contender) -> Floats:
        """(R,) held-out log density of each run (of each fold if there is one run) [nats]."""
        if contender not in self._densities:
            self._densities[contender] = self._by_run(self.fitting.held_out(contender.weighed))
        return self._densities[contender]

    def _by_run(self, rows: Floats) -> Floats:
        """(R,) sums over the rows (N,) of each run; of folds if there is one run."""
        data = self.data
        runs, number = np.unique(data.run, return_inverse=True)
        if len(runs) == 1:
            number = self.fitting.group
        return np.asarray(np.bincount(of_rows(data, number), rows))

    def is_worth(self, better: Contender, base: Contender, least: float | None = None) -> bool:
        """Whether a model replaces a simpler one: enough evidence, and support from more than one group of runs."""
        if better.evidence - base.evidence <= (self.least if least is None else least):
            return False
        gains = self.held_out(better) - self.held_out(base)
        able = [k for k, part in enumerate(better.parts) if part.free and _is_gated(part)]
        return is_confirmed(gains, [self.held_out(better) - self._density_without_effect(better, k) for k in able])

    def _density_without_effect(self, contender: Contender, number: int) -> Floats:
        """Held-out log density by run with effect `number` disabled and all else equal."""
        gate = columns(contender.fit.model[: len(self.given) + number + 1]) - GATES
        return self._by_run(self.fitting.held_out(contender.weighed, gate))

    def is_within_bounds(self, contender: Contender) -> bool:
        """Whether no parameter ended at a bound: there the form of the effect is wrong."""
        free, at = contender.fit.free, 0
        x = contender.fit.vector[free.at]
        std = np.sqrt(np.abs(np.diag(np.linalg.inv(contender.weighed.hessian))))
        for part in contender.parts:
            for column in part.free:
                neutral = part.term.form.parameters[column].neutral
                near = min(_AT_BOUND * float(free.scale[at]), _CERTAIN_STDS * float(std[at]))
                for bound, side in ((free.low[at], 1.0), (free.high[at], -1.0)):
                    if side * (x[at] - bound) < near and bound != neutral:
                        return False
                at += 1
        return True


def _best_starts(fitting: Fitting, every: Sequence[Sequence[Fit]], keep: int) -> list[list[Fit]]:
    """The best starts of each option, each with its own noise level: a better explanation leaves less noise."""
    quieter = [[fit.with_noise(fit.noise[: len(STDS)] - by) for fit in fits for by in _QUIETER] for fits in every]
    started = iter(fitting.started([fit for fits in quieter for fit in fits]))
    kept = []
    for fits in every:
        best = [min((next(started) for _ in _QUIETER), key=lambda fit: fit.loss) for _ in fits]
        kept.append(sorted(best, key=lambda fit: fit.loss)[:keep])
    return kept


def _is_first_of_places(option: Option) -> bool:
    """Whether an option introduces a response to positions: the noise of its base is then no guide."""
    is_before = option.base is not None and any(part.name == FOLLOW and part.free for part in option.base.parts)
    return not is_before and any(part.name == FOLLOW and part.free for part in option.parts)


def _best_of_each(pairs: Iterable[tuple[Option, Fit]], most: int | None) -> list[tuple[Option, Fit]]:
    """The best fit of each option; of these the best for each base, best first."""
    best = dict[int, tuple[Option, Fit]]()
    for option, fit in pairs:
        if id(option) not in best or fit.loss < best[id(option)][1].loss:
            best[id(option)] = option, fit
    of_base = dict[int, list[tuple[Option, Fit]]]()
    for option, fit in sorted(best.values(), key=lambda pair: pair[1].loss):
        of_base.setdefault(id(option.base), []).append((option, fit))
    return [pair for ranked in of_base.values() for pair in ranked[:most]]


def with_other_noise(fit: Fit) -> list[Fit]:
    """The fit restarted with most noise in readings, in motion or in drift: each may be a local optimum."""
    return [fit.with_noise(float(fit.noise[: len(STDS)].max()) + np.array(split)) for split in _SPLITS]


def _loss_with_tail_prior(fit: Fit) -> float:
    """Loss with a prior against heavy tails [nats]."""
    return fit.loss + _NORMAL * (fit.freedom < NORMAL)


def best_first(contenders: Sequence[Contender]) -> list[Contender]:
    """The models sorted by decreasing evidence."""
    return sorted(contenders, key=lambda model: -model.evidence)


def is_confirmed(gains: Floats, by_each: Sequence[Floats] = ()) -> bool:
    """Whether held-out gains (G,) of groups of runs [nats] exceed chance, and not in one group only.

    Args:
        by_each: (G,) losses without each effect, with everything else unchanged.
    """
    if gains.sum() <= _CHANCE or gains.sum() - gains.max() <= 0.0:
        return False
    # What one run alone shows makes the noise of all smaller, which is no evidence from the others.
    return all(bool(losses.sum() - losses.max() > TIE) for losses in by_each)


def on_top(head: Contender, part: TermCandidate) -> Option:
    """A model with an additional effect."""
    before = (np.repeat(each.starts, len(part.starts), axis=0) for each in head.parts)
    return Option((*head.parts, part), np.hstack([*before, part.starts]), head)


def _subset_of_segments(data: CoordinateData, rows: int) -> CoordinateData | None:
    """Segments with about `rows` rows, spread over the recording; None if that saves little."""
    per_segment = data.counted.sum(axis=1)
    total = int(per_segment.sum())
    if total < 1.6 * rows:
        return None
    count = max(int(len(per_segment) * rows / total), 3)
    if count >= len(per_segment):
        return None
    return data.of_segments(np.unique(np.linspace(0, len(per_segment) - 1, count).astype(int)))
