"""Recordings with a planted action channel.

A joint, a motion that the actions command except for a random walk, and a channel: the frame of the actions turned by
up to 180°, gains of 0.05 to 3, delays of -0.1 to 0.5 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from true_channel import TrueChannel

from micah_plan.automaton.joint import prismatic, revolute
from micah_plan.automaton.kinematics import forward, jacobian
from micah_plan.learning.actions.channel_search import ROTATION_STD
from micah_plan.learning.track import PartTrack, part_track
from micah_plan.recording.value import Recording

AXIS = np.array([0.36, 0.48, 0.8])
POSITION = np.array([0.5, 0.1, 0.3])


@dataclass(frozen=True)
class Case:
    """One setting; noise in m, the walk as a share of the motion, actions across the joint of those along it."""

    kind: str
    arc: float = 0.8
    rows: int = 150
    rate: float = 18.0
    noise: float = 0.001
    walk: float = 0.05
    across: float = 0.5
    intermittent: bool = False
    orientation: bool = True
    uneven: bool = False


CASES = [
    Case("prismatic"),
    Case("prismatic", noise=0.01),
    Case("prismatic", intermittent=True, walk=0.1),
    Case("prismatic", across=0.05),
    Case("prismatic", uneven=True, orientation=False, across=2.0),
    Case("revolute", arc=0.3),
    Case("revolute", arc=0.8, noise=0.005),
    Case("revolute", arc=1.5),
    Case("revolute", arc=1.5, intermittent=True, walk=0.1),
    Case("revolute", arc=0.8, uneven=True, orientation=False, across=2.0),
    Case("revolute", arc=1.0, across=0.05, walk=0.02),
    Case("revolute", arc=0.8, rows=60, walk=0.15),
]


@dataclass(frozen=True)
class Planted(TrueChannel):
    """A simulated recording and its truth."""

    track: PartTrack
    white_std: float


def planted(case: Case, rng: np.random.Generator, angle: float | None = None) -> Planted:
    """A recording of the case; the angle of the frame in rad, None: anything up to 180°."""
    quaternion = Rotation.from_rotvec([0.4, -0.3, 0.9]).as_quat()
    if case.kind == "prismatic":
        joint, total, lever = prismatic(AXIS, POSITION, quaternion), 0.3 * case.arc, 1.0
    else:
        joint, total, lever = revolute(AXIS, POSITION - [0.24, -0.18, 0.0], POSITION, quaternion), case.arc, 0.3
    axis = rng.standard_normal(3)
    angle = rng.uniform(0, np.pi) if angle is None else angle
    rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    gain, delay = float(np.exp(rng.uniform(np.log(0.05), np.log(3.0)))), float(rng.uniform(-0.1, 0.5))
    fine = 8
    n = case.rows * fine
    duration = case.rows / case.rate
    time = np.arange(n + 1) / n * duration
    speed = hand_speed(time, duration, rng, case.intermittent)
    speed *= total / max(speed.mean() * duration, 1e-9)
    side = case.across * np.abs(total / duration) * lever * np.stack([smooth(time, duration, rng) for _ in range(3)], 1)
    step = duration / n
    walk = rng.standard_normal(n + 1) * case.walk * abs(total) / np.sqrt(n)
    c = np.concatenate([[0.0], np.cumsum(speed * step + walk)])[: n + 1]
    # What the hand commanded at the moment of motion: the joint's own displacement, and something across it.
    direction = jacobian(joint, c)[:, 3:]
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    side -= np.sum(side * unit, axis=1, keepdims=True) * unit
    given = rotation.inv().apply(direction * (speed * step)[:, None] + side * step) / gain
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(given[:-1], axis=0)])
    rows = np.arange(0, n + 1, fine)
    if case.uneven:
        rows = np.sort(rng.choice(np.arange(0, n + 1, fine // 2), case.rows, replace=False))
    # Nothing is commanded before or after: the recording's actions of time t move the part at t + delay.
    recorded = np.stack([np.interp(time[rows] + delay, time, path[:, i]) for i in range(3)], axis=1)
    action = np.concatenate([np.diff(recorded, axis=0), np.full((1, 3), np.nan)])
    poses = forward(joint, c[rows])
    position = poses.translation + case.noise * rng.standard_normal((len(rows), 3))
    turn = Rotation.from_rotvec(6 * case.noise * rng.standard_normal((len(rows), 3)))
    measured = (turn * poses.rotation).as_quat() if case.orientation else None
    recording = Recording(time[rows], position, measured, action)
    white = case.noise
    if case.kind == "revolute":
        # Closest angles weigh positions and orientations, see automaton.kinematics.inverse.
        reach, weight = 0.3**2, 0.2**2 if case.orientation else 0.0
        white = float(np.hypot(0.3 * case.noise, weight * 6 * case.noise) / (reach + weight))
    track = part_track(recording, int(recording.run[0]), recording.parts[0])
    return Planted(joint, rotation, gain, delay, track, white)


def smooth(time: np.ndarray, duration: float, rng: np.random.Generator, waves: int = 6) -> np.ndarray:
    """A signal of variance 1 with a few waves per run."""
    waves_of = np.arange(1, waves + 1)
    phase = 2 * np.pi * (waves_of[:, None] * time / duration + rng.random((waves, 1)))
    return np.asarray(rng.standard_normal(waves) @ np.sin(phase) * np.sqrt(2 / waves))


def hand_speed(time: np.ndarray, duration: float, rng: np.random.Generator, intermittent: bool) -> np.ndarray:
    """An uneven speed, mostly forwards; with pauses if intermittent."""
    speed = 1 + 0.6 * smooth(time, duration, rng)
    if intermittent:
        starts = np.sort(rng.uniform(0.05, 0.95, 6)).reshape(3, 2) * duration
        speed = np.where(((time[:, None] > starts[:, 0]) & (time[:, None] < starts[:, 1])).any(axis=1), 0.0, speed)
    return speed


def believed_angle(rng: np.random.Generator) -> float:
    """An angle of the frame as the prior has it [rad]."""
    angles = np.linspace(0, np.pi, 1001)
    density = (1 - np.cos(angles)) * np.exp(-0.5 * (angles / ROTATION_STD) ** 2)
    return float(rng.choice(angles, p=density / density.sum()))
