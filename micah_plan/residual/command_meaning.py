"""What a command means: a displacement from wherever the part is, or a place that the part goes after.

A log's action is the same in both: the place relative to the measured pose. But a displacement says nothing of where
the part is, and a place does: what the part missed before, it makes up for. Both are compared by what they predict of
held-out rows, each from all measurements before. What was meant is also more regular by itself, the sequence of
displacements or that of places, since what blurs a measurement is in the other one: that decides where both predict the
same (a part that does as it is told, seen without noise), and speaks against places that hardly predict better, as
measured poses do where the noise of a tracker wanders. Roll-outs cannot decide, since places contain the measured poses
that they are relative to; but where commands were relative to what a controller believed, and something else measured
the part, they can, and do. Where the recording says what its commands mean, nothing is compared.

The response to a place is one family (`follow`): a share of the way per row, and an offset; with delay, momentum
(second order), gain and a dead zone, alone or together, where that predicts held-out rows clearly better.

Source: Ljung, System Identification, 2nd ed., ch. 4.2 and 16 (model structures, their selection on held-out data).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.effects.memories import AS_COMMANDED, is_as_commanded
from micah_plan.automaton.effects.registry import form
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.likelihood import LEAST_EVIDENCE, robust_log_density
from micah_plan.residual.search import NEVER_GATED, Scored, Search, TermCandidate
from micah_plan.residual.simulation import GATES, Term
from micah_plan.residual.worth import ELSEWHERE, elsewhere, is_worth, ranked

FOLLOW = "follow"
# Columns of `follow`: those that are always fitted, and starts of the others, which are at rest otherwise.
_SHARE, _OFFSET, _GAIN, _DELAY, _MOMENTUM, _WIDTH = range(6)
_AT_REST = (0.5, 0.0, 1.0, 0.0, 0.0, 0.0)
_SHARES = (0.03, 0.15, 0.5, 0.9)
RESPONSE_STARTS = {_GAIN: (0.9, 1.1), _DELAY: (0.5, 1.5, 3.0, 6.0), _MOMENTUM: (0.3, 0.7), _WIDTH: (0.02, 0.1)}

# Names of the effects that this family has in itself.
CONTAINED = ("gain", "bias", "delay", "lag", "dead_zone", "spring")
# Commands before one that its regularity is judged by.
_MEMORY = 2
# Degrees of freedom of what is not foretold (a few jumps decide nothing), and the least of it, as a share of all.
_FREEDOM, _FINEST = 2.0, 1e-3

# Share of what a sequence of commands says by being irregular that counts: its rows are no independent witnesses.
_HEARD = 0.25


def may_mean_places(search: Search, place: Scored, displaced: Scored) -> bool:
    """Whether places must be given a further effect before they are judged: the best model of displacements has one.

    Only where earlier places foretell the next one better than earlier displacements do.
    """
    is_fair = search.data.is_outside or len(displaced.parts) <= len(place.parts)
    return not is_fair and is_worth(place, search.nominal, search.data) and regularity(search.data) > 0.0


def means_places(search: Search, place: Scored, displaced: Scored, nominal: Scored | None = None) -> bool:
    """Whether commands that are places predict better than the best model of displacements.

    Args:
        nominal: the model without either; None: that of the search.
    """
    if search.data.is_outside:
        rolled, displaced_squares = (float(np.sum(search.rollout_errors(model) ** 2)) for model in (place, displaced))
        return rolled < displaced_squares
    if not is_worth(place, nominal or search.nominal, search.data):
        return False
    gain, regular = place.over(displaced)[0], regularity(search.data)
    if (
        gain + _HEARD * min(regular, 0.0) > LEAST_EVIDENCE
        and elsewhere(place.density - displaced.density, search.data) > ELSEWHERE
    ):
        return True
    return gain > -LEAST_EVIDENCE and regular > LEAST_EVIDENCE


def regularity(data: CoordinateData) -> float:
    """By how much places are more predictable from those before than displacements from those before [nats].

    What blurs a measurement is in a displacement that leads to a place, and in the place that a displacement leads to.
    """
    whole = data.whole or data
    starts = whole.counted_starts
    starts[:, :_MEMORY] = False
    forms = []
    for series in (whole.u, whole.place):
        before = [np.roll(series, k + 1, axis=1)[starts] for k in range(_MEMORY)]
        now = series[starts]
        design = np.stack([np.ones(len(now)), *before], axis=1)
        forms.append(robust_log_density(design, now, _FREEDOM, _FINEST * float(np.std(now)) + ROUND_OFF))
    return forms[1] - forms[0]


def followed(search: Search, most: int) -> Scored:
    """The best response to commands that are places: of all forms of the family, each with all its parameters free.

    One parameter at a time would miss those that pay together only, such as a gain and a dead zone.

    Args:
        most: parameters beyond the share and the offset.
    """
    data, term = search.data, Term(form(FOLLOW))
    starts = np.array([[share, *_AT_REST[1:], *(-np.inf,) * GATES] for share in _SHARES])
    plain = (_SHARE, _OFFSET)
    forms = {frozenset[int](): search.score((TermCandidate(term, starts, plain, _scale(data, plain)),))}
    best = forms[frozenset()]
    for size in range(1, most + 1):
        for columns in map(frozenset, combinations(RESPONSE_STARTS, size)):
            column = max(columns, key=lambda column_left: float(forms[columns - {column_left}].density.sum()))
            forms[columns] = search.score((_freed(forms[columns - {column}].parts[0], column, data),))
        best_form = ranked([model for columns, model in forms.items() if len(columns) == size])[0]
        if is_worth(best_form, best, data):
            best = best_form
    return best


def _freed(part: TermCandidate, column: int, data: CoordinateData) -> TermCandidate:
    """The candidate with one more parameter to fit, from where it was fitted."""
    tried = RESPONSE_STARTS[column]
    starts = np.repeat(part.starts[:1], len(tried), axis=0)
    low, high = data.visited
    starts[:, column] = np.array(tried) * (high - low if column == _WIDTH else 1.0)
    free = tuple(sorted((*part.free, column)))
    return replace(part, starts=starts, free=free, scale=_scale(data, free))


def _scale(data: CoordinateData, free: tuple[int, ...]) -> Floats:
    low, high = data.visited
    large = 0.1 * (high - low) + 1e-9
    return np.array([{_OFFSET: large, _WIDTH: large, _DELAY: 1.0}.get(column, 0.3) for column in free])


def with_free_response(data: CoordinateData) -> Search:
    """A search whose nominal model is at the commanded places, but which may say how the part follows them."""
    others = tuple(effect for effect in data.effects if not is_as_commanded(effect))
    search = Search(replace(data, effects=others, meaning="position"))
    at_once = [[*(value for _, value in AS_COMMANDED), *NEVER_GATED]]
    search.nominal = search.score((TermCandidate(Term(form(FOLLOW)), np.array(at_once), (), np.zeros(0)),))
    return search
