"""Which effect is missing: forward selection over the library by held-out likelihood, and an honest verdict.

A model may add effects one by one. Each must predict held-out rows better by more than `LEAST_EVIDENCE` nats, by more
than chance over stretches allows, and by enough per row to matter. What a smooth correction still gains on top says how
much is left that no effect of the library explains (Akaike's predictive argument, by cross-validation: Stone, JRSS B
1974).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.residual.candidates import Candidate, candidates, indistinguishable, smooth
from micah_plan.residual.lane import Lane
from micah_plan.residual.search import Scored, Search, gated
from micah_plan.residual.simulation import GATES, Term
from micah_plan.residual.verdict import Verdict, verdict

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

# Evidence [nats] that an effect must have: odds of 3000 to 1, more than what two dozen candidates take to be safe.
LEAST_EVIDENCE = 8.0
# ... by so many standard errors over stretches, and so much per row (1 % of the innovations' std).
_ERRORS = 2.0
_PER_ROW = 0.01
# Innovations that are correlated more than this, and less probably so by chance, have something left in them.
_CORRELATED = 0.25
_UNLIKELY = 1e-4
# Errors below this are those of arithmetic [rad or m].
_EXACT = 1e-7
# A more complicated variant (only in a mode, only since a time) must gain this much over the plain one [nats].
_VARIANT_EVIDENCE = 8.0
# Candidates within this of the best are tied with it, or within two standard errors up to so much per stretch [nats].
TIE = 3.0
_SLACK = 0.5
_SHORTER = 0.999
# Steps that a smooth function of the configuration needs at least.
_ROWS_FOR_SMOOTH = 60
_WIDE = 3
# Of forms that the data cannot tell apart the plainest is named first.
PLAINEST = (
    "gain",
    "bias",
    "spring",
    "gravity",
    "dead_zone",
    "saturation",
    "delay",
    "lag",
    "backlash",
    "guard_shift",
    "limit",
    "latch",
    "guard_hysteresis",
    "drift",
    "sensor_scale",
    "frame_rotation",
)


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that was found on a lane.

    Attributes:
        part: its term and fitted parameters, gates included.
        std: (size,) of the parameters; 0 for those that were not fitted.
        evidence: what predictions lose without it [nats].
        tied: names of other effects that would do as well in its place.
    """

    part: Candidate
    std: Floats
    evidence: float
    tied: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class LaneTrace:
    """What was found on one lane.

    Attributes:
        nominal, chosen: the model as it is, and with the effects.
        remaining: the chosen model with a smooth correction on top.
        ranking: (name, evidence [nats], standard error) of every candidate alone, best first, the smooth correction
            among them as ``unexplained``.
        correlation, white_probability: largest autocorrelation of the innovations that remain, and how probable it were
            if they were white.
        final: what a new automaton should have: the chosen model, with the correction if it is worth it.
    """

    lane: Lane
    search: Search
    nominal: Scored
    chosen: Scored
    remaining: Scored
    final: Scored
    findings: tuple[Finding, ...]
    ranking: tuple[tuple[str, float, float], ...]
    verdict: Verdict
    unexplained_fraction: float
    correlation: float
    white_probability: float


def trace(lane: Lane, progress: Progress | None = None) -> LaneTrace:
    """Find what a lane's model lacks."""
    told = progress or _silent
    told(f"{lane.coordinate}: noise", 0.0)
    search = Search(lane)
    lane = search.lane
    library = candidates(lane)
    singles = _scored_all(search, search.nominal, library, told, 0.05, 0.5)
    loose = _smoothed(search, search.nominal)
    ranking = sorted([(one.names[-1], *one.over(search.nominal)) for one in [*singles, loose]], key=lambda row: -row[1])
    able = [one for one in singles if not one.is_idle]
    chosen, alternatives = _grown(search, library, able, told)
    told(f"{lane.coordinate}: what remains", 0.9)
    remaining = chosen if search.leaves_nothing(chosen) else _smoothed(search, chosen)
    correlation, chance = search.whiteness(chosen)
    size = float(np.sqrt(chosen.squared / lane.counted.sum()))
    is_wandering = abs(correlation) > _CORRELATED and chance < _UNLIKELY and size > _EXACT
    is_left = _is_worth(remaining, chosen, lane)
    # Several effects together that predict worse than a correction without a name only imitate it.
    is_outdone = len(chosen.parts) > 1 and loose.over(chosen)[0] > LEAST_EVIDENCE
    fraction = _fraction_left(search.nominal, chosen, [loose, remaining])
    final = remaining if is_left and _shortens(search, remaining, chosen) else chosen
    return LaneTrace(
        lane=lane,
        search=search,
        nominal=search.nominal,
        chosen=chosen,
        remaining=remaining,
        final=final,
        findings=_findings(search, chosen, alternatives),
        ranking=tuple(ranking),
        verdict=verdict(len(chosen.parts), is_left, is_wandering or is_outdone, fraction),
        unexplained_fraction=fraction if chosen.parts or is_left else float(is_wandering),
        correlation=correlation,
        white_probability=chance,
    )


def _silent(message: str, fraction: float) -> None:
    """Progress that nobody asked for."""
    del message, fraction


def _scored_all(
    search: Search,
    base: Scored,
    library: Sequence[Candidate],
    told: Progress,
    begin: float,
    end: float,
) -> list[Scored]:
    scored = []
    for number, candidate in enumerate(library):
        told(f"{search.lane.coordinate}: {candidate.name}", begin + (end - begin) * number / len(library))
        scored.append(search.score((*base.parts, candidate), base))
    return scored


def _grown(
    search: Search, library: Sequence[Candidate], singles: Sequence[Scored], told: Progress
) -> tuple[Scored, list[Scored]]:
    """The best model that effects can make, and the models of one effect that it competed with."""
    lane = search.lane
    current = search.nominal
    plain = _plainest(singles, current)
    is_good = plain is not None and _is_worth(plain, current, lane) and _shortens(search, plain, current)
    if plain is not None and is_good and search.leaves_nothing(plain):
        # Then neither a second effect nor one that acts only in places or since some time can gain anything.
        return plain, list(singles)
    promising = [one for one in _ranked(singles)[:_WIDE] if one.over(current)[0] > LEAST_EVIDENCE]
    options = [*singles, *(variant for one in promising for variant in _variants(search, one, current))]
    first = _plainest(options, current)
    while first is not None and _is_worth(first, current, lane) and not _shortens(search, first, current):
        options = [one for one in options if one is not first]
        first = _plainest(options, current)
    if first is None or not _is_worth(first, current, lane):
        return current, options
    grown: list[Scored] = []
    heads = list({one.names[-1]: one for one in (*promising, first)}.values())
    for number, head in enumerate(heads):
        rest = [c for c in library if c.name not in head.names]
        share = 0.5 + 0.4 * number / len(heads)
        grown += _scored_all(search, head, rest, told, share, share + 0.4 / len(heads))
    grown = [one for one in grown if not one.is_idle]
    better = _ranked(grown)[:2]
    grown += [variant for one in better for variant in _variants(search, one, first)]
    second = max(grown, key=lambda one: float(one.density.sum()), default=first)
    if not _is_worth(second, first, lane):
        return first, options
    return _without_idle(search, second, first), options


def _without_idle(search: Search, pair: Scored, first: Scored) -> Scored:
    """A model of two effects, or of one of them fitted again if the other does not pay."""
    alone = [search.score(pair.parts[:1]), search.score(pair.parts[1:]), first]
    best = _plainest(alone, search.nominal) or first
    return pair if _is_worth(pair, best, search.lane) else best


def _variants(search: Search, one: Scored, base: Scored) -> list[Scored]:
    """The last effect of a model only in one mode, or only since some time, where that predicts clearly better."""
    if one.over(base)[0] < LEAST_EVIDENCE:
        return []
    lane, last, before = search.lane, one.parts[-1], one.parts[:-1]
    found = []
    rows = lane.mode[lane.counted]
    present = [k for k in range(len(lane.modes)) if np.mean(rows == k) > 0.05]
    if len(present) > 1:
        for k in present:
            term = Term(last.term.form, (lane.modes[k],))
            found.append(search.score((*before, replace(last, term=term))))
    if last.term.form.layer != "guard":
        duration = float(lane.time[lane.counted].max())
        places = [float(q) for q in np.linspace(0.1, 0.9, 9)]
        times = [share * duration for share in (0.2, 0.35, 0.5, 0.65, 0.8)]
        found.append(search.score((*before, gated(last, places, times))))
    return [variant for variant in found if variant.over(one)[0] > _VARIANT_EVIDENCE]


def _ranked(scored: Sequence[Scored]) -> list[Scored]:
    return sorted(scored, key=lambda one: -float(one.density.sum()))


def _plainest(options: Sequence[Scored], base: Scored) -> Scored | None:
    """The best; of those that are as good, the one with the plainest last effect."""
    # Likelihood alone could be bought by calling a few rows noise.
    options = [one for one in options if one.squared < base.squared]
    if not options:
        return None
    best = _ranked(options)[0].over(base)[0]
    close = [one for one in options if one.over(base)[0] >= best - TIE]
    return min(close, key=lambda one: _plainness(one.names[-1]))


def _plainness(name: str) -> int:
    return PLAINEST.index(name) if name in PLAINEST else len(PLAINEST)


def _is_worth(better: Scored, base: Scored, lane: Lane) -> bool:
    gain, error = better.over(base)
    rows = int(lane.counted.sum())
    return better.squared < base.squared and gain > max(LEAST_EVIDENCE, _ERRORS * error, _PER_ROW * rows)


def _smoothed(search: Search, base: Scored) -> Scored:
    """A model with the smooth correction on top: all of it, or only what depends on the command if that is better."""
    lane = search.lane
    kinds = (True, False) if lane.counted.sum() >= _ROWS_FOR_SMOOTH else (True,)
    return _ranked([search.score((*base.parts, smooth(lane, is_lean=is_lean)), base) for is_lean in kinds])[0]


def _fraction_left(nominal: Scored, chosen: Scored, smoother: Sequence[Scored]) -> float:
    """Share of the evidence against the nominal model that the chosen effects leave to smooth corrections, 0 to 1."""
    best = max(one.over(nominal)[0] for one in (chosen, *smoother))
    return float(np.clip(1.0 - chosen.over(nominal)[0] / best, 0.0, 1.0)) if best > 0 else 0.0


def _shortens(search: Search, better: Scored, base: Scored) -> bool:
    """Whether plain one-step errors get smaller too: what only helps a filter is not worth a place in the model."""
    after, before = (float(np.sum(search.errors(one, "one_step") ** 2)) for one in (better, base))
    return after < _SHORTER * before


def _findings(search: Search, chosen: Scored, alternatives: Sequence[Scored]) -> tuple[Finding, ...]:
    found, at, column = [], 0, 0
    information = chosen.fit.information[0] if chosen.parts else np.zeros((0, 0))
    covariance = np.linalg.pinv(information) if information.size else information
    for number, part in enumerate(chosen.parts):
        std = np.zeros(part.term.size)
        for free in part.free:
            std[free] = np.sqrt(max(float(covariance[column, column]), 0.0))
            column += 1
        others = (*chosen.parts[:number], *chosen.parts[number + 1 :])
        without = search.score(others) if others else search.nominal
        evidence = chosen.over(without)[0]
        tied: tuple[str, ...] = ()
        if len(chosen.parts) == 1:
            rivals = {one.names[-1]: one for one in alternatives if one.names[-1] != part.name}
            able = [(name, one) for name, one in rivals.items() if _is_tied(chosen, one)]
            # What would do the same as a tied one was not tried, but is tied as well.
            alike = [name for _, one in able for name in indistinguishable(one.parts[-1], search.lane)]
            tied = tuple(name for name in (*(name for name, _ in able), *alike) if name != part.name)
        is_always = not part.term.modes and not np.isfinite(part.starts[0, -GATES:]).any()
        same = indistinguishable(part, search.lane) if is_always else ()
        tied = tuple(dict.fromkeys((*tied, *same)))
        found.append(Finding(part, std, evidence, tied))
        at += part.term.size
    return tuple(sorted(found, key=lambda finding: -finding.evidence))


def _is_tied(best: Scored, other: Scored) -> bool:
    gap, error = best.over(other)
    return gap < max(TIE, min(_ERRORS * error, _SLACK * other.density.size))
