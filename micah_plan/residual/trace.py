"""Findings on one coordinate: the effects that won the competition, and the conclusions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.registry import form
from micah_plan.residual.averaged_commands import Average, likeliest_average, with_averages
from micah_plan.residual.candidates import FOLLOW, GATES, MEMORY, UNNAMED, TermCandidate, indistinguishable
from micah_plan.residual.competition import Standings
from micah_plan.residual.contenders import NO_MENTION, TO_THE_END, Contender, best_first, has_onset
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.filtering import filtered
from micah_plan.residual.fitting import ENOUGH_INDEPENDENT, Fitting
from micah_plan.residual.held_out import HeldOut
from micah_plan.residual.missing_mode import MissingMode, missing_modes
from micah_plan.residual.residual_test import ResidualTest
from micah_plan.residual.verdict import UNEXPLAINED, Facts, Outcome, outcome_of
from micah_plan.summaries import Progress

# A motion is one from end to end of at least this share of where the part was.
_A_MOTION = 0.2
# Roll-outs that are so many times as long as before are longer.
_LONGER = 1.02
A_LINE = ("gain", "bias")
"""Effects that make a line in the command."""
# Single effects for further tests.
_MOST_ALTERNATIVES = 8


@dataclass(frozen=True, eq=False)
class CoordinateFinding:
    """An effect found in a coordinate's data.

    Attributes:
        part: its term and parameters, gates included; a median where one was fitted, the best fit of several.
        interval: (size, 2) at `arrays.INTERVAL`; low = high for fixed parameters.
        evidence: by how much the recording is likelier with it [nats].
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
    """Findings on one coordinate.

    Attributes:
        held_out: of all models.
        nominal, chosen: the model as it is, and with the effects.
        final: model for the new automaton: the chosen one, with a smooth correction if that improves it.
        ranking: (name, evidence [nats], standard error) of every candidate alone, best first, the smooth correction
            among them as ``unexplained``.
        facts, outcome: observations, and the conclusion from them.
        whiteness: largest autocorrelation of the innovations that remain, and how probable it were if they were white.
        innovation_test: functions that the remaining innovations follow; None with too few rows.
        floor, rollout_floor: errors of one step and of roll-outs from noise alone [rad or m].
        missing_modes: that the automaton lacks; a correction without a name is in their place (or see `calibrate`).
        closest: names of the closest effects, where an unnamed correction predicts better.
        alternatives: the closest models of one effect.
        average: of commands over rows before and after that steps follow; None: they follow commands as written.
    """

    data: CoordinateData
    held_out: HeldOut
    nominal: Contender
    chosen: Contender
    final: Contender
    findings: tuple[CoordinateFinding, ...]
    ranking: tuple[tuple[str, float, float], ...]
    facts: Facts
    outcome: Outcome
    whiteness: tuple[float, float]
    innovation_test: ResidualTest | None
    floor: float
    rollout_floor: float
    missing_modes: tuple[MissingMode, ...] = ()
    closest: tuple[str, ...] = ()
    alternatives: tuple[Contender, ...] = ()
    average: Average | None = None

    @property
    def unexplained_fraction(self) -> float:
        """Fraction (0 to 1) of the explainable residual that the effects do not explain."""
        if self.findings or self.facts.smooth:
            return self.facts.smooth
        return float(self.facts.is_corrected and not self.missing_modes)


def trace(held_out: HeldOut, progress: Progress | None = None) -> CoordinateTrace:
    """Identify the effects that a coordinate's model lacks."""
    standings = held_out.competition.search(progress or _no_progress)
    average = likeliest_average(held_out.competition, standings)
    if average is None:
        return _traced(held_out, standings)
    held_out = HeldOut(with_averages(held_out.data, average), held_out.data)
    return _traced(held_out, held_out.competition.search(progress or _no_progress), average)


def _traced(held_out: HeldOut, standings: Standings, average: Average | None = None) -> CoordinateTrace:
    data, nominal = held_out.data, held_out.nominal
    standings = (
        _without_useless_effects(held_out, standings)
        if average is not None
        else _with_best_roll_out(held_out, standings)
    )
    modes = _modes(held_out, standings) if standings.remaining else ()
    share = _share_left(standings)
    closest = standings.chosen.names if standings.chosen is not nominal and share > UNEXPLAINED and not modes else ()
    # Effects that act everywhere only imitate a separate mode, or an unnamed effect.
    chosen = nominal if modes or closest else standings.chosen
    findings = () if chosen is nominal else _findings(held_out, standings)
    final = _final(held_out, standings, chosen)
    innovation_test = held_out.innovation_test(chosen)
    is_passing = any(model.names[-1] not in (UNNAMED, MEMORY) for model in standings.remaining)
    facts = Facts(
        effects=len(findings),
        modes=len(modes),
        is_open=any(may_remember(data, finding) for finding in findings),
        is_contradicted=_is_contradicted(held_out, chosen),
        is_longer=final is not nominal and _rolled(held_out, final) > _LONGER * _rolled(held_out, nominal),
        is_noisier=_is_noisier(held_out, final),
        is_single=_is_single(data),
        is_changing=_is_changing(chosen, innovation_test),
        is_passing=is_passing,
        is_following=innovation_test is not None and innovation_test.is_more,
        smooth=0.0 if modes else share,
        is_corrected=any(effect.name == UNNAMED for effect in data.effects),
        is_averaged=average is not None,
    )
    alternatives = tuple(best_first(standings.singles)[:_MOST_ALTERNATIVES])
    return CoordinateTrace(
        data=held_out.as_written,
        held_out=held_out,
        nominal=nominal,
        chosen=chosen,
        final=nominal if facts.is_kept_out else final,
        findings=tuple(replace(finding, is_added=not facts.is_kept_out) for finding in findings),
        ranking=_ranking(nominal, [*standings.singles, *standings.loose]),
        missing_modes=modes,
        facts=facts,
        outcome=outcome_of(facts),
        whiteness=held_out.whiteness(chosen),
        innovation_test=innovation_test,
        floor=held_out.noise_floor(final),
        rollout_floor=held_out.rollout_floor(final),
        closest=closest,
        alternatives=alternatives,
        average=average,
    )


def _without_useless_effects(held_out: HeldOut, standings: Standings) -> Standings:
    """The standings under averaged commands, without effects that do not improve roll-outs of the recorded ones.

    Averages leave something of their own in single steps, which no part does.
    """
    is_shorter = _LONGER * _rolled(held_out, standings.chosen) < _rolled(held_out, standings.nominal)
    return replace(standings, chosen=standings.chosen if is_shorter else standings.nominal, remaining=())


def _with_best_roll_out(held_out: HeldOut, standings: Standings) -> Standings:
    """The standings, with a near rival chosen if the best lengthens held-out roll-outs and the rival does not."""
    longest = _LONGER * _rolled(held_out, standings.nominal)
    if standings.chosen is standings.nominal or _rolled(held_out, standings.chosen) <= longest:
        return standings
    rivals = [model for model in best_first(standings.near) if model.names != standings.chosen.names]
    able = (model for model in rivals if _rolled(held_out, model) <= longest)
    return replace(standings, chosen=next(able, standings.chosen))


def _rolled(held_out: HeldOut, model: Contender) -> float:
    """Root mean square error of roll-outs of held-out rows [rad or m]."""
    return float(np.sqrt(np.mean(held_out.rollout_errors(model) ** 2)))


def _is_noisier(held_out: HeldOut, model: Contender) -> bool:
    """Whether one-step errors of held-out rows grow with a model."""
    sizes = [
        float(np.mean(held_out.errors(model, "one_step")[held_out.data.counted] ** 2))
        for model in (model, held_out.nominal)
    ]
    return sizes[0] > sizes[1]


def _share_left(standings: Standings) -> float:
    """Fraction (0 to 1) of the evidence against the nominal model that remains for unnamed corrections."""
    corrected = [model for model in standings.remaining if model.names[-1] in (UNNAMED, MEMORY)]
    if not corrected:
        return 0.0
    best = corrected[0].evidence - standings.nominal.evidence
    gained = standings.chosen.evidence - standings.nominal.evidence
    return float(np.clip(1.0 - gained / best, 0.0, 1.0)) if best > 0 else 0.0


def _final(held_out: HeldOut, standings: Standings, chosen: Contender) -> Contender:
    """The chosen model with the best correction that an automaton can hold."""
    able = [model for model in standings.remaining if model.names and model.names[-1] == UNNAMED]
    able = [model for model in able if model.names[:-1] == chosen.names]
    return next(filter(held_out.competition.is_within_bounds, able), chosen)


def _is_contradicted(held_out: HeldOut, named: Contender) -> bool:
    """Whether one of few runs is evidence against effects fitted to the others.

    Rows of one run share what is particular to it, so few runs are weak evidence however many rows they have.
    """
    data, base = held_out.data, held_out.nominal
    runs = np.unique(data.run)
    if named is base or not 1 < len(runs) < ENOUGH_INDEPENDENT:
        return False
    for run in runs:
        held, rest = (data.of_segments(np.flatnonzero(is_of)) for is_of in (data.run == run, data.run != run))
        fits = [Fitting(rest).improved([model.fit], TO_THE_END)[0] for model in (named, base)]
        with_it, without = (float(filtered(held, [fit.hypotheses(fit.vector[None])]).total[0]) for fit in fits)
        if with_it < without - NO_MENTION:
            return True
    return False


def _is_changing(chosen: Contender, innovation_test: ResidualTest | None) -> bool:
    """Whether the effects keep changing: several onsets, or one onset and residuals that still depend on time."""
    begun = {gate for part in chosen.parts if np.isfinite(gate := float(part.starts[0, -GATES]))}
    return len(begun) > 1 or (
        len(begun) == 1 and innovation_test is not None and "time" in (what for what, _ in innovation_test.follows)
    )


def _is_single(data: CoordinateData) -> bool:
    """Whether there is one run with few motions, so that nothing is left for validation."""
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


def _ranking(nominal: Contender, models: Sequence[Contender]) -> tuple[tuple[str, float, float], ...]:
    """(name, evidence, error) of every candidate, by its best variant."""
    best: dict[str, tuple[str, float, float]] = {}
    for model in models:
        row = (model.names[-1], *model.over(nominal))
        if model.names[-1] != MEMORY and row[1] > best.get(row[0], row)[1] - 1e-12:
            best[row[0]] = row
    return tuple(sorted(best.values(), key=lambda row: -row[1]))


def _modes(held_out: HeldOut, standings: Standings) -> tuple[MissingMode, ...]:
    """Missing modes, if no other model predicts as well; all of them where one run deviates."""
    nominal = standings.nominal
    rivals = (
        standings.chosen,
        *standings.remaining[:1],
        *standings.loose,
        *best_first(standings.singles)[:_MOST_ALTERNATIVES],
    )
    # Corrections by a smooth function are compared by their evidence, once the mode is in the model (`calibrate`).
    errors = [held_out.errors(model, "filter") for model in rivals if model.names and model.names[-1] != UNNAMED]
    return missing_modes(held_out.data, *held_out.innovations(nominal), held_out.competition.fitting.group, errors)


def may_remember(data: CoordinateData, finding: CoordinateFinding) -> bool:
    """Whether it is undecided if an effect depends on the present or on earlier commands.

    It is tied with one of the other kind; or it depends on the place while the runs are so alike that a dependence on
    earlier commands looks the same. A wrong guess harms a plan more than no correction.
    """
    layer = finding.part.term.form.layer
    if layer == "force" and data.repeats_one_motion:
        return True
    return any((form(name).layer == "memory") != (layer == "memory") for name in finding.tied)


def _no_progress(message: str, fraction: float) -> None:
    """No-op progress callback."""
    del message, fraction


def _findings(held_out: HeldOut, standings: Standings) -> tuple[CoordinateFinding, ...]:
    chosen, data = standings.chosen, held_out.data
    declared = len(held_out.nominal.parts) if FOLLOW not in chosen.names[:1] or len(chosen.parts[0].free) == 0 else 0
    intervals = held_out.intervals(chosen)
    findings, column = [], 0
    for number, part in enumerate(chosen.parts):
        interval_rows = intervals[column : column + len(part.free)]
        column += len(part.free)
        if number < declared:
            continue
        values, free = part.starts.copy(), list(part.free)
        interval = np.repeat(part.starts.T, 2, axis=1)
        interval[free] = interval_rows[:, [0, 2]]
        if len(free) == 1:  # medians of several, each with the others following, belong to no one fit
            values[0, free] = interval_rows[:, 1]
        others = tuple(each for each in chosen.parts if each is not part)
        without = held_out.competition.of_parts(others)
        tied = _tied(standings, number)
        is_always = not part.term.modes and not has_onset(part)
        # What would do the same as a tied one was not tried, but is tied as well.
        equivalent = (
            [name for model in standings.near for name in indistinguishable(model.parts[-1], data)] if tied else []
        )
        same = indistinguishable(part, data) if is_always else ()
        names = tuple(dict.fromkeys(name for name in (*tied, *equivalent, *same) if name != part.name))
        findings.append(CoordinateFinding(replace(part, starts=values), interval, chosen.evidence - without, names))
    return tuple(sorted(findings, key=lambda finding: -finding.evidence))


def _tied(standings: Standings, number: int) -> list[str]:
    """Alternatives to one of the chosen effects that explain the recording equally well."""
    chosen = standings.chosen
    unchanged = sorted(name for k, name in enumerate(chosen.names) if k != number)
    tied = []
    for model in standings.near:
        names = sorted(model.names)
        if len(names) == len(chosen.names):
            rest = list(names)
            for name in unchanged:
                if name in rest:
                    rest.remove(name)
            if len(rest) == 1 and rest[0] != chosen.names[number]:
                tied.append(rest[0])
    return tied
