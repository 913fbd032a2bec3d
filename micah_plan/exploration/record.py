"""Record of actions and observations, with faults of tracker and grip.

A tracker may be out (no pose, a late answer, or the same pose to the last digit), leap once, or see the handle
elsewhere for good: then the grip has slipped on it, or the hand has lost it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.execution.plant import Measurement
from micah_plan.exploration import messages
from micah_plan.exploration.chain import PLACE_STD, Chain, StepRows
from micah_plan.exploration.hand import UNKNOWN, Hand, hand_of
from micah_plan.exploration.slips import Slips

_CONTRADICTS = 6.0  # std
_PERHAPS_OFF, _SURELY_OFF = 1.0, 9.0  # nats
_NOT_LINEAR = 0.02  # share of a lead by which no hand is a linear spring
_LEAST_STD = 3e-4  # m
_SOFT = 4e-4  # m/N, of a panel that bends much
_LET_GO = 0.25  # of the last lead; places that commands count from are noisy, so that it is not 0
_FEWEST = 5
_DOUBTFUL_PROBABILITY = 0.1  # that the grip has slipped, from which on it is looked at again without force
_LOOKS = 4  # without force, that are as informative as many
_SAME = 0.3  # std, by which a hand is no other


class Record:
    """Rows of one exploration, with the estimates derived from them.

    Attributes:
        hand: current estimate.
        slips: whether the grip has slipped on the handle.
        places, turns: (3,) and (3, 3) measured, one more than commands; NaN where not seen.
        commands, leads: (3,) as given, and from the estimated place of the handle to the hand's equilibrium [m].
        forces: (3,) [N]; 0 where not measured.
        moved, moved_std: (3,) displacement by the odometer alone, and its std [m].
        shifted: (3,) displacement by odometer and tracker [m].
        led: whether a command continued along a known chain; otherwise it was a push to find one.
        place, variance: (3,) where the handle is, and the variance per axis.
        place_std: noise of the tracker per axis [m].
        blind: steps since the tracker saw the handle.
        lost, doubtful: whether the hand certainly, or possibly, has lost the handle: no command meets a force, and it
            does not follow them.
        notes: faults, one sentence each.
        first_seen, last_seen: (3,) places as measured, without later corrections [m].
    """

    def __init__(self, first: Measurement) -> None:
        self.hand: Hand = UNKNOWN
        self.first_seen = self.last_seen = first.position[0].copy()
        self.places: list[Floats] = [first.position[0].copy()]
        self.turns: list[Floats] = [Rotation.from_quat(first.quaternion[0]).as_matrix()]
        self.commands, self.leads, self.forces = list[Floats](), list[Floats](), list[Floats]()
        self.moved, self.moved_std, self.shifted = list[Floats](), list[float](), list[Floats]()
        self.led: list[bool] = []
        self.place, self.variance = self.places[0].copy(), PLACE_STD**2
        self.place_std = PLACE_STD
        self.slips = Slips(self.places[0], self.hand)
        self.blind, self.notes = 0, list[str]()
        self._reference, self._time, self._off = self.place.copy(), first.time, 0.0
        self._rests, self._usual = 0, PLACE_STD  # the latter: noise of the tracker while the hand held the handle
        self._late, self._leapt = list[bool](), [False]

    @property
    def is_contradictory(self) -> bool:
        """Whether recent readings contradict the odometer for an unknown reason."""
        return self._leapt[-1] or self.slips.doubt > _DOUBTFUL_PROBABILITY

    @property
    def looks_again(self) -> bool:
        """Whether further readings will resolve the contradiction."""
        return self._leapt[-1] or (self.is_contradictory and self._rests < _LOOKS)

    @property
    def lost(self) -> bool:
        return self._off > _SURELY_OFF

    @property
    def doubtful(self) -> bool:
        return self._off > _PERHAPS_OFF

    def command(self, lead: Floats, led: bool, most: float) -> Floats:
        """(3,) the command for a lead, which is recorded.

        Args:
            most: the largest that is safe [m], whether the tracker is right on where the handle is or the odometer.
        """
        lead_now, self._rests = lead, 0 if lead.any() else self._rests + 1
        if self.hand.from_measured and not self.blind:
            off = self.place + self.slips.expected - self._reference
            lead_now = lead + off * min(1.0, _CONTRADICTS * self.place_std / max(float(np.linalg.norm(off)), 1e-9))
            lead_now = lead_now * min(1.0, (most + self.place_std) / max(float(np.linalg.norm(lead_now)), 1e-9))
            lead = lead_now + self._reference - self.place
        self.leads.append(lead)
        self.commands.append(lead_now)
        self.led.append(led)
        return lead_now

    def remove_last_command(self) -> None:
        """Remove the last command, which was not carried out."""
        for column in (self.leads, self.commands, self.led):
            column.pop()

    def take(self, measurement: Measurement) -> Floats | None:
        """Record a measurement; returns the slip (3,) of the grip in the handle's frame [m], if one was detected.

        The offset counts in the handle's own frame.
        """
        force = np.full(3, np.nan) if measurement.force is None else measurement.force[0]
        place, turn = measurement.position[0], measurement.quaternion[0]
        late = measurement.time <= self._time or not bool(np.isfinite(force).all())
        unseen = late or not (np.isfinite(place).all() and np.isfinite(turn).all()) or self._repeats(place)
        self._time = max(self._time, measurement.time)
        self.forces.append(np.nan_to_num(force))
        self._late.append(late)
        self.places.append(np.full(3, np.nan) if unseen else place.copy())
        self.turns.append(np.full((3, 3), np.nan) if unseen else Rotation.from_quat(turn).as_matrix())
        self.moved.append(np.zeros(3))
        self.moved_std.append(0.0)
        self.shifted.append(np.zeros(3))
        self._leapt.append(False)
        self._test_for_slip(len(self.forces) - 1)
        self._process_step(len(self.forces) - 1)
        if unseen:
            self.blind += 1
            return None
        if self.blind:
            self.notes.append(messages.blind_until(self.blind, len(self.forces)))
            self.blind = 0
        self._reference = self.last_seen = place.copy()
        self._doubt_hand(place)
        return None if self.doubtful else self._slip()

    def _process_step(self, k: int) -> None:
        """Process step k by odometer and tracker."""
        before = self.place
        self.moved[k], self.moved_std[k] = self._odometer(k)
        self.place = before + self.moved[k]
        self.variance = self.moved_std[k] ** 2 + (0.0 if self._counts_from_seen_position(k) else self.variance)
        if self._is_seen(k + 1) and not self._leapt[k + 1]:
            gain = self.variance / (self.variance + self.place_std**2)
            self.place = self.place + gain * (self.places[k + 1] - self.place)
            self.variance *= 1.0 - gain
        self.shifted[k] = self.place - before

    def _test_for_slip(self, k: int) -> None:
        """Process step k in the test for slips."""
        is_certain = not self._late[k] and self.hand is not UNKNOWN
        if self._counts_from_seen_position(k):
            size = float(np.linalg.norm(self.leads[k]))
            along = self.leads[k] / size if self.led[k] and size > 0 else None
            self.slips.update_contact(self.commands[k] + self.places[k], self.forces[k], along)
        elif is_certain and not self.hand.from_measured:
            self.slips.update_displacement(self.commands[k], self.forces[k])
        else:
            self.slips.update_unseen_step(float(np.linalg.norm(self.leads[k])) + self.place_std)
        if self._is_seen(k + 1):
            self.slips.update_reading(self.places[k + 1], k + 1)
        self._leapt[k + 1] = self._is_seen(k + 1) and self.slips.leapt

    def _counts_from_seen_position(self, k: int) -> bool:
        """Whether command k counted from a place that the tracker saw."""
        return self.hand.from_measured and not self._late[k] and self._is_seen(k)

    def _is_seen(self, row: int) -> bool:
        """Whether the tracker saw the handle in a row."""
        return bool(np.isfinite(self.places[row]).all())

    def _repeats(self, place: Floats) -> bool:
        """Whether a noisy tracker repeats its last reading exactly: then it is no measurement."""
        places = [p for p in self.places if np.isfinite(p).all()]
        if len(places) < 3 or not np.array_equal(place, places[-1]):
            return False
        return not any(np.array_equal(a, b) for a, b in pairwise(places))

    def _odometer(self, k: int) -> tuple[Floats, float]:
        """(displacement in step k by its force, std) [m]; a late answer carries an old force."""
        unknown = self.hand.from_measured and not self._is_seen(k)  # what the command counted from
        if self._late[k] or unknown:
            return np.zeros(3), float(np.linalg.norm(self.leads[k])) + self.place_std
        return self.leads[k] - self.hand.compliance * self.forces[k], self.hand.std(self.forces[k])

    def _doubt_hand(self, place: Floats) -> None:
        """Log odds that the hand does not hold the handle: it follows without force, or does not move."""
        before = self.places[-2]
        if np.linalg.norm(self.forces[-1]) > 5.0 * self.hand.force_std + 0.3:
            self._off, self._usual = 0.0, max(self.slips.tracker_std, self.place_std)
        elif np.isfinite(before).all():
            gone, led = place - before, self.leads[-1]
            self._off = max(self._off + float(led @ (led - 2.0 * gone)) / (4.0 * self._usual**2), 0.0)

    def _slip(self) -> Floats | None:
        """Detect a slip and move earlier positions to the point that is now held."""
        slip = self.slips.detected_slip()
        if slip is None:
            return None
        row, off = slip
        self.notes.append(messages.slipped(row, float(np.linalg.norm(off))))
        shift = np.asarray(self.turns[row].T @ off)
        for i in range(row):
            if self._is_seen(i):
                self.places[i] = self.places[i] + self.turns[i] @ shift
        self._recompute_positions()
        self._repeat_slip_test()
        return shift

    def estimate_hand(self) -> None:
        """Re-estimate the hand from all pushes, and with it all displacements."""
        usable = ~np.array(self._late)
        commands, places = np.array(self.commands), np.array(self.places[:-1])
        self.hand = hand_of(commands[usable], places[usable], np.array(self.forces)[usable])
        hand = self.slips.hand
        differs = abs(self.hand.compliance / hand.compliance - 1.0) > _SAME * self.hand.spread
        if differs or self.hand.from_measured != hand.from_measured:
            self._repeat_slip_test()
        self._recompute_positions()

    def _recompute_positions(self) -> None:
        """Recompute the handle's positions from the start."""
        self.place, self.variance = self.places[0].copy(), self.place_std**2
        if self.hand.from_measured:  # the force says where it is, the first place only as well as the tracker
            self.place = self.place + self.commands[0] - self.hand.compliance * self.forces[0]
        for k, command in enumerate(self.commands):
            is_measured = self.hand.from_measured and self._is_seen(k)
            self.leads[k] = command + self.places[k] - self.place if is_measured else command
            self._process_step(k)

    def _repeat_slip_test(self) -> None:
        """Repeat the test for slips from the start."""
        self.slips = Slips(self.places[0], self.hand)
        for k in range(len(self.commands)):
            self._test_for_slip(k)

    def step_std(self, k: int) -> float:
        """Std of the displacement in step k per axis [m]: the odometer's, and the nonlinearity of the hand."""
        away = _NOT_LINEAR * float(np.linalg.norm(self.leads[k]))
        return float(np.sqrt(self.moved_std[k] ** 2 + _LEAST_STD**2 + away**2))

    def permanent_displacement(self, k: int) -> Floats:
        """(3,) displacement in step k without elastic bending [m]."""
        before = self.forces[k - 1] if k else np.zeros(3)
        return np.asarray(self.shifted[k] - self.support_compliance() @ (self.forces[k] - before))

    def support_compliance(self) -> Floats:
        """(3, 3) compliance of the handle's support [m/N], from how far it springs back.

        Bayesian regression; its prior is isotropic: the displacement of the handle per change of force in most pushes,
        since what only a few pushes do is a motion.
        """
        change = np.diff(np.array([np.zeros(3), *self.forces]), axis=0)
        size = np.linalg.norm([np.zeros(3), *self.leads], axis=1)
        moved, strong = np.array(self.shifted), (change**2).sum(axis=1) > (4.0 + 5.0 * self.hand.force_std) ** 2
        let_go = strong & (size[1:] < _LET_GO * size[:-1])
        pushed = strong & ~let_go & ~np.array(self.led)
        isotropic = 0.0
        if pushed.sum() >= _FEWEST:
            along = (moved[pushed] * change[pushed]).sum(axis=1) / (change[pushed] ** 2).sum(axis=1)
            isotropic = max(float(np.median(along)), 0.0)
        force, back = change[let_go], moved[let_go] - isotropic * change[let_go]
        doubt = (_LEAST_STD / _SOFT) ** 2 * np.eye(3)
        return np.asarray(isotropic * np.eye(3) + np.linalg.solve(force.T @ force + doubt, force.T @ back).T)

    def pushes(self) -> tuple[Floats, Floats]:
        """(k, 3) leads and (k, 3) forces of all nonzero commands with a valid force."""
        rows = [k for k in range(len(self.forces)) if self.leads[k].any() and not self._late[k]]
        leads, forces = ([column[k] for k in rows] for column in (self.leads, self.forces))
        return np.array(leads).reshape(-1, 3), np.array(forces).reshape(-1, 3)

    def rows(self) -> StepRows:
        """All rows for fitting chains."""
        std = np.hypot(np.array(self.moved_std), _LEAST_STD)
        leapt = np.array(self._leapt)
        places = np.where(leapt[:, None], np.nan, self.places)
        return StepRows(places, np.array(self.turns), np.array(self.moved), std)

    def fitted(self, chain: Chain) -> None:
        """Estimate the tracker's noise from the residuals of a chain."""
        self.place_std = float(np.clip(chain.place_std, 2e-4, 0.01))
