"""Initial values for fits of position responses (`follow`).

A fit finds the nearest optimum, and there are many in delays and momenta: so fits start at delays up to the longest, at
slow and fast responses, and at least-squares estimates from measured steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from micah_plan.automaton.effects.fit_start import step_sizes
from micah_plan.automaton.effects.memories import AS_COMMANDED, LONGEST_DELAY
from micah_plan.automaton.effects.registry import form
from micah_plan.residual.candidates import FOLLOW, NEVER_GATED, Term, TermCandidate
from micah_plan.residual.coordinate_data import CoordinateData

# Share of commands that lead to where the part can be, give or take the range that was seen, if they are places.
_REACHABLE = 0.5
# Commands that differ by less than this share of their size are the same, except for their digits.
_DIGITS = 1e-3
# Delays [steps]; shares with momenta, down to those of rows that follow one another fast; the quantile of steps that
# limits cut.
_DELAYS = (0.5, 1.5, 2.5, 4.0, 6.0, 9.0, 13.0, 18.0, 25.0)
_RESPONSES = ((0.6, 0.0), (0.2, 0.0), (0.1, 0.5), (0.05, 0.9), (0.02, 0.8), (0.005, 0.87), (0.0005, 0.96))
_FASTEST = 0.98
# Delays of fewer rows than this each have a regression where fits begin; of longer ones the best has.
_SOON = 3
SHARE, OFFSET, GAIN, DELAY, MOMENTUM, WIDTH, PULL, ACCELERATION, SPEED, FRICTION = range(10)
"""Columns of the parameters of `follow`."""
_WHOLE = (SHARE, OFFSET, GAIN, DELAY, MOMENTUM)

_Start = Mapping[int, float]


def follows(data: CoordinateData) -> list[TermCandidate]:
    """Candidates of first order, with delay, of second order, with a dead zone or friction, and with limits.

    None if most commands lead out of the part's range, or all are the same: places are then the measured ones.
    """
    size, places = data.command_size, (data.z + data.u)[data.counted_starts]
    low, high = data.visited
    if np.ptp(data.u[data.counted_starts]) <= _DIGITS * size:
        return []
    if np.mean((places > low - (high - low)) & (places < high + (high - low))) < _REACHABLE:
        return []
    fastest, regressed = max(step_sizes(data, _FASTEST), default=size), _regressions(data)
    slow = [{DELAY: late, SHARE: share, MOMENTUM: of} for late in _DELAYS for share, of in _RESPONSES]
    at_once = [one for one in slow if not one[MOMENTUM]]
    delayed = [
        {SHARE: share, MOMENTUM: of, WIDTH: width * size, DELAY: late}
        for share, of in ((0.6, 0.0), (0.2, 0.6))
        for width in (0.02, 0.5)
        for late in (0.05, 1.0)
    ]
    delayed += [{**one, WIDTH: width * size} for one in regressed for width in (0.001, 0.1, 0.3)]
    delayed += [one | {WIDTH: 0.001 * size} for one in slow]
    rubbing = [{**one, WIDTH: 0.0, FRICTION: one[SHARE] * one[WIDTH]} for one in delayed]
    lates = (1.0, 2.0, 3.0, *(one[DELAY] for one in regressed[_SOON:]))
    second = [{SHARE: 0.5, MOMENTUM: 0.2}, {SHARE: 0.1, MOMENTUM: 0.7}, {SHARE: 0.01, MOMENTUM: 0.9}, *regressed[:1]]
    sizes: list[tuple[Sequence[int], Sequence[_Start]]] = [
        ((SHARE,), [{SHARE: share} for share in (0.9, 0.4, 0.1, 0.02)]),
        ((SHARE, OFFSET), [{SHARE: share} for share in (0.9, 0.4, 0.1, 0.02)]),
        ((SHARE, DELAY), [{SHARE: share, DELAY: late} for share in (0.5, 0.15) for late in lates]),
        ((SHARE, FRICTION), [{SHARE: s, FRICTION: k * s * size} for s in (0.9, 0.4, 0.1) for k in (0.03, 0.3)]),
        ((SHARE, OFFSET, GAIN, MOMENTUM), second),
        ((*_WHOLE, WIDTH), delayed),
        ((*_WHOLE, FRICTION), rubbing),
        ((SHARE, DELAY, PULL), [one | {PULL: k * fastest} for one in at_once for k in (1.0, 0.4)]),
        (
            (*_WHOLE, WIDTH, PULL),
            [one | {PULL: k * fastest * (1.0 - one[MOMENTUM])} for one in slow for k in (1.0, 0.4)],
        ),
        ((*_WHOLE, WIDTH, SPEED), [one | {SPEED: fastest} for one in slow]),
        (
            (SHARE, DELAY, ACCELERATION, SPEED),
            [one | {SPEED: fastest, ACCELERATION: k * fastest} for one in at_once for k in (0.3, 0.1)],
        ),
    ]
    return [_candidate_of(free, starts, size, fastest) for free, starts in sizes]


def _candidate_of(free: Sequence[int], starts: Sequence[_Start], size: float, fastest: float) -> TermCandidate:
    """Args: fitted columns; their values at each start; usual command and fast step [rad or m]."""
    values = np.repeat([[0.5, *(value for _, value in AS_COMMANDED[1:]), *NEVER_GATED]], len(starts), axis=0)
    for row, start in zip(values, starts, strict=True):
        for column, value in start.items():
            parameter = form(FOLLOW).parameters[column]
            row[column] = min(max(value, parameter.lower), parameter.upper)
    large = {SHARE: 0.3, OFFSET: 0.3 * size, GAIN: 0.1, DELAY: 1.0, MOMENTUM: 0.3, WIDTH: 0.2 * size}
    large |= dict.fromkeys((PULL, ACCELERATION, SPEED, FRICTION), 0.3 * fastest)
    return TermCandidate(Term(form(FOLLOW)), values, tuple(free), np.array([large[k] for k in free]))


def _regressions(data: CoordinateData) -> list[dict[int, float]]:
    """Least-squares parameters for each short delay, and for the best longer one."""
    longest = min(LONGEST_DELAY, data.z.shape[1] - 3)
    soon = [_regressed(data, late)[0] for late in range(_SOON)]
    later = [_regressed(data, late) for late in range(_SOON, longest)]
    return [*soon, *(found for found, _ in sorted(later, key=lambda one: one[1])[:1])]


def _regressed(data: CoordinateData, late: int) -> tuple[dict[int, float], float]:
    """Least-squares parameters of `follow` from measured steps, with positions delayed by `late` to `late` + 1 rows.

    A delay between two rows is a share of the place in each.

    Returns:
        the parameters, and the mean squared error of a step.
    """
    first = late + 1
    rows = data.z.shape[1] - 1
    now, before, after = data.z[:, first:rows], data.z[:, first - 1 : rows - 1], data.z[:, first + 1 :]
    places = [data.place[:, first - lag : rows - lag] for lag in (late, late + 1)]
    counts = data.counted[:, first + 1 :] & data.is_measured[:, first:rows] & data.is_measured[:, first - 1 : rows - 1]
    terms = [np.ones(counts.sum()), (now - before)[counts], *(place[counts] for place in places), now[counts]]
    given, moved = np.stack(terms, axis=1), (after - now)[counts]
    solution = np.linalg.lstsq(given, moved, rcond=None)[0]
    error = float(np.mean((moved - given @ solution) ** 2)) if len(moved) else np.inf
    offset, momentum, *of_places, of_part = solution.tolist()
    share, whole = max(-of_part, 1e-4), sum(of_places)
    between = min(max(of_places[1] / whole, 0.01), 1.0) if whole > 0.0 else 0.01
    start = {SHARE: share, OFFSET: offset / share, GAIN: whole / share, DELAY: late + between, MOMENTUM: momentum}
    return start, error
