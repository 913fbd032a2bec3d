"""The hand: a spring of unknown stiffness, whose force measures the displacement of the handle.

A command u puts the spring's equilibrium at E = r + u, with r the place of the handle: where it is or, for plants that
only know that, where it was measured. At rest again the hand exerts F = K (E - p) at the handle's new place p, so p = E
- c F with c = 1/K: with c known, force is an odometer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.exploration import messages

_SOFTEST, _STIFFEST = 100.0, 20000.0
_LEAST_STD = 0.02  # of the compliance, as a share
_FEWEST, _SURE_STDS = 3, 5.0  # std
_LARGEST_ANISOTROPY = 1.5  # times, by which a hand may be stiffer in one direction
_BEFORE = 0.1  # of the squares that forces leave, if they belong to the command before
_TURNED = 0.5  # of a map's size, how far it is from symmetric where forces are in another frame


@dataclass(frozen=True)
class Hand:
    """Estimated properties of the hand.

    Attributes:
        compliance: c [m/N].
        spread: its std as a share of it.
        force_std: per axis of a measured force [N].
        from_measured: whether commands count from the measured place of the handle, noise included.
        perhaps_measured: whether commands may count from measured places, which pushes do not decide.
        stiffest: largest stiffness that pushes showed in any direction [N/m]; 0 before any.
        complaint: contradiction of the meaning of forces; empty without one.
    """

    compliance: float
    spread: float
    force_std: float
    from_measured: bool = False
    perhaps_measured: bool = False
    stiffest: float = 0.0
    complaint: str = ""

    @property
    def stiffness(self) -> float:
        """K = 1/c [N/m]."""
        return 1.0 / self.compliance

    def std(self, force: Floats) -> float:
        """Std of a displacement found from a force (3,), per axis [m]."""
        size = self.compliance * float(np.linalg.norm(force))
        return float(np.hypot(self.compliance * self.force_std, self.spread * size) + 1e-5)


UNKNOWN = Hand(1.0 / _STIFFEST, 1.0, 0.3)


def stiffest(commands: Floats, forces: Floats) -> float:
    """The largest stiffness compatible with pushes (k, 3) and their forces, for sizing the next push."""
    sizes = np.linalg.norm(commands, axis=1)
    pushed = sizes > 0
    if not pushed.any():
        return _STIFFEST
    return float(np.clip((np.linalg.norm(forces[pushed], axis=1) / sizes[pushed]).max(), _SOFTEST, _STIFFEST))


def hand_of(commands: Floats, places: Floats, forces: Floats) -> Hand:
    """The hand's properties from pushes of a handle that stays within some millimetres.

    Force is a linear map of the command, F = K (1 - a t tᵀ) u: a joint yields along one line t at most, so two singular
    values of three are the stiffness for any motion. The middle one is taken, since the largest has most noise. The
    same holds of E = measured place + u, if commands count from there; the better fit is used.

    Args:
        commands: (k, 3) [m], k at least 4.
        places: (k, 3) measured before each of them [m]; NaN where not.
        forces: (k, 3) after each of them [N].
    """
    plain = _fitted(commands, forces)
    if len(commands) > _FEWEST + 2 and _fitted(commands[:-1], forces[1:])[1] < _BEFORE * plain[1]:
        return replace(plain[0], complaint=messages.forces_late())
    is_measured = np.isfinite(places).all(axis=1)
    if is_measured.sum() < 2 * _FEWEST:
        return replace(plain[0], perhaps_measured=True)
    absolute = commands[is_measured] + places[is_measured]
    fit = _fitted(
        np.hstack([absolute - absolute.mean(axis=0), np.ones((int(is_measured.sum()), 1))]), forces[is_measured]
    )
    if fit[1] < 0.5 * plain[1]:
        return replace(fit[0], from_measured=True)
    return replace(plain[0], perhaps_measured=bool(plain[1] > 0.5 * fit[1]))


def _fitted(displacements: Floats, forces: Floats) -> tuple[Hand, float]:
    """(hand fitted to linear inputs (k, 3 or 4), mean square residual across the yielding direction)."""
    slope = np.linalg.lstsq(displacements, forces, rcond=None)[0]
    matrix = slope[:3].T
    vectors, values, _ = np.linalg.svd(matrix)
    stiffness = float(np.clip(values[1], _SOFTEST, _STIFFEST))
    residual = (forces - displacements @ slope) @ vectors[:, :2]
    spare = max(len(displacements) - displacements.shape[1], 1)
    variance = float((residual**2).sum()) / (2 * spare) + 1e-6
    power = float(np.square(displacements[:, :3]).sum()) / 3.0 + 1e-12
    force_std = float(np.sqrt((variance * 2 * spare + 0.15**2 * 4) / (2 * spare + 4)))
    spread = float(np.hypot(_LEAST_STD, force_std / np.sqrt(power) / stiffness))
    complaint = ""
    symmetric, least = np.linalg.eigvalsh(0.5 * (matrix + matrix.T)), np.linalg.svd(displacements[:, :3])[1][-1]
    doubt = force_std / max(float(least), 1e-6)  # std of the entry that is known worst
    if symmetric[1] < -_SURE_STDS * doubt:
        complaint = messages.forces_reversed()
    elif values[1] < _SOFTEST:
        complaint = messages.no_force()
    elif np.linalg.norm(matrix - matrix.T) > _TURNED * np.linalg.norm(matrix) + _SURE_STDS * doubt:
        complaint = messages.forces_turned()
    elif (
        values[0] > _LARGEST_ANISOTROPY * values[1] + _SURE_STDS * doubt
    ):  # what moves makes it softer along one line only
        complaint = messages.stiffness_differs(float(values[1]), float(values[0]))
    hand = Hand(1.0 / stiffness, min(spread, 0.5), force_std, stiffest=float(values[0]), complaint=complaint)
    return hand, variance
