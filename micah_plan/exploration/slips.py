"""Detection of slips of the grip: likelihood-ratio test over the tracker's readings.

A slip is a sudden and lasting offset between the handle's place by the odometer and by the tracker; a leap is an offset
of a single measurement. Each hypothesis, that nothing happened or that the grip slipped just before a certain
measurement, is a Kalman filter; the likelihoods of all later measurements decide between them, so that several show an
offset that one noisy measurement does not. Offsets that the force explains are no slip: the error of the hand's
compliance is part of the state, and a panel that bends alike in all directions has the same effect. Every filter
estimates the noise of the tracker itself.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln

from micah_plan.arrays import Floats
from micah_plan.exploration.chain import PLACE_STD, PRIOR_ROWS
from micah_plan.exploration.hand import Hand

_LEAST, _MOST = 2e-4, 0.01  # m, noise of a tracker
_SLIPS, _SLIP_STD = 2e-3, 0.01  # probability per look, and std per axis [m]
_LEAPS, _LEAP_STD = 1e-3, 0.1
_MOST_LOOKS, _SURE_PROBABILITY = 20, 0.95  # looks after which a slip that they do not show is given up
_BENDS, _NOT_LINEAR_STRETCH = 0.25, 0.01  # shares of a stretch: of what bends, and by which no hand is a linear spring
_PLAY, _ASIDE = 0.001, 0.002  # m, that what rests gives, and that it goes aside of where it is led
_SEEN = np.concatenate([np.eye(3), np.zeros((3, 1)), np.eye(3)], axis=1)  # the tracker sees place and slip


class Slips:
    """A bank of Kalman filters: one without a slip, and one for a slip before each look.

    Attributes:
        hand: the assumed one.
        state: (n, 7) place of the point that was held first [m], share by which the compliance is more than that of
            the hand, and from that point to the one that is held [m].
        covariance: (n, 7, 7) of it.
        row: (n,) of the look before which it slipped.
        odds: (n,) log odds against the first.
        leapt: whether the last measurement was not of the handle, if nothing happened.
    """

    def __init__(self, place: Floats, hand: Hand) -> None:
        self.hand = hand
        self.state = np.concatenate([place, np.zeros(4)])[None]
        self.covariance = np.diag([*[PLACE_STD**2] * 3, hand.spread**2 + _BENDS**2, 0.0, 0.0, 0.0])[None]
        self.row, self.odds = np.zeros(1, int), np.zeros(1)
        self._count, self._noise = np.full(1, PRIOR_ROWS), np.full(1, PLACE_STD**2)
        self.leapt = False

    @property
    def _share(self) -> Floats:
        """(h,) probabilities of the hypotheses."""
        share = np.exp(self.odds - self.odds.max())
        return np.asarray(share / share.sum())

    @property
    def doubt(self) -> float:
        """Probability of a slip before one of the last readings."""
        return 1.0 - float(self._share[0])

    @property
    def tracker_std(self) -> float:
        """Std of the tracker per axis without a slip [m]."""
        return float(np.sqrt(self._noise[0]))

    @property
    def expected(self) -> Floats:
        """(3,) mean displacement of the handle due to slips over all hypotheses [m]."""
        held = self.state @ _SEEN.T
        return np.asarray(self._share @ held - held[0])

    def update_displacement(self, command: Floats, force: Floats) -> None:
        """Process a displacement of the equilibrium (3,) [m] that met a force [N]."""
        self._propagate(command, force, np.eye(3, 7))

    def update_contact(self, equilibrium: Floats, force: Floats, along: Floats | None) -> None:
        """Process an equilibrium position (3,) [m] in the tracker's frame: it relates all hypotheses to one position.

        So the next measurements have no further information on them; the inferred motion of the handle has.

        Args:
            along: (3,) unit vector in which it was led; None if it was pushed to see whether it moves.
        """
        moved = self._displacement_log_likelihoods(equilibrium, force, along)
        self.odds = self.odds + moved - moved[0]
        self.state[:, :3] = 0.0
        self._propagate(equilibrium, force, np.eye(3, 7, k=4) * -1.0)

    def update_unseen_step(self, std: float) -> None:
        """Process an unobserved step of at most `std` per axis [m]."""
        self.covariance = self.covariance + np.diag([*[std**2] * 3, 0.0, 0.0, 0.0, 0.0])

    def _displacement_log_likelihoods(self, equilibrium: Floats, force: Floats, along: Floats | None) -> Floats:
        """(n,) log likelihoods of a displacement: at rest, or within the range of the lead."""
        lead = equilibrium - self.state @ _SEEN.T
        gone, covariance = lead - self.hand.compliance * force, _SEEN @ self.covariance @ _SEEN.T
        length = np.linalg.norm(lead, axis=1)[:, None, None]
        round_ = np.broadcast_to(np.eye(3), covariance.shape)
        rests = _normal(gone, covariance + _PLAY**2 * round_)
        if along is None:
            goes = _normal(gone - 0.5 * lead, covariance + (length**2 / 12.0 + _PLAY**2) * round_)
        else:
            half = 0.5 * (lead @ along)[:, None] * along
            goes = _normal(gone - half, covariance + length**2 / 12.0 * np.outer(along, along) + _ASIDE**2 * round_)
        return np.asarray(np.logaddexp(rests, goes))

    def _propagate(self, shift: Floats, force: Floats, carry: Floats) -> None:
        """Propagate the state: the position becomes `carry` of it, plus a shift minus the hand's extension."""
        stretch = self.hand.compliance * force
        whole = np.concatenate([carry, np.eye(7)[3:]])
        whole[:3, 3] = -stretch
        self.state = self.state @ whole.T
        self.state[:, :3] += shift - stretch
        noise = (self.hand.compliance * self.hand.force_std) ** 2 + _NOT_LINEAR_STRETCH**2 * float(stretch @ stretch)
        self.covariance = whole @ self.covariance @ whole.T
        self.update_unseen_step(float(np.sqrt(noise)))

    def update_reading(self, measured: Floats, row: int) -> None:
        """Process a reading of the handle at (3,) [m]."""
        self._branch(row)
        off, noise = measured - self.state @ _SEEN.T, self._noise
        covariance = _SEEN @ self.covariance @ _SEEN.T
        width = covariance + noise[:, None, None] * np.eye(3)
        inverse, volume = np.linalg.inv(width), np.linalg.slogdet(width)[1]
        share = noise / np.exp(volume / 3.0)  # share of the tracker's noise in what the look can be off
        fits = _student(np.einsum("ni,nij,nj->n", off, inverse, off), volume, self._count / share**2)
        squares = (off**2).sum(axis=1)
        leaps = np.log(_LEAPS) - 0.5 * squares / _LEAP_STD**2 - 1.5 * np.log(2.0 * np.pi * _LEAP_STD**2)
        taken = fits > leaps
        self.odds = self.odds + np.maximum(fits, leaps)
        self.odds = self.odds - self.odds[0]
        gain = np.where(taken[:, None, None], self.covariance @ _SEEN.T @ inverse, 0.0)
        self.state = self.state + np.einsum("nij,nj->ni", gain, off)
        self.covariance = self.covariance - gain @ _SEEN @ self.covariance
        weight = share**2 * taken
        count = self._count + 3.0 * weight
        excess = squares - np.trace(covariance, axis1=1, axis2=2)
        self._noise = np.clip((self._count * noise + weight * excess) / count, _LEAST**2, _MOST**2)
        self._count, self.leapt = count, not bool(taken[0])

    def _branch(self, row: int) -> None:
        """Add the hypothesis of a slip before this row."""
        kept = np.append(0, np.arange(max(len(self.row) - _MOST_LOOKS, 1), len(self.row)))
        first = np.append(kept, 0)
        self.state, self.covariance = self.state[first], self.covariance[first]
        self._count, self._noise = self._count[first], self._noise[first]
        self.covariance[-1, 4:, 4:] += _SLIP_STD**2 * np.eye(3)
        self.row, self.odds = np.append(self.row[kept], row), np.append(self.odds[kept], np.log(_SLIPS))

    def detected_slip(self) -> tuple[int, Floats] | None:
        """(row, slip (3,) [m]) of the most probable slip; None if it is not certain."""
        if self.doubt < _SURE_PROBABILITY:
            return None
        best = int(np.argmax(self.odds))
        return int(self.row[best]), self.state[best, 4:].copy()


def _student(square: Floats, volume: Floats, count: Floats) -> Floats:
    """Log density of Student's t in three dimensions, of Mahalanobis squares and log determinants."""
    tail = 0.5 * (count + 3.0) * np.log1p(square / count)
    return np.asarray(
        gammaln(0.5 * (count + 3.0)) - gammaln(0.5 * count) - tail - 0.5 * volume - 1.5 * np.log(np.pi * count)
    )


def _normal(off: Floats, covariance: Floats) -> Floats:
    """(n,) log densities of offsets (n, 3), up to a constant."""
    square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)
    return np.asarray(-0.5 * square - 0.5 * np.linalg.slogdet(covariance)[1])
