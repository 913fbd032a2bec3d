"""Hypotheses: joints fitted to stretches of rows, with how the part moves along them, as every row sees them.

Approximate model parameters, as CHAMP's name has it: the evidence of a segment takes the best of a pool of fitted
joints, so that no row pair needs a fit of its own, and segments that obey one joint share its parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import jacobian
from micah_plan.learn.noise import NoiseScales
from micah_plan.learn.refine import compare
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A moving joint and the rows it was fitted to.

    Attributes:
        joint: prismatic, revolute or screw.
        start, end: first and last row (inclusive) of the stretch, within the track.
    """

    joint: Joint
    start: int
    end: int


@dataclass(frozen=True, eq=False)
class JointView:
    """All n rows of a track as a hypothesis sees them.

    Attributes:
        hypothesis: the joint and its rows.
        configuration: (n,) continuous over the rows [rad or m].
        error: (n, 6) [rad, m] what is left across the joint.
        leverage: (3,) J⁻¹ for the part's translation, in the frame of the track's actions [rad or m per m].
        white_variance, wander_variance: noise of one configuration, of either kind [rad² or m²].
    """

    hypothesis: Hypothesis
    configuration: Floats
    error: Floats
    leverage: Floats
    white_variance: float
    wander_variance: float


def view(hypothesis: Hypothesis, track: PartTrack, noise: NoiseScales, inlier: NDArray[np.bool_]) -> JointView:
    """Compare all rows of a track with a joint."""
    joint, length = hypothesis.joint, noise.rotation_length
    residuals = compare(joint, track.position, track.rotation, length)
    c = residuals.configuration.copy()
    if joint.kind == "revolute":
        c[inlier] = np.unwrap(c[inlier])
    direction = jacobian(joint, 0.0)[0]
    moves = float(direction[3:] @ direction[3:])
    turns = float(direction[:3] @ direction[:3]) * length**2 if track.quaternion is not None else 0.0
    total = max(moves + turns, 1e-12) ** 2
    white = (moves * noise.position_white**2 + turns * length**2 * noise.rotation_white**2) / total
    wander = (moves * noise.position_wander**2 + turns * length**2 * noise.rotation_wander**2) / total
    # The part's translation per unit of configuration has a constant direction in the part's frame.
    lever = direction[3:] / max(moves, 1e-12)
    if track.quaternion is not None:
        lever = Rotation.from_quat(joint.quaternion).inv().apply(lever)
    return JointView(hypothesis, c, residuals.error, lever, white, wander)
