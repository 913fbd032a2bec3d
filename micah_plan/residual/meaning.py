"""What a command means: a displacement from wherever the part is, or a place that the part goes after.

A log's action is the same in both: the place relative to the measured pose. But a displacement says nothing of where
the part is, and a place does: what the part missed before, it makes up for. Both are compared by what they predict of
held-out rows, each from all measurements before. What was meant is also more regular by itself, the sequence of
displacements or that of places, since what blurs a measurement is in the other one: that decides where both predict the
same (a part that does as it is told, seen without noise), and speaks against places that hardly predict better, as
measured poses do where the noise of a tracker wanders. Roll-outs cannot decide,
since places contain the measured poses that they are relative to; but where commands were relative to what a controller
believed, and something else measured the part, they can, and do.

The response to a place is one family (`follow`): a share of the way per row, and an offset; with delay, momentum
(second order), gain and a dead zone, alone or together, where that predicts held-out rows clearly better.

Source: Ljung, System Identification, 2nd ed., ch. 4.2 and 16 (model structures, their selection on held-out data).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.registry import form
from micah_plan.residual.candidates import Candidate
from micah_plan.residual.growth import LEAST_EVIDENCE, is_worth, ranked
from micah_plan.residual.lane import Lane
from micah_plan.residual.likelihood import SMALLEST_SCALE, robust_log_density
from micah_plan.residual.search import Scored, Search
from micah_plan.residual.simulation import GATES, Term

FOLLOW = "follow"
# Columns of `follow`: those that are always fitted, and starts of the others, which are at rest otherwise.
_SHARE, _OFFSET, _GAIN, _DELAY, _MOMENTUM, _WIDTH = range(6)
_AT_REST = (0.5, 0.0, 1.0, 0.0, 0.0, 0.0)
_SHARES = (0.03, 0.15, 0.5, 0.9)
_STARTS = {_GAIN: (0.9, 1.1), _DELAY: (0.5, 1.5, 3.0, 6.0), _MOMENTUM: (0.3, 0.7), _WIDTH: (0.02, 0.1)}

# Names of the effects that this family has in itself.
CONTAINED = ("gain", "bias", "delay", "lag", "dead_zone", "spring")
# Commands before one that its regularity is judged by.
_MEMORY = 2
# Degrees of freedom of what is not foretold (a few jumps decide nothing), and the least of it, as a share of all.
_FREEDOM, _FINEST = 2.0, 1e-3

# Share of what a sequence of commands says by being irregular that counts: its rows are no independent witnesses.
_HEARD = 0.25


def means_places(search: Search, place: Scored, displaced: Scored) -> bool:
    """Whether commands that are places predict better than the best model of displacements."""
    if search.lane.is_outside:
        rolled, other = (search.squares(one, "whole") for one in (place, displaced))
        return rolled < other
    if not is_worth(place, search.nominal, search.lane):
        return False
    gain, regular = place.over(displaced)[0], _regularity(search.lane)
    if gain + _HEARD * min(regular, 0.0) > LEAST_EVIDENCE:
        return True
    return gain > -LEAST_EVIDENCE and regular > LEAST_EVIDENCE


def _regularity(lane: Lane) -> float:
    """By how much places are more predictable from those before than displacements from those before [nats].

    What blurs a measurement is in a displacement that leads to a place, and in the place that a displacement leads to.
    """
    whole = lane.whole or lane
    starts = whole.counted_starts
    starts[:, :_MEMORY] = False
    found = []
    for series in (whole.u, whole.place):
        before = [np.roll(series, k + 1, axis=1)[starts] for k in range(_MEMORY)]
        now = series[starts]
        design = np.stack([np.ones(len(now)), *before], axis=1)
        found.append(robust_log_density(design, now, _FREEDOM, _FINEST * float(np.std(now)) + SMALLEST_SCALE))
    return found[1] - found[0]


def followed(search: Search) -> Scored:
    """The best response to commands that are places: of all forms of the family, each with all its parameters free.

    One parameter at a time would miss those that pay together only, such as a gain and a dead zone.
    """
    lane, term = search.lane, Term(form(FOLLOW))
    starts = np.array([[share, *_AT_REST[1:], *(-np.inf,) * GATES] for share in _SHARES])
    plain = (_SHARE, _OFFSET)
    forms = {frozenset[int](): search.score((Candidate(term, starts, plain, _scale(lane, plain)),))}
    best = forms[frozenset()]
    for size in range(1, len(_STARTS) + 1):
        for columns in map(frozenset, combinations(_STARTS, size)):
            column = max(columns, key=lambda one: float(forms[columns - {one}].density.sum()))
            forms[columns] = search.score((_freed(forms[columns - {column}].parts[0], column, lane),))
        found = ranked([one for columns, one in forms.items() if len(columns) == size])[0]
        if is_worth(found, best, lane):
            best = found
    return best


def _freed(part: Candidate, column: int, lane: Lane) -> Candidate:
    """The candidate with one more parameter to fit, from where it was fitted."""
    tried = _STARTS[column]
    starts = np.repeat(part.starts[:1], len(tried), axis=0)
    low, high = lane.visited
    starts[:, column] = np.array(tried) * (high - low if column == _WIDTH else 1.0)
    free = tuple(sorted((*part.free, column)))
    return replace(part, starts=starts, free=free, scale=_scale(lane, free))


def _scale(lane: Lane, free: tuple[int, ...]) -> Floats:
    low, high = lane.visited
    large = 0.1 * (high - low) + 1e-9
    return np.array([{_OFFSET: large, _WIDTH: large, _DELAY: 1.0}.get(column, 0.3) for column in free])
