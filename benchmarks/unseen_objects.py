"""Objects with something in them that their model lacks, and recordings of them: simulated here, from nothing else.

The motion, the devices between a command and the part, the sensors and the logger are written in this file and share no
code with the package, which only gets a recording and a model built from exact joints. A plant goes in ten small steps
per row; a hand goes to and fro between drawn places. Every case is drawn from its seed: the object, its size, what it
hides and how much, the runs, the noise, and how the hand moves.
"""

# ruff: noqa: ARG005

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count, pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint, prismatic, revolute, rigid, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.recording.value import Recording

PERIOD = 0.1
Array = np.ndarray
Device = Callable[[], Callable[[float, int], float]]
"""Makes, for each run, a function of a row's command and the run's number: what arrives."""


@dataclass(frozen=True)
class Piece:
    """A stretch of a path: it turns about an axis through a point, slides along it, or both (a screw)."""

    kind: str
    length: float
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pitch: float = 0.0

    def moved(self, by: Array, position: Array, turn: Rotation) -> tuple[Array, Rotation]:
        """Poses (k,) of a part that starts at a pose and goes by (k,) along the piece."""
        axis, center = np.array(self.axis), np.array(self.center)
        if self.kind == "prismatic":
            return position + by[:, None] * axis, Rotation.from_quat(np.tile(turn.as_quat(), (len(by), 1)))
        rotation = Rotation.from_rotvec(by[:, None] * axis)
        along = self.pitch * by[:, None] * axis
        return center + rotation.apply(position - center) + along, rotation * turn


@dataclass(frozen=True)
class Thing:
    """A part on a path of pieces, from configuration 0 on.

    Attributes:
        start: position of the handle at configuration 0.
        held: whether the model has a rigid mode at the lower and the upper end.
        told: configurations that the model's demonstration went over; None: all.
        cuts: configurations at which the model has one mode end and another begin, inside of a piece.
    """

    pieces: tuple[Piece, ...]
    start: tuple[float, float, float]
    held: tuple[bool, bool] = (False, False)
    told: tuple[float, float] | None = None
    cuts: tuple[float, ...] = ()

    @property
    def length(self) -> float:
        return sum(piece.length for piece in self.pieces)

    def pose(self, c: Array) -> tuple[Array, Rotation]:
        """Poses at configurations (k,)."""
        position, turn = np.array(self.start), Rotation.identity()
        begin, found, spun = 0.0, np.zeros((len(c), 3)), np.zeros((len(c), 4))
        for number, piece in enumerate(self.pieces):
            end = begin + piece.length
            inside = (c >= begin if number else np.ones(len(c), dtype=bool)) & (
                (c < end) if number + 1 < len(self.pieces) else np.ones(len(c), dtype=bool)
            )
            if inside.any():
                found[inside], turned = piece.moved(c[inside] - begin, position, turn)
                spun[inside] = turned.as_quat()
            there, after = piece.moved(np.array([piece.length]), position, turn)
            position, turn, begin = there[0], after[0], end
        return found, Rotation.from_quat(spun)

    def model(self, std: float) -> HybridAutomaton:
        """What a demonstration over the whole path would teach, without errors."""
        low, high = self.told or (0.0, self.length)
        bounds, joints, begin = [], [], 0.0
        position, turn = np.array(self.start), Rotation.identity()
        for piece in self.pieces:
            at0, turn0 = piece.moved(np.array([-begin]), position, turn)
            made = _joint(piece, at0[0], turn0[0].as_quat())
            edges = sorted({begin, begin + piece.length, *(c for c in self.cuts if begin < c < begin + piece.length)})
            for a, b in pairwise(edges):
                if a < high and b > low:
                    bounds.append((max(a, low), min(b, high)))
                    joints.append(made)
            there, after = piece.moved(np.array([piece.length]), position, turn)
            position, turn, begin = there[0], after[0], begin + piece.length
        segments = [
            _segment(j, a, b, 20 * k + 10, std) for k, (j, (a, b)) in enumerate(zip(joints, bounds, strict=True))
        ]
        if self.held[0]:
            segments.insert(0, _segment(_rigid(joints[0], low), low, low, 0, std))
        if self.held[1]:
            segments.append(_segment(_rigid(joints[-1], high), high, high, 20 * len(joints) + 10, std))
        return build_automaton(KinematicGraph((KinematicEdge(BASE, "part", tuple(segments)),)))


def _joint(piece: Piece, position: Array, quaternion: Array) -> Joint:
    if piece.kind == "prismatic":
        return prismatic(piece.axis, position, quaternion)
    if piece.pitch:
        return screw(piece.axis, piece.center, piece.pitch, position, quaternion)
    return revolute(piece.axis, piece.center, position, quaternion)


def _rigid(moving: Joint, c: float) -> Joint:
    pose = forward(moving, c)[0]
    return rigid(pose.translation, pose.rotation.as_quat(), c)


def _segment(joint: Joint, a: float, b: float, row: int, std: float) -> Segment:
    return Segment(joint, 0, row, row + 9, a, b, (a, b), std, std, 0.0, 1.0)


@dataclass
class World:
    """What happens to a command, and to what is seen of the part. A device that is None does nothing.

    Attributes:
        actuator: command of a row, and number of the run, to what arrives.
        push: configuration, arriving command and number of the run to what is added in the row.
        ends: where the part stops.
        cling: (lower, upper) command that it takes to leave an end; reach: how near to an end that is.
        read: configuration and time in the run to what the sensor makes of it.
        goes_to: place and configuration to displacement, of a machine that is told places; None: displacements.
        beside: configuration to the path that poses really are on; None: as the model says.
        turned: rotation vector by which the log's actions are turned.
    """

    actuator: Callable[[], Callable[[float, int], float]] = lambda: lambda u, run: u
    push: Callable[[float, float, int], float] = lambda c, u, run: 0.0
    ends: tuple[float, float] | None = None
    cling: tuple[float, float] = (0.0, 0.0)
    reach: float = 0.0
    read: Callable[[float, float], float] = lambda c, t: c
    goes_to: Callable[[], Callable[[float, float], float]] | None = None
    beside: Callable[[Array], tuple[Array, Rotation]] | None = None
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Hand:
    """How runs are made and seen.

    Attributes:
        runs, rows: of the recording; step: largest command [rad or m].
        span: shares of the range between which the hand goes; beyond 0 and 1 it pushes against the ends.
        one_way: whether runs only go up.
        noise: std of a reading [rad or m]; moved: of what moves the part in a row, as a share of that.
        memory: of the noise from row to row, 0 to 1; jitter: of the times, as a log std.
        outliers, dropped: shares of rows; heavy: whether noise has Student's t with 3 degrees.
        poses: whether orientation is measured.
        across: whether hands also push across the motion, by a share of a step.
    """

    runs: int = 6
    rows: int = 60
    step: float = 0.05
    span: tuple[float, float] = (0.03, 0.97)
    one_way: bool = False
    noise: float = 0.003
    moved: float = 0.3
    memory: float = 0.0
    jitter: float = 0.0
    outliers: float = 0.0
    dropped: float = 0.0
    heavy: bool = False
    poses: bool = True
    across: float = 0.0


@dataclass(frozen=True)
class Case:
    """A plant with its model, its hand, and what is true of it.

    Attributes:
        truth: names that must all be found, each entry several that mean the same here; empty with `is_known` false:
            something that no effect names; empty with `is_known` true: nothing.
        size: root mean square of what differs in a row, in units of the noise; None: noise as the hand has it.
    """

    thing: Thing
    world: World
    hand: Hand
    truth: tuple[frozenset[str], ...] = ()
    is_known: bool = True
    size: float | None = None
    kind: str = ""


@dataclass
class _Run:
    """True configurations, readings, commands, times, and the places asked for, of one run."""

    c: list[float]
    z: list[float]
    u: list[float]
    t: list[float]
    place: list[float]


def scaled(case: Case, seed: int) -> Case:
    """The case with its noise so that what differs is `size` of it."""
    if case.size is None:
        return case
    quiet = replace(case.hand, noise=0.0, jitter=0.0, outliers=0.0, dropped=0.0, moved=0.0, rows=60, runs=6)
    differs = []
    for number in range(quiet.runs):
        run = _simulated(case, quiet, number, np.random.default_rng([seed, 7, number]))
        low, high = 0.0, case.thing.length
        asked = np.array(run.z) + run.u if case.world.goes_to is None else np.array(run.place)
        told = np.clip(asked[:-1], low, high)
        differs += list(np.abs(np.array(run.z[1:]) - told))
    felt = np.array(differs)
    felt = felt[felt > 1e-6]
    if not len(felt):
        return case
    return replace(case, hand=replace(case.hand, noise=float(np.sqrt(np.mean(felt**2))) / case.size))


def recorded(case: Case, seed: int, runs_before: int = 0) -> Recording:
    """A recording of the case, made after so many runs."""
    rng = np.random.default_rng([seed, 3])
    hand, columns = case.hand, {name: [] for name in ("time", "position", "quaternion", "action", "run")}
    for number in range(hand.runs):
        run = _simulated(case, hand, runs_before + number, np.random.default_rng([seed, 5, number]))
        z, u, t = (np.array(values) for values in (run.z, run.u, run.t))
        z = z + _noise(hand, len(z), rng)
        path = case.world.beside or case.thing.pose
        position, turn = path(z)
        lever = 0.3 if case.thing.pieces[-1].kind != "prismatic" else 1.0
        position = position + hand.noise * lever * rng.standard_normal(position.shape) * 0.5
        turn = Rotation.from_rotvec(hand.noise * rng.standard_normal((len(z), 3))) * turn
        # Of a machine that is told places, the action is the place relative to the measured pose.
        ahead, _ = path(z + u if case.world.goes_to is None else np.array(run.place))
        here, _ = path(z)
        action = ahead - here
        if hand.across:
            side = np.cross(action, rng.standard_normal(3))
            size = np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12)
            action = action + side / size * hand.across * lever * hand.step * rng.standard_normal((len(z), 1))
        action = Rotation.from_rotvec(case.world.turned).apply(action)
        bad = rng.random(len(z)) < hand.outliers
        position[bad] += 12.0 * hand.noise * lever * rng.standard_normal((int(bad.sum()), 3))
        action[-1] = np.nan
        kept = rng.random(len(z)) >= hand.dropped
        kept[[0, -1]] = True
        for name, values in (("time", t), ("position", position), ("quaternion", turn.as_quat()), ("action", action)):
            columns[name].append(values[kept])
        columns["run"].append(np.full(int(kept.sum()), number + 1))
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    if not hand.poses:
        whole["quaternion"] = None
    return Recording(**whole, has_run=True)


def _noise(hand: Hand, rows: int, rng: np.random.Generator) -> Array:
    white = rng.standard_t(3, rows) / np.sqrt(3.0) if hand.heavy else rng.standard_normal(rows)
    if not hand.memory:
        return hand.noise * white
    found = np.zeros(rows)
    for k in range(rows):
        found[k] = hand.memory * found[k - 1] + np.sqrt(1.0 - hand.memory**2) * white[k] if k else white[k]
    return hand.noise * found


def _simulated(case: Case, hand: Hand, number: int, rng: np.random.Generator) -> _Run:
    """One run: the hand decides by where it believes the part to be, which is where its commands should have led."""
    world, length = case.world, case.thing.length
    low, high = world.ends or (0.0, length)
    actuator = world.actuator()
    goes = None if world.goes_to is None else world.goes_to()
    ends_at = np.array(hand.span) * length
    c = believed = float(np.clip(ends_at[0] if hand.one_way else rng.uniform(*np.clip(ends_at, low, high)), low, high))
    goal = ends_at[1] if hand.one_way else rng.uniform(*ends_at)
    at = [c <= low, c >= high]
    run, t = _Run([], [], [], [], []), 0.0
    for _ in range(hand.rows):
        run.c.append(c)
        run.z.append(world.read(c, t))
        run.t.append(t)
        t += PERIOD * float(np.exp(hand.jitter * rng.standard_normal()))
        if abs(goal - believed) < 0.7 * hand.step:
            goal = rng.uniform(*ends_at)
        if not hand.one_way and rng.random() < 0.15:
            goal = ends_at[int(rng.integers(2))]
        u = float(np.clip(goal - believed, -hand.step, hand.step) * rng.uniform(0.25, 1.0))
        if rng.random() < 0.05:
            u = 0.0
        run.u.append(u)
        believed = float(np.clip(believed + u, low - 2 * hand.step, high + 2 * hand.step))
        run.place.append(believed)
        if goes is not None:
            d = goes(believed, c)
        else:
            d = actuator(u, number)
            d = d + world.push(c, d, number)
        d += hand.moved * hand.noise * float(rng.standard_normal())
        for side, away in ((0, d), (1, -d)):
            near = (c - low if side == 0 else high - c) <= world.reach
            if (at[side] or near) and world.cling[side] and away <= world.cling[side] and away > 0:
                d = 0.0
        c = float(np.clip(c + d, low, high))
        at = [c <= low, c >= high]
        if goes is None and not hand.one_way and rng.random() < 0.1:
            believed = c
    return run


def changed(since: tuple[int, int], after: Callable[[float], float], share: float = 1.0) -> Device:
    """A share of what is asked for, and from a run and a row in it on what that became."""

    def made() -> Callable[[float, int], float]:
        row = count()
        return lambda u, run: after(share * u) if (run, next(row)) >= since else share * u

    return made


def late(steps: int) -> Device:
    def made() -> Callable[[float, int], float]:
        waiting = [0.0] * steps

        def send(u: float, _: int) -> float:
            waiting.append(u)
            return waiting.pop(0)

        return send

    return made


def slow(share: float) -> Device:
    def made() -> Callable[[float, int], float]:
        state = [0.0]

        def send(u: float, _: int) -> float:
            state[0] += share * (u - state[0])
            return state[0]

        return send

    return made


def loose(width: float, first: Callable[[float, int], float] = lambda u, _: u) -> Device:
    def made() -> Callable[[float, int], float]:
        place = [0.5 * width]

        def send(u: float, run: int) -> float:
            ahead = place[0] + first(u, run)
            place[0] = min(max(ahead, 0.0), width)
            return ahead - place[0]

        return send

    return made


def stick_slip(grip: float) -> Device:
    """What is asked for winds up a spring, which lets go all at once when it is wound too far."""

    def made() -> Callable[[float, int], float]:
        wound = [0.0]

        def send(u: float, _: int) -> float:
            wound[0] += u
            if abs(wound[0]) < grip:
                return 0.0
            gone, wound[0] = wound[0], 0.0
            return gone

        return send

    return made


def second_order(share: float, momentum: float, steps: int) -> Callable[[], Callable[[float, float], float]]:
    def made() -> Callable[[float, float], float]:
        before: list[float] = []
        asked: list[float] = []

        def go(place: float, c: float) -> float:
            if not asked:
                asked.extend([c] * steps)
            asked.append(place)
            d = share * (asked.pop(0) - c) + momentum * (c - (before[-1] if before else c))
            before.append(c)
            return d

        return go

    return made
