"""Noise scales of a track: white noise and outliers from the rows themselves, wander from the settings.

White noise is what neighbouring rows do not share: a line through the two neighbours predicts a row, and for white
noise of variance σ² the miss has variance 1.5 σ². Medians keep outliers and real turns of the motion out of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_STD_PER_MAD = 1.4826
_MISS_VARIANCE = 1.5
_FINEST_POSITION = 1e-4  # m; no tracker is better, and a std of 0 would make likelihoods infinite
_FINEST_ROTATION = 1e-3  # rad
_OUTLIER_STDS = 7.0
_NEIGHBOURS = 7


@dataclass(frozen=True)
class NoiseScales:
    """Noise of one pose measurement: white plus an Ornstein-Uhlenbeck wander.

    Attributes:
        position_white, rotation_white: std of the white part [m, rad].
        position_wander, rotation_wander: stationary std of the wander [m, rad].
        wander_time: its correlation time [s].
        outlier_ratio: γ, the share of rows that are outliers.
    """

    position_white: float
    rotation_white: float
    position_wander: float
    rotation_wander: float
    wander_time: float
    outlier_ratio: float

    @property
    def position_std(self) -> float:
        """Total std of a position [m]."""
        return float(np.hypot(self.position_white, self.position_wander))

    @property
    def rotation_std(self) -> float:
        """Total std of a rotation [rad]."""
        return float(np.hypot(self.rotation_white, self.rotation_wander))

    @property
    def rotation_length(self) -> float:
        """What weighs rotation against position [m/rad]."""
        return self.position_std / self.rotation_std


def measure_noise(track: PartTrack, settings: LearnSettings) -> tuple[NoiseScales, Bools]:
    """Noise scales of a track and (n,) which of its rows are no outliers."""
    outlying = _outliers(track, settings)
    clean = track.take(np.flatnonzero(~outlying))
    position_white = settings.position_std or max(_white_std(_position_misses(clean)), _FINEST_POSITION)
    rotation_white = settings.rotation_std or max(_white_std(_rotation_misses(clean)), _FINEST_ROTATION)
    # The posterior mode of γ under p(γ) ∝ exp(-w γ), to first order in γ.
    ratio = max(float(outlying.sum()) / (len(track) + settings.outlier_weight), 1.0 / (len(track) + 100.0))
    scales = NoiseScales(
        position_white=position_white,
        rotation_white=rotation_white,
        position_wander=settings.position_wander,
        rotation_wander=settings.rotation_wander,
        wander_time=settings.wander_time or settings.wander_durations * track.duration,
        outlier_ratio=min(ratio, 0.4),
    )
    return scales, ~outlying


def _white_std(misses: Floats) -> float:
    """Std per axis from (n, 3) misses of the neighbours' line."""
    if not len(misses):
        return 0.0
    stds = _STD_PER_MAD * np.median(np.abs(misses), axis=0) / np.sqrt(_MISS_VARIANCE)
    return float(np.sqrt(np.mean(stds**2)))


def _position_misses(track: PartTrack) -> Floats:
    p = track.position
    return np.asarray(p[1:-1] - 0.5 * (p[:-2] + p[2:]))


def _rotation_misses(track: PartTrack) -> Floats:
    if track.rotation is None or len(track) < 3:
        return np.zeros((0, 3))
    steps = (track.rotation[:-1].inv() * track.rotation[1:]).as_rotvec()
    return np.asarray(0.5 * (steps[:-1] - steps[1:]))


def _outliers(track: PartTrack, settings: LearnSettings) -> Bools:
    """Rows far from the running median of their neighbours, measured in the spread of such distances (Hampel).

    A row within the wander that every pose may have is no outlier, however smooth its neighbours are: the row where a
    motion stops dead would be one.
    """
    distances = [np.linalg.norm(track.position - _running_median(track.position), axis=1)]
    floors = [settings.position_wander]
    if track.quaternion is not None:
        middle = _running_median(track.quaternion)
        lengths = np.linalg.norm(middle, axis=1)
        middle = np.where(lengths[:, None] > 0.1, middle, track.quaternion)
        apart = Rotation.from_quat(track.quaternion) * Rotation.from_quat(middle).inv()
        distances.append(np.asarray(apart.magnitude()))
        floors.append(settings.rotation_wander)
    outlying = np.zeros(len(track), dtype=bool)
    for distance, floor in zip(distances, floors, strict=True):
        outlying |= distance > max(_OUTLIER_STDS * float(np.median(distance)), floor)
    return outlying if outlying.mean() < 0.4 else np.zeros(len(track), dtype=bool)


def _running_median(values: Floats) -> Floats:
    return np.asarray(median_filter(values, size=(_NEIGHBOURS, 1), mode="nearest"))
