"""Decisions of an exploration: the belief after each measurement, and the next command.

First, six small pushes determine the hand's stiffness. Then each push is the one with the best chance of a motion per
force; directions that should have moved and did not are ruled out. Once the handle moves it is led along the chain of
joints that fits all rows, two centimetres ahead of what friction takes. If it stops, the same belief determines the
next push: harder, elsewhere, where another joint may begin, or back, since it may have been ajar.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.execution.plant import Measurement
from micah_plan.exploration import messages
from micah_plan.exploration.chain import Chain, oriented_outwards
from micah_plan.exploration.chain_joints import most_probable_chain, refitted, with_joint
from micah_plan.exploration.hand import UNKNOWN, stiffest
from micah_plan.exploration.moves import Moves, compass, moves_after_motion, prior_moves
from micah_plan.exploration.next_push import SEEN, best_push, largest_lead
from micah_plan.exploration.record import Record
from micah_plan.quantities import count
from micah_plan.task.exploration_scene import Scene

Outcome = Literal["opened", "held", "gave_up"]

_PUSHES, _FIRST_PUSH, _PUSH_FORCE = 6, 0.001, 6.0
# An answer may be that of the push before, of which this is larger: the two stay within the largest force together.
_PUSH_SHARE, _GROWTH = 0.35, 2.5
_AHEAD = 0.02  # m
_SURE_PROBABILITY = 0.6  # of a motion: then the handle is led on
_CHANGE = 0.03  # probability per step that another joint takes over
_HELD = 0.005  # that anything within the force would move it
_AGREED = 0.7  # of the travel by force, the least that the tracker must see
_SURE_DISTANCE = 0.006  # m; play and panels that bend are less
_MOVED = 0.03  # m of travel; less is no opening
_PROGRESS = 0.004  # m
_GENTLE = 3.0  # times the friction on the path, and 3 N: the largest push before the other end is tried
_BENT = 0.35  # of the largest force, with which a panel may be bent that has to come back first
_NO_FORCE = 1.0  # N
_LEAPT = 0.03  # m, further than first pushes move anything, and than trackers are noisy
_TANGENTS, _BLIND = 12, 60
_LEAST_SPREAD, _LARGEST_SPREAD = 0.01, 0.14  # of the direction ahead [rad]


@dataclass(frozen=True, eq=False)
class Moment:
    """Action and belief of one step, for the page and the log.

    Attributes:
        place: (3,) estimated place of the handle after it [m].
        force: (3,) measured [N].
        lead: (3,) of the hand's equilibrium before it [m].
        kinds: probabilities by name: fast, unknown, and the kinds of joint.
        fan: (k, 3) most probable directions of motion.
        way: of the handle along its chain of joints [m].
    """

    place: Floats
    force: Floats
    lead: Floats
    kinds: dict[str, float]
    fan: Floats
    way: float


class _Rest(NamedTuple):
    """The last row at which the handle moved along the chain: row, chain, position and its variance."""

    row: int
    chain: Chain
    place: Floats
    variance: float


class Explorer:
    """Belief, decisions and log of an exploration; it does not call a plant."""

    def __init__(self, scene: Scene, first: Measurement) -> None:
        self.scene, self.record = scene, Record(first)
        self.outcome: Outcome | None = None
        self.reason = ""
        self.moments: list[Moment] = []
        self.moves: Moves | None = None
        self.chains: tuple[Chain, ...] = ()
        self.friction, self.tried, self.p_movable = 3.0, 0.0, 1.0
        self.direction, self.farthest, self.range_seen, self.travel = 1.0, 0.0, 0.0, 0.0
        self._frame = self.record.turns[0]
        self._axes = np.concatenate([np.eye(3), -np.eye(3)]) @ self._frame.T
        self._compass = compass() @ self._frame.T
        self._anchor = self.record.place
        self._rest: _Rest | None = None
        self._left: dict[float, tuple[float, Moves | None]] = {}
        self._is_gentle, self._is_returning = True, False

    @property
    def steps(self) -> int:
        """Number of commands so far."""
        return len(self.record.commands)

    @property
    def chain(self) -> Chain | None:
        """The most probable chain of joints; None before any motion."""
        return max(self.chains, key=lambda chain: chain.evidence) if self.chains else None

    def decide(self) -> Floats | None:
        """(3,) the next command [m]; None at the end of the exploration."""
        if self.outcome is None and self.steps >= self.scene.steps:
            self._end("gave_up", f"{count(self.steps, 'step')} {'was' if self.steps == 1 else 'were'} not enough")
        if self.outcome is not None:
            return None
        lead, led = self._lead()
        if self._has_ended():
            return None
        size = float(np.linalg.norm(lead))
        most = self.scene.largest_step if self.moves is None else self._most()
        return self.record.command(lead * min(1.0, self.scene.largest_step / max(size, 1e-9)), led, most)

    def _has_ended(self) -> bool:
        return self.outcome is not None

    def stopped(self, reason: str) -> None:
        """Record a failure of the machine during the last command."""
        self.record.remove_last_command()
        self._end("gave_up", messages.plant_failed(reason))

    def _end(self, outcome: Outcome, reason: str) -> None:
        self.outcome, self.reason = outcome, reason

    def _lead(self) -> tuple[Floats, bool]:
        """The next lead, and whether it continues a known chain."""
        record, chain, still = self.record, self.chain, (np.zeros(3), False)
        if record.blind or record.looks_again:
            return still
        if self.moves is None:
            return self._probe(), False
        most = self._most()
        directions = self._compass
        if chain is not None:
            ahead = self._ahead(chain)
            if self.scene.is_outside(self.record.place + _AHEAD * ahead):
                self._end("gave_up", messages.workspace_ends())
                return still
            far = min(record.hand.compliance * self.friction + _AHEAD, most)
            needed = self.moves.leads_to_move(ahead[None], record.hand.compliance)[0]
            if float(self.moves.weight[needed + SEEN <= far].sum()) > _SURE_PROBABILITY:
                return far * ahead, True
            directions = np.concatenate([ahead[None], directions[directions @ ahead > -0.3]])
        else:
            directions = np.concatenate([directions, self.moves.likely_directions()])
        push = best_push(self.moves, directions, record.hand, most)
        self.p_movable = push.p_movable
        size = float(np.linalg.norm(push.lead))
        too_strong = self._is_gentle and size > record.hand.compliance * (_GENTLE * self.friction + 3.0)
        if self.p_movable < _HELD or (chain is not None and too_strong):
            return self._turn_around(chain)
        bent = float(record.forces[-1] @ push.lead) / size
        if size > 2.0 * _BENT * most and bent > _BENT * self.scene.largest_force:
            return still
        self.tried = max(self.tried, size / record.hand.compliance)
        return push.lead, False

    def _most(self) -> float:
        """The largest safe lead [m]."""
        record = self.record
        doubt = record.place_std if record.hand.from_measured else 0.0
        return largest_lead(self.scene, record.hand, *record.pushes(), doubt)

    def _probe(self) -> Floats:
        """A push along an axis of the handle, as strong as the known stiffness allows safely."""
        record, stiffness = self.record, self.scene.largest_stiffness or UNKNOWN.stiffness
        size = min(_FIRST_PUSH, 0.5 * self.scene.largest_force / stiffness)
        if record.forces:
            last = max(float(np.linalg.norm(command)) for command in record.commands)
            force = min(_PUSH_FORCE, _PUSH_SHARE * self.scene.largest_force)
            size = min(force / max(stiffest(*record.pushes()), self.scene.largest_stiffness or 0.0), _GROWTH * last)
        return np.asarray(size * self._axes[self.steps % _PUSHES])

    def _ahead(self, chain: Chain) -> Floats:
        """(3,) direction to the position one step further along the chain."""
        here = chain.way[-1]
        places, _, _ = chain.poses(np.array([here, here + self.direction * _AHEAD]))
        chord = places[1] - places[0]
        return np.asarray(chord / np.linalg.norm(chord))

    def _turn_around(self, chain: Chain | None) -> tuple[Floats, bool]:
        """Turn to the other end: this one is reached, or needs more force. The search ends after both."""
        opposite = self._left.get(-self.direction)
        if chain is None or (self.p_movable < _HELD and opposite is not None and opposite[1] is None):
            self._end_held()
            return np.zeros(3), False
        self._is_gentle = self._is_gentle and not self._left
        self._left[self.direction] = (self.farthest, None if self.p_movable < _HELD else self.moves)
        self.direction = -self.direction
        self._is_returning = opposite is not None
        self.farthest = self.direction * float(chain.way[-1]) if opposite is None else opposite[0]
        self.moves = self._moves_ahead(chain)
        return self._lead()

    def _end_held(self) -> None:
        force = self._most() / self.record.hand.compliance
        if force < _NO_FORCE:
            self._end("gave_up", messages.hand_unknown())
        elif self.range_seen < _MOVED:
            self._end("held", messages.nothing_moved(force))
        else:
            self._end("gave_up", messages.nothing_moved_on(self.range_seen, force))

    def take(self, measurement: Measurement) -> None:
        """Process a measurement: update the belief, and record the step."""
        record = self.record
        slip = record.take(measurement)
        if slip is not None:
            self._shift_by_slip(slip)
        if record.blind >= _BLIND:
            self._end("gave_up", messages.handle_not_seen(record.blind))
        elif record.lost:
            self._end("gave_up", messages.handle_lost())
        elif (met := float(np.linalg.norm(record.forces[-1]))) > self.scene.largest_force:
            self._end("gave_up", messages.force_exceeded(met, self.scene.largest_force))
        elif (pull := self._pull_of_rest()) > self.scene.largest_force:
            self._end("gave_up", messages.rest_pulls(pull))
        elif self.moves is not None or (self.steps >= _PUSHES and not record.blind):
            self._learn()
        fan = np.zeros((0, 3)) if self.moves is None else self.moves.likely_directions(40)
        way = 0.0 if self.chain is None else self.direction * float(self.chain.way[-1])
        lead, force = record.leads[-1], record.forces[-1]
        self.moments.append(Moment(record.place.copy(), force, lead, self.probabilities(), fan, way))

    def _pull_of_rest(self) -> float:
        """The force [N] of a command to stay, which counts from the measured position."""
        record = self.record
        if record.blind:
            return 0.0
        if record.hand is UNKNOWN:  # perhaps it counts from there
            leapt = float(np.linalg.norm(record.last_seen - record.first_seen))
            return leapt * stiffest(*record.pushes()) if leapt > _LEAPT else 0.0
        away = record.last_seen - record.place - record.slips.expected
        counts = record.hand.from_measured or record.hand.perhaps_measured
        return float(np.linalg.norm(away)) * record.hand.stiffness if counts else 0.0

    def _shift_by_slip(self, slip: Floats) -> None:
        """Shift all stored positions by a slip of the grip (3,) in the handle's frame [m]."""
        moved = [replace(chain, place=chain.place + chain.turn @ slip) for chain in self.chains]
        self.chains = tuple(moved)
        if self._rest is not None:
            row, chain, place, variance = self._rest
            turn = chain.poses(chain.way[-1:])[1][0]
            chain = replace(chain, place=chain.place + chain.turn @ slip)
            self._rest = _Rest(row, chain, place + turn @ slip, variance)

    def _learn(self) -> None:
        record = self.record
        if not self.chains and not record.blind:
            record.estimate_hand()
            self._anchor = record.place - np.sum(record.moved, axis=0)
            if record.hand.complaint:
                self._end("gave_up", record.hand.complaint)
                return
        if self.moves is None:
            self.moves = prior_moves(self._frame)
            for k in range(self.steps):
                self._update_moves(k)
        elif not (record.blind or record.is_contradictory):
            self._update_moves(self.steps - 1)
        if not self.chains:
            net = record.place - self._anchor - record.support_compliance() @ record.forces[-1]
            if not record.is_contradictory and float(np.linalg.norm(net)) > _SURE_DISTANCE + 3.0 * np.sqrt(
                record.variance
            ):
                pose = (self._anchor, self._frame)
                self.chains = with_joint(None, pose, net, record.rows(), 0)
                self._rest = _Rest(self.steps, self.chains[0], record.place, record.variance)
        elif not (record.blind or record.is_contradictory) and self._leaves_chain():
            self._next_joint()
        else:
            self.chains = refitted((self.chains[0], self.chains[1]), record.rows())
        if self.chain is not None:
            self._follow(self.chain)

    def _update_moves(self, k: int) -> None:
        """Update the belief over motions by the response to step k."""
        record, lead = self.record, self.record.leads[k]
        if self.moves is not None and lead.any():
            self.moves = self.moves.updated(
                lead, record.permanent_displacement(k), record.step_std(k), record.hand.compliance
            )

    def _leaves_chain(self) -> bool:
        """Whether the handle has left its chain sideways: evidence of another joint."""
        if self._rest is None:
            return False
        _, chain, place, variance = self._rest
        along, net = chain.poses(chain.way[-1:])[2][0], self.record.place - place
        across = float(np.linalg.norm(net - (net @ along) * along))
        shows = _SURE_DISTANCE + 3.0 * float(np.sqrt(variance + self.record.variance))
        return across > max(shows, abs(float(net @ along)))

    def _next_joint(self) -> None:
        if self._rest is None:
            return
        row, before, place, _ = self._rest
        before = oriented_outwards(before)
        self.chains = with_joint(before, (place, self._frame), self.record.place - place, self.record.rows(), row)
        self.direction, self.farthest, self._left = 1.0, float(before.way[-1]), {}
        self._is_gentle, self._is_returning = True, False

    def _follow(self, chain: Chain) -> None:
        """Update the belief of a handle that follows its chain."""
        record = self.record
        record.fitted(chain)
        way = self.direction * float(chain.way[-1])
        self.range_seen = float(np.ptp(chain.way))
        along, gone = chain.poses(chain.way[-1:])[2][0], record.moved[-1]
        if self._is_returning:
            travel = self._left[self.direction][1]
            self._is_returning = way <= self.farthest - 0.006
            if not self._is_returning and travel is not None:
                self.moves = travel
            elif not self._is_returning or abs(gone @ along) > _PROGRESS:  # otherwise an obstacle stops it
                self.moves = self._moves_ahead(chain)
        if abs(gone @ along) > max(_PROGRESS, 0.8 * float(np.linalg.norm(gone))):
            self._rest = _Rest(self.steps, chain, record.place, record.variance)
        if way > self.farthest + _PROGRESS:
            self.farthest = way
            pull = max(self.direction * float(record.forces[-1] @ along), 0.3)
            led = float(np.linalg.norm(record.leads[-1])) > record.hand.compliance * self.friction + 0.5 * _AHEAD
            if not led or pull < 2.0 * self.friction:  # more than that is no friction: something stopped it
                self.friction = pull
            self.moves = self._moves_ahead(chain)
        if record.blind or record.is_contradictory or record.doubtful:
            return  # force alone shows no motion
        expected, moved = self._moved(chain)
        if moved >= _AGREED * expected:
            self.travel = max(self.travel, abs(way))
        if way < self.scene.opening:
            return
        if moved >= _AGREED * expected:
            self._end("opened", messages.opened(way))
        else:
            self._end("gave_up", messages.force_contradicts_tracker(expected, max(moved, 0.0)))

    def _moved(self, chain: Chain) -> tuple[float, float]:
        """Distance of the handle along its chain, as a straight line, and the part of it that the tracker saw [m]."""
        places, _, _ = chain.poses(np.array([0.0, chain.way[-1]]))
        net = places[1] - places[0]
        size = float(np.linalg.norm(net))
        return size, float((self.record.last_seen - self.record.first_seen) @ net) / max(size, 1e-9)

    def _moves_ahead(self, chain: Chain) -> Moves:
        """The belief over the continued motion: along the tangent, as uncertain as the chain."""
        _, slope = chain.ahead(float(chain.way[-1]))
        values, axes = np.linalg.eigh(slope.T @ chain.covariance @ slope)
        spread = (axes * np.sqrt(np.clip(values, _LEAST_SPREAD**2, _LARGEST_SPREAD**2))) @ axes.T
        drawn = np.random.default_rng(0).standard_normal((_TANGENTS, 3)) @ self._frame.T
        made = self._ahead(chain) + drawn @ spread
        return moves_after_motion(made / np.linalg.norm(made, axis=1)[:, None], self.friction, self._frame, _CHANGE)

    def most_probable_mechanism(self) -> tuple[Chain | None, float]:
        """(most probable chain, probability of its kinds); (None, probability of a stuck handle) if nothing moved."""
        if not self.chains or self.range_seen < _MOVED or self.travel < _MOVED:
            return None, (1.0 - self.p_movable if self.outcome == "held" else self.probabilities().get("fast", 0.0))
        rows = self.record.rows()
        return most_probable_chain(
            [oriented_outwards(chain) for chain in refitted((self.chains[0], self.chains[1]), rows)], rows
        )

    def probabilities(self) -> dict[str, float]:
        """Probabilities by name: fast (stuck), unknown, or the kind of the last joint."""
        if not self.chains:
            fast = self.moves.p_stuck if self.moves is not None else 0.1
            return {"fast": fast, "unknown": 1.0 - fast}
        logs = np.array([chain.evidence for chain in self.chains])
        share = np.exp(logs - logs.max())
        return {chain.kinds[-1]: float(p) for chain, p in zip(self.chains, share / share.sum(), strict=True)}
