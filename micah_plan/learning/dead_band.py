"""Dead band of a coarse servo: actions without motion that are not signs of a stop.

A servo that an encoder measures rests some counts away from its goal, and the command there (the goal minus the pose)
is not carried out for as long as it rests. A stop differs: it withstands larger actions than those that moved the part
elsewhere. So where readings repeat to the last digit, the model of a dead band,

    p(moved | action) = p0 if |action| <= D, p1 otherwise,   p0 ~ Beta(1/2, 19/2), p1 ~ Beta(1/2, 1/2),

competes with one probability for all actions, and actions within the likeliest D are left out. D is at most some
counts, whose size is the part's smallest step: a part that is only pushed gently is stopped.

A part that was sent to a place and is within some counts of it, or within noise, has arrived: no further command is
open, and no density is needed.
"""

from __future__ import annotations

import numpy as np
from scipy.special import betaln

from micah_plan.arrays import Booleans, Floats, white_std

_FEWEST = 12
"""Rows at rest though something is asked for."""
_MOST_COUNTS = 3.5
"""A dead band is no wider: controllers are tuned to rest within two or three counts."""
_COARSE = 0.3
"""Of a usual step, a count: if all steps are one count, a slow hand cannot be told from a coarse one."""
_AHEAD = 3.0
"""Nats: what a dead band must be ahead by."""
_RESTS = 0.05
"""Share of rows that repeat the one before to the last digit, from which on readings are counts."""
_IDLE, _ALIVE = (0.5, 9.5), (0.5, 0.5)


def without_dead_band(position: Floats, quaternion: Floats | None, action: Floats) -> Floats:
    """Actions (n, 3) with those inside the dead band of the actuator set to 0.

    Args:
        position: (n, 3) [m]; quaternion: (n, 4) unit, or None.
        action: commanded displacements to the next row [m], in any frame; 0 where there is none.
    """
    asked = np.linalg.norm(action[:-1], axis=1)
    vectors = [position] if quaternion is None else [position, quaternion]
    moves = np.any([(vector[1:] != vector[:-1]).any(axis=1) for vector in vectors], axis=0)
    is_commanded = asked > 0.0
    if (is_commanded & ~moves).sum() < _FEWEST or not (is_commanded & moves).any():
        return action
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)[moves]
    count = float(steps.min())
    if count > _COARSE * float(np.median(steps)):
        return action
    widest = _dead_band(asked[is_commanded], moves[is_commanded], _MOST_COUNTS * count)
    return np.where(np.append(asked <= widest, False)[:, None], 0.0, action)


def without_actions_at_goal(position: Floats, action: Floats) -> Floats:
    """Actions (n, 3) to commanded places, set to 0 in rows in which the part has arrived.

    Args:
        position: (n, 3) [m].
        action: displacements to commanded places, in any frame; 0 where there is none.
    """
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    if not steps.any():
        return action
    is_coarse = float(np.mean(steps == 0.0)) > _RESTS
    finest = float(steps[steps > 0.0].min()) if is_coarse else float(np.linalg.norm(white_std(position, 3)))
    return np.where((np.linalg.norm(action, axis=1) <= _MOST_COUNTS * finest)[:, None], 0.0, action)


def _dead_band(asked: Floats, moves: Booleans, most: float) -> float:
    """Most probable width of a dead band, from sizes of actions (n,) and whether the part moves; else 0."""
    order = np.argsort(asked, kind="stable")
    asked, moves = asked[order], moves[order]
    within = np.arange(1.0, len(asked) + 1)
    moved = np.cumsum(moves, dtype=np.float64)
    last = np.append(asked[1:] > asked[:-1], True) & (asked <= most)
    if not last.any():
        return 0.0
    density = _log_density(moved, within, _IDLE) + _log_density(moved[-1] - moved, len(asked) - within, _ALIVE)
    density = np.where(last, density, -np.inf)
    best = int(np.argmax(density))
    alone = float(_log_density(moved[-1:], within[-1:], _ALIVE)[0])
    return float(asked[best]) if density[best] - np.log(len(asked)) > alone + _AHEAD else 0.0


def _log_density(moved: Floats, rows: Floats, prior: tuple[float, float]) -> Floats:
    """Beta-binomial log density of `moved` among `rows` [nats]."""
    return np.asarray(betaln(moved + prior[0], rows - moved + prior[1]) - betaln(*prior))
