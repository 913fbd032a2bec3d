"""How often the 95 % intervals of a fitted joint hold the truth, over repeated simulations.

    python -m benchmarks fit_coverage [--trials 300] [--seed 0] [--kind revolute ...] [--scan]

Each trial plants a joint, adds a tracker's noise (white, or white with an Ornstein-Uhlenbeck wander) to its poses and
fits it again from a rough guess. An interval is the estimate -+ 1.96 stds of its reported covariance. Origins are
compared where the true motion comes closest to the estimated one, which is what the covariance refers to. `--scan`
shows where it ends: correlation times up to the duration, and arcs too short for their noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import (
    SCREW_KINDS,
    Joint,
    JointKind,
    axis_basis,
    prismatic,
    radius,
    revolute,
    rigid,
    screw,
)
from micah_plan.automaton.kinematics import forward, inverse, reversed_direction, shifted
from micah_plan.learning.joints.final_fit import FittedJoint, fit_joint
from micah_plan.learning.joints.parametrization import chart_of, stepped
from micah_plan.learning.settings import LearnSettings

AXIS = np.array([0.1, 0.7, 0.5**0.5])  # far from where `axis_basis` changes over
QUANTILE = 1.959964
POSITION_STD, ROTATION_STD = 0.001, 0.006  # m, rad; the white part
SLIDE = 0.3  # m that a prismatic joint slides per rad of arc
RATE = 18.0  # Hz


@dataclass(frozen=True)
class Case:
    """One simulation: arc [rad], radius [m], wander in stds of the white noise and its memory in rows."""

    kind: JointKind
    has_orientation: bool = True
    rows: int = 100
    arc: float = 0.6
    radius: float = 0.2
    wander: float = 0.0
    memory: float = 4.0
    outliers: float = 0.0

    def __str__(self) -> str:
        noise = f"wander {self.wander:.1f} x {self.memory:.0f} rows" if self.wander else "white"
        sees = "poses" if self.has_orientation else "positions"
        return f"{self.kind:9} {sees:9} n {self.rows:4} arc {self.arc:.1f} radius {self.radius:.2f} {noise:20}"


@dataclass(frozen=True, eq=False)
class Coverage:
    """What repeated trials of a case gave, per parameter.

    Attributes:
        names: of the parameters, and the radius where there is one.
        share: of the trials whose interval holds the truth.
        claimed, real: rms of the reported stds, and of the errors.
        bias: mean error, in its standard errors.
        seconds: of processor time per fit.
    """

    names: tuple[str, ...]
    share: np.ndarray
    claimed: np.ndarray
    real: np.ndarray
    bias: np.ndarray
    seconds: float


def planted(case: Case) -> Joint:
    """The true joint."""
    position, quaternion = np.array([0.5, 0.1, 0.3]), Rotation.from_rotvec([0.4, -0.3, 0.9]).as_quat()
    if case.kind == "rigid":
        return rigid(position, quaternion)
    if case.kind == "prismatic":
        return prismatic(AXIS, position, quaternion)
    center = position - case.radius * np.array([0.8, 0.6]) @ axis_basis(AXIS)
    if case.kind == "revolute":
        return revolute(AXIS, center, position, quaternion)
    return screw(AXIS, center, 0.12, position, quaternion)


def simulated(case: Case, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """Measured positions (n, 3), quaternions (n, 4) and times (n,)."""
    n = case.rows
    phase = np.linspace(0, 1, n)
    c = case.arc * (phase + 0.04 * np.sin(9 * phase)) * (SLIDE if case.kind == "prismatic" else 1.0)
    poses = forward(planted(case), c)
    noise = rng.standard_normal((n, 6))
    if case.wander:
        noise += case.wander * wandering(n, case.memory, rng)
    wrong = (rng.random(n) < case.outliers)[:, None]
    position = poses.translation + POSITION_STD * noise[:, 3:] + wrong * rng.uniform(-0.5, 0.5, (n, 3))
    turn = Rotation.from_rotvec(wrong * rng.uniform(-1.5, 1.5, (n, 3))) * Rotation.from_rotvec(
        ROTATION_STD * noise[:, :3]
    )
    quaternion = (turn * poses.rotation).as_quat() * rng.choice([-1.0, 1.0], (n, 1))
    return position, quaternion if case.has_orientation else None, np.arange(n) / RATE


def wandering(n: int, memory: float, rng: np.random.Generator) -> np.ndarray:
    """(n, 6) Ornstein-Uhlenbeck processes of variance 1, with a memory in rows."""
    keep = np.exp(-1 / memory)
    steps = rng.standard_normal((n, 6)) * np.sqrt(1 - keep**2)
    steps[0] /= np.sqrt(1 - keep**2)
    for i in range(1, n):
        steps[i] += keep * steps[i - 1]
    return steps


def trial(case: Case, seed: int) -> tuple[FittedJoint, float]:
    """One fit from a rough guess, and its seconds of processor time."""
    rng = np.random.default_rng([seed, case.rows])
    position, quaternion, time = simulated(case, rng)
    truth = planted(case)
    chart = chart_of(truth, case.has_orientation)
    guess = stepped(truth, chart, 0.01 * rng.standard_normal(chart.free.shape[1]))
    if guess is None:
        raise ValueError("the guess is too far away")
    begin = process_time()
    # The parameters of a kind are asked for, not which kind it is.
    settings = LearnSettings(kinds=(case.kind,))
    fitted = fit_joint(guess, position, quaternion, time, np.ones(case.rows), settings)
    return fitted, process_time() - begin


def errors(truth: Joint, found: Joint) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names, errors and reported stds of the parameters and the radius."""
    covariance = found.covariance
    if covariance is None:
        raise ValueError("a joint without covariance")
    if np.dot(truth.axis, found.axis) < 0:
        truth = reversed_direction(truth)
    names, matrix = list(covariance.names), np.array(covariance.matrix)
    rotation = Rotation.from_quat(found.quaternion)
    if truth.kind != "rigid":
        measured = rotation if "rotation_1" in names else None
        truth = shifted(truth, float(inverse(truth, found.position, measured, near=0.0)[0]))
    basis = np.zeros((2, 3)) if truth.kind == "rigid" else axis_basis(found.axis)
    groups = {
        "axis": basis @ np.cross(found.axis, truth.axis),
        "center": basis @ np.subtract(truth.center, found.center),
        "pitch": np.array([truth.pitch - found.pitch]),
        "rotation": (Rotation.from_quat(truth.quaternion) * rotation.inv()).as_rotvec(),
        "position": np.subtract(truth.position, found.position),
    }
    values = [float(groups[group][int(i or 1) - 1]) for group, _, i in (name.partition("_") for name in names)]
    stds = np.sqrt(np.diag(matrix)).tolist()
    if truth.kind in ("revolute", "screw"):
        outwards = np.subtract(found.position, found.center) / radius(found)
        slope = np.zeros(len(names))
        slope[-3:], slope[2:4] = outwards, -basis @ outwards
        values.append(radius(truth) - radius(found))
        stds.append(float(np.sqrt(slope @ matrix @ slope)))
        names.append("radius")
    return tuple(names), np.array(values), np.array(stds)


def covered(case: Case, trials: int, first: int = 0) -> Coverage:
    """Repeated trials of a case, with the seeds from `first` on."""
    truth = planted(case)
    wrong, claimed, seconds = [], [], 0.0
    names: tuple[str, ...] = ()
    for seed in range(first, first + trials):
        fitted, took = trial(case, seed)
        names, values, stds = errors(truth, fitted.joint)
        wrong.append(values)
        claimed.append(stds)
        seconds += took
    error, std = np.array(wrong), np.array(claimed)
    return Coverage(
        names,
        (np.abs(error) < QUANTILE * std).mean(axis=0),
        np.sqrt((std**2).mean(axis=0)),
        np.sqrt((error**2).mean(axis=0)),
        error.mean(axis=0) / np.maximum(error.std(axis=0), 1e-12) * np.sqrt(trials),
        seconds / trials,
    )


def table(kinds: list[JointKind]) -> Iterator[Case]:
    """The cases of the table."""
    for kind in kinds:
        for has_orientation in (True, False):
            for rows, arc, size in ((40, 0.6, 0.2), (100, 1.2, 0.05), (100, 0.3, 0.4), (300, 0.6, 0.2)):
                for wander in (0.0, 1.5):
                    yield Case(kind, has_orientation, rows, arc, size, wander)


def limits() -> Iterator[Case]:
    """Cases towards what no data can tell: slower and slower wander, weaker wander, shorter and shorter arcs."""
    door = Case("revolute", rows=200, wander=1.5)
    for memory in (2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0):
        yield replace(door, memory=memory)
    for wander in (0.25, 0.5, 1.0):
        yield replace(door, wander=wander)
    for has_orientation in (True, False):
        for arc in (1.2, 0.6, 0.3, 0.15):
            yield replace(door, wander=0.0, arc=arc, radius=0.1, has_orientation=has_orientation)
    for outliers in (0.1, 0.2):
        yield replace(door, wander=0.0, outliers=outliers)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="the first of the seeds, one per trial")
    parser.add_argument("--kind", nargs="+", choices=SCREW_KINDS, default=list(SCREW_KINDS))
    parser.add_argument("--scan", action="store_true", help="where it ends instead of the table")
    options = parser.parse_args()
    print(f"{'case':66} mean  least most  claimed/real std  bias/se  ms")
    for case in limits() if options.scan else table(options.kind):
        result = covered(case, options.trials, options.seed)
        ratio = result.claimed / result.real
        least = result.names[int(np.argmin(result.share))]
        print(
            f"{case!s:66} {result.share.mean():.3f} {result.share.min():.3f} {result.share.max():.3f} "
            f"{ratio.min():.2f} to {ratio.max():.2f}    {np.abs(result.bias).max():4.1f}  "
            f"{1e3 * result.seconds:5.1f}  least: {least}",
            flush=True,
        )


if __name__ == "__main__":
    main()
