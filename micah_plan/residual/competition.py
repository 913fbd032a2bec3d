"""Competition of effects: singles, pairs on the best, effects with an onset; parameters without evidence are pruned.

The remainder is tested against unnamed corrections: smooth functions of the command, of place and command, and of
earlier commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.residual.candidates import (
    DRIVE,
    FOLLOW,
    GATES,
    MEMORY,
    Term,
    TermCandidate,
    always,
    candidates,
    columns,
    earlier_commands,
    gated,
    smooth,
    variants,
)
from micah_plan.residual.command_meaning import CONTAINED
from micah_plan.residual.contenders import (
    NO_MENTION,
    RESTARTED,
    SPECIAL_CASES,
    Contender,
    Contenders,
    Option,
    best_first,
    has_onset,
    on_top,
)
from micah_plan.residual.likelihood import TIE
from micah_plan.residual.responses import follows
from micah_plan.summaries import Progress

# Models that a second effect is tried on; of these effects, how many are fitted to the end.
_HEADS, _SECONDS = 4, 6
# Models of displacements that may be rivals of places with something that began.
_RIVALS = 2
_RESPONSES_POLISHED = 3
_MOST_CHANGES = 3
# Rows that a smooth function of the configuration needs at least.
_ROWS_FOR_SMOOTH = 60
# Rows of a recording at which something may have begun at first, and how often the search comes closer.
_PROFILE = 32
_TURNS, _COARSE_TURNS = 4, 2
# Shares of the rows before which, and after which, no onset can be identified.
_EARLIEST = 0.03
# Of models that are tied, so many of the best are fitted to the end, and the simplest.
_POLISHED = 4
_LINE_LIKE = ("gain", "bias", "dead_zone")
# Candidate onsets without a hint: shares of the recording.
_PLACES_OF_CHANGE = (0.25, 0.5, 0.75)
_COMMON = 0.05
# What no other run confirms must be so many times what an effect must add.
_UNCONFIRMED = 2.0
_ROUNDS_OF_CORRECTIONS = 8


@dataclass(frozen=True, eq=False)
class Standings:
    """Result of a competition.

    Attributes:
        nominal: without effects. chosen: with the best effects. near: models that are as good.
        singles: models of one effect. remaining: corrections that improve on the chosen model; best first.
        loose: corrections of the nominal model.
    """

    nominal: Contender
    chosen: Contender
    near: tuple[Contender, ...]
    singles: tuple[Contender, ...]
    remaining: tuple[Contender, ...]
    loose: tuple[Contender, ...]


class Competition(Contenders):
    """Competition among the candidate effects of one coordinate."""

    def search(self, progress: Progress) -> Standings:
        """Run the competition."""
        data, nominal, library = self.data, self.nominal, self._library()
        progress(f"{data.coordinate}: single effects", 0.1)
        singles = self.fitted([self._single(part) for part in library], restarted=RESTARTED)
        singles = self._with_polished_responses(singles)
        singles += self._in_modes(singles)
        progress(f"{data.coordinate}: since when", 0.3)
        later = self._with_onset(singles, library)
        loose = self.corrected([nominal])
        every = [*singles, *later]
        able = [model for model in every if self.is_worth(model, nominal) and self.is_within_bounds(model)]
        progress(f"{data.coordinate}: pairs", 0.5)
        pairs = self._pairs(able, library) if able else []
        chosen, near, rivals = nominal, tuple[Contender, ...](), [nominal]
        for is_place in (False, True):
            same_kind = [model for model in able if (FOLLOW in model.names) == is_place]
            if same_kind:
                alone, near_alone = simplest(same_kind)
                of_kind = [pair for pair in pairs if (FOLLOW in pair.names) == is_place]
                best, near_best = self._with_second_effect(alone, near_alone, every, of_kind)
                if best.evidence > chosen.evidence:
                    chosen, near, rivals = best, near_best, [best, alone]
                elif best.evidence > chosen.evidence - self.least:
                    near = (*near, *near_best)
        progress(f"{data.coordinate}: what changes", 0.7)
        chosen, passing = self._with_changes(chosen, every, library)
        if chosen is nominal and not passing:
            least = nominal.evidence + _UNCONFIRMED * self.least
            likelier = [model for model in best_first(every) if model.evidence > least]
            passing = [model for model in likelier if self.is_within_bounds(model)][:1]
        near = near if chosen is rivals[0] else (chosen,)
        progress(f"{data.coordinate}: what remains", 0.8)
        corrected = self.corrected(
            list({id(model): model for model in (chosen, *rivals) if model is not nominal}.values())
        )
        remaining = (*passing, *self._worthwhile([*loose, *corrected], chosen))
        return Standings(nominal, chosen, near, tuple(every), remaining, tuple(loose))

    def _with_polished_responses(self, singles: Sequence[Contender]) -> list[Contender]:
        """The models with the likeliest position responses refitted to convergence, before bounds are checked."""
        best = [model for model in best_first(singles) if FOLLOW in model.names][:_RESPONSES_POLISHED]
        return [self.polished(model) if model in best else model for model in singles]

    def _with_second_effect(
        self, alone: Contender, near: tuple[Contender, ...], every: Sequence[Contender], pairs: Sequence[Contender]
    ) -> tuple[Contender, tuple[Contender, ...]]:
        """(best model, its ties) of two effects, if likelier than the best of one."""
        best_of: dict[str, Contender] = {}
        for model in every:
            name = model.names[-1]
            best_of[name] = max(best_of.get(name, model), model, key=_evidence)
        nominal, good = self.nominal, []
        for pair in pairs:
            halves = [best_of[name] for name in pair.names if name in best_of]
            under = max(halves, key=_evidence, default=nominal)
            if self.is_worth(pair, under) and self.is_within_bounds(pair):
                good.append(pair)
        chosen, near = self._simplest_polished(alone, near)
        if good:
            best, near_best = self._simplest_polished(*simplest(good))
            if best.evidence - chosen.evidence > self.least:
                chosen, near = best, near_best
        return self._pruned(chosen), near

    def _simplest_polished(
        self, simple: Contender, near: Sequence[Contender]
    ) -> tuple[Contender, tuple[Contender, ...]]:
        """(simplest, ties) of tied models after fitting them to convergence."""
        return simplest([self.polished(model) for model in dict.fromkeys((simple, *best_first(near)[:_POLISHED]))])

    def _with_changes(
        self, chosen: Contender, every: Sequence[Contender], library: Sequence[TermCandidate]
    ) -> tuple[Contender, list[Contender]]:
        """(chosen model with effects that have an onset, likelier models that only one run supports)."""
        for _ in range(_MOST_CHANGES):
            heads = [chosen]
            if FOLLOW in chosen.names:
                displaced = [model for model in best_first(every) if FOLLOW not in model.names][:_HEADS]
                heads = [model for model in displaced if self.is_within_bounds(model)][:_RIVALS]
            least = chosen.evidence + self.least
            again = [model for model in best_first(self._with_further_onset(heads, library)) if model.evidence > least]
            if not again:
                return chosen, []
            head = next(model for model in heads if model.names == again[0].names[:-1])
            if not self.is_worth(again[0], head) or not self.is_within_bounds(again[0]):
                return head, [again[0]]
            chosen = self._pruned(again[0])
        return chosen, []

    def _worthwhile(self, corrected: Sequence[Contender], base: Contender) -> tuple[Contender, ...]:
        """Corrections with enough evidence over a base, best first."""
        return tuple(best_first([model for model in corrected if self.is_worth(model, base, TIE)]))

    def _library(self) -> list[TermCandidate]:
        """The library for this coordinate: position responses where applicable, and effects outside of these.

        A servo moves like a drive that is commanded the distance from its place: where commands may be places, motion
        does not separate the two, and the recording must state that commands are speeds or displacements.
        """
        places = () if self.has_places or self.data.meaning in ("displacement", "velocity") else follows(self.data)
        others = candidates(self.data)
        if self.has_places or self.data.meaning == "position":
            others = tuple(part for part in others if part.name not in CONTAINED[FOLLOW])
        if places:
            others = tuple(part for part in others if part.name != DRIVE)
        return [variant for part in (*others, *places) for variant in variants(part)]

    def _single(self, part: TermCandidate) -> Option:
        if part.name == FOLLOW:  # how the part gets to the places, in the place of being there at once
            return Option((part,), part.starts, self.nominal)
        return on_top(self.nominal, part)

    def alone(self, parts: Sequence[TermCandidate]) -> list[Contender]:
        """Models of one effect each, unfiltered, best first."""
        return best_first(self.fitted([replace(self._single(part), base=None) for part in parts], restarted=RESTARTED))

    def _in_modes(self, singles: Sequence[Contender]) -> list[Contender]:
        """The best effects restricted to each mode."""
        rows = self.data.mode[self.data.counted_starts]
        present = [name for k, name in enumerate(self.data.modes) if np.mean(rows == k) > _COMMON]
        if len(present) < 2:
            return []
        best = [
            model for model in best_first(singles) if model.parts[-1].term.form.layer not in ("guard", "place", "frame")
        ]
        tried = {model.names: model for model in reversed(best[:_HEADS])}.values()
        return self.fitted(
            [
                self._single(replace(model.parts[-1], term=Term(model.parts[-1].term.form, (mode,))))
                for model in tried
                for mode in present
            ],
            most=3 * len(present),
        )

    def _with_onset(self, singles: Sequence[Contender], library: Sequence[TermCandidate]) -> list[Contender]:
        """The best effects and the simplest with an onset, where that is likelier than acting from the start."""
        ranked = best_first(singles)
        tried = [*ranked[:3], *(model for model in ranked if model.names[-1] in _LINE_LIKE)]
        able = {model.names: model for model in reversed(tried) if _may_have_onset(model.parts[-1])}
        always_there = list(able.values())
        later = [*self._with_fitted_onsets(always_there), *self._with_fitted_onsets(always_there, in_each_run=True)]
        later += self._with_further_onset([self.nominal], library)
        of_names = {model.names: max(self.nominal.evidence, model.evidence) for model in always_there}
        return [
            model for model in later if model.evidence > of_names.get(model.names, self.nominal.evidence) + self.least
        ]

    def _with_further_onset(self, heads: Sequence[Contender], library: Sequence[TermCandidate]) -> list[Contender]:
        """Models with an additional effect that sets in at some row."""
        order = np.quantile(self.data.order[self.data.counted_starts], _PLACES_OF_CHANGE)
        options = [
            on_top(head, gated(part, order.tolist(), []))
            for head in heads
            for part in library
            if part.name in {*_LINE_LIKE, *_of_commands(head)} and _may_have_onset(part)
        ]
        return self._with_fitted_onsets(self.fitted(options, first=2))

    def _with_fitted_onsets(self, contenders: Sequence[Contender], *, in_each_run: bool = False) -> list[Contender]:
        """The models with the last effect's onset and parameters fitted alternately.

        That something changed between two runs is as likely beforehand as that it did within one (Hinkley, "Inference
        about the change-point from cumulative sum tests", Biometrika 1971).

        Args:
            in_each_run: since the same time in every run, and not since one row of the recording.
        """
        starts = self.data.counted_starts
        if not contenders or (in_each_run and len(np.unique(self.data.run)) == 1):
            return []
        at, firsts = self._starts_of_runs()
        if in_each_run:
            at, firsts = np.unique(self.data.time[starts]), at[:0]
        fits = [contender.fit for contender in contenders]
        gates = [columns(fit.model) - GATES + in_each_run for fit in fits]
        bonus = float(np.log(len(at) / len(firsts))) if len(firsts) else 0.0
        stride = max(len(at) // _PROFILE, 1)
        first, last = (at[int(share * (len(at) - 1))] for share in (_EARLIEST, 1.0 - _EARLIEST))
        rows = [np.unique([*at[stride::stride], *firsts[1:][:_PROFILE]])] * len(fits)
        rows = [places[(places >= first) & (places <= last)] for places in rows]
        if not len(rows[0]):
            return []
        for turn in range(_TURNS):
            # Some rows of a long recording determine its approximate onset.
            fitting = self.screening if turn < _COARSE_TURNS else self.fitting
            vectors = [np.repeat(fit.vector[None], len(places), axis=0) for fit, places in zip(fits, rows, strict=True)]
            for tried, gate, places in zip(vectors, gates, rows, strict=True):
                tried[:, gate] = places
            losses = fitting.losses(fits, vectors)
            likeliest = [
                int(np.argmin(loss - bonus * np.isin(places, firsts)))
                for loss, places in zip(losses, rows, strict=True)
            ]
            begun = [replace(fit, vector=tried[k]) for fit, tried, k in zip(fits, vectors, likeliest, strict=True)]
            fits = fitting.improved(begun, 3, within=self.within(fitting))
            rows = [
                _onsets_near(float(places[k]), at, firsts, stride) for places, k in zip(rows, likeliest, strict=True)
            ]
            rows = [places[(places >= first) & (places <= last)] for places in rows]
            stride = max(stride // 4, 1)
        weighed = self.fitting.weighed(fits)
        return [self._contender(contender.parts, fit) for contender, fit in zip(contenders, weighed, strict=True)]

    def _starts_of_runs(self) -> tuple[Floats, Floats]:
        """Orders of all counted steps, and of the first of each run; both sorted."""
        order, starts = self.data.order, self.data.counted_starts
        runs = (starts & (self.data.run == run)[:, None] for run in np.unique(self.data.run))
        return np.sort(order[starts]), np.sort([order[counted].min() for counted in runs if counted.any()])

    def _pairs(self, able: Sequence[Contender], library: Sequence[TermCandidate]) -> list[Contender]:
        displaced, places = (
            [model for model in best_first(able) if (FOLLOW in model.names) == kind] for kind in (False, True)
        )
        heads = [*displaced[:_HEADS], *places[: _RIVALS if displaced else _HEADS]]
        options = [
            option
            for head in heads
            for part in library
            if are_compatible(head, part)
            for option in (on_top(head, part), *_in_reverse_order(head, part))
        ]
        return self.fitted(options, most=_SECONDS, restarted=RESTARTED)

    def of_parts(self, parts: Sequence[TermCandidate]) -> float:
        """Log evidence of a model of fitted parts after a refit [nats]."""
        if tuple(parts) == self.nominal.parts or not parts:
            return self.nominal.evidence
        start = np.hstack([part.starts for part in parts])
        return self.fitted([Option(tuple(parts), start)], first=0)[0].evidence

    def _pruned(self, contender: Contender) -> Contender:
        """The model without effects, onsets and options that lack evidence."""
        parts, options = contender.parts, []
        for k, part in enumerate(parts):
            before, after = parts[:k], parts[k + 1 :]
            rests = [(*before, *after)] if len(parts) > 1 else []
            rests += [(*before, always(part), *after)] if has_onset(part) else []
            rests += [(*before, plain, *after) for plain in (*self._special_cases(part), *_without_one_option(part))]
            options += [Option(rest, np.hstack([each.starts for each in rest])) for rest in rests]
        simpler = [
            model
            for model in map(self.polished, self.fitted(options, first=0))
            if model.evidence > contender.evidence - self._min_gain(model, contender)
        ]
        return self._pruned(best_first(simpler)[0]) if simpler else contender

    def _special_cases(self, part: TermCandidate) -> list[TermCandidate]:
        """The special case of an effect: its parameters equal."""
        plain = next((each for each in candidates(self.data) if each.name == SPECIAL_CASES.get(part.name)), None)
        if plain is None:
            return []
        starts = plain.starts[:1].copy()
        starts[0, plain.free], starts[0, -GATES:] = part.starts[0, part.free].mean(), part.starts[0, -GATES:]
        return [replace(plain, term=replace(plain.term, modes=part.term.modes), starts=starts)]

    def _min_gain(self, simpler: Contender, contender: Contender) -> float:
        """Minimum log-evidence gain [nats] over a simpler model: for another effect, option or onset."""
        if len(simpler.parts) < len(contender.parts):
            return self.least
        return NO_MENTION if simpler.names == contender.names and _free(simpler) < _free(contender) else TIE

    def corrected(self, models: Sequence[Contender]) -> list[Contender]:
        """The models with an unnamed correction added.

        If all runs are alike, a function of place could be one of time, and few rows do not identify it.
        """
        data = self.data
        is_enough = data.counted.sum() >= _ROWS_FOR_SMOOTH and not data.repeats_one_motion
        smooths = [smooth(data, is_lean=True), *([smooth(data)] if is_enough else [])]
        options = [
            on_top(model, part)
            for model in models
            for part in (*smooths, earlier_commands(data))
            if part.name != MEMORY or FOLLOW not in model.names
        ]
        return self.fitted(options, first=2, keep=1, rounds=_ROUNDS_OF_CORRECTIONS)


def _without_one_option(part: TermCandidate) -> list[TermCandidate]:
    """An effect with one of its options off, for each option."""
    options, fewer = part.term.form.options(), []
    for k, parameter in enumerate(part.term.form.parameters):
        if k in part.free and parameter.name in options:
            kept = [at for at, column in enumerate(part.free) if column != k]
            starts = part.starts.copy()
            starts[:, k] = options[parameter.name]
            free = tuple(part.free[at] for at in kept)
            fewer.append(replace(part, starts=starts, free=free, scale=part.scale[kept]))
    return fewer


def _free(model: Contender) -> int:
    """Number of fitted parameters."""
    return sum(len(part.free) for part in model.parts)


def _of_commands(head: Contender) -> set[str]:
    """Names of the head's effects on the command; those at a place may occur at several places."""
    return {part.name for part in head.parts if part.term.form.layer in ("memory", "command")}


def _may_have_onset(part: TermCandidate) -> bool:
    """Whether an effect may have an onset; guards, frames and effects at a place may not."""
    return part.term.form.layer not in ("guard", "place", "frame")


def _onsets_near(row: float, order: Floats, firsts: Floats, stride: int) -> Floats:
    """Candidate onsets: rows around one, and starts of runs nearby."""
    k = int(np.searchsorted(order, row))
    at = np.clip(k + np.linspace(-stride, stride, 9).astype(int), 1, max(len(order) - 10, 2) - 1)
    runs = firsts[np.abs(np.searchsorted(order, firsts) - k) < 2 * stride][:6]
    return np.unique([*order[at], row, *runs])


def _in_reverse_order(head: Contender, part: TermCandidate) -> list[Option]:
    """The two effects in reverse order if both act on the command: limit and gain do not commute."""
    last = head.parts[-1:]
    if not last or {last[0].term.form.layer, part.term.form.layer} != {"command"}:
        return []
    others, count = head.parts[:-1], len(part.starts)
    before, behind = ([np.repeat(each.starts, count, axis=0) for each in parts] for parts in (others, last))
    return [Option((*others, part, *last), np.hstack([*before, part.starts, *behind]), head)]


def are_compatible(head: Contender, part: TermCandidate) -> bool:
    """Whether a second effect may be added: neither a repetition, nor a complete form, nor an equivalent one."""
    names = {*head.names, part.name}
    if part.name in CONTAINED or any(part.name in CONTAINED.get(name, ()) for name in head.names):
        return False
    is_later = any(map(has_onset, head.parts))
    if part.name in head.names or (is_later and part.term.form.layer == "guard"):
        return is_later and part.term.form.layer != "guard"  # what acts always, and again since some row
    both = [{"sensor_scale", "gain"}, {"spring", "gravity"}, {"gain", "direction_gain"}]
    return not any(names >= pair for pair in both) and not {"sensor_scale", "drift"} >= names


def simplest(contenders: Sequence[Contender]) -> tuple[Contender, tuple[Contender, ...]]:
    """(simplest model tied with the likeliest, all ties)."""
    best = max(contenders, key=_evidence)
    near = tuple(model for model in contenders if model.evidence > best.evidence - TIE)
    plain = [model for model in near if not any(special.is_special_case_of(model) for special in near)]
    most = max(model.evidence for model in plain)
    return min((model for model in plain if model.evidence > most - NO_MENTION), key=lambda model: model.rank), near


def _evidence(model: Contender) -> float:
    return model.evidence
