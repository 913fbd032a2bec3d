"""Which effect is missing: forward selection over the library by held-out likelihood, and a verdict.

A model may add effects one by one. Each must predict held-out rows better by more than `LEAST_EVIDENCE` nats, by more
than chance over segments allows, and by enough per row to matter. What a smooth correction still gains on top says how
much is left that no effect of the library explains (Akaike's predictive argument, by cross-validation: Stone, JRSS B
1974).

**Forward selection.** The best one, one that acts in places or since some time only, or two together.

A model may take in an effect if it predicts held-out rows better by more than chance, and not in a single run alone,
and if plain one-step errors get smaller too.

Source: Ljung, System Identification, 2nd ed., ch. 4.2 and 16 (model structures, their selection on held-out data).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.memories import is_as_commanded
from micah_plan.automaton.effects.registry import form
from micah_plan.quantities import Progress
from micah_plan.residual.command_meaning import (
    CONTAINED,
    FOLLOW,
    RESPONSE_STARTS,
    followed,
    may_mean_places,
    means_places,
    regularity,
    with_free_response,
)
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.likelihood import (
    LEAST_EVIDENCE,
    TIE,
    student_t_log_density,
)
from micah_plan.residual.missing_mode import MissingMode, missing_modes
from micah_plan.residual.residual_test import ResidualTest
from micah_plan.residual.search import (
    UNNAMED,
    Scored,
    Search,
    TermCandidate,
    candidates,
    gated,
    indistinguishable,
    smooth,
)
from micah_plan.residual.simulation import GATES, Term
from micah_plan.residual.verdict import Facts, Outcome, outcome_of
from micah_plan.residual.worth import ELSEWHERE, begins_later, elsewhere, improves, is_worth, ranked, shortens

# Candidates as good as the best are tied with it, or within two standard errors up to so much per segment [nats].
_ERRORS = 2.0
_SLACK = 0.5
# Independent runs, or motions of the only run, from which on evidence of rows is evidence.
ENOUGH_INDEPENDENT = 5
# A motion is one from end to end of at least this share of where the part was.
_A_MOTION = 0.2
# The last runs, as a share of all.
_LATEST_SHARE = 0.25
# Steps that a smooth function of the configuration needs at least.
_ROWS_FOR_SMOOTH = 60


@dataclass(frozen=True, eq=False)
class CoordinateFinding:
    """An effect that was found in a coordinate's data.

    Attributes:
        part: its term and parameters, gates included; a median where one was fitted, the best fit of several.
        interval: (size, 2) at `arrays.INTERVAL`; low = high for those that were not fitted.
        evidence: what predictions lose without it [nats].
        tied: names of other effects that would do as well in its place.
        is_added: whether the model takes it in; not if it may as well come from earlier commands, nor if one of few
            runs contradicts it.
    """

    part: TermCandidate
    interval: Floats
    evidence: float
    tied: tuple[str, ...]
    is_added: bool = True


@dataclass(frozen=True, eq=False)
class CoordinateTrace:
    """What was found on one coordinate.

    Attributes:
        nominal, chosen: the model as it is, and with the effects.
        final: what a new automaton should have: the chosen model, with a smooth correction if it is worth it.
        ranking: (name, evidence [nats], standard error) of every candidate alone, best first, the smooth correction
            among them as ``unexplained``.
        facts, outcome: what is known, and what is concluded from it.
        whiteness: largest autocorrelation of the innovations that remain, and how probable it were if they were white.
        left: what the innovations that remain follow; None where rows are too few.
        floor, rollout_floor: errors of one step and of roll-outs that noise alone would leave [rad or m].
        missing_modes: that the automaton lacks; a correction without a name is in their place (or see `calibrate`).
        closest: names of the effects that came closest, where a correction without a name predicts better.
        alternatives: the models of one effect that were considered.
    """

    data: CoordinateData
    search: Search
    nominal: Scored
    chosen: Scored
    final: Scored
    findings: tuple[CoordinateFinding, ...]
    ranking: tuple[tuple[str, float, float], ...]
    facts: Facts
    outcome: Outcome
    whiteness: tuple[float, float]
    left: ResidualTest | None
    floor: float
    rollout_floor: float
    missing_modes: tuple[MissingMode, ...] = ()
    closest: tuple[str, ...] = ()
    alternatives: tuple[Scored, ...] = ()

    @property
    def unexplained_fraction(self) -> float:
        """Share of the explainable residual that effects leave, 0 to 1."""
        if self.findings or self.facts.smooth:
            return self.facts.smooth
        return float((self.facts.is_left or self.facts.is_corrected) and not self.missing_modes)


def trace(search: Search, progress: Progress | None = None) -> CoordinateTrace:
    """Find what a coordinate's model lacks; where it leaves noise alone, nothing is sought."""
    is_quiet = search.residual_is_white(search.nominal)
    if not is_quiet and any(map(is_as_commanded, search.data.effects)):
        search = with_free_response(search.data)
    progress_told, data, nominal = progress or _silent, search.data, search.nominal
    singles, selection = ((), Selection(nominal, ())) if is_quiet else _explored(search, progress_told)
    loose = nominal if is_quiet else _smoothed(search, search.nominal)
    others = (selection.chosen, loose, *selection.alternatives)
    modes = () if search.residual_is_white(selection.chosen) else _modes(search, others)
    closest = () if modes else _imitated(search, selection.chosen, loose)
    if modes or closest:
        # Effects that act everywhere only imitate what a mode of its own, or something without a name, does.
        selection = Selection(search.nominal, selection.alternatives)
    chosen = selection.chosen
    progress_told(f"{data.coordinate}: what remains", 0.9)
    is_enough = not modes and not closest and search.residual_is_white(chosen)
    remaining = chosen if is_enough else loose if chosen is search.nominal else _smoothed(search, chosen)
    findings = () if chosen is nominal else _findings(search, nominal, chosen, selection.alternatives)
    # Commands that are places make a model of their own, which runs bear out or not as they do effects on top of it.
    base = nominal if chosen is search.nominal else search.nominal
    remaining_tests, is_worth_it = search.left_by(chosen), is_worth(remaining, chosen, data)
    final = remaining if is_worth_it and shortens(search, remaining, chosen) else chosen
    facts = Facts(
        effects=len(chosen.parts),
        modes=len(modes),
        is_open=any(may_remember(data, finding) for finding in findings),
        is_contradicted=_is_contradicted(search, chosen, base),
        is_over=_is_over(search, final, base),
        is_single=_is_single(data),
        is_changing=len({gate for part in chosen.parts if np.isfinite(gate := float(part.starts[0, -GATES]))}) > 1,
        smooth=_fraction_left(nominal, chosen, [loose, remaining]) if is_worth_it and not modes else 0.0,
        is_left=remaining_tests is not None and remaining_tests.is_more,
        is_corrected=any(effect.name == UNNAMED for effect in data.effects),
    )
    models = list({id(model): model for model in (final, chosen)}.values())
    floor, number = min((search.noise_floor(model), number) for number, model in enumerate(models))
    return CoordinateTrace(
        data=data,
        search=search,
        nominal=nominal,
        chosen=chosen,
        final=base if facts.is_contradicted or facts.is_over else search.nominal if facts.is_open else final,
        findings=tuple(replace(finding, is_added=not facts.is_kept_out) for finding in findings),
        ranking=() if is_quiet else _ranking(nominal, [*singles, loose]),
        missing_modes=modes,
        facts=facts,
        outcome=outcome_of(facts),
        whiteness=search.whiteness(chosen),
        left=remaining_tests,
        floor=floor,
        rollout_floor=search.rollout_floor(models[number], floor),
        closest=closest,
        alternatives=selection.alternatives,
    )


def _is_contradicted(search: Search, named: Scored, base: Scored) -> bool:
    """Whether one of few runs is predicted no better by effects that were fitted to the others.

    Rows of one run share what is particular to it, so few runs show what many rows of them do not.
    """
    runs = len(np.unique(search.data.run))
    if named is base or not 1 < runs < ENOUGH_INDEPENDENT:
        return False
    return bool(np.any(search.density_by_run(named) <= search.density_by_run(base)))


def _is_over(search: Search, named: Scored, base: Scored) -> bool:
    """Whether the last runs are clearly predicted better without effects or a correction: what was so is so no more.

    Both at one scale, that of the model with them: else what it explains of earlier runs counts in the last.
    """
    data, runs = search.data, np.unique(search.data.run)
    if named is base or len(runs) == 1:
        return False
    latest = np.isin(data.run, runs[-max(1, round(_LATEST_SHARE * len(runs))) :])[:, None] & data.counted
    errors = [search.innovations(model) / search.spread(model) for model in (named, base)]
    scale = float(np.sqrt(np.mean(errors[0][data.counted] ** 2)))
    with_it, without = (float(student_t_log_density(e[latest] / scale, search.freedom).sum()) for e in errors)
    return with_it - without < -LEAST_EVIDENCE


def _is_single(data: CoordinateData) -> bool:
    """Whether there is one run alone, with few motions: then nothing is left to test an effect with."""
    if len(np.unique(data.run)) > 1:
        return False
    places = data.z[data.counted]
    least, turn, direction, motions = _A_MOTION * float(np.ptp(places)), float(places[0]), 0.0, 0
    for place in places.tolist():
        way = place - turn
        if direction * way > 0.0:
            turn = place
        elif abs(way) > least:
            turn, direction, motions = place, float(np.sign(way)), motions + 1
    return motions < ENOUGH_INDEPENDENT


def _ranking(nominal: Scored, models: Sequence[Scored]) -> tuple[tuple[str, float, float], ...]:
    return tuple(sorted([(model.names[-1], *model.over(nominal)) for model in models], key=lambda row: -row[1]))


def _modes(search: Search, others: Sequence[Scored]) -> tuple[MissingMode, ...]:
    """Modes that the automaton lacks, if other models predict no better: all, where one run is unlike the others."""
    nominal = search.nominal
    # An idle model predicts as the one without it, which is a rival anyway.
    rivals = [search.innovations(model) for model in others if not model.is_idle]
    return missing_modes(search.data, search.innovations(nominal), search.fold, rivals, search.spread(nominal))


def _imitated(search: Search, chosen: Scored, loose: Scored) -> tuple[str, ...]:
    """Names of effects that only imitate what a correction without a name does; none if they do more than that.

    One is the plainer of the two: only a correction that is worth it speaks against it. Two together must be worth it
    themselves: nearly any smooth curve is a sum of two effects.
    """
    if chosen is search.nominal or not chosen.parts or loose.is_idle:
        return ()
    is_one, data = len(chosen.parts) == 1, search.data
    is_outdone = is_worth(loose, chosen, data) if is_one else not is_worth(chosen, loose, data)
    return chosen.names if is_outdone and shortens(search, loose, search.nominal) else ()


def _explored(search: Search, progress: Progress) -> tuple[tuple[Scored, ...], Selection]:
    """All single effects, and what was chosen; first of all whether commands are places, which is then nominal."""
    library = candidates(search.data)
    for_places = [candidate for candidate in library if candidate.name not in CONTAINED]
    if search.data.meaning == "position" and search.nominal.names == (FOLLOW,):
        # That commands are places is said; how the part follows them is not.
        place, as_told = followed(search, len(RESPONSE_STARTS)), search.nominal
        search.nominal = place if is_worth(place, as_told, search.data) else as_told
        more, selected = _selected(search, for_places, progress)
        return (place, *more), selected
    if search.leads_to_places(search.nominal):
        return _selected(search, for_places, progress)
    singles, selection = _selected(search, library, progress)
    if search.data.meaning == "displacement":
        return singles, selection
    progress(f"{search.data.coordinate}: {FOLLOW}", 0.5)
    # Where displacements leave noise alone, places can only be tied with them, and then the plainest forms are.
    is_done = search.residual_is_white(selection.chosen) and regularity(search.data) <= LEAST_EVIDENCE
    place = followed(search, 1 if is_done and not search.data.is_outside else len(RESPONSE_STARTS))
    # Displacements that the part carries out in any way that is smooth: few one-way runs look as if they were places.
    loose = _smoothed(search, search.nominal)
    best, before = ranked([selection.chosen, loose])[0], search.nominal
    are_places, is_open = means_places(search, place, best), may_mean_places(search, place, best)
    if are_places or is_open:
        search.nominal = place
        more, selected = _selected(search, for_places, progress)
        if are_places or means_places(search, selected.chosen, best, before):
            return (*singles, place, *more), selected
        search.nominal = before
    # Where neither is ahead, places are tied with what was found.
    return singles, replace(selection, alternatives=(*selection.alternatives, place))


def _selected(
    search: Search, library: Sequence[TermCandidate], progress: Progress
) -> tuple[tuple[Scored, ...], Selection]:
    """All single effects on top of the nominal model, and what was chosen among them and those of two."""
    singles = scored_all(search, search.nominal, library, progress, 0.05, 0.5)
    return tuple(singles), select_forward(
        search, library, [single for single in singles if not single.is_idle], progress
    )


def may_remember(data: CoordinateData, finding: CoordinateFinding) -> bool:
    """Whether it is open if an effect comes from this command or from earlier ones.

    It is tied with one of the other sort; or it depends on the place, and the runs are so alike that what depends on
    earlier commands looks the same. What a wrong guess does to a plan is worse than doing nothing.
    """
    layer = finding.part.term.form.layer
    if layer == "force" and data.repeats_one_motion:
        return True
    return any((form(name).layer == "memory") != (layer == "memory") for name in finding.tied)


def _silent(message: str, fraction: float) -> None:
    """Progress that nobody asked for."""
    del message, fraction


def _smoothed(search: Search, base: Scored) -> Scored:
    """A model with the smooth correction on top: all of it, or only what depends on the command if that is better."""
    if base not in search.smoothed:
        data = search.data
        # Where all runs are alike a function of the place could be one of time.
        is_enough = data.counted.sum() >= _ROWS_FOR_SMOOTH and not data.repeats_one_motion
        kinds = (True, False) if is_enough else (True,)
        smoothed = [search.score((*base.parts, smooth(data, is_lean=is_lean)), base) for is_lean in kinds]
        search.smoothed[base] = ranked(smoothed)[0]
    return search.smoothed[base]


def _fraction_left(nominal: Scored, chosen: Scored, smoother: Sequence[Scored]) -> float:
    """Share of the evidence against the nominal model that the chosen effects leave to smooth corrections, 0 to 1."""
    best = max(model.over(nominal)[0] for model in (chosen, *smoother))
    return float(np.clip(1.0 - chosen.over(nominal)[0] / best, 0.0, 1.0)) if best > 0 else 0.0


def _findings(
    search: Search, nominal: Scored, chosen: Scored, alternatives: Sequence[Scored]
) -> tuple[CoordinateFinding, ...]:
    findings, column = [], 0
    intervals = search.intervals(chosen) if chosen.parts else np.zeros((0, 3))
    for number, part in enumerate(chosen.parts):
        own = intervals[column : column + len(part.free)]
        column += len(part.free)
        values, free = part.starts.copy(), list(part.free)
        interval = np.repeat(part.starts.T, 2, axis=1)
        interval[free] = own[:, [0, 2]]
        if len(free) == 1:  # medians of several, each with the others following, belong to no one fit
            values[0, free] = own[:, 1]
        others = (*chosen.parts[:number], *chosen.parts[number + 1 :])
        without = search.score(others) if others else nominal
        evidence = chosen.over(without)[0]
        tied: tuple[str, ...] = ()
        if number == len(search.nominal.parts) == len(chosen.parts) - 1:
            names = dict.fromkeys(rival.names[-1] for rival in alternatives if rival.names[-1] != part.name)
            rivals = {name: ranked([rival for rival in alternatives if rival.names[-1] == name])[0] for name in names}
            able = [(name, alternative) for name, alternative in rivals.items() if _is_tied(chosen, alternative)]
            # What would do the same as a tied one was not tried, but is tied as well.
            alike = [name for _, alternative in able for name in indistinguishable(alternative.parts[-1], search.data)]
            tied = tuple(name for name in (*(name for name, _ in able), *alike) if name != part.name)
        is_always = not part.term.modes and not np.isfinite(part.starts[0, -GATES:]).any()
        same = indistinguishable(part, search.data) if is_always else ()
        tied = tuple(dict.fromkeys((*tied, *same)))
        findings.append(CoordinateFinding(replace(part, starts=values), interval, evidence, tied))
    return tuple(sorted(findings, key=lambda finding: -finding.evidence))


def _is_tied(best: Scored, rival: Scored) -> bool:
    """Whether another model would do as well.

    It predicts as well; or no effect's evidence is between them, and with no more parameters it fits all rows better:
    where one run alone shows an effect, what is held out says how well the other runs happen to tell its parameters.
    """
    gap, error = best.over(rival)
    fits = rival.fit.loss[0] <= best.fit.loss[0] and len(rival.parts[-1].free) <= len(best.parts[-1].free)
    return gap < max(TIE, min(_ERRORS * error, _SLACK * rival.density.size)) or (bool(fits) and gap < LEAST_EVIDENCE)


_WIDE = 3
_TRIED = 5
# Effects that make a line in the command.
A_LINE = ("gain", "bias")
# Rounds of when an effect began, and of its parameters since then.
_BEGINNINGS = 2


@dataclass(frozen=True, eq=False)
class Selection:
    """What was chosen.

    Attributes:
        chosen: the best model that effects can make; the nominal one if none is worth it.
        alternatives: the models of one effect that it competed with.
    """

    chosen: Scored
    alternatives: tuple[Scored, ...]


def select_forward(
    search: Search, library: Sequence[TermCandidate], singles: Sequence[Scored], progress: Progress
) -> Selection:
    """Choose among models of one and two effects, and variants of the best."""
    nominal = search.nominal
    plain = _simplest(singles, nominal, search.data)
    if plain is not None and improves(search, plain, nominal) and search.residual_is_white(plain):
        # Then neither a second effect nor one that acts only in places or since some time can gain anything.
        return Selection(plain, tuple(singles))
    begun = scored_all(search, nominal, _since_a_change(search, nominal, library), progress, 0.5, 0.5)
    later = [single for single in begun if not single.is_idle]
    promising = _promising(search, singles)
    options = [*singles, *later, *(variant for single in promising for variant in _variants(search, single, nominal))]
    first = _first(search, options)
    if first is None:
        return Selection(nominal, tuple(options))
    if search.residual_is_white(first):
        return Selection(first, tuple(options))
    for pair in _pairs(search, library, [*promising, first], progress):
        if is_worth(pair, first, search.data) and improves(search, pair, nominal):
            return Selection(_without_idle(search, pair, first), tuple(options))
    return Selection(first, tuple(options))


def _promising(search: Search, singles: Sequence[Scored]) -> list[Scored]:
    """Those that predict best from some segment on."""
    gains = [(_gain_since(single, search.nominal, search.data), single) for single in singles]
    best = sorted(gains, key=lambda pair: -pair[0])[:_WIDE]
    return [single for gain, single in best if gain > LEAST_EVIDENCE]


def _gain_since(better: Scored, base: Scored, data: CoordinateData) -> float:
    """By how much a model predicts better from some segment on [nats]: what began there predicts earlier ones badly."""
    latest_first = np.argsort(-data.order[:, 0])
    return float(np.cumsum((better.density - base.density)[latest_first]).max())


def _first(search: Search, options: Sequence[Scored]) -> Scored | None:
    """The plainest of the best single effects that may be taken in."""
    remaining, data = list(options), search.data
    while (first := _simplest(remaining, search.nominal, data)) is not None and is_worth(first, search.nominal, data):
        if shortens(search, first, search.nominal):
            return first
        remaining = [option for option in remaining if option is not first]
    return None


def _pairs(
    search: Search, library: Sequence[TermCandidate], heads: Sequence[Scored], progress: Progress
) -> list[Scored]:
    """Models of two effects, best first; the second acts always, or since something changed on top of the first."""
    selected: list[tuple[float, Scored, Scored]] = []
    kept = list({head.names[-1]: head for head in heads}.values())
    for number, head in enumerate(kept):
        last = head.parts[-1]
        rest = [c for c in library if c.name not in head.names or (c.name == last.name and begins_later(last))]
        rest += _since_a_change(search, head, library)
        share = 0.5 + 0.4 * number / len(kept)
        pairs = scored_all(search, head, rest, progress, share, share + 0.4 / len(kept))
        gained = head.over(search.nominal)[0]
        selected += [(gained + _gain_since(pair, head, search.data), head, pair) for pair in pairs if not pair.is_idle]
    most = sorted(selected, key=lambda gain_of_pair: -gain_of_pair[0])[:_WIDE]
    variants = [variant for _, head, pair in most for variant in _variants(search, pair, head)]
    return _simplest_first([*(pair for _, _, pair in selected), *variants], search.data)[:_TRIED]


def _since_a_change(search: Search, model: Scored, library: Sequence[TermCandidate]) -> list[TermCandidate]:
    """The library from where on a model misses something; none if it does not.

    That shows as its last effect once more, or as a line in the command.
    """
    order, last = search.data.order[search.data.counted_starts], model.parts[-1:]
    since = max((float(part.starts[0, -GATES]) for part in last), default=-np.inf)
    place, best = float(np.median(order[order >= since])), model
    more = [candidate for candidate in library if candidate.name in (*(part.name for part in last), *A_LINE)]
    for _ in range(_BEGINNINGS if more else 0):
        again = [search.score((*model.parts, gated(candidate, [place], [])), model) for candidate in more]
        best = min(again, key=lambda changed: float(changed.fit.loss[0]))
        place = search.begins(best)[0]
    if place <= order.min() or _gain_since(best, model, search.data) <= LEAST_EVIDENCE:
        return []
    return [gated(candidate, [place], []) for candidate in library if candidate.term.form.layer != "guard"]


def _simplest_first(options: Sequence[Scored], data: CoordinateData) -> list[Scored]:
    """Best first, but of those that are as good as the best, but for one run, the plainest effects first."""
    order = ranked(options)
    close = [
        m for m in order if order[0].over(m)[0] <= TIE or elsewhere(order[0].density - m.density, data) <= ELSEWHERE
    ]
    plainest = sorted(close, key=lambda model: sum(part.term.form.complexity_rank for part in model.parts))
    return [*plainest, *(model for model in order if model not in close)]


def scored_all(
    search: Search,
    base: Scored,
    library: Sequence[TermCandidate],
    progress: Progress,
    begin: float,
    end: float,
) -> list[Scored]:
    """Each of the library on top of a model."""
    scored = []
    for number, candidate in enumerate(library):
        progress(f"{search.data.coordinate}: {candidate.name}", begin + (end - begin) * number / len(library))
        scored.append(search.score((*base.parts, candidate), base))
    return scored


def _without_idle(search: Search, pair: Scored, base: Scored) -> Scored:
    """A model of two effects, or of one of them fitted again if the other does not pay."""
    alone = [search.score((*pair.parts[:-2], part)) for part in pair.parts[-2:]]
    best = ranked([*alone, *((base,) if base.names else ())])[0]
    return pair if is_worth(pair, best, search.data) else best


def _variants(search: Search, model: Scored, base: Scored) -> list[Scored]:
    """The last effect of a model only in one mode, or only since some time, where that predicts clearly better."""
    if _gain_since(model, base, search.data) < LEAST_EVIDENCE:
        return []
    data, last, before = search.data, model.parts[-1], model.parts[:-1]
    variants = []
    rows = data.mode[data.counted]
    present = [k for k in range(len(data.modes)) if np.mean(rows == k) > 0.05]
    if len(present) > 1:
        for k in present:
            term = Term(last.term.form, (data.modes[k],))
            variants.append(search.score((*before, replace(last, term=term))))
    if last.term.form.layer != "guard":
        began = [model]
        # Fitted to what came after, it tells better when that was.
        for _ in range(_BEGINNINGS):
            place, time = search.begins(began[-1])
            began.append(search.score((*before, gated(began[-1].parts[-1], [place], [time]))))
        variants += began[1:]
    return [variant for variant in variants if variant.over(model)[0] > LEAST_EVIDENCE]


def _simplest(options: Sequence[Scored], base: Scored, data: CoordinateData) -> Scored | None:
    """The best; of those that are as good, the one with the plainest last effect."""
    # Likelihood alone could be bought by calling a few rows noise.
    options = [option for option in options if option.squared < base.squared]
    if not options:
        return None
    return _simplest_first(options, data)[0]
