"""Recordings with planted joints and changepoints, for the tests of learning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.joint import Joint, prismatic, revolute, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.recording.value import Recording

AXIS = np.array([0.36, 0.48, 0.8])
START = Rotation.from_rotvec([0.4, -0.3, 0.9])
JOINTS: dict[str, Joint] = {
    "prismatic": prismatic(AXIS, (0.5, 0.1, 0.3), START.as_quat()),
    "revolute": revolute(AXIS, (0.2, 0.3, 0.1), (0.5, 0.1, 0.3), START.as_quat()),
    "screw": screw(AXIS, (0.4, 0.2, 0.2), 0.12, (0.5, 0.1, 0.3), START.as_quat()),
}
TRAVEL = {"prismatic": 0.25, "revolute": 0.9, "screw": 1.2}


@dataclass(frozen=True)
class Noise:
    position: float = 0.001
    rotation: float = 0.006
    outliers: float = 0.0


def moving_then_held(kind: str, moving: int = 70, held: int = 40, step: float | None = None) -> np.ndarray:
    """(n,) configurations of a joint that moves at an uneven speed and then stays."""
    total = TRAVEL[kind] if step is None else step * moving
    phase = np.linspace(0, 1, moving)
    return np.concatenate([total * (phase + 0.04 * np.sin(9 * phase)), np.full(held, total * (1 + 0.04 * np.sin(9)))])


def recorded(
    pieces: Sequence[tuple[Joint, np.ndarray]],
    rng: np.random.Generator,
    noise: Noise | None = None,
    *,
    commanded: Sequence[np.ndarray] | None = None,
    orientation: bool = True,
) -> Recording:
    """Measured poses of a part that follows each joint along its configurations.

    Args:
        commanded: per piece the (k,) configuration steps commanded, written as displacements; None: no actions.
    """
    noise = noise or Noise()
    poses = RigidTransform.concatenate([forward(joint, c) for joint, c in pieces])
    n = len(poses)
    position = poses.translation + noise.position * rng.standard_normal((n, 3))
    rotation = Rotation.from_rotvec(noise.rotation * rng.standard_normal((n, 3))) * poses.rotation
    wrong = rng.random(n) < noise.outliers
    position = position + wrong[:, None] * rng.uniform(-0.5, 0.5, (n, 3))
    rotation = Rotation.from_rotvec(wrong[:, None] * rng.uniform(-1.5, 1.5, (n, 3))) * rotation
    action = None
    if commanded is not None:
        ends = [forward(joint, c + u) for (joint, c), u in zip(pieces, commanded, strict=True)]
        action = RigidTransform.concatenate(ends).translation - poses.translation
        action[-1] = np.nan
    return Recording(
        time=np.arange(n) / 18,
        position=position,
        quaternion=rotation.as_quat() if orientation else None,
        action=action,
    )
