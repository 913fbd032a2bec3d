"""Repeated rows: a lost reading, or a part at rest.

A tracker that loses the part, or is slower than the log, repeats its last pose. An encoder does the same whenever the
part rests. An exactly equal reading counts as lost only if it is improbable under *motion and encoder together*:

    log odds = -log P(equal | read anew) + sum over repeats of log p(step after | lost) / p(step after | at rest)

The first term compares the grid of the values with the white noise of the other rows. The second uses the first new
reading after a repeat: if readings were lost, it makes up for all the rows in between at the speed beside them; if the
part was at rest, it is a step like the others, or the beginning of one.

A tracker that is slower than the log leaves no steps of one row to compare with. It has a clock instead:

    log odds = -log P(equal | read anew) + sum over new readings of log p(rows since the last | clock) / p(... | rests)

where rests end at any time, and a clock ticks at a fixed number of rows, a few ticks of which may be without a new
reading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from micah_plan.arrays import ROUND_OFF, VANISHING, Booleans, Floats, Ints, robust_std, white_std

_MIRACLE = 1e-3
"""Odds that readings anew are equal, below which they are no readings."""
_ORDERS = (2, 3, 4, 5, 6)
"""Of the differences that noise is read from."""
_FEWEST = 8
"""Rows: differences of the highest order need as many."""
_FEWEST_STEPS = 5
"""Single steps with another one beside them: from fewer the usual change of speed is not known."""
_FREEDOM = 3.0
"""Of the steps' Student-t distribution: speeds change now and then by much more than usual."""
_USUAL = 0.9
"""Quantile at which changes of speed are cut before their root mean square is taken."""
_SEVERAL = 1.5
"""Rows of one wait that ask for a motion: between one and two."""
_OFF_BEAT = 0.05
"""Share of the readings of a slow tracker that come at any time: a tick that was late, or seen a row too early."""


def repeated_readings(position: Floats, quaternion: Floats | None, action: Floats | None = None) -> Booleans:
    """(n,) rows that repeat the previous reading, as opposed to new readings that are equal.

    Args:
        position: (n, 3) [m]; quaternion: (n, 4) unit, or None.
        action: (n, 3) commanded displacement to the next row [m], NaN or 0 where there is none; or None.
    """
    vectors = [position] if quaternion is None else [position, quaternion]
    none = np.zeros(len(position), dtype=bool)
    same = none.copy()
    same[1:] = np.all([(vector[1:] == vector[:-1]).all(axis=1) for vector in vectors], axis=0)
    if not same.any() or len(same) - same.sum() < _FEWEST:
        return none
    chance = float(np.prod([_chance_of_equal(vector[~same]) for vector in vectors]))
    waits = _Waits.of(same)
    if waits.are_long:
        odds = waits.log_odds_of_clock() if action is None or waits.actions_in_all_waits(action) else -np.inf
    elif chance > _MIRACLE:
        return none
    else:
        odds = float(np.mean([_log_odds_of_steps(vector, same) for vector in vectors]))
    return same if odds - np.log(max(chance, VANISHING)) > -np.log(_MIRACLE) else none


@dataclass(frozen=True, eq=False)
class _Waits:
    """Intervals between new readings.

    Attributes:
        first: (m,) their first rows. rows: (m,) how many rows each lasts. usual: a short one of them.
    """

    first: Ints
    rows: Ints
    usual: int

    @classmethod
    def of(cls, same: Booleans) -> _Waits:
        """The intervals of rows (n,) flagged as equal to the previous one."""
        new = np.flatnonzero(~same)
        rows = np.diff(new)
        # Longer ones are rests, and a few shorter ones are off the beat.
        return cls(new[:-1], rows, int(np.quantile(rows, 0.25, method="lower")))

    @property
    def are_long(self) -> bool:
        """Whether consecutive rows are hardly ever both new."""
        return self.usual > 1

    def actions_in_all_waits(self, action: Floats) -> bool:
        """Whether actions (n, 3) ask for motion in several rows of each wait.

        A part that is commanded to move now and then, and arrives at once, also rests periodically.
        """
        commanded = np.linalg.norm(np.nan_to_num(action), axis=1)[: self.first[-1] + self.rows[-1]]
        if not commanded.any():
            return True
        squared, squares = np.add.reduceat(commanded, self.first) ** 2, np.add.reduceat(commanded**2, self.first)
        # Effective number of rows of a wait with equal commands (Kish, "Survey Sampling", 1965).
        return bool(squared.sum() > _SEVERAL * squares.sum())

    def log_odds_of_clock(self) -> float:
        """Log odds that a tracker with a slower clock causes the repeats, rather than rests [nats]."""
        mean, period = float(self.rows.mean()), float(self.rows[np.abs(self.rows - self.usual) <= 1].mean())
        rest = (1.0 - 1.0 / mean) ** (self.rows - 1.0) / mean
        ticks = np.maximum(np.round(self.rows / period), 1.0)
        shows = min(1.0, period / mean)
        # A whole number of ticks ends in one of two rows.
        before = np.floor(ticks * period)
        past = ticks * period - before
        ends = np.where(self.rows == before, 1.0 - past, np.where(self.rows == before + 1, past, 0.0))
        clock = _OFF_BEAT * rest + (1.0 - _OFF_BEAT) * ends * shows * (1.0 - shows) ** (ticks - 1.0)
        return float(np.sum(np.log(clock / rest)))


def _log_odds_of_steps(vector: Floats, same: Booleans) -> float:
    """Log odds that readings (n, k) were lost in repeated rows (n,), rather than the part at rest [nats].

    Only repeats next to a motion larger than the usual changes of speed count: elsewhere both are the same.
    """
    new = np.flatnonzero(~same)
    step, rows = np.diff(vector[new], axis=0), np.diff(new)
    is_single = rows == 1
    speed, neighbours = _speed_beside(step, is_single)
    is_usual = is_single & (neighbours == 2)
    if is_usual.sum() < _FEWEST_STEPS:
        is_usual = is_single & (neighbours > 0)
    if is_usual.sum() < _FEWEST_STEPS:
        return 0.0
    change = np.linalg.norm(step - speed, axis=1)[is_usual]
    usual = max(float(np.sqrt(np.mean(np.minimum(change, np.quantile(change, _USUAL)) ** 2))), ROUND_OFF)
    chosen = ~is_single & (neighbours > 0) & (np.linalg.norm(speed, axis=1) > usual)
    step, speed, over = step[chosen], speed[chosen], rows[chosen]
    # A speed that stays the same all the while, or that changes from row to row; a whole step, or half of one.
    way = step - over[:, None] * speed
    lost = np.logaddexp(_step_density(way, usual), _step_density(way, usual * np.sqrt(over)))
    rest = np.logaddexp(_step_density(step - speed, usual), _step_density(step - 0.5 * speed, usual))
    return float(np.sum(lost - rest))


def _speed_beside(step: Floats, is_single: Booleans) -> tuple[Floats, Ints]:
    """(m, k) mean of the single-row steps on both sides of each step, and (m,) their number."""
    padded = np.pad(np.where(is_single[:, None], step, 0.0), ((1, 1), (0, 0)))
    there = np.pad(is_single, 1).astype(np.int64)
    neighbours = there[:-2] + there[2:]
    return (padded[:-2] + padded[2:]) / np.maximum(neighbours, 1)[:, None], neighbours


def _step_density(error: Floats, scale: Floats | float) -> Floats:
    """(m,) log density of the lengths of errors (m, k), up to a constant: Student-t."""
    squares = np.sum(np.square(error), axis=1) / np.square(scale)
    return np.asarray(-np.log(scale) - 0.5 * (_FREEDOM + 1.0) * np.log1p(squares / _FREEDOM))


def _chance_of_equal(vector: Floats) -> float:
    """Probability that two independent readings (n, k) of one place are equal.

    By the grid and the noise of each column. Columns may not lie on a grid though the tracker reads on one, as angles
    that became quaternions, and positions in another frame. Then readings are equal while the rest of the pose is not,
    or repeat a difference after another one, and by noise this would be a miracle.
    """
    chance = float(np.prod([_chance_on_grid(column) for column in vector.T]))
    steps = np.round(np.diff(vector, axis=0) / ROUND_OFF)
    n, alone = len(steps), int((steps == 0).all(axis=1).sum())
    # A recording that was interpolated goes on by the same for a while.
    steps = steps[np.append(True, (steps[1:] != steps[:-1]).any(axis=1))]
    again = len(steps) - len(np.unique(steps, axis=0))
    is_miracle = min(bdtrc(alone - 1, n, chance), bdtrc(again - 1, n * (n - 1) // 2, chance)) < _MIRACLE
    return 1.0 if is_miracle else chance


def _chance_on_grid(column: Floats) -> float:
    """Probability that two independent readings (n,) of one value are equal, from their grid and noise.

    Noise is what differences of every order show, and what reverses in the next row; the rest is motion.
    """
    noise = min(*(float(white_std(column, order)) for order in _ORDERS), _alternating_std(column))
    levels = np.unique(column)
    if noise == 0.0 or len(levels) == 1:
        return 1.0
    return min(1.0, float(np.diff(levels).min()) / (2.0 * float(np.sqrt(np.pi)) * noise))


def _alternating_std(column: Floats) -> float:
    """Largest std of white noise on rows (n,) compatible with the autocovariance of second differences.

    Of white noise it is -4 times the variance at lag 1. The steps of a servo between two rests are large in differences
    of every order, but go on in one direction: their covariance there is not negative. Differences are cut at twice
    their robust std, so that the few rows where a motion turns round do not decide; one standard error is added, since
    few rows may show no noise by chance. Source: Roll, Journal of Finance 1984, for first differences.
    """
    bends = np.diff(column, 2)
    if len(bends) < _FEWEST:
        return float("inf")
    most = 2.0 * float(robust_std(np.concatenate([bends, -bends])))
    cut = np.clip(bends, -most, most)
    variances = cut[1:] * cut[:-1] / -4.0
    return float(np.sqrt(max(np.mean(variances) + np.std(variances) / np.sqrt(len(variances)), 0.0)))
