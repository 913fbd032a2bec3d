"""A simulated pose tracker with white noise and optional drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats


@dataclass(frozen=True)
class TrackerNoise:
    """Standard deviations per axis.

    Attributes:
        position, rotation: of the white error, (l,) or one for all links [m] and [rad].
        position_wander, rotation_wander: of the slowly wandering error (Ornstein-Uhlenbeck process) [m] and [rad].
        wander_time: correlation time of the wander [s].
    """

    position: Floats | float
    rotation: Floats | float
    position_wander: float = 0.0
    rotation_wander: float = 0.0
    wander_time: float = 5.0


class PoseTracker:
    """Adds a tracker's noise to true poses, with its state."""

    def __init__(self, noise: TrackerNoise, links: int, rng: np.random.Generator) -> None:
        self._noise = noise
        self._rng = rng
        self._links = links
        self._wander_std = np.repeat([noise.position_wander, noise.rotation_wander], 3)
        self._wander = rng.standard_normal((links, 6)) * self._wander_std

    def measure(
        self, position: Floats, quaternion: Floats, elapsed: float, noise: TrackerNoise | None = None
    ) -> tuple[Floats, Floats]:
        """The measured poses.

        Args:
            position, quaternion: (l, 3) [m] and (l, 4), the true poses.
            elapsed: time since the last sample [s].
            noise: whose white error this sample has; None: the tracker's own.

        Returns:
            (l, 3) and (l, 4); the rotational error is a rotation vector in the base frame.
        """
        keep = np.exp(-elapsed / self._noise.wander_time)
        fresh = self._rng.standard_normal(self._wander.shape) * self._wander_std
        self._wander = keep * self._wander + np.sqrt(1.0 - keep**2) * fresh
        error = self._wander + self._rng.standard_normal(self._wander.shape) * self._white(noise or self._noise)
        rotation = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_quat(quaternion)
        return position + error[:, :3], rotation.as_quat()

    def _white(self, noise: TrackerNoise) -> Floats:
        """(l, 6) std of the white error in position and rotation."""
        columns = [np.broadcast_to(std, (self._links,)) for std in (noise.position, noise.rotation)]
        return np.repeat(np.stack(columns, axis=1), 3, axis=1)
