"""How much of a residual any function of mode, configuration, direction and speed could take out at most.

Two steps that start in one mode at nearly the same place with nearly the same command get the same correction from
every such function, so it cannot touch by how much their residuals differ. Steps of different runs are compared, since
what lasts in time is alike within a run.

Sources: Draper and Smith, Applied Regression Analysis, ch. 2 (pure error and lack of fit); Devroye, Gyorfi, Lugosi and
Walk, "A nearest neighbor estimate of the residual variance", Electronic Journal of Statistics 2018.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from micah_plan.arrays import Floats
from micah_plan.residual.lane import Lane

_FEWEST_ROWS = 60
_NEIGHBOURS = 12


def correctable_share(lane: Lane, errors: Floats) -> float | None:
    """Share of squared errors (S, T) that such a correction could take out, 0 to 1; None for one run or few rows."""
    starts = lane.counted_starts
    run = np.repeat(lane.run[:, None], lane.z.shape[1], axis=1)[starts]
    if len(run) < _FEWEST_ROWS or len(np.unique(run)) < 2:
        return None
    low, high = lane.visited
    place, command = lane.z[starts] / max(high - low, 1e-12), lane.u[starts] / lane.command_size
    # Modes lie so far apart that no neighbour is in another one.
    under = np.stack([place, command, 1e3 * lane.mode[starts]], axis=1)
    e = np.roll(errors, -1, axis=1)[starts]
    _, near = KDTree(under).query(under, k=min(_NEIGHBOURS, len(run)))
    others = run[near] != run[:, None]
    first = np.argmax(others, axis=1)
    able = others.any(axis=1)
    mate = near[np.arange(len(run)), first][able]
    pure = 0.5 * float(np.mean((e[able] - e[mate]) ** 2))
    return float(np.clip(1.0 - pure / max(float(np.mean(e**2)), 1e-300), 0.0, 1.0))
