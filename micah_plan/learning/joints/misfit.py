"""Misfit of real joints: a smooth function of the configuration, equal in all rows at the same configuration.

Rows do not average such a deviation out. It is a random path over the range of configurations,

    b(c) = s · sum over j of z_j / j² · sqrt(2) cos(j π u),    u from 0 to 1 over the range, z_j normal,

about as smooth as an integrated random walk. A fit absorbs its slowest modes, which make the joint's parameters wrong;
their size (s) is estimated from the remaining modes. Source: Wahba, "Bayesian confidence intervals for the
cross-validated smoothing spline", JRSS B 1983.
"""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import ROUND_OFF, Floats

_MODES = 8  # waves along the travel that a misfit is made of
_FACTOR = 8.0  # from one variance of a misfit that is tried to the next
_LARGEST = 1e4  # of these, in units of the white noise of a row; the smallest is that of the mean of all rows
_IDEAL = 0.98  # probability, before anything is seen, of no misfit; less widens what ideal joints leave
_BREADTH = float(np.log(4.0))  # std of ln of its size, where there is one


def misfit_modes(configuration: Floats) -> Floats:
    """(n, m) modes of a misfit of size 1 at configurations (n,); m = 0 where these do not differ."""
    low = configuration.min()
    span = float(configuration.max() - low)
    if span < ROUND_OFF:
        return np.zeros((len(configuration), 0))
    order = np.arange(1, _MODES + 1)
    return np.asarray(np.sqrt(2) * np.cos(np.pi * np.outer((configuration - low) / span, order)) / order**2)


def misfits_tried(modes: Floats) -> Floats:
    """(s,) variances of a misfit with modes (n, m), in units of the white noise; the first is 0."""
    n, m = modes.shape
    if m == 0:
        return np.zeros(1)
    steps = int(np.ceil(np.log(_LARGEST * n) / np.log(_FACTOR)))
    return np.append(0.0, _FACTOR ** np.arange(steps + 1) / n)


def misfit_prior(variance: Floats, typical: float) -> Floats:
    """(s, ...) probabilities of the variances (s, ...) of `misfits_tried`.

    Args:
        typical: variance of a misfit.
    """
    if len(variance) == 1:
        return np.ones_like(variance)
    away = 0.5 * np.log(np.maximum(variance[1:] / typical, 1e-300)) / _BREADTH
    density = np.exp(-0.5 * away**2) / np.sqrt(2 * np.pi) / _BREADTH * 0.5 * np.log(_FACTOR)
    return np.concatenate([np.full_like(variance[:1], _IDEAL), (1 - _IDEAL) * density])


def without_misfit(products: Floats, contrasts: list[slice], tried: Floats) -> tuple[Floats, Floats]:
    """Products of columns with the misfit marginalised, and the log determinants of that.

    Args:
        products: (g, k, k) of the columns of all contrasts and, behind them, of the modes.
        contrasts: columns of each of several blocks of equal size; each has its own misfit.
        tried: (s,) variances.

    Returns:
        (s, g, r, r) products of a contrast's columns, summed over the contrasts, and (s, g) ln det.
    """
    behind = slice(contrasts[-1].stop, None)
    # Eigenvectors of the modes' products serve all variances.
    values, vectors = np.linalg.eigh(products[:, behind, behind])
    values = np.maximum(values, 0.0)
    plain = sum(products[:, contrast, contrast] for contrast in contrasts)
    on_modes = np.concatenate(
        [vectors.swapaxes(1, 2) @ products[:, behind, contrast] for contrast in contrasts], axis=1
    )
    weight = tried[:, None, None] / (1 + tried[:, None, None] * values)
    wide = np.tile(weight, len(contrasts))[..., None]
    residual = plain - on_modes.swapaxes(1, 2) @ (wide * on_modes)
    return residual, len(contrasts) * np.log1p(tried[:, None, None] * values).sum(axis=2)
