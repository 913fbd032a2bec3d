"""Actions stored in later rows than the motions they cause, as by a logger that writes the latest value read.

The motion decides: actions were stored late if the command of a later row predicts it better than that of its own row
and earlier ones. Displacements are tested, or places where these are the smoother sequence: then they contain no
measurement noise and cannot predict it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.tracks import Track
from micah_plan.residual.likelihood import FREEDOM, LEAST_EVIDENCE, robust_log_density

# Actions are stored at most so many rows late; commands before one's own that a motion may remember, and commands on
# both sides of it over which poses may have been smoothed.
_MOST_LATE, _PAST, _BESIDE = 3, 2, 3
_FEWEST_STEPS = 20
# What a later row must foretell better per step [nats], and its share of all that commands do.
_LATE_PER_ROW, _OWN_SHARE = 0.05, 0.3
# Places are so much less rough than displacements that lead to them: 0.22 to 0.72 in 43 of 45 simulated recordings of
# places. Displacements that are drawn anew in each row make places that are 0.77 to 0.89 as rough, smooth ones over 1.
_MORE_REGULAR = 0.75
# Places have inertia between them and a motion, so that the first row of a way is a small part of it.
_OWN_SHARE_OF_PLACES = 0.2


def rows_late(runs: Sequence[Track]) -> int:
    """Number of rows by which actions are stored late.

    The action of a later row predicts a motion better than its own row's and earlier ones, with their sign. (Where
    commands are feedback of measurements, the next command predicts the noise of a motion with the opposite sign; where
    poses were smoothed, commands of rows before and after predict it equally.)
    """
    # Goals that lead on from where the part is foretell where it is: what commands are said to mean is not enough.
    coordinates, late = range(runs[0].x.shape[1]), 0
    if any(track.u is None or track.u.shape[1] != track.x.shape[1] for track in runs):
        return 0
    means_places = [is_regular_in_places(runs, i) for i in coordinates]

    def is_later(i: int) -> bool:
        return _is_predicted_later(runs, late, i) or (means_places[i] and _moves_to_later_position(runs, late, i))

    while late < _MOST_LATE and any(map(is_later, coordinates)):
        late += 1
    return late


def _is_predicted_later(runs: Sequence[Track], late: int, i: int) -> bool:
    """Whether a coordinate's motion follows the command `late` + 1 rows later rather than those up to `late`."""
    designs, moved = [], []
    for track in runs:
        dx, u = np.diff(track.x[:, i]), _displacements(track, i)
        steps = np.arange(_BESIDE, len(dx) - late - _BESIDE)
        if len(steps):
            designs.append(np.stack([u[steps + late + k] for k in range(-_BESIDE, _BESIDE + 1)], axis=1))
            moved.append(dx[steps])
    design, now = _finite_rows(designs, moved)
    if len(now) < _FEWEST_STEPS or not np.any(now):
        return False
    first = _BESIDE - _PAST
    own, next_one = design[:, first : _BESIDE + 1], design[:, first + 1 : _BESIDE + 2]
    symmetric = np.column_stack([design[:, _BESIDE], (design + design[:, ::-1])[:, :_BESIDE]])
    ones = np.ones((len(now), 1))
    up_to_own, up_to_next, on_both_sides, any_row = (
        robust_log_density(np.hstack([ones, columns]), now, FREEDOM) for columns in (own, next_one, symmetric, design)
    )
    if min(up_to_next - up_to_own, any_row - on_both_sides) < max(LEAST_EVIDENCE, _LATE_PER_ROW * len(now)):
        return False
    response = np.linalg.lstsq(np.hstack([ones, next_one]), now, rcond=None)[0][1:]
    return bool(response[-1] > _OWN_SHARE * np.abs(response).sum())


def is_regular_in_places(runs: Sequence[Track], i: int) -> bool:
    """Whether a coordinate's commands are more regular as positions than as displacements.

    Measurement noise enters the displacement that leads to a commanded place, and the place that a commanded
    displacement leads to. The criterion is the mean root of second differences, in which a few jumps count little.
    """
    bends = [np.concatenate([np.diff(series(track, i), 2) for track in runs]) for series in (_places, _displacements)]
    if min(map(len, bends)) < _FEWEST_STEPS:
        return False
    rough, other = (float(np.mean(np.sqrt(np.abs(bend)))) for bend in bends)
    return rough < _MORE_REGULAR * other


def _moves_to_later_position(runs: Sequence[Track], late: int, i: int) -> bool:
    """Whether a coordinate moves toward the position commanded `late` + 1 rows later, given the earlier ones."""
    designs, moved = [], []
    for track in runs:
        z, place = track.x[:, i], _places(track, i)
        steps = np.arange(_PAST, len(place) - late - 1)
        if len(steps):
            speeds = [z[steps - k] - z[steps - k - 1] for k in range(_PAST)]
            ways = [place[steps + late + k] - z[steps] for k in range(-_PAST, 2)]
            designs.append(np.stack([np.ones(len(steps)), *speeds, *ways], axis=1))
            moved.append(z[steps + 1] - z[steps])
    design, now = _finite_rows(designs, moved)
    if len(now) < _FEWEST_STEPS or not np.any(now):
        return False
    up_to_own, up_to_next = (robust_log_density(columns, now, FREEDOM) for columns in (design[:, :-1], design))
    if up_to_next - up_to_own < max(LEAST_EVIDENCE, _LATE_PER_ROW * len(now)):
        return False
    to_places = np.linalg.lstsq(design, now, rcond=None)[0][1 + _PAST :]
    return bool(to_places[-1] > _OWN_SHARE_OF_PLACES * np.abs(to_places).sum())


def _finite_rows(designs: Sequence[Floats], moved: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Regressors (n, k) and motions (n,) of all runs, without rows that have a missing regressor."""
    if not designs:
        return np.zeros((0, 0)), np.zeros(0)
    design, now = np.concatenate(designs), np.concatenate(moved)
    is_finite = np.isfinite(design).all(axis=1)
    return design[is_finite], now[is_finite]


def _displacements(track: Track, i: int) -> Floats:
    """(T,) commanded displacements of coordinate i; empty without commands."""
    return np.zeros(0) if track.u is None else track.u[:, i]


def _places(track: Track, i: int) -> Floats:
    """Positions to which the commands lead."""
    displacements = _displacements(track, i)
    return np.asarray(track.origin[: len(displacements), i] + displacements)
