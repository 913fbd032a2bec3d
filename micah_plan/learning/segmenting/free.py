"""Free motion: the alternative to joints (two degrees of freedom, a path that deforms).

Every channel continues at a nearly constant velocity: a local linear trend under white noise, filtered row by row, with
one scale of noise and one of acceleration for positions, and one each for rotations. A joint predicts all but one of
six channels to within noise, so it wins wherever there is one. Source: Harvey, "Forecasting, structural time series
models and the Kalman filter", Cambridge 1989, section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.learning.joints.quaternions import conjugate, rotation_vector, times
from micah_plan.learning.roughness import extent
from micah_plan.learning.segmenting.noise import NoiseModel, log_peak
from micah_plan.learning.track import PartTrack

_WHITE = np.array([0.3, 0.6, 1.0, 1.5])  # stds of white noise that are tried, in the roughness of the rows
_ACCELERATION = np.geomspace(0.003, 10.0, 12)  # stds of a change of velocity from row to row, in the same unit
_WHITES, _ACCELERATIONS = (grid.ravel() for grid in np.meshgrid(_WHITE, _ACCELERATION, indexing="ij"))
_DOF = 8.0  # of Student's distribution
_ITERATIONS = 4  # of its scale
FINEST_EXTENT = 1e-3  # m or rad


@dataclass(frozen=True, eq=False)
class Trend:
    """Autoregressive prediction of rows, under the likeliest scales of noise and acceleration.

    Attributes:
        squares: (n - 2,) squared innovations of the third row on, in their variance.
        sizes: (n - 2,) ln of the volume of an innovation's standard deviations.
        begun: ln density of the first two rows.
    """

    squares: Floats
    sizes: Floats
    begun: float


def free_log_probability(track: PartTrack, noise: NoiseModel, likelihood_power: float) -> float:
    """Log evidence of a track as free motion, comparable with that of segments.

    Args:
        noise: estimated from the roughness of the rows.
        likelihood_power: power of the likelihood.
    """
    path = _path(track)
    trends = [
        trend_of(path[:, i : i + 3], std)
        for i, std in zip(range(0, path.shape[1], 3), roughness_stds(noise), strict=True)
    ]
    squares = np.sum([trend.squares for trend in trends], axis=0)
    sizes = np.sum([trend.sizes for trend in trends], axis=0)
    log_probability = float(density(squares, sizes, path.shape[1]).sum()) + sum(trend.begun for trend in trends)
    return float(likelihood_power * log_probability - len(trends) * price(len(track)))


def roughness_stds(noise: NoiseModel) -> list[float]:
    """Stds of white noise per axis: of rotations [rad], if they were measured, and of positions [m]."""
    stds: list[float] = np.sqrt(noise.white[0]).reshape(-1, 3).mean(axis=1).tolist()
    return stds


def price(rows: int) -> float:
    """Cost of the two fitted scales of a trend [nats]."""
    return float(np.log(3.0 * rows))


def _path(track: PartTrack) -> Floats:
    """(n, d) rotation so far, as a sum of small rotation vectors [rad], and position [m]."""
    if track.quaternion is None:
        return track.position
    turns = rotation_vector(times(track.quaternion[1:], conjugate(track.quaternion[:-1])))
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
    return np.concatenate([turned, track.position], axis=1)


def trend_of(vector: Floats, std: float, spacing: Floats | None = None) -> Trend:
    """The likeliest local linear trend of rows (n, k).

    Args:
        std: roughness of the rows.
        spacing: (n - 1,) how far apart neighbouring rows are; None: 1.
    """
    n, k = vector.shape
    apart = np.ones(n - 1) if spacing is None else spacing
    squares, sizes = _innovations(vector, std, apart)
    best = int(density(squares, sizes, k).sum(axis=0).argmax())
    return Trend(squares[:, best], sizes[:, best], _first_rows_density(vector, std))


def density(squares: Floats, sizes: Floats, d: int) -> Floats:
    """Student's t log densities of innovations in d dimensions, robust against outliers."""
    return np.asarray(log_peak(d, _DOF) - 0.5 * (_DOF + d) * np.log1p(squares / (_DOF + d)) - sizes)


def likeliest_scale(squares: Floats, d: int) -> float:
    """The maximum-likelihood common factor of variances of squared innovations in d dimensions."""
    scale = float(squares.mean()) / d
    for _ in range(_ITERATIONS):
        scale = float((squares / (1 + squares / (scale * (_DOF + d)))).mean()) / d
    return scale


def _first_rows_density(vector: Floats, std: float) -> float:
    """Log density of the first two rows: uniform over the extent of the path, then a step of its size."""
    k = vector.shape[1]
    step = max(np.sqrt((np.diff(vector, axis=0) ** 2).sum(axis=1).mean() / k), std)
    away = (vector[1] - vector[0]) / step
    reach = max(extent(vector), FINEST_EXTENT)
    return float(-k * np.log(reach * step * np.sqrt(2 * np.pi)) - 0.5 * away @ away)


def _innovations(vector: Floats, std: float, spacing: Floats) -> tuple[Floats, Floats]:
    """(n - 2, g) squared innovations of rows (n, k) in their variance, and ln of their volume; by pairs of scales."""
    white, changed = (std * _WHITES) ** 2, (std * _ACCELERATIONS) ** 2
    (n, k), g = vector.shape, len(white)
    place, speed = np.tile(vector[1], (g, 1)), np.tile((vector[1] - vector[0]) / spacing[0], (g, 1))
    of_place, both, of_speed = white, white / spacing[0], 2 * white / spacing[0] ** 2
    squares, variances = np.empty((n - 2, g)), np.empty((n - 2, g))
    for row, h, square, variance in zip(vector[2:], spacing[1:].tolist(), squares, variances, strict=True):
        place = place + h * speed
        of_place, both, of_speed = (
            of_place + 2 * h * both + h**2 * of_speed + changed * h**3 / 3,
            both + h * of_speed + changed * h**2 / 2,
            of_speed + changed * h,
        )
        innovation, variance[:] = row - place, of_place + white
        square[:] = (innovation**2).sum(axis=1) / variance
        trusted, turned = of_place / variance, both / variance
        place, speed = place + trusted[:, None] * innovation, speed + turned[:, None] * innovation
        of_place, both, of_speed = of_place - trusted * of_place, both - trusted * both, of_speed - turned * both
    return squares, 0.5 * k * np.log(variances)
