"""Which effect is missing: forward selection over the library by held-out likelihood, and a verdict.

A model may add effects one by one. Each must predict held-out rows better by more than `LEAST_EVIDENCE` nats, by more
than chance over stretches allows, and by enough per row to matter. What a smooth correction still gains on top says how
much is left that no effect of the library explains (Akaike's predictive argument, by cross-validation: Stone, JRSS B
1974).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.registry import form
from micah_plan.residual.candidates import UNNAMED, Candidate, candidates, indistinguishable, smooth
from micah_plan.residual.growth import (
    LEAST_EVIDENCE,
    TIE,
    Growth,
    grow,
    is_worth,
    ranked,
    scored_all,
    shortens,
)
from micah_plan.residual.lane import Lane
from micah_plan.residual.leftover import Leftover
from micah_plan.residual.meaning import CONTAINED, FOLLOW, followed, means_places
from micah_plan.residual.missing_mode import MissingMode, missing_modes
from micah_plan.residual.search import Scored, Search
from micah_plan.residual.simulation import GATES
from micah_plan.residual.verdict import Facts, Outcome, outcome_of
from micah_plan.summaries import Progress

# Candidates as good as the best are tied with it, or within two standard errors up to so much per stretch [nats].
_ERRORS = 2.0
_SLACK = 0.5
# Steps that a smooth function of the configuration needs at least.
_ROWS_FOR_SMOOTH = 60


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that was found on a lane.

    Attributes:
        part: its term and parameters, gates included; a median where one was fitted, the best fit of several.
        interval: (size, 2) at `interval.CONFIDENCE`; low = high for those that were not fitted.
        evidence: what predictions lose without it [nats].
        tied: names of other effects that would do as well in its place.
        is_added: whether the model takes it in; not if it helps single steps but makes the roll-out worse, nor if it
            may as well come from earlier commands.
    """

    part: Candidate
    interval: Floats
    evidence: float
    tied: tuple[str, ...]
    is_added: bool = True


@dataclass(frozen=True, eq=False)
class LaneTrace:
    """What was found on one lane.

    Attributes:
        nominal, chosen: the model as it is, and with the effects.
        final: what a new automaton should have: the chosen model, with a smooth correction if it is worth it.
        ranking: (name, evidence [nats], standard error) of every candidate alone, best first, the smooth correction
            among them as ``unexplained``.
        facts, outcome: what is known, and what is concluded from it.
        whiteness: largest autocorrelation of the innovations that remain, and how probable it were if they were white.
        left: what the innovations that remain follow; None where rows are too few.
        floor, rollout_floor: errors of one step and of roll-outs that noise alone would leave [rad or m].
        missing_modes: that the automaton lacks; a correction without a name is in their place (or see `added_mode`).
        closest: names of the effects that came closest, where a correction without a name predicts better.
        alternatives: the models of one effect that were considered.
    """

    lane: Lane
    search: Search
    nominal: Scored
    chosen: Scored
    final: Scored
    findings: tuple[Finding, ...]
    ranking: tuple[tuple[str, float, float], ...]
    facts: Facts
    outcome: Outcome
    whiteness: tuple[float, float]
    left: Leftover | None
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


def trace(search: Search, progress: Progress | None = None) -> LaneTrace:
    """Find what a lane's model lacks; where it leaves noise alone, nothing is sought."""
    told, lane, nominal = progress or _silent, search.lane, search.nominal
    is_quiet = search.leaves_nothing(nominal)
    singles, growth = ((), Growth(nominal, ())) if is_quiet else _explored(search, told)
    loose = nominal if is_quiet else _smoothed(search, search.nominal)
    modes = () if search.leaves_nothing(growth.chosen) else _modes(search, growth.chosen, loose)
    closest = () if modes else _imitated(search, growth.chosen, loose)
    if modes or closest:
        # Effects that act everywhere only imitate what a mode of its own, or something without a name, does.
        growth = Growth(search.nominal, growth.alternatives)
    chosen = growth.chosen
    told(f"{lane.coordinate}: what remains", 0.9)
    is_enough = not modes and not closest and search.leaves_nothing(chosen)
    remaining = chosen if is_enough else loose if chosen is search.nominal else _smoothed(search, chosen)
    named = chosen if chosen.parts or growth.blocked is None else growth.blocked
    findings = _findings(search, nominal, named, growth.alternatives)
    left, is_worth_it = search.left_by(chosen), is_worth(remaining, chosen, lane)
    facts = Facts(
        effects=len(named.parts),
        modes=len(modes),
        is_open=any(may_remember(lane, one) for one in findings),
        is_blocked=named is not chosen,
        smooth=_fraction_left(nominal, named, [loose, remaining]) if is_worth_it and not modes else 0.0,
        is_left=left is not None and left.is_more,
        is_corrected=any(effect.name == UNNAMED for effect in lane.effects),
    )
    final = remaining if is_worth_it and shortens(search, remaining, chosen) else chosen
    models = list({id(one): one for one in (final, chosen, named)}.values())
    floor, number = min((search.noise_floor(one), number) for number, one in enumerate(models))
    return LaneTrace(
        lane=lane,
        search=search,
        nominal=nominal,
        chosen=chosen,
        final=search.nominal if facts.is_open else final,
        findings=tuple(replace(one, is_added=not (facts.is_open or facts.is_blocked)) for one in findings),
        ranking=() if is_quiet else _ranking(nominal, [*singles, loose]),
        missing_modes=modes,
        facts=facts,
        outcome=outcome_of(facts),
        whiteness=search.whiteness(chosen),
        left=left,
        floor=floor,
        rollout_floor=search.rollout_floor(models[number], floor),
        closest=closest,
        alternatives=growth.alternatives,
    )


def _ranking(nominal: Scored, models: Sequence[Scored]) -> tuple[tuple[str, float, float], ...]:
    return tuple(sorted([(one.names[-1], *one.over(nominal)) for one in models], key=lambda row: -row[1]))


def _modes(search: Search, chosen: Scored, loose: Scored) -> tuple[MissingMode, ...]:
    """Modes that the automaton lacks. An idle correction predicts as the model without it, which is a rival anyway."""
    rivals = [search.innovations(one) for one in (chosen, loose) if not one.is_idle]
    nominal = search.nominal
    return missing_modes(search.lane, search.innovations(nominal), search.fold, rivals, search.spread(nominal))


def _imitated(search: Search, chosen: Scored, loose: Scored) -> tuple[str, ...]:
    """Names of effects that only imitate what a correction without a name does; none if they do more than that.

    One is the plainer of the two: only evidence as for an effect speaks against it. Two together must have that
    evidence themselves: nearly any smooth curve is a sum of two effects.
    """
    if chosen is search.nominal or not chosen.parts or loose.is_idle:
        return ()
    least = -LEAST_EVIDENCE if len(chosen.parts) == 1 else LEAST_EVIDENCE
    is_outdone = chosen.over(loose)[0] < least and shortens(search, loose, search.nominal)
    return chosen.names if is_outdone else ()


def _explored(search: Search, told: Progress) -> tuple[tuple[Scored, ...], Growth]:
    """All single effects, and what was chosen; first of all whether commands are places, which is then nominal."""
    library = candidates(search.lane)
    for_places = [one for one in library if one.name not in CONTAINED]
    if search.leads_to_places(search.nominal):
        return _grown(search, for_places, told)
    singles, growth = _grown(search, library, told)
    told(f"{search.lane.coordinate}: {FOLLOW}", 0.5)
    place = followed(search)
    # Displacements that the part carries out in any way that is smooth: few one-way runs look as if they were places.
    loose = _smoothed(search, search.nominal)
    rivals = [growth.chosen, loose, *((growth.blocked,) if growth.blocked is not None else ())]
    if not means_places(search, place, ranked(rivals)[0]):
        # Where neither is ahead, places are tied with what was found.
        return singles, replace(growth, alternatives=(*growth.alternatives, place))
    search.nominal = place
    more, growth = _grown(search, for_places, told)
    return (*singles, place, *more), growth


def _grown(search: Search, library: Sequence[Candidate], told: Progress) -> tuple[tuple[Scored, ...], Growth]:
    """All single effects on top of the nominal model, and what was chosen among them and those of two."""
    singles = scored_all(search, search.nominal, library, told, 0.05, 0.5)
    return tuple(singles), grow(search, library, [one for one in singles if not one.is_idle], told)


def may_remember(lane: Lane, finding: Finding) -> bool:
    """Whether it is open if an effect comes from this command or from earlier ones.

    It is tied with one of the other sort; or it depends on the place, and the runs are so alike that what depends on
    earlier commands looks the same. What a wrong guess does to a plan is worse than doing nothing.
    """
    own = finding.part.term.form.layer
    if own == "force" and lane.repeats_one_motion:
        return True
    return any((form(name).layer == "memory") != (own == "memory") for name in finding.tied)


def _silent(message: str, fraction: float) -> None:
    """Progress that nobody asked for."""
    del message, fraction


def _smoothed(search: Search, base: Scored) -> Scored:
    """A model with the smooth correction on top: all of it, or only what depends on the command if that is better."""
    lane = search.lane
    # Where all runs are alike a function of the place could be one of time.
    is_enough = lane.counted.sum() >= _ROWS_FOR_SMOOTH and not lane.repeats_one_motion
    kinds = (True, False) if is_enough else (True,)
    return ranked([search.score((*base.parts, smooth(lane, is_lean=is_lean)), base) for is_lean in kinds])[0]


def _fraction_left(nominal: Scored, chosen: Scored, smoother: Sequence[Scored]) -> float:
    """Share of the evidence against the nominal model that the chosen effects leave to smooth corrections, 0 to 1."""
    best = max(one.over(nominal)[0] for one in (chosen, *smoother))
    return float(np.clip(1.0 - chosen.over(nominal)[0] / best, 0.0, 1.0)) if best > 0 else 0.0


def _findings(search: Search, nominal: Scored, chosen: Scored, alternatives: Sequence[Scored]) -> tuple[Finding, ...]:
    found, column = [], 0
    known = search.intervals(chosen) if chosen.parts else np.zeros((0, 3))
    for number, part in enumerate(chosen.parts):
        own = known[column : column + len(part.free)]
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
            rivals = {one.names[-1]: one for one in alternatives if one.names[-1] != part.name}
            able = [(name, one) for name, one in rivals.items() if _is_tied(chosen, one)]
            # What would do the same as a tied one was not tried, but is tied as well.
            alike = [name for _, one in able for name in indistinguishable(one.parts[-1], search.lane)]
            tied = tuple(name for name in (*(name for name, _ in able), *alike) if name != part.name)
        is_always = not part.term.modes and not np.isfinite(part.starts[0, -GATES:]).any()
        same = indistinguishable(part, search.lane) if is_always else ()
        tied = tuple(dict.fromkeys((*tied, *same)))
        found.append(Finding(replace(part, starts=values), interval, evidence, tied))
    return tuple(sorted(found, key=lambda finding: -finding.evidence))


def _is_tied(best: Scored, other: Scored) -> bool:
    """Whether another model would do as well.

    It predicts as well; or no effect's evidence is between them, and with no more parameters it fits all rows better:
    where one run alone shows an effect, what is held out says how well the other runs happen to tell its parameters.
    """
    gap, error = best.over(other)
    fits = other.fit.loss[0] <= best.fit.loss[0] and len(other.parts[-1].free) <= len(best.parts[-1].free)
    return gap < max(TIE, min(_ERRORS * error, _SLACK * other.density.size)) or (bool(fits) and gap < LEAST_EVIDENCE)
