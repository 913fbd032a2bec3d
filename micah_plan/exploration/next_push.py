"""Choice of the next push: the largest probability of motion per force.

A step costs some newtons at any force, so weak pushes in many directions come first, and stronger ones when the weak
ones had no effect: directions that they ruled out are no longer worth a push.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.exploration.hand import Hand
from micah_plan.exploration.moves import Moves
from micah_plan.task.exploration_scene import Scene

SEEN = 0.001  # m, a motion that shows
_EFFORT = 2.0  # N that each step costs; 6 N takes a third more force and saves no step (35 objects)
_SAFE = 0.93  # of the largest force, for what is not known of the hand
_LEVELS, _LEAST_FORCE = 12, 2.0


@dataclass(frozen=True, eq=False)
class Push:
    """A push, and the probability that any push moves the handle.

    Attributes:
        lead: (3,) of the hand's equilibrium before the handle [m].
        can: probability that any push of these directions within the force would move it.
    """

    lead: Floats
    p_movable: float


def best_push(moves: Moves, directions: Floats, hand: Hand, most: float) -> Push:
    """The push along one of the directions (k, 3), with a lead of at most `most` [m]."""
    leads_to_move = moves.leads_to_move(directions, hand.compliance)
    p_movable = float(moves.weight[leads_to_move.min(axis=0) <= most].sum())
    forces = np.geomspace(_LEAST_FORCE, max(most / hand.compliance, 1.01 * _LEAST_FORCE), _LEVELS)
    leads = np.unique(np.minimum(hand.compliance * forces, most))
    number = np.searchsorted(leads, leads_to_move + max(2.0 * hand.std(np.zeros(3)), SEEN))
    chances = np.stack([np.bincount(row, moves.weight, len(leads) + 1)[:-1] for row in number]).cumsum(axis=1)
    worth = chances / (leads / hand.compliance + _EFFORT)
    best, level = np.unravel_index(int(np.argmax(worth)), worth.shape)
    return Push(np.asarray(leads[level] * directions[best]), p_movable)


def largest_lead(scene: Scene, hand: Hand, leads: Floats, forces: Floats, doubt: float) -> float:
    """The largest lead [m] whose force stays below its limit even against a stuck handle.

    Args:
        leads, forces: (k, 3) of pushes so far; none may have met more force per lead than is reckoned with.
        doubt: std of a lead [m].
    """
    surely = min(hand.compliance, 1.0 / max(hand.stiffest, 1e-9)) * (1.0 - 2.0 * hand.spread)
    sizes, met = np.linalg.norm(leads, axis=1), np.linalg.norm(forces, axis=1)
    strong = met > 5.0 + 5.0 * hand.force_std
    surely = min(surely, float(((sizes[strong] + 2.0 * doubt) / met[strong]).min(initial=np.inf)))
    if scene.largest_stiffness is not None:
        surely = min(surely, 1.0 / scene.largest_stiffness)
    return max(min(scene.largest_step, surely * (_SAFE * scene.largest_force - 3.0 * hand.force_std)), 0.0)
