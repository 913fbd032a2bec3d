"""Parts on joints that a hand moves, simulated with joints, stops and noise of its own: nothing of the learner is used.

A hand commands a displacement of the part's origin in every row. The part follows by the projection of that
displacement on the tangent of its joint, times one plus white noise (it slips), up to its stops. A locked joint, or one
that has latched, does not move, whatever the hand commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from simulated_hand import slow

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Verb = Literal["move", "back", "press", "pull", "locked", "rest", "aside"]

RATE = 18.0  # Hz
MEMORY = -1.0 / np.log(0.9)  # rows; a wander that keeps nine tenths from row to row
ROTATION_PER_POSITION = 6.0  # rad per m of a tracker's noise
_ACROSS = 0.3  # what the hand commands across the joint, as a share of what it commands along


@dataclass(frozen=True, eq=False)
class TrueJoint:
    """A joint with one freedom, in the frame of its base.

    Attributes:
        kind: prismatic, revolute or screw.
        axis: (3,) unit vector.
        point: (3,) on the axis [m]; no matter for prismatic.
        pitch: along the axis per turn [m/rad]; 0 unless screw.
        position, rotation: of the part at configuration 0, (3,) [m] and (3, 3).
    """

    kind: str
    axis: Floats
    point: Floats
    pitch: float
    position: Floats
    rotation: Floats

    def poses(self, c: Floats) -> tuple[Floats, Floats]:
        """Positions (n, 3) and orientations (n, 3, 3) at configurations (n,)."""
        c = np.atleast_1d(np.asarray(c, dtype=float))
        if self.kind == "prismatic":
            return self.position + c[:, None] * self.axis, np.broadcast_to(self.rotation, (len(c), 3, 3))
        about = np.outer(self.axis, self.axis)
        skew = np.cross(np.eye(3), self.axis)
        sine, cosine = np.sin(c)[:, None, None], np.cos(c)[:, None, None]
        turn = cosine * np.eye(3) + sine * skew + (1 - cosine) * about
        position = self.point + turn @ (self.position - self.point) + self.pitch * c[:, None] * self.axis
        return position, turn @ self.rotation

    def tangent(self, c: float) -> Floats:
        """(3,) displacement of the part's origin per configuration."""
        if self.kind == "prismatic":
            return self.axis
        return np.cross(self.axis, self.poses(np.array([c]))[0][0] - self.point) + self.pitch * self.axis


@dataclass(frozen=True, eq=False)
class Hand:
    """What a hand commands in n rows.

    Attributes:
        along: (n,) configuration steps.
        across: (n, 3) displacements of which only what is across the joint is commanded, per displacement along [-].
        locked: (n,) whether the joint does not move, for a reason that the hand does not know.
    """

    along: Floats
    across: Floats
    locked: Bools


@dataclass(frozen=True, eq=False)
class Moved:
    """What the part did.

    Attributes:
        configuration: (n + 1,).
        command: (n, 3) displacement of the part's origin from each row to the next [m].
        held: first and last row of every stretch in which the part was commanded to move, and did not.
    """

    configuration: Floats
    command: Floats
    held: tuple[tuple[int, int], ...]


def unit(rng: np.random.Generator) -> Floats:
    """(3,) a random direction."""
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def random_joint(
    kind: str, rng: np.random.Generator, position: Floats | None = None, rotation: Floats | None = None
) -> tuple[TrueJoint, float]:
    """A joint about or along a random axis, and how far it is moved [rad or m].

    Args:
        position, rotation: of the part at the start; None: at random within 1 m.
    """
    position = rng.uniform(-1.0, 1.0, 3) if position is None else position
    rotation = Rotation.random(rng=rng).as_matrix() if rotation is None else rotation
    axis = unit(rng)
    if kind == "prismatic":
        return TrueJoint(kind, axis, np.zeros(3), 0.0, position, rotation), rng.uniform(0.15, 0.5)
    out = np.cross(axis, unit(rng))
    out /= np.linalg.norm(out)
    if kind == "revolute":
        point = position - rng.uniform(0.15, 0.6) * out
        return TrueJoint(kind, axis, point, 0.0, position, rotation), rng.uniform(0.6, 1.6)
    pitch = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.02), np.log(0.15)))
    point = position - rng.uniform(0.05, 0.3) * out
    return TrueJoint(kind, axis, point, float(pitch), position, rotation), rng.uniform(1.0, 4.0)


def hand_of(phases: Sequence[tuple[Verb, int]], travel: float, rng: np.random.Generator) -> Hand:
    """A hand that does one thing after the other, each for so many rows, and gets on by `travel` while it moves."""
    typical = travel / sum(rows for verb, rows in phases if verb == "move")
    along, aside = [], []
    for verb, rows in phases:
        sign = -1.0 if verb in ("back", "pull") else 1.0
        if verb in ("move", "back"):
            along.append(sign * typical * _pace(rows, rng))
        elif verb in ("press", "pull", "locked"):
            along.append(sign * typical * rng.uniform(0.6, 1.5) * np.exp(0.3 * slow(rng, rows, 12)))
        else:
            along.append(np.zeros(rows))
        aside.append(np.full(rows, typical if verb == "aside" else 0.0))
    asked = np.concatenate(along)
    size = _ACROSS * np.abs(asked) + np.concatenate(aside)
    across = np.stack([slow(rng, len(asked), 15) for _ in range(3)], axis=1)
    locked = np.concatenate([np.full(rows, verb == "locked") for verb, rows in phases])
    return Hand(asked, size[:, None] * across, locked)


def _pace(rows: int, rng: np.random.Generator) -> Floats:
    """(rows,) uneven steps of mean 1, which begin gently."""
    pace = np.minimum(1.0, (np.arange(rows) + 1.0) / rng.uniform(3.0, 7.0)) * np.exp(0.25 * slow(rng, rows, 8))
    return np.asarray(pace / pace.mean())


def moved_by(joint: TrueJoint, hand: Hand, high: float, latches: bool, slip: float, rng: np.random.Generator) -> Moved:
    """The part under the hand's commands.

    Args:
        high: configuration of the stop.
        latches: whether the part stays at the stop for good.
        slip: std of the share by which a step differs from the command.
    """
    c, latched = 0.0, False
    configuration, command, blocked = [c], [], []
    for along, across, locked in zip(hand.along, hand.across, hand.locked, strict=True):
        tangent = joint.tangent(c)
        lever = float(np.linalg.norm(tangent))
        beside = lever * (across - (across @ tangent) * tangent / lever**2)
        command.append(along * tangent + beside)
        step = float(command[-1] @ tangent) / lever**2 * (1.0 + slip * rng.standard_normal())
        held = bool(locked or latched)
        reached = c if held else min(c + step, high)
        # The row in which the part arrives at its stop is still one of motion.
        blocked.append(along != 0.0 and reached == c)
        latched = latches and reached == high
        c = reached
        configuration.append(c)
    return Moved(np.array(configuration), np.array(command), _stretches(np.array(blocked)))


def _stretches(blocked: Bools) -> tuple[tuple[int, int], ...]:
    """First and last row of every stretch of steps without motion: rows that begin and end one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], blocked, [False]]).astype(int)))
    return tuple((int(a), int(b)) for a, b in edges.reshape(-1, 2))


def tracker_noise(rows: int, white: float, wander: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Errors of positions (n, 3) [m] and rotation vectors (n, 3) [rad], of the same size in all directions."""
    noise = white * rng.standard_normal((rows, 6))
    if wander:
        noise += wander * np.stack([slow(rng, rows, MEMORY) for _ in range(6)], axis=1)
    return noise[:, :3], ROTATION_PER_POSITION * noise[:, 3:]


def written_actions(
    command: Floats, rotation: Rotation, gain: float, late: int, noise: float, rng: np.random.Generator
) -> Floats:
    """(n + 1, 3) column of actions: the commands (n, 3) turned, scaled, so many rows late, and noisy.

    Args:
        late: rows by which the column is late; negative: the part follows later.
        noise: std per component, as a share of the root mean square of the commands; what is exactly zero stays so.
    """
    rows = np.arange(len(command)) - late
    known = (rows >= 0) & (rows < len(command))
    action = np.where(known[:, None], command[np.clip(rows, 0, len(command) - 1)], 0.0)
    size = noise * np.sqrt(np.mean(command**2)) * action.any(axis=1, keepdims=True)
    action = gain * rotation.apply(action + size * rng.standard_normal(action.shape))
    return np.concatenate([action, np.full((1, 3), np.nan)])
