"""MLESAC: robust joints from random minimal sets, scored by the likelihood of a mixture with outliers.

Sources: Torr and Zisserman, "MLESAC", CVIU 2000; MICAH, the mixture (1 - γ) N + γ U with p(γ) ∝ exp(-w γ).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import Joint, JointKind
from micah_plan.learn.closed_form import fit_closed_form, fit_minimal, minimal_rows
from micah_plan.learn.refine import compare, refine

Floats = NDArray[np.float64]

_MIXTURE_STEPS = 5
_POLISHES = 3


@dataclass(frozen=True, eq=False)
class RobustFit:
    """A fitted joint.

    Attributes:
        joint: maximum-likelihood joint.
        inlier: (n,) posterior probability that each row is no outlier.
        outlier_ratio: γ.
        log_likelihood: of the mixture, at γ, with the prior of γ.
    """

    joint: Joint
    inlier: Floats
    outlier_ratio: float
    log_likelihood: float


@dataclass(frozen=True)
class Mixture:
    """Noise of a row as MLESAC sees it.

    Attributes:
        rotation_std, position_std: Gaussian noise of inliers [rad, m].
        rotation_span, position_span: widths of the uniform density of outliers, per axis [rad, m].
        weight: w of p(γ) ∝ exp(-w γ).
    """

    rotation_std: float
    position_std: float
    rotation_span: float
    position_span: float
    weight: float

    @property
    def stds(self) -> tuple[float, float]:
        return (self.rotation_std, self.position_std)

    @property
    def rotation_length(self) -> float:
        return self.position_std / self.rotation_std

    def score(self, error: Floats, has_orientation: bool) -> tuple[Floats, float, float]:
        """Responsibilities (n,), γ and the log likelihood of errors (n, 6) [rad, m], γ by expectation maximisation."""
        squares = (error[:, 3:] ** 2).sum(axis=1) / self.position_std**2
        inside = -3 * np.log(np.sqrt(2 * np.pi) * self.position_std)
        outside = -3 * np.log(self.position_span)
        if has_orientation:
            squares = squares + (error[:, :3] ** 2).sum(axis=1) / self.rotation_std**2
            inside -= 3 * np.log(np.sqrt(2 * np.pi) * self.rotation_std)
            outside -= 3 * np.log(self.rotation_span)
        log_normal = inside - 0.5 * squares
        ratio = 0.1
        for _ in range(_MIXTURE_STEPS):
            log_in, log_out = np.log1p(-ratio) + log_normal, np.log(ratio) + outside
            responsibility = np.exp(log_in - np.logaddexp(log_in, log_out))
            ratio = _map_ratio(float((1 - responsibility).sum()), len(error), self.weight)
        total = float(np.logaddexp(np.log1p(-ratio) + log_normal, np.log(ratio) + outside).sum())
        return responsibility, ratio, total - self.weight * ratio


def fit_robust(
    kind: JointKind,
    position: Floats,
    rotation: Rotation | None,
    mixture: Mixture,
    rng: np.random.Generator,
    draws: int,
    prior_weight: Floats | None = None,
) -> RobustFit | None:
    """The joint of a kind that makes the rows most likely, outliers included.

    Args:
        position, rotation: (n, 3) [m] and (n,) rows; rotation None if not measured.
        draws: random minimal sets to try beside the closed form of all rows.
        prior_weight: (n,) what is known of each row before; rows of weight 0 are not looked at.

    Returns:
        the fit; None where the rows do not determine such a joint.
    """
    n = len(position)
    known = np.ones(n) if prior_weight is None else prior_weight
    usable = np.flatnonzero(known > 0.5)
    need = minimal_rows(kind, rotation is not None)
    if len(usable) < need:
        return None
    starts = [fit_closed_form(kind, position, rotation, known)]
    for _ in range(draws if kind != "rigid" else min(draws, len(usable))):
        chosen = np.sort(rng.choice(usable, size=need, replace=False))
        starts.append(fit_minimal(kind, position[chosen], None if rotation is None else rotation[chosen]))
    fits = [_scored(joint, position, rotation, mixture) for joint in starts if joint is not None]
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.log_likelihood)
    for _ in range(_POLISHES):
        joint = refine(best.joint, position, rotation, best.inlier * known, mixture.stds)
        better = _scored(joint, position, rotation, mixture)
        gain = better.log_likelihood - best.log_likelihood
        if gain > 0:
            best = better
        if gain < 1e-3:
            break
    return best


def _scored(joint: Joint, position: Floats, rotation: Rotation | None, mixture: Mixture) -> RobustFit:
    error = compare(joint, position, rotation, mixture.rotation_length).error
    return RobustFit(joint, *mixture.score(error, rotation is not None))


def _map_ratio(outliers: float, n: int, weight: float) -> float:
    """The γ that maximises outliers ln γ + (n - outliers) ln(1 - γ) - weight γ."""
    total = n + weight
    ratio = (total - np.sqrt(total**2 - 4 * weight * outliers)) / (2 * weight)
    return float(np.clip(ratio, 1e-4, 0.6))
