"""Mechanisms that one joint describes nearly: hinges in two stages, caps, slides that tilt, linkages, waves.

What a tracker shows of each is close to a hinge or a slide; what it is differs by more than the tracker's noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from kinds_of_one_part import ROWS, EdgeTruth, Simulated, as_value, between
from kinds_plant import RATE, Floats, TrueJoint, random_joint, tracker_noise, unit
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.recording.value import DEFAULT_PART, Recording

_NOISE = (3e-4, 1.5e-3)  # m


def bottle_cap(rng: np.random.Generator) -> Simulated:
    """A cap that is turned off its thread: 1.5 to 5 mm a turn, one and a half to five turns."""
    noise = between((2e-4, 6e-4), rng)
    pitch, turns = rng.uniform(1.5e-3, 5e-3) / (2 * np.pi), rng.uniform(1.5, 5.0)
    axis, position = unit(rng), rng.uniform(-1.0, 1.0, 3)
    out = np.cross(axis, unit(rng))
    point = position - rng.uniform(0.0, 0.03) * out / np.linalg.norm(out)
    joint = TrueJoint("screw", axis, point, float(pitch), position, Rotation.random(rng=rng).as_matrix())
    c = 2 * np.pi * turns * _eased(int(rng.integers(120, 301)), 1)
    return _told(*joint.poses(c), noise, rng, EdgeTruth((("screw",),), BASE, (as_value(joint),)))


def two_stage_hinge(rng: np.random.Generator) -> Simulated:
    """A flap that turns about one axis up to its stop, and then about a parallel one 6 to 12 cm away."""
    first, _ = random_joint("revolute", rng)
    rows, share = int(rng.integers(*ROWS)), rng.uniform(0.35, 0.65)
    travel = rng.uniform(1.2, 2.0)
    stop = share * travel
    (position,), (rotation,) = first.poses(np.array([stop]))
    aside = np.cross(first.axis, unit(rng))
    shift = rng.uniform(0.06, 0.12) * aside / np.linalg.norm(aside)
    second = replace(first, point=first.point + shift, position=position, rotation=rotation)
    c = travel * _eased(rows, 1)
    there = c <= stop
    parts = [first.poses(c[there]), second.poses(c[~there] - stop)]
    row = int(there.sum()) - 1
    answers = ("revolute", "revolute"), ("none",)  # that no single joint holds it is true as well
    truth = EdgeTruth(answers, BASE, (as_value(first), as_value(second)), (row,), (max(8.0, 0.05 * rows),))
    return _told(*(np.concatenate(two) for two in zip(*parts, strict=True)), between(_NOISE, rng), rng, truth)


def tilting_slide(rng: np.random.Generator) -> Simulated:
    """A part that tilts by 15 to 40 degrees while it slides straight, passed once to three times."""
    slide, travel = random_joint("prismatic", rng)
    sweep = _eased(int(rng.integers(*ROWS)), int(rng.integers(1, 4)))
    position, rotation = slide.poses(travel * sweep)
    tilt = Rotation.from_rotvec(np.outer(np.radians(rng.uniform(15.0, 40.0)) * sweep, unit(rng))).as_matrix()
    return _told(position, tilt @ rotation, between(_NOISE, rng), rng, _NO_JOINT)


def four_bar_lid(rng: np.random.Generator) -> Simulated:
    """The coupler of a four-bar linkage, passed once to three times."""
    while True:
        ground, crank, rocker = 1.0, rng.uniform(0.4, 0.9), rng.uniform(0.5, 1.1)
        coupler, begin, size = rng.uniform(0.3, 0.9), rng.uniform(0.6, 1.2), rng.uniform(0.15, 0.4)
        sweep = _eased(int(rng.integers(*ROWS)), int(rng.integers(1, 4)))
        angle = begin + rng.uniform(0.7, 1.3) * sweep
        joint = crank * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        across = np.array([ground, 0.0]) - joint
        apart = np.linalg.norm(across, axis=1)
        cosine = (coupler**2 + apart**2 - rocker**2) / (2 * coupler * apart)
        if (np.abs(cosine) < 0.95).all():
            break
    turn = np.arctan2(across[:, 1], across[:, 0]) + np.arccos(cosine)
    along = rng.uniform(0.3, 1.2) * coupler
    flat = size * (joint + along * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    base = Rotation.random(rng=rng)
    position = base.apply(np.column_stack([flat, np.zeros(len(flat))]))
    rotation = (base * Rotation.from_rotvec(np.outer(turn, [0.0, 0.0, 1.0]))).as_matrix()
    return _told(position, rotation, between(_NOISE, rng), rng, _NO_JOINT)


def wave(rng: np.random.Generator) -> Simulated:
    """A point that goes once along one to two waves: no joint, whatever arcs and lines are near."""
    s = _eased(int(rng.integers(*ROWS)), 1)
    length, waves = rng.uniform(0.2, 0.6), rng.uniform(1.0, 2.0)
    height = length * rng.uniform(0.1, 0.3)
    flat = np.stack([length * s, height * np.cos(2 * np.pi * waves * s + rng.uniform(0, 2 * np.pi)), 0 * s], axis=1)
    position = Rotation.random(rng=rng).apply(flat)
    shifts, _ = tracker_noise(len(s), between(_NOISE, rng), 0.0, rng)
    recording = Recording(np.arange(len(s)) / RATE, position + shifts, None)
    return Simulated(recording, {DEFAULT_PART: _NO_JOINT})


_NO_JOINT = EdgeTruth((("none",), ("path",)))


def _eased(rows: int, passes: int) -> Floats:
    """(rows,) from 0 to 1 and back, so often, at a speed that is not quite even."""
    phase = passes * np.linspace(0.0, 1.0, rows)
    phase = phase + 0.05 * np.sin(2 * np.pi * phase)
    return np.asarray(np.abs((phase + 1.0) % 2.0 - 1.0))


def _told(position: Floats, rotation: Floats, noise: float, rng: np.random.Generator, truth: EdgeTruth) -> Simulated:
    shifts, turns = tracker_noise(len(position), noise, 0.0, rng)
    turned = Rotation.from_rotvec(turns) * Rotation.from_matrix(rotation)
    recording = Recording(np.arange(len(position)) / RATE, position + shifts, turned.as_quat())
    return Simulated(recording, {DEFAULT_PART: truth})
