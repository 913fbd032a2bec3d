"""Recordings of one part that a hand moves on its joint, or on one joint after the other, and what is true of them.

A changepoint is told as the row that is on both joints: a segment may begin with it or with the row after.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from kinds_plant import (
    RATE,
    Floats,
    Moved,
    TrueJoint,
    Verb,
    hand_of,
    moved_by,
    random_joint,
    tracker_noise,
    written_actions,
)
from scipy.spatial.transform import Rotation
from true_channel import TrueChannel

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.joint import Joint, prismatic, revolute, screw
from micah_plan.recording.value import DEFAULT_PART, Recording

ROWS = (80, 300)
_TELLING = 4.0  # stds of the noise by which a path is off those of rival joints
Answer = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class EdgeTruth:
    """What is true of one part.

    Attributes:
        answers: kinds of its segments; the first is what was simulated, the others are right as well.
        parent: that it is attached to.
        joints: per segment of the first answer, None where it is rigid or no joint.
        changepoints: last rows that are on the joint before; the row after is the first one that need not be.
        tolerance: rows by which a changepoint may be missed, each.
        channel: how the actions move the part; None without actions.
        rests: whether rests count as segments.
    """

    answers: tuple[Answer, ...]
    parent: str = BASE
    joints: tuple[Joint | None, ...] = ()
    changepoints: tuple[int, ...] = ()
    tolerance: tuple[float, ...] = ()
    channel: TrueChannel | None = None
    rests: bool = True


@dataclass(frozen=True, eq=False)
class Simulated:
    """A recording and the truth of its parts."""

    recording: Recording
    edges: Mapping[str, EdgeTruth]


@dataclass(frozen=True)
class Kind:
    """One part on one joint, or on one joint after the other, that a hand moves.

    Attributes:
        phases: what the hand does; a whole number is in rows, a share is of the rows drawn.
        joints: kinds of joint to draw from, for each joint that the part is on.
        stops: share of the way at which a stop is.
        latches: whether the stop keeps the part.
        white, wander: range of the tracker's noise [m].
        orientation, actions: whether they are recorded.
        scaled, turned: probability that the actions are.
        late: rows by which the actions are late, to draw from; negative: the part follows them later.
        noise: range of the noise of the actions, as a share.
        slip: range of the noise with which the part follows, as a share.
        again: second joint, that the part is on once it has come to the end of the first.
    """

    phases: tuple[tuple[Verb, float], ...] = (("move", 1.0),)
    joints: tuple[str, ...] = ("revolute", "prismatic")
    stops: float | None = None
    latches: bool = False
    white: tuple[float, float] = (0.0003, 0.002)
    wander: tuple[float, float] | None = None
    orientation: bool = True
    actions: bool = True
    scaled: float = 0.3
    turned: float = 0.3
    late: tuple[int, ...] = (0, 0, 0, 0, 0, 0, -3, -2, -1, 1, 2, 3)
    noise: tuple[float, float] = (0.01, 0.15)
    slip: tuple[float, float] = (0.02, 0.2)
    again: tuple[str, ...] = ()

    def __call__(self, rng: np.random.Generator) -> Simulated:
        phases = _in_rows(self.phases, rng)
        white, slip = between(self.white, rng), between(self.slip, rng)
        wander = rng.uniform(*self.wander) if self.wander else 0.0
        joint, travel = _telling_joint(self, white + wander, rng)
        high = np.inf if self.stops is None else self.stops * travel
        legs = [(joint, moved_by(joint, hand_of(phases, travel, rng), high, self.latches, slip, rng))]
        if self.again:
            legs.append(_next_leg(self, *legs[0], phases, slip, rng))
        return _recorded(self, legs, white, wander, rng)


def between(limits: tuple[float, float], rng: np.random.Generator) -> float:
    """A number between two positive ones, its logarithm uniform."""
    return float(np.exp(rng.uniform(*np.log(limits))))


def _in_rows(phases: tuple[tuple[Verb, float], ...], rng: np.random.Generator) -> list[tuple[Verb, int]]:
    """The phases in rows: those that are shares divide what is left of the rows drawn, at least 30."""
    fixed = sum(int(length) for _, length in phases if isinstance(length, int))
    rows = int(rng.integers(max(ROWS[0], fixed + 30), ROWS[1] + 1)) - fixed - 1
    return [(verb, length if isinstance(length, int) else max(round(length * rows), 8)) for verb, length in phases]


def _telling_joint(kind: Kind, noise: float, rng: np.random.Generator) -> tuple[TrueJoint, float]:
    """A joint that an ideal estimator tells from its rivals by positions, if these are all there is."""
    while True:
        joint, travel = random_joint(str(rng.choice(kind.joints)), rng)
        if kind.orientation or _bend(joint, travel) > _TELLING * noise:
            return joint, travel


def _bend(joint: TrueJoint, travel: float) -> float:
    """How far the path is from a line (hinge), or from a circle (screw) [m]."""
    if joint.kind == "prismatic":
        return np.inf
    path = joint.poses(np.linspace(0.0, travel, 50))[0]
    if joint.kind == "revolute":
        return float(np.linalg.svd(path - path.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(path)))
    return float(np.linalg.svd(path - path.mean(axis=0), compute_uv=False)[2] / np.sqrt(len(path)))


def _next_leg(
    kind: Kind,
    joint: TrueJoint,
    moved: Moved,
    phases: list[tuple[Verb, int]],
    slip: float,
    rng: np.random.Generator,
) -> tuple[TrueJoint, Moved]:
    """The second joint: it begins where the first one ends, in another direction."""
    end = float(moved.configuration[-1])
    (position,), (rotation,) = joint.poses(np.array([end]))
    heading = joint.tangent(end) / np.linalg.norm(joint.tangent(end))
    while True:
        new, travel = random_joint(str(rng.choice(kind.again)), rng, position, rotation)
        turn = abs(heading @ new.tangent(0.0)) / np.linalg.norm(new.tangent(0.0))
        if turn < np.cos(0.6) and abs(joint.axis @ new.axis) < np.cos(0.6):
            return new, moved_by(new, hand_of(phases, travel, rng), np.inf, False, slip, rng)


def _recorded(
    kind: Kind, legs: list[tuple[TrueJoint, Moved]], white: float, wander: float, rng: np.random.Generator
) -> Simulated:
    """What a tracker and a log of the actions hold of it, and what is true."""
    begins = np.concatenate([[0], np.cumsum([len(moved.command) for _, moved in legs])]).astype(int).tolist()
    parts = [joint.poses(moved.configuration[min(i, 1) :]) for i, (joint, moved) in enumerate(legs)]
    position, rotation = (np.concatenate(column) for column in zip(*parts, strict=True))
    shifts, turns = tracker_noise(len(position), white, wander, rng)
    frame = Rotation.random(rng=rng) if rng.random() < kind.turned else Rotation.identity()
    gain = between((0.5, 5.0), rng) if rng.random() < kind.scaled else 1.0
    late = int(rng.choice(kind.late))
    command = np.concatenate([moved.command for _, moved in legs])
    action = written_actions(command, frame, gain, late, between(kind.noise, rng), rng)
    recording = Recording(
        time=np.arange(len(position)) / RATE,
        position=position + shifts,
        quaternion=(Rotation.from_rotvec(turns) * Rotation.from_matrix(rotation)).as_quat()
        if kind.orientation
        else None,
        action=action if kind.actions else None,
    )
    # Poses move by gain * R(rotation) of the recorded action, `delay` later.
    channel = TrueChannel(as_value(legs[0][0]), frame.inv(), 1.0 / gain, -late / RATE) if kind.actions else None
    kinds, joints, edges = _segments(legs, begins)
    tolerance = tuple(_tolerance(position, row, white + wander) for row in edges)
    truth = EdgeTruth((kinds,), BASE, joints, edges, tolerance, channel)
    return Simulated(recording, {DEFAULT_PART: truth})


def _segments(
    legs: list[tuple[TrueJoint, Moved]], begins: list[int]
) -> tuple[Answer, tuple[Joint | None, ...], tuple[int, ...]]:
    """Kinds, joints and changepoints of what the part did."""
    kinds: list[str] = []
    joints: list[Joint | None] = []
    starts: list[int] = []
    for (joint, moved), first in zip(legs, begins, strict=False):
        last = len(moved.command)
        edges = sorted({0, last, *(row for stretch in moved.held for row in stretch)})
        for a in edges[:-1]:
            held = any(a == begin for begin, _ in moved.held)
            kinds.append("rigid" if held else joint.kind)
            joints.append(None if held else as_value(joint))
            starts.append(first + a)
    return tuple(kinds), tuple(joints), tuple(starts[1:])


def as_value(joint: TrueJoint) -> Joint:
    """The joint as the project writes it, to compare with."""
    quaternion = Rotation.from_matrix(joint.rotation).as_quat()
    if joint.kind == "prismatic":
        return prismatic(joint.axis, joint.position, quaternion)
    if joint.kind == "revolute":
        return revolute(joint.axis, joint.point, joint.position, quaternion)
    return screw(joint.axis, joint.point, joint.pitch, joint.position, quaternion)


def _tolerance(position: Floats, row: int, noise: float) -> float:
    """Rows by which a changepoint may be missed: 3, or 3 %, and those that the part needs to leave the noise."""
    around = position[max(row - 8, 0) : row + 9]
    fastest = float(np.quantile(np.linalg.norm(np.diff(around, axis=0), axis=1), 0.75))
    out_of_noise = 3.0 * noise / max(fastest, 1e-9)
    return max(3.0, 0.03 * len(position)) + min(out_of_noise, 0.05 * len(position))
