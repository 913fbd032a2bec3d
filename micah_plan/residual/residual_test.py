"""Residual test: a regression on generic functions that separates noise from structure, without any library of effects.

Anything that the model lacks appears in one-step errors as a function of the command, of earlier commands, of the place
or of time. A linear regression on flexible functions of these removes it; the remainder is the noise floor of the data.
It is an upper bound: errors that follow none of these functions count as noise.

Sources: Draper and Smith, Applied Regression Analysis, ch. 5 and 6 (extra sum of squares, F test); Jones, Mathematical
and Computer Modelling 2004 (noise variance from data before any model is chosen).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr
from scipy.special import fdtrc

from micah_plan.arrays import ROUND_OFF, Floats, Ints, earlier_rows, robust_std

# Earlier commands that may still act, and places over the range.
LAGS = 4
_PLACES = 8
# Rows per function that a regression takes.
_ROWS_PER_FUNCTION = 4
FEWEST_ROWS = 12
_FIRST = ("a constant", "the command", "earlier commands")  # of what few rows are asked for
_ERRORS = "earlier errors"
# Probabilities: below the first a residual is not noise, above the second it is (an effect with one parameter and the
# evidence that it needs has 4e-4 among seven groups).
UNLIKELY, _SUSPECT = 1e-4, 1e-2
# Share of the variance that may follow something: a fourth of what is correlated from row to row, squared.
_FOLLOWS = 0.0625
_RANK = 1e-8


@dataclass(frozen=True, eq=False)
class ResidualTest:
    """Result of regressing d residuals.

    Attributes:
        floor: (d,) std of the noise, in the residuals' units.
        remainder: (N, d) residual of the regression.
        probability: that noise alone explains as much.
        follows: (name, probability under noise) of each group of functions that explains more than those before.
        share: of the variance that the regression explains beyond noise, 0 to 1.
        least: smallest probability of a single group, times their number.
    """

    floor: Floats
    remainder: Floats
    probability: float
    follows: tuple[tuple[str, float], ...]
    share: float = 0.0
    least: float = 1.0

    def __str__(self) -> str:
        return ", ".join(what for what, _ in self.follows) or "several things together"

    @property
    def is_noise(self) -> bool:
        """Whether neither all functions together nor any group is significant."""
        return min(self.probability, self.least) > _SUSPECT

    @property
    def is_more(self) -> bool:
        """Whether the explained part is significant and not negligible."""
        return min(self.probability, self.least) < UNLIKELY and self.share > _FOLLOWS


@dataclass(frozen=True, eq=False)
class Circumstances:
    """Regressors of N steps.

    Attributes:
        place: (N,) configuration at the start of the step, not from the measurement that the residual contains.
        command: (N, 1 + LAGS) of the step and of previous steps, the latest first.
        time: (N,) since the start of the run [s].
        order: (N,) place in the recording, 0 to 1.
        errors: (N, k) of the steps before; None where they cannot be independent.
        away: (N, k) for each end that a part is at, the command away from it; 0 elsewhere.
        spread: (N,) divisor of residuals that makes them equally precise; None: 1.
    """

    place: Floats
    command: Floats
    time: Floats
    order: Floats
    errors: Floats | None = None
    away: Floats | None = None
    spread: Floats | None = None


def whiteness_test(residual: Floats, under: Circumstances) -> ResidualTest | None:
    """Regress residuals (N, d); None with too few rows."""
    rows = len(residual)
    if rows < FEWEST_ROWS:
        return None
    groups = _groups(under, rows)
    size = np.sqrt(np.mean(residual**2, axis=0))
    scaled = _without_outliers(residual)
    names = list(groups)
    directions, of_group = _orthonormal(groups)
    freedom = rows - len(of_group)
    if freedom < 1 or not (size > ROUND_OFF).any():
        return ResidualTest(size, residual, 1.0, ())
    explained, nothing = (directions.T @ scaled) ** 2, (scaled**2).sum(axis=0)
    remainder = nothing - explained.sum(axis=0)
    tests = []
    for k, name in enumerate(names):
        # Each group on top of those before it: the plainest that explains something is named.
        of_this_group = explained[of_group == k]
        tests.append((name, _f_test_probability(of_this_group.sum(axis=0), remainder, len(of_this_group), freedom)))
    chance = _f_test_probability(nothing - remainder, remainder, rows - freedom, freedom)
    kept = residual - directions @ (directions.T @ residual)
    floor = np.sqrt((kept**2).sum(axis=0) / freedom)
    sure = tuple(test for test in tests if test[1] < UNLIKELY)
    share = 1.0 - float((remainder / freedom).sum()) / max(float(nothing.sum()) / rows, ROUND_OFF**2)
    least = min(1.0, len(tests) * min(test[1] for test in tests))
    return ResidualTest(np.asarray(floor), np.asarray(kept), chance, sure, min(max(share, 0.0), 1.0), least)


def _groups(under: Circumstances, rows: int) -> Mapping[str, Floats]:
    """(N, k) functions by group of what they depend on; fewer functions for fewer rows."""
    v, ones = under.command[:, :1], np.ones((rows, 1))
    speed = max(float(np.sqrt(np.mean(v**2))), ROUND_OFF)
    low, high = float(under.place.min()), float(under.place.max())
    spacing = max((high - low) / (_PLACES - 1), ROUND_OFF)
    at = low + spacing * np.arange(_PLACES)
    bumps = np.exp(-0.5 * ((under.place[:, None] - at) / spacing) ** 2)
    middle = (under.place - 0.5 * (low + high))[:, None] / spacing
    clocks = np.stack([under.time / max(float(np.max(under.time)), ROUND_OFF), under.order], axis=1)
    groups = {
        "a constant": ones,
        "the command": v / speed,
        "the size or direction of the command": np.hstack([np.abs(v), v * np.abs(v) / speed]) / speed,
        "earlier commands": under.command[:, 1:] / speed,
        **({} if under.errors is None else {_ERRORS: _standardised(under.errors)}),
        **({} if under.away is None else {"the ends": under.away / speed}),
        "time": np.hstack([clocks, clocks * v / speed]),
        "the configuration": np.hstack([bumps[:, 1:], bumps[:, 1:] * v / speed]),
    }
    if sum(group.shape[1] for group in groups.values()) * _ROWS_PER_FUNCTION > rows:
        groups = {**groups, "the configuration": middle}
    kept, room = set[str](), rows // _ROWS_PER_FUNCTION
    for name in _FIRST + tuple(groups):
        if name not in kept and name in groups and groups[name].shape[1] <= room:
            kept.add(name)
            room -= groups[name].shape[1]
    # What acts on the part was divided as the residuals were; earlier errors were already.
    per = np.ones((rows, 1)) if under.spread is None else under.spread[:, None]
    return {
        name: functions if name == _ERRORS else functions / per for name, functions in groups.items() if name in kept
    }


def _standardised(values: Floats) -> Floats:
    """Values (N, k) standardised and clipped."""
    return np.asarray(_without_outliers(values) / np.maximum(np.std(values, axis=0), ROUND_OFF))


def lagged_commands(commands: Floats) -> Floats:
    """(..., T, 1 + LAGS) commands of each step (..., T) and of the steps before; 0 before the first."""
    return np.stack([earlier_rows(commands, k, axis=commands.ndim - 1) for k in range(1 + LAGS)], axis=-1)


def _orthonormal(groups: Mapping[str, Floats]) -> tuple[Floats, Ints]:
    """(N, r) orthonormal basis of the groups of functions, group after group, and (r,) the group of each direction.

    Functions are orthogonal to those before, so the explained share of a group is a sum of squares (regression by QR
    factorisation with pivoting within a group; Golub and Van Loan, Matrix Computations, ch. 5).
    """
    directions, of_group = np.zeros((len(next(iter(groups.values()))), 0)), list[int]()
    for k, functions in enumerate(groups.values()):
        size = np.linalg.norm(functions, axis=0)
        scaled = functions / np.where(size > 0, size, 1.0)
        for _ in range(2):  # twice is enough
            scaled = scaled - directions @ (directions.T @ scaled)
        new, triangle, _ = qr(scaled, mode="economic", pivoting=True)
        rank = int(np.sum(np.abs(np.diag(triangle)) > _RANK))
        directions = np.hstack([directions, new[:, :rank]])
        of_group += [k] * rank
    return directions, np.array(of_group, dtype=np.int64)


def _without_outliers(residual: Floats) -> Floats:
    """Residuals clipped at five robust standard deviations, so that single bad rows do not decide the test."""
    spread = robust_std(residual)
    reach = np.where(spread > 0, 5.0 * spread, np.inf)
    return np.asarray(np.clip(residual, -reach, reach))


def _f_test_probability(explained: Floats, residual: Floats, functions: int, freedom: int) -> float:
    """Bonferroni-corrected F-test probability of the explained sums of squares under noise alone."""
    if functions < 1 or freedom < 1:
        return 1.0
    ratio = np.maximum(explained, 0.0) / functions / np.maximum(residual / freedom, ROUND_OFF**2)
    return float(min(1.0, len(ratio) * fdtrc(functions, freedom, ratio).min()))
