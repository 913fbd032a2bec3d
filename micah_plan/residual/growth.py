"""Forward selection of effects: the best one, one that acts in places or since some time only, or two together.

A model may take in an effect if it predicts held-out rows better by more than chance, and not in a single stretch
alone; if plain one-step errors get smaller too; and if the roll-out does not get worse: what helps each single step but
adds up to a larger error hides that something else is missing as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.residual.candidates import Candidate
from micah_plan.residual.lane import Lane
from micah_plan.residual.search import Errors, Scored, Search, gated
from micah_plan.residual.simulation import Term
from micah_plan.summaries import Progress

# Evidence [nats] that an effect must have: odds of 3000 to 1, more than what two dozen candidates take to be safe.
LEAST_EVIDENCE = 8.0
# ... of which so much outside of the stretch that gains most, by so many times what other stretches lose (as a root of
# squares), and so much per row (1 % of the innovations' std).
_ELSEWHERE = 4.0
_ERRORS = 2.0
_PER_ROW = 0.01
# A more complicated variant (only in a mode, only since a time) must gain this much over the plain one [nats].
_VARIANT_EVIDENCE = 8.0
# Candidates within this of the best are as good as it [nats].
TIE = 3.0
# What one-step and roll-out errors may be of those before.
_SHORTER = 0.999
_NOT_LONGER = 1.02
_WIDE = 3
_TRIED = 5


@dataclass(frozen=True, eq=False)
class Growth:
    """What was chosen.

    Attributes:
        chosen: the best model that effects can make; the nominal one if none is worth it.
        alternatives: the models of one effect that it competed with.
        blocked: the best model that predicts single steps better but makes the roll-out longer, if nothing else did
            better; it was not chosen.
    """

    chosen: Scored
    alternatives: tuple[Scored, ...]
    blocked: Scored | None = None


def grow(search: Search, library: Sequence[Candidate], singles: Sequence[Scored], told: Progress) -> Growth:
    """Choose among models of one and two effects, and variants of the best."""
    nominal = search.nominal
    plain = _plainest(singles, nominal)
    if plain is not None and improves(search, plain, nominal) and search.leaves_nothing(plain):
        # Then neither a second effect nor one that acts only in places or since some time can gain anything.
        return Growth(plain, tuple(singles))
    promising = [one for one in ranked(singles)[:_WIDE] if one.over(nominal)[0] > LEAST_EVIDENCE]
    options = [*singles, *(variant for one in promising for variant in _variants(search, one, nominal))]
    first, blocked = _first(search, options)
    if first is not None and search.leaves_nothing(first):
        return Growth(first, tuple(options))
    if first is None and blocked is None:
        return Growth(nominal, tuple(options))
    heads = [*promising, *(one for one in (first, blocked) if one is not None)]
    base = first or nominal
    for pair in _pairs(search, library, heads, base, told):
        if is_worth(pair, base, search.lane) and improves(search, pair, nominal):
            return Growth(_without_idle(search, pair, base), tuple(options), blocked)
    return Growth(base, tuple(options), blocked)


def _first(search: Search, options: Sequence[Scored]) -> tuple[Scored | None, Scored | None]:
    """The plainest of the best single effects that may be taken in, and the best that only helps single steps."""
    blocked, left = None, list(options)
    while (first := _plainest(left, search.nominal)) is not None and is_worth(first, search.nominal, search.lane):
        if improves(search, first, search.nominal):
            return first, blocked
        steps, before = (search.squares(one, "one_step") for one in (first, search.nominal))
        if blocked is None and steps < _SHORTER * before:
            blocked = first
        left = [one for one in left if one is not first]
    return None, blocked


def _pairs(
    search: Search, library: Sequence[Candidate], heads: Sequence[Scored], base: Scored, told: Progress
) -> list[Scored]:
    """Models of two effects, best first."""
    grown: list[Scored] = []
    kept = list({one.names[-1]: one for one in heads}.values())
    for number, head in enumerate(kept):
        rest = [c for c in library if c.name not in head.names]
        share = 0.5 + 0.4 * number / len(kept)
        grown += scored_all(search, head, rest, told, share, share + 0.4 / len(kept))
    grown = [one for one in grown if not one.is_idle]
    grown += [variant for one in ranked(grown)[:2] for variant in _variants(search, one, base)]
    return _plainest_first(grown)[:_TRIED]


def _plainest_first(options: Sequence[Scored]) -> list[Scored]:
    """Best first, but of those that are as good as the best the plainest effects first."""
    order = ranked(options)
    close = [one for one in order if order[0].over(one)[0] <= TIE]
    plainest = sorted(close, key=lambda one: sum(part.term.form.plainness for part in one.parts))
    return [*plainest, *order[len(close) :]]


def scored_all(
    search: Search,
    base: Scored,
    library: Sequence[Candidate],
    told: Progress,
    begin: float,
    end: float,
) -> list[Scored]:
    """Each of the library on top of a model."""
    scored = []
    for number, candidate in enumerate(library):
        told(f"{search.lane.coordinate}: {candidate.name}", begin + (end - begin) * number / len(library))
        scored.append(search.score((*base.parts, candidate), base))
    return scored


def _without_idle(search: Search, pair: Scored, base: Scored) -> Scored:
    """A model of two effects, or of one of them fitted again if the other does not pay."""
    alone = [search.score((*pair.parts[:-2], one)) for one in pair.parts[-2:]]
    best = ranked([*alone, *((base,) if base.names else ())])[0]
    return pair if is_worth(pair, best, search.lane) else best


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


def ranked(scored: Sequence[Scored]) -> list[Scored]:
    """Best first."""
    return sorted(scored, key=lambda one: -float(one.density.sum()))


def _plainest(options: Sequence[Scored], base: Scored) -> Scored | None:
    """The best; of those that are as good, the one with the plainest last effect."""
    # Likelihood alone could be bought by calling a few rows noise.
    options = [one for one in options if one.squared < base.squared]
    if not options:
        return None
    return _plainest_first(options)[0]


def is_worth(better: Scored, base: Scored, lane: Lane) -> bool:
    """Whether held-out rows are predicted so much better that it is no chance, and not in a single stretch alone."""
    gains = better.density - base.density
    gain = float(gains.sum())
    if better.squared >= base.squared or gain <= max(LEAST_EVIDENCE, _PER_ROW * int(lane.counted.sum())):
        return False
    losses = float(np.sqrt((np.minimum(gains, 0.0) ** 2).sum()))
    return gain > _ERRORS * losses and gain - float(gains.max()) > _ELSEWHERE


def improves(search: Search, better: Scored, base: Scored) -> bool:
    """Whether a model is worth it and one-step errors get smaller too, without making the roll-out longer."""
    if better is base or not is_worth(better, base, search.lane):
        return False
    return shortens(search, better, base)


def shortens(search: Search, better: Scored, base: Scored) -> bool:
    """Whether held-out one-step errors get smaller and roll-out errors, of stretches and of whole runs, no larger."""
    kinds: tuple[Errors, ...] = ("one_step", "rollout", "whole")
    steps, *rolls = ([search.squares(one, kind) for one in (better, base)] for kind in kinds)
    return steps[0] < _SHORTER * steps[1] and all(own[0] <= _NOT_LONGER**2 * own[1] for own in rolls)
