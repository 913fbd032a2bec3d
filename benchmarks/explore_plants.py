"""Objects with a handle that nobody has demonstrated, drawn by seed: quasi-static, with code of their own.

The track of the handle is sampled every quarter of a millimetre. The hand is a spring; the object moves as long as its
pull along the track exceeds what holds it: dry friction, friction of the side force, a latch, a closer.
Nothing here is imported by the explorer, and nothing of the explorer is used here but what a plant is.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.execution.plant import Command, Measurement, PlantError

Floats = NDArray[np.float64]
MOVING = ("hinge_left", "hinge_right", "hinge_above", "hinge_below", "drawer", "sliding", "two_stage")
LATCHED = ("latched_door", "latched_drawer")
LOCKED = ("locked", "locked_flex")
FAMILIES = (*MOVING, *LATCHED, *LOCKED)
FAULTS = ("none", "out_nan", "out_frozen", "out_late", "slip", "lost", "dies")
_GRID = 0.00025


@dataclass(frozen=True)
class Stage:
    """A stretch of the track: length of the way [m], direction at its beginning (3,), turn per metre (3,) [rad/m].

    A slide does not turn."""

    length: float
    direction: tuple[float, float, float]
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def kind(self) -> str:
        return "revolute" if np.any(self.turn) else "prismatic"


@dataclass(frozen=True)
class Thing:
    """An object in the hand. Lengths m, forces N, stiffness N/m; noise stds; frame: rotation vector and shift.

    What is locked may flex: by the stiffness `flex` along the way that it would go, `flex_across` else; 0: not at all.
    """

    family: str
    stages: tuple[Stage, ...]
    start: float = 0.0
    stiffness: float = 1000.0
    friction: float = 3.0
    stick: float = 1.0
    jam: float = 0.0
    closer: tuple[float, float] = (0.0, 0.0)
    latch: float = 0.0
    play: float = 0.0
    flex: float = 0.0
    flex_across: float = 0.0
    position_noise: float = 0.001
    rotation_noise: float = 0.01
    force_noise: float = 0.2
    from_measured: bool = False
    frame: tuple[float, ...] = (0.0,) * 6
    fault: str = "none"
    fault_at: int = 15

    @property
    def is_locked(self) -> bool:
        return self.family in LOCKED

    @property
    def kinds(self) -> tuple[str, ...]:
        return () if self.is_locked else tuple(stage.kind for stage in self.stages)


def _hinge(axis: Floats, arm: Floats, length: float = 0.45) -> Stage:
    """Turning about an axis, the handle at `arm` from it."""
    speed = np.cross(axis, arm)
    radius = float(np.linalg.norm(speed))
    return Stage(length, tuple(speed / radius), tuple(axis / radius))


def drawn(seed: int, family: str | None = None, fault: str = "none") -> Thing:
    """One of the objects: front in the plane y = 0, outwards is -y, z is up; then turned at random."""
    rng = np.random.default_rng([seed, 19])
    family = family or FAMILIES[seed % len(FAMILIES)]
    radius = rng.uniform(0.2, 0.7)
    x, y, z = np.eye(3)
    like = family
    if family in ("latched_door", *LOCKED):
        like = ["hinge_left", "hinge_right", "hinge_above", "hinge_below", "drawer"][
            rng.integers(5 if family in LOCKED else 4)
        ]
    like = "drawer" if family == "latched_drawer" else like
    out = rng.uniform(0.0, 0.05)  # handles stand off the front
    arms = {
        "hinge_left": (-z, radius * x - out * y),
        "hinge_right": (z, -radius * x - out * y),
        "hinge_above": (-x, -radius * z - out * y),
        "hinge_below": (x, radius * z - out * y),
    }
    length = rng.uniform(0.3, 0.5)
    if like in arms:
        stages: tuple[Stage, ...] = (_hinge(*arms[like], length=min(length, 1.4 * radius)),)
    elif like == "drawer":
        stages = (Stage(length, tuple(-y)),)
    elif like == "sliding":
        stages = (Stage(length, tuple(x * rng.choice([-1, 1]))),)
    else:
        first = -y if rng.random() < 0.5 else x * rng.choice([-1, 1])
        hinge = _hinge(*arms[["hinge_left", "hinge_right", "hinge_above", "hinge_below"][rng.integers(4)]], length=0.3)
        stages = (Stage(rng.uniform(0.04, 0.1), tuple(first)), hinge)
    frame = (*Rotation.random(random_state=np.random.RandomState(seed)).as_rotvec(), *rng.uniform(-1, 1, 3))
    has = lambda share: rng.random() < share  # noqa: E731
    return Thing(
        family=family,
        stages=stages,
        frame=frame,
        fault=fault,
        fault_at=int(rng.integers(4, 16)),
        start=float(rng.uniform(0.0, 0.05)) if has(0.25) and family in MOVING[:6] else 0.0,
        stiffness=float(np.exp(rng.uniform(np.log(600), np.log(2500)))),
        friction=float(rng.uniform(0.8, 5.0)),
        stick=float(rng.uniform(1.1, 1.6)) if has(0.3) else 1.0,
        jam=float(rng.uniform(0.1, 0.4)) if has(0.5) else 0.0,
        closer=(float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.0, 10.0))) if has(0.25) else (0.0, 0.0),
        latch=float(rng.uniform(10.0, 28.0)) if family in LATCHED else 0.0,
        play=float(rng.uniform(0.0005, 0.003)) if has(0.3) else 0.0,
        flex=(bends := float(rng.uniform(2500, 15000))) if family == "locked_flex" else 0.0,
        flex_across=bends if family == "locked_flex" and seed % 2 else 0.0,
        position_noise=float(rng.uniform(0.0008, 0.003)),
        rotation_noise=float(rng.uniform(0.004, 0.02)),
        force_noise=float(rng.uniform(0.05, 0.3)),
        from_measured=has(0.2),
    )


@dataclass(frozen=True, eq=False)
class Track:
    """Places (k, 3), orientations (k,) as rotation vectors, and directions of the k - 1 small steps between."""

    place: Floats
    turn: Rotation
    step: Floats
    corner: tuple[float, ...] = field(default=())


def track_of(stages: tuple[Stage, ...]) -> Track:
    places, turns = [np.zeros((1, 3))], [np.zeros((1, 3))]
    rotation, origin = Rotation.identity(), np.zeros(3)
    for stage in stages:
        s = np.arange(1, round(stage.length / _GRID) + 1) * _GRID
        turn, direction = np.array(stage.turn), np.array(stage.direction)
        angle, size = s * np.linalg.norm(turn), float(np.linalg.norm(turn))
        if size:
            axis = turn / size
            side = np.cross(axis, direction)
            moved = (np.sin(angle)[:, None] * direction + (1 - np.cos(angle))[:, None] * side) / size
        else:
            moved = s[:, None] * direction
        places.append(origin + moved)
        turned = Rotation.from_rotvec(s[:, None] * turn) * rotation
        turns.append(turned.as_rotvec())
        origin, rotation = places[-1][-1], turned[-1]
    place = np.concatenate(places)
    steps = np.diff(place, axis=0)
    return Track(place, Rotation.from_rotvec(np.concatenate(turns)), steps / np.linalg.norm(steps, axis=1)[:, None])


class HandlePlant:
    """A plant made for a scene, which it ignores: a machine knows its object by itself."""

    def __init__(self, scene: object, thing: Thing) -> None:
        del scene
        self.thing, self.track = thing, track_of(thing.stages)
        self.frame, self.shift = Rotation.from_rotvec(thing.frame[:3]), np.array(thing.frame[3:])
        self.largest_force = 0.0
        self.seen: Measurement | None = None

    def reset(self, rng: np.random.Generator) -> Measurement:
        thing = self.thing
        self.rng, self.time, self.count = rng, 0.0, 0
        self.index = round(thing.start / _GRID)
        self.loose = 0.0  # of the play [m]
        self.bent = np.zeros(3)
        self.released, self.grip, self.held = thing.latch == 0.0, np.zeros(3), True
        self.force, self.seen = np.zeros(3), None
        self.seen = self._measure()
        return self.seen

    def close(self) -> None:
        pass

    @property
    def way(self) -> float:
        """True way from where it is shut [m]."""
        return self.index * _GRID

    @property
    def travelled(self) -> float:
        """True way of the handle since the start [m]."""
        return abs(self.index * _GRID - self.thing.start)

    def place(self) -> Floats:
        """Of the handle, in the object's own frame."""
        i = min(self.index, len(self.track.step) - 1)
        return np.asarray(self.track.place[self.index] + self.loose * self.track.step[i] + self.bent)

    def apply(self, command: Command) -> Measurement:
        thing = self.thing
        self.count, self.time = self.count + 1, self.time + 0.5
        began = self.count - thing.fault_at
        if thing.fault == "dies" and began == 0:
            raise PlantError("the controller stopped itself")
        if thing.fault == "lost" and began == 0:
            self.held = False
        offset = np.zeros(3)
        if thing.from_measured and self.seen is not None:
            offset = self.frame.inv().apply(self.measured - self.shift) - self.place() - self.grip
        target = self.place() + offset + self.frame.inv().apply(np.asarray(command.handle).reshape(3))
        self.peak = 0.0
        self.force = self._settle(target) if self.held else np.zeros(3)
        self.largest_force = max(self.largest_force, self.peak, float(np.linalg.norm(self.force)))
        if thing.fault == "slip" and began == 0:  # under the pull, which it relaxes
            slip = self.rng.standard_normal(3)
            self.grip = self.grip + 0.01 * slip / np.linalg.norm(slip)
        fresh = self._measure()
        if thing.fault.startswith("out") and 0 <= began < 20:
            fresh = self._without_tracker(fresh)
        self.seen = fresh
        return fresh

    def _settle(self, target: Floats) -> Floats:
        """Move along the track until the hand's pull is held; the force of the hand."""
        thing, k = self.thing, self.thing.stiffness
        if thing.is_locked:
            if thing.flex:
                step = self.track.step[0]
                along = (target @ step) * step
                across = (target - along) * (k / (k + thing.flex_across) if thing.flex_across else 0.0)
                self.bent = along * k / (k + thing.flex) + across
            else:
                i = min(self.index, len(self.track.step) - 1)
                pull = (target - self.track.place[self.index]) @ self.track.step[i]
                self.loose = float(np.clip(pull, -thing.play / 2, thing.play / 2))
            return k * (target - self.place())
        for sign in (1, -1):
            self._slide(target, sign)
        last = len(self.track.step) - 1
        here, along = self.track.place[self.index], self.track.step[min(self.index, last)]
        self.loose = float(np.clip((target - here) @ along, -thing.play / 2, thing.play / 2))
        return k * (target - self.place())

    def _slide(self, target: Floats, sign: int) -> None:
        thing, k, track = self.thing, self.thing.stiffness, self.track
        if sign > 0:
            indices = np.arange(self.index, len(track.step))
            steps = track.step[indices]
        else:
            indices = np.arange(self.index, 0, -1)
            steps = -track.step[indices - 1]
        if not len(indices):
            return
        stretch = target - track.place[indices] - thing.play / 2 * steps
        along = np.einsum("ij,ij->i", stretch, steps)
        side = np.linalg.norm(stretch - along[:, None] * steps, axis=1)
        closing = thing.closer[0] + thing.closer[1] * indices * _GRID
        resist = thing.friction + thing.jam * k * side + sign * closing
        first = resist[0] + (thing.stick - 1.0) * thing.friction
        if not self.released and self.index == 0 and sign > 0:
            first = first + thing.latch
        if k * along[0] <= first:
            return
        # The hand pulls ever more until it goes: by the share of the command at which it does.
        share = (first - thing.jam * k * side[0]) / max(k * (along[0] - thing.jam * side[0]), 1e-9)
        self.peak = max(self.peak, float(np.clip(share, 0.0, 1.0) * k * np.linalg.norm(stretch[0])))
        self.released = self.released or sign > 0
        stays = np.flatnonzero(k * along <= resist)
        self.index = int(indices[stays[0]]) if len(stays) else int(indices[-1] + sign)

    def _measure(self) -> Measurement:
        thing, rng = self.thing, self.rng
        place = self.frame.apply(self.place() + self.grip) + self.shift
        turn = self.frame * self.track.turn[self.index]
        noise = self.frame.apply(rng.standard_normal((3, 3)))  # turned with the object, so that answers can be compared
        self.measured = place + thing.position_noise * noise[0]
        seen = Rotation.from_rotvec(thing.rotation_noise * noise[1]) * turn
        force = self.frame.apply(self.force) + thing.force_noise * noise[2]
        return Measurement(self.time, self.measured[None], seen.as_quat()[None], force[None])

    def _without_tracker(self, fresh: Measurement) -> Measurement:
        if self.thing.fault == "out_nan":
            return replace(fresh, position=np.full((1, 3), np.nan), quaternion=np.full((1, 4), np.nan))
        if self.thing.fault == "out_late":
            return self.seen
        return replace(fresh, position=self.seen.position, quaternion=self.seen.quaternion)
