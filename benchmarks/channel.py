"""How well the action channel is estimated: coverage of its 95 % intervals over simulated recordings.

    python -m benchmarks channel [--trials 200] [--case N] [--as-believed]

Each trial plants a joint, a motion that the actions command but for a random walk, and a channel: the frame of the
actions turned by up to 180°, gains of 0.05 to 3, delays of -0.1 to 0.5 s. The rotation is compared by the Mahalanobis
distance of the turn between truth and estimate, over the directions that the recording tells (std under 0.3 rad) and
over all; for a prismatic joint, among the true rotations that no recording can tell apart the one nearest to
the estimate.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from time import process_time

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from micah_plan.automaton.graph import ActionChannel
from micah_plan.automaton.joint import Joint, prismatic, revolute
from micah_plan.automaton.kinematics import forward, jacobian
from micah_plan.learn.actions.channel import estimate_channel
from micah_plan.learn.actions.channel_search import ROTATION_STD
from micah_plan.learn.track import PartTrack, part_track
from micah_plan.recording.value import Recording

AXIS = np.array([0.36, 0.48, 0.8])
POSITION = np.array([0.5, 0.1, 0.3])
QUANTILE = 1.959964
TOLD = 0.3  # rad


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

    def __str__(self) -> str:
        extras = [name for name in ("intermittent", "uneven") if getattr(self, name)]
        extras += [] if self.orientation else ["positions"]
        shape = f"arc {self.arc:.1f}" if self.kind == "revolute" else f"{0.3 * self.arc:.2f} m"
        return (
            f"{self.kind:9} {shape:7} n {self.rows:4} noise {1e3 * self.noise:4.1f} mm walk {self.walk:.2f} "
            f"across {self.across:.2f} {' '.join(extras)}"
        )


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
class TrueChannel:
    """How actions move a part: by gain * rotation of the action, `delay` [s] later."""

    joint: Joint
    rotation: Rotation
    gain: float
    delay: float


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


def misses(truth: TrueChannel, found: ActionChannel) -> dict[str, float | bool]:
    """Whether the intervals hold the truth, and the errors."""
    covariance = np.array(found.covariance)
    rotation = Rotation.from_rotvec(found.frame_rotation)
    candidates = Rotation.concatenate([truth.rotation])
    if truth.joint.kind == "prismatic":
        turns = Rotation.from_rotvec(np.linspace(-np.pi, np.pi, 721)[:, None] * np.array(truth.joint.axis))
        candidates = turns * truth.rotation
    errors = (candidates * rotation.inv()).as_rotvec()
    values, vectors = np.linalg.eigh(covariance[:3, :3])
    seen = errors @ vectors / np.sqrt(np.maximum(values, 1e-18))
    nearest = int(np.argmin(np.sum(seen**2, axis=1)))
    error, reduced = errors[nearest], seen[nearest]
    told = values < TOLD**2
    freedom = 2 if truth.joint.kind == "prismatic" else 3
    d = min(int(told.sum()), freedom)
    stds = np.sqrt(np.diag(covariance))
    return {
        "all": bool(np.sum(reduced**2) < chi2.ppf(0.95, freedom)),
        "told": bool(np.sum(reduced[told] ** 2) < chi2.ppf(0.95, d)) if d else True,
        "told number": d,
        "gain": bool(abs(found.gain - truth.gain) < QUANTILE * stds[3]),
        "ln gain": bool(abs(np.log(found.gain / truth.gain)) < QUANTILE * stds[3] / found.gain),
        "delay": bool(abs(found.delay - truth.delay) < QUANTILE * stds[4]),
        "angle error": float(np.linalg.norm(error)),
        "gain error": float(abs(found.gain / truth.gain - 1)),
        "delay error": float(abs(found.delay - truth.delay)),
        "gain std": float(stds[3] / found.gain),
        "delay std": float(stds[4]),
        "angle std": float(np.sqrt(np.sum(values[:freedom]))),
    }


def believed_angle(rng: np.random.Generator) -> float:
    """An angle of the frame as the prior has it [rad]."""
    angles = np.linspace(0, np.pi, 1001)
    density = (1 - np.cos(angles)) * np.exp(-0.5 * (angles / ROTATION_STD) ** 2)
    return float(rng.choice(angles, p=density / density.sum()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, default=None)
    parser.add_argument("--as-believed", action="store_true", help="frames drawn from the prior, not uniform angles")
    chosen = parser.parse_args()
    print(
        f"{'':82} found |  cover: turn  told  gain  ln g delay | median error: turn  gain   delay | claimed std |  ms"
    )
    for number, case in enumerate(CASES):
        if chosen.case is not None and number != chosen.case:
            continue
        results, seconds = [], 0.0
        for trial in range(chosen.trials):
            rng = np.random.default_rng([chosen.seed, number, trial])
            truth = planted(case, rng, believed_angle(rng) if chosen.as_believed else None)
            before = process_time()
            found = estimate_channel(truth.joint, [(0, len(truth.track) - 1)], truth.track, truth.white_std)
            seconds += process_time() - before
            if found is not None:
                results.append(misses(truth, found))
        if not results:
            print(f"{case!s:82} none found")
            continue
        mean = {k: np.mean([r[k] for r in results]) for k in ("all", "told", "gain", "ln gain", "delay")}
        middle = {k: np.median([r[k] for r in results]) for k in results[0] if "error" in k or "std" in k}
        print(
            f"{case!s:82} {len(results):5d} |        {100 * mean['all']:5.1f} {100 * mean['told']:5.1f} "
            f"{100 * mean['gain']:5.1f} {100 * mean['ln gain']:5.1f} {100 * mean['delay']:5.1f} |"
            f"          {np.degrees(middle['angle error']):6.1f}° {100 * middle['gain error']:5.1f}% "
            f"{middle['delay error']:6.3f}s | {np.degrees(middle['angle std']):5.1f}° {100 * middle['gain std']:5.1f}% "
            f"{middle['delay std']:6.3f}s | {1e3 * seconds / chosen.trials:5.1f}"
        )


if __name__ == "__main__":
    main()
