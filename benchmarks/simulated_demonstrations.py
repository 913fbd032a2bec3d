"""Simulated demonstrations of the six cases of the paper's Table I, with their truth.

Objects (all numbers are drawn per demonstration):

* microwave: a door on a hinge, 0.2 to 0.4 m from the tracked origin, that is swung by 0.5 to 1.2 rad until it is shut;
  the hand goes on pushing. Truth: revolute, then rigid from the first row at which the door is shut.
* drawer: moved by 0.15 to 0.35 m, and not to its end. Truth: one prismatic joint, whatever the hand did.

A part that rests because nobody pushes it (a pause, a finger in the air) has not become rigid: the truth of the cases
"no actions" and "without grasp" has no changepoint there.

What is drawn to look like the authors' recordings: 18 Hz and 130 to 160 rows; an object anywhere in the camera's
view, at any attitude; a tracker whose error is white plus slowly wandering, of unequal size along the axes. With a
grasp it is 0.15 to 0.5 mm and 0.5 to 2 mrad white, 0.3 to 1.5 mm and 3 to 15 mrad wandering. Without, where the
hand hides the part, it is 3 to 6 mm for the door, 6 to 14 mm for the drawer and 30 to 60 mrad white, 3 to 9 mm and
10 to 35 mrad wandering (the measured drawer: 5 to 14 mm and 30 to 70 mrad white, 4 to 9 mm wandering). Actions are the
hand's displacements, not the part's: the hand holds the part elsewhere than the tracker does, and the column comes
in a frame that is tilted a little or, in every second demonstration, not related to the camera's at all, with a gain of
0.5 to 6, up to two rows late or one early, smoothed, and noisy. The measured ones go further: their gains are 8 to 16,
and drift. Nothing here knows how the learner works.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from simulated_hand import Habits, HandMotion, grasping, pushing, slow

from micah_plan.automaton.joint import Joint, JointKind, axis_basis, prismatic, radius, revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.recording.value import Recording

Floats = NDArray[np.float64]
Object = Literal["microwave", "drawer"]
Handling = Literal["with grasp", "no actions", "without grasp"]
OBJECTS: tuple[Object, ...] = ("microwave", "drawer")
HANDLINGS: tuple[Handling, ...] = ("with grasp", "no actions", "without grasp")

RATE = 18.0
"""Rows per second."""


@dataclass(frozen=True)
class Tracker:
    """The error of a tracked pose, left-multiplied for rotations; base frame, per axis.

    Attributes:
        position_white, position_wander: std [m].
        rotation_white, rotation_wander: std [rad].
        memory: of the wandering errors [s].
        scale: share of these along x, y and z.
    """

    position_white: float = 0.0
    position_wander: float = 0.0
    rotation_white: float = 0.0
    rotation_wander: float = 0.0
    memory: float = 3.0
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def errors(self, rows: int, white: float, wander: float, rng: np.random.Generator) -> Floats:
        """(rows, 3) errors with the given std."""
        columns = [
            share * (white * rng.standard_normal(rows) + wander * slow(rng, rows, self.memory * RATE))
            for share in self.scale
        ]
        return np.stack(columns, axis=1)


@dataclass(frozen=True)
class ActionChannel:
    """How the column of actions comes from what the hand asked of the part's origin.

    Attributes:
        rotation: rotation vector, base frame to the frame of the actions [rad].
        gain: action per displacement.
        delay: rows by which the column is late (negative: early).
        smoothing: rows of a moving average.
        noise: std per component, as a share of the column's root mean square.
    """

    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gain: float = 1.0
    delay: int = 0
    smoothing: int = 1
    noise: float = 0.0

    def __call__(self, displacement: Floats, rng: np.random.Generator) -> Floats:
        """(n, 3) actions of (n - 1, 3) displacements [m]; NaN in the last row."""
        rows = np.arange(len(displacement))
        window = rows[:, None] - self.delay + np.arange(self.smoothing) - (self.smoothing - 1) // 2
        known = (window >= 0) & (window < len(displacement))  # the hand rests before and after
        smooth = np.mean(displacement[np.clip(window, 0, len(displacement) - 1)] * known[..., None], axis=1)
        action = self.gain * Rotation.from_rotvec(self.rotation).apply(smooth)
        action += self.noise * np.sqrt(np.mean(action**2)) * rng.standard_normal(action.shape)
        return np.concatenate([action, np.full((1, 3), np.nan)])


@dataclass(frozen=True)
class Scene:
    """All that is drawn before a demonstration.

    Attributes:
        joint: that moves, at configuration 0 in the first row, growing in the direction of the demonstration.
        travel: [rad or m].
        stops: whether the part is rigid once it has travelled so far.
        lever: hand motion per configuration [m/rad, or 1].
        handle: angle about the axis from the tracked origin to the hand [rad].
    """

    handling: Handling
    joint: Joint
    travel: float
    stops: bool
    lever: float
    handle: float
    rows: int
    tracker: Tracker
    channel: ActionChannel
    habits: Habits = field(default_factory=Habits)


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A recording and its truth: the scene, and what the hand and the part did."""

    recording: Recording
    scene: Scene
    motion: HandMotion

    @property
    def kinds(self) -> tuple[JointKind, ...]:
        return (self.scene.joint.kind, "rigid") if self.scene.stops else (self.scene.joint.kind,)

    @property
    def changepoints(self) -> tuple[int, ...]:
        """First row of every segment but the first."""
        return (int(np.argmax(self.motion.configuration == self.scene.travel)),) if self.scene.stops else ()


def draw_scene(name: Object, handling: Handling, rng: np.random.Generator) -> Scene:
    """A random object, hand, tracker and action channel of a case."""
    position = rng.uniform([-0.4, -0.3, 0.6], [0.4, 0.3, 1.2])  # before a camera that looks along z
    axis, quaternion = _unit(rng), Rotation.random(rng=rng).as_quat()
    if name == "microwave":
        out = np.cross(axis, _unit(rng))
        distance = rng.uniform(0.2, 0.4)
        joint = revolute(axis, position - distance * out / np.linalg.norm(out), position, quaternion)
        travel, lever = rng.uniform(0.5, 1.2), distance * rng.uniform(0.9, 1.5)
    else:
        joint = prismatic(axis, position, quaternion)
        travel, lever = rng.uniform(0.15, 0.35), 1.0
    return Scene(
        handling=handling,
        joint=joint,
        travel=float(travel),
        stops=name == "microwave",
        lever=float(lever),
        handle=float(rng.normal(0.0, 0.2)) if name == "microwave" else 0.0,
        rows=int(rng.integers(130, 161)),
        tracker=_draw_tracker(name, handling, rng),
        channel=_draw_channel(rng),
    )


def perform(scene: Scene, rng: np.random.Generator) -> Demonstration:
    """Move the part by hand and record it."""
    about = (scene.rows, scene.travel, scene.lever, scene.stops)
    if scene.handling == "without grasp":
        motion = pushing(*about, scene.habits, rng)
    else:
        motion = grasping(*about, 2 if scene.handling == "no actions" else 0, scene.habits, rng)
    poses = forward(scene.joint, motion.configuration)
    tracker, rows = scene.tracker, scene.rows
    wrong = Rotation.from_rotvec(tracker.errors(rows, tracker.rotation_white, tracker.rotation_wander, rng))
    recording = Recording(
        time=np.arange(rows) / RATE,
        position=poses.translation + tracker.errors(rows, tracker.position_white, tracker.position_wander, rng),
        quaternion=(wrong * poses.rotation).as_quat(),
        action=scene.channel(hand_displacement(scene, motion), rng),
    )
    return Demonstration(recording, scene, motion)


def demonstration(name: Object, handling: Handling, seed: int) -> Demonstration:
    """The demonstration of a case that belongs to a seed."""
    rng = np.random.default_rng([seed, OBJECTS.index(name), HANDLINGS.index(handling)])
    return perform(draw_scene(name, handling, rng), rng)


def hand_displacement(scene: Scene, motion: HandMotion) -> Floats:
    """(n - 1, 3) displacement of the hand from each row to the next [m], base frame."""
    joint, start = scene.joint, motion.configuration[:-1]
    here = forward(joint, start).translation
    along = forward(joint, start + motion.command).translation - here
    if joint.kind == "prismatic":
        return np.asarray(along + motion.across @ axis_basis(joint.axis))
    axis = np.array(joint.axis)
    distance = radius(joint)
    outwards = (here - np.array(joint.center)) / distance
    across = motion.across[:, :1] * outwards + motion.across[:, 1:] * axis
    return Rotation.from_rotvec(scene.handle * axis).apply(along * (scene.lever / distance) + across)


def _draw_tracker(name: Object, handling: Handling, rng: np.random.Generator) -> Tracker:
    scale = np.exp(0.25 * rng.standard_normal(3))
    if handling == "without grasp":
        position = (0.003, 0.006) if name == "microwave" else (0.006, 0.014)
        ranges = (position, (0.003, 0.009), (0.03, 0.06), (0.01, 0.035))
    else:
        ranges = ((0.00015, 0.0005), (0.0003, 0.0015), (0.0005, 0.002), (0.003, 0.015))
    stds = (float(rng.uniform(*one)) for one in ranges)
    share = (float(scale[0]), float(scale[1]), float(scale[2]))
    return Tracker(*stds, memory=float(rng.uniform(1.5, 5.0)), scale=share)


def _draw_channel(rng: np.random.Generator) -> ActionChannel:
    tilted = Rotation.from_rotvec(0.15 * rng.standard_normal(3))
    unrelated = Rotation.random(rng=rng)
    rotvec = (unrelated if rng.random() < 0.5 else tilted).as_rotvec()
    return ActionChannel(
        rotation=(float(rotvec[0]), float(rotvec[1]), float(rotvec[2])),
        gain=float(np.exp(rng.uniform(np.log(0.5), np.log(6.0)))),
        delay=int(rng.integers(-1, 3)),
        smoothing=int(rng.integers(1, 6)),
        noise=float(rng.uniform(0.02, 0.1)),
    )


def _unit(rng: np.random.Generator) -> Floats:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))
