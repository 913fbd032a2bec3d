"""How a joint turns and moves a part, by Rodrigues' formula in plain NumPy.

For loops that need a few poses many times, and for checks that start at once: SciPy's transforms take a quarter of a
second to import. `kinematics` has everything else.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.path import along_path


def turns_and_translations(joint: Joint, c: ArrayLike) -> tuple[Floats, Floats]:
    """Rotations (k, 3, 3) away from the pose at 0, and positions (k, 3) of the part [m], at c (k,) [rad or m]."""
    configurations = np.atleast_1d(np.asarray(c, dtype=float))
    if joint.kind == "path":
        there = along_path(joint, configurations)
        return _matrices(there.quaternion) @ _matrices(np.array([joint.quaternion]))[0].T, there.position
    slide, cross, squared, center, start = _rodrigues(joint)
    sine, versine = np.sin(configurations)[:, None, None], (1.0 - np.cos(configurations))[:, None, None]
    turn = np.eye(3) + sine * cross + versine * squared
    return turn, center + turn @ (start - center) + configurations[:, None] * slide


@lru_cache(maxsize=1024)
def _rodrigues(joint: Joint) -> tuple[Floats, ...]:
    """Slide per unit (3,), rotation generator (3, 3), its square, the centre and the position at 0 (3,)."""
    slide = (1.0 if joint.kind == "prismatic" else joint.pitch) * np.array(joint.axis)
    x, y, z = (0.0, 0.0, 0.0) if joint.kind == "prismatic" else joint.axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return slide, cross, cross @ cross, np.array(joint.center), np.array(joint.position)


def _matrices(quaternion: Floats) -> Floats:
    """(k, 3, 3) rotations of unit quaternions (k, 4)."""
    x, y, z, w = quaternion.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)
