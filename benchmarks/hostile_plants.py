"""Machines and trackers that fail or lie while `execute` follows a plan: what is claimed, and what is commanded.

    OMP_NUM_THREADS=1 python -m benchmarks hostile_plants [PROBLEM.yaml ...] [--seeds 10] [--kinds none ...]

Each plant is the nominal one with a fault that begins at a step of its own, and answers as a machine without a
referee: success is what the belief says. "false" counts successes whose true state is not in the goal, "missed" those
true states in the goal that were not believed.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.documents.problem import load_problem
from micah_plan.errors import MicahError
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import Command, Measurement
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

PROBLEMS = Path(__file__).parents[1] / "problems"
KINDS = {
    "none": "nothing is wrong",
    "leap": "the tracker leaps by half a metre, once",
    "leap for good": "it is started anew 10 cm aside",
    "half turn": "a symmetric object is seen turned by 180 degrees, once",
    "frozen": "it repeats its last pose from some step on",
    "zeros": "it writes zeros from some step on",
    "millimetres": "it measures in millimetres",
    "turned frame": "its frame is turned by 90 degrees",
    "late": "every answer is that of the step before",
    "doubled": "every answer comes twice",
    "nan once": "one answer has no pose",
    "nan often": "a third of the answers have no pose",
    "nan for good": "no answer has a pose from some step on",
    "drift": "the tracker drifts by 2 mm a step",
    "noise": "its noise is 1 cm more than the model says",
    "stuck": "the object does not move from some step on",
    "half way": "commands go half as far from some step on",
    "twice as far": "and twice",
    "backwards": "and backwards",
}
_SHARES = {"stuck": 0.0, "half way": 0.5, "twice as far": 2.0, "backwards": -1.0}


class Hostile:
    """The nominal plant behind a fault."""

    def __init__(self, problem: Problem, kind: str, at: int) -> None:
        self.plant, self.kind, self.at, self.largest = NominalPlant.of(problem), kind, at, 0.0

    def reset(self, rng: np.random.Generator) -> Measurement:
        self.rng, self.step, self.before = np.random.default_rng(rng.integers(2**32)), 0, None
        return self.told(self.plant.reset(rng))

    def apply(self, command: Command) -> Measurement:
        self.step += 1
        self.largest = max(self.largest, float(np.abs(command.input).max()))
        share = _SHARES.get(self.kind, 1.0) if self.later else 1.0
        moved = {name: share * getattr(command, name) for name in ("input", "origin", "handle")}
        return self.told(self.plant.apply(replace(command, **moved)))

    @property
    def later(self) -> bool:
        return self.step >= self.at

    def told(self, seen: Measurement) -> Measurement:
        before, self.before = self.before, seen
        if before is not None and (
            self.kind == "late" or (self.kind == "doubled" and self.step % 2) or (self.kind == "frozen" and self.later)
        ):
            self.before = before if self.kind == "frozen" else seen
            return replace(before, time=seen.time)
        position, quaternion = self.lied(seen.position.copy(), seen.quaternion.copy())
        return replace(seen, position=position, quaternion=quaternion)

    def lied(self, position: np.ndarray, quaternion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        kind, once = self.kind, self.step == self.at
        if kind.startswith("nan") and self.step:
            hidden = {"nan once": once, "nan often": self.rng.random() < 1 / 3, "nan for good": self.later}[kind]
            return (np.full_like(position, np.nan), quaternion) if hidden else (position, quaternion)
        if kind == "zeros" and self.later:
            return np.zeros_like(position), np.tile([0.0, 0.0, 0.0, 1.0], (len(position), 1))
        if kind == "half turn" and once:
            return position, (Rotation.from_rotvec([0.0, 0.0, np.pi]) * Rotation.from_quat(quaternion)).as_quat()
        if kind == "turned frame":
            turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
            return turn.apply(position), (turn * Rotation.from_quat(quaternion)).as_quat()
        shift = {
            "leap": 0.3 * once,
            "leap for good": np.array([0.1, 0.0, 0.0]) * self.later,
            "drift": 0.002 * self.step,
            "noise": 0.01 * self.rng.standard_normal(position.shape),
        }.get(kind, 0.0)
        return position * (1000.0 if kind == "millimetres" else 1.0) + shift, quaternion

    def close(self) -> None:
        """Nothing to free."""


def counted(problem: Problem, plan: Plan, kind: str, seeds: int) -> str:
    """A line of the table."""
    ends: Counter[str] = Counter()
    steps, largest = list[int](), 0.0
    for seed in range(seeds):
        plant = Hostile(problem, kind, at=2 + seed % 8)
        try:
            (result,) = run_trials(problem, plan, plant=plant, seed=seed).results
        except MicahError:
            ends["refused"] += 1
            continue
        truth = plant.plant.truth()
        is_there = problem.goal.contains(str(truth.mode), truth.x)
        ends["success" if result.success else "failed"] += 1
        ends["false"] += result.success and not is_there
        ends["missed"] += is_there and not result.success
        steps.append(result.steps)
        largest = max(largest, plant.largest)
    counts = "".join(f"{ends[name]:>9}" for name in ("success", "failed", "refused", "false", "missed"))
    return f"{kind:<15}{counts}{np.mean(steps) if steps else 0:>8.1f}{largest:>10.3f}"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = [PROBLEMS / f"{name}.yaml" for name in ("drawer_open", "cabinet_close")]
    parser.add_argument("problems", nargs="*", type=Path, default=default)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="default: all")
    given = parser.parse_args()
    for path in given.problems:
        problem = load_problem(path)
        plan = solve(problem)
        print(f"\n{path.stem}: a plan of {len(plan.trajectory.inputs)} steps")
        print(f"{'':<15}{'success':>9}{'failed':>9}{'refused':>9}{'false':>9}{'missed':>9}{'steps':>8}{'largest':>10}")
        for kind in given.kinds:
            print(counted(problem, plan, kind, given.seeds), flush=True)


if __name__ == "__main__":
    main()
