"""Hands, force sensors and trackers that fail or lie while `explore` pushes: the force spent, and what is claimed.

    OMP_NUM_THREADS=1 python -m benchmarks hostile_hands [--seeds 5] [--first 0] [--kinds NAME ...] [--runs]

Each kind of fault meets a handle on a slide or hinge that moves, and one that is fast, with limits of 10 to 45 N; hands
are springs of 300 to 20,000 N/m. "over" counts runs in which the true force on the handle was above the limit, "worst"
is the largest force over its limit; "false" counts those said to be opened of which the handle went less than half of
what was asked, and those said to be held that move. Springs, limits, frictions and faults are drawn by seed.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.errors import MicahError
from micah_plan.execution.handle import HandlePlant
from micah_plan.execution.plant import Command, Measurement, PlantError
from micah_plan.exploration.run import explore
from micah_plan.task.exploration_scene import Scene

Floats = NDArray[np.float64]
KINDS = {
    "none": "nothing is wrong",
    "leaps": "the tracker leaps by 5 to 100 cm, once",
    "flips": "the tracker leaps to and fro, in every third step",
    "frozen": "the tracker repeats its last pose",
    "wander": "the tracker wanders by 5 cm",
    "softer": "the hand softens to 40 %",
    "stiffer": "the hand stiffens fourfold",
    "half force": "the force sensor reads half, always",
    "half, told": "the same, but the scene says how stiff the hand is",
    "deaf": "the force sensor reads 40 % from some step on",
    "numb": "the force sensor reads zero from some step on",
    "late": "every answer is that of the step before",
    "doubled": "every answer comes twice",
    "nan": "a third of the poses and forces are not numbers",
    "dead": "the machine stops answering",
    "three springs": "the hand is a spring of another stiffness in each of three directions",
    "turned force": "the force sensor's frame is turned by 30 degrees",
}
OPENING = 0.2  # m
_STEP = 0.0005  # m
_NOISE = 0.001  # m, of the tracker


class Hand:
    """A handle on a track, held by a spring between the place that it is told and the handle; quasi-static."""

    def __init__(self, kind: str, seed: int, *, fast: bool, measured: bool) -> None:
        rng = np.random.default_rng([seed, len(kind), fast, measured])
        self.kind, self.fast, self.measured, self.rng = kind, fast, measured, rng
        self.limit = float(rng.uniform(10.0, 45.0))
        # A hand that goes by a place that is measured to a millimetre must be soft enough for its noise alone.
        most = min(20_000.0 if kind != "stiffer" else 5_000.0, 0.1 * self.limit / _NOISE if measured else np.inf)
        self.stiffness = float(np.exp(rng.uniform(np.log(300.0), np.log(most))))
        self.friction = 1e9 if fast else float(rng.uniform(2.0, 0.3 * self.limit))
        frame = Rotation.random(rng=rng).as_matrix()
        self.out, self.side = frame[0], frame[1]
        self.radius = float(rng.uniform(0.25, 0.6)) if rng.random() < 0.5 else np.inf
        shares = (
            np.array([1.0, rng.uniform(0.3, 1.0), rng.uniform(0.15, 0.5)]) if kind == "three springs" else np.ones(3)
        )
        turn = Rotation.random(rng=rng).as_matrix()
        self.springs = turn @ np.diag(shares) @ turn.T
        self.lie = Rotation.from_rotvec(np.radians(30.0) * turn[0]).as_matrix()
        self.at, self.leap = int(rng.integers(8, 25)), rng.uniform(0.05, 1.0) * turn[1]
        self.way = self.widest = self.largest = 0.0

    def place(self, way: float) -> Floats:
        if not np.isfinite(self.radius):
            return way * self.out
        angle = way / self.radius
        return self.radius * (np.sin(angle) * self.out + (1 - np.cos(angle)) * self.side)

    def along(self) -> Floats:
        if not np.isfinite(self.radius):
            return self.out
        angle = self.way / self.radius
        return np.cos(angle) * self.out + np.sin(angle) * self.side

    def reset(self, _: np.random.Generator) -> Measurement:
        self.steps, self.force, self.wander, self.before = 0, np.zeros(3), np.zeros(3), None
        return self.answer()

    def apply(self, command: Command) -> Measurement:
        self.steps += 1
        if self.kind == "dead" and self.steps >= self.at:
            raise PlantError("the controller does not answer")
        counts_from = self.told if self.measured else self.place(self.way)
        target = counts_from + np.asarray(command.handle)[0]
        for _ in range(4000):
            pull = float(self.spring(target) @ self.along())
            if abs(pull) <= self.friction or (self.way >= 0.4 and pull > 0) or (self.way <= 0.0 and pull < 0):
                break
            self.way = float(np.clip(self.way + np.sign(pull) * _STEP, 0.0, 0.4))
        self.force = self.spring(target)
        self.largest = max(self.largest, float(np.linalg.norm(self.force)))
        self.widest = max(self.widest, self.way)
        return self.answer()

    def spring(self, target: Floats) -> Floats:
        size = self.stiffness
        if self.later:
            size *= {"softer": 0.4, "stiffer": 4.0}.get(self.kind, 1.0)
        return size * self.springs @ (target - self.place(self.way))

    @property
    def later(self) -> bool:
        return self.steps >= self.at

    def answer(self) -> Measurement:
        rng, kind = self.rng, self.kind
        self.wander += 0.01 * rng.standard_normal(3) - 0.02 * self.wander if kind == "wander" else 0.0
        place = self.place(self.way) + _NOISE * rng.standard_normal(3) + self.wander
        if (kind == "leaps" and self.steps == self.at) or (kind == "flips" and self.later and self.steps % 3 == 0):
            place = place + self.leap
        shares = {
            "half force": 0.5,
            "half, told": 0.5,
            "deaf": 0.4 if self.later else 1.0,
            "numb": 0.0 if self.later else 1.0,
        }
        force = shares.get(kind, 1.0) * self.force + 0.2 * rng.standard_normal(3)
        force = self.lie @ force if kind == "turned force" else force
        if kind == "frozen" and self.later:
            place = self.told
        self.told = place
        if kind == "nan" and self.steps:
            place = np.full(3, np.nan) if rng.random() < 1 / 3 else place
            force = np.full(3, np.nan) if rng.random() < 1 / 3 else force
        turned = Rotation.from_rotvec(0.005 * rng.standard_normal(3))
        if np.isfinite(self.radius):
            turned *= Rotation.from_rotvec(self.way / self.radius * np.cross(self.out, self.side))
        now = Measurement(0.5 * self.steps, place[None], turned.as_quat()[None], force[None])
        if kind == "late" and self.before is not None:
            now, self.before = (
                Measurement(now.time, self.before.position, self.before.quaternion, self.before.force),
                now,
            )
            return now
        if kind == "doubled" and self.steps % 2 == 1 and self.before is not None:
            return replace(self.before, time=now.time)
        self.before = now
        return now

    def close(self) -> None:
        """Nothing to free."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--seeds", type=int, default=5, help="hands of each kind, with a handle that moves and a fast one"
    )
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), metavar="NAME")
    parser.add_argument("--runs", action="store_true", help="print every run")
    given = parser.parse_args()
    print(f"{'kind':<14}{'runs':>5}{'over':>6}{'worst':>7}{'false':>7}  moves: ended as   fast: ended as")
    for kind in given.kinds:
        over, worst, false, count = 0, 0.0, 0, 0
        ends: dict[bool, Counter[str]] = {False: Counter(), True: Counter()}
        for fast in (False, True):
            for seed in range(given.first, given.first + given.seeds):
                for measured in (False, True):
                    hand = Hand(kind, seed, fast=fast, measured=measured)
                    stiffness = hand.stiffness if kind == "half, told" else None
                    scene = Scene(largest_force=hand.limit, largest_stiffness=stiffness, opening=OPENING)
                    try:
                        found = explore(scene, HandlePlant(hand), np.random.default_rng(seed))
                        end, reason = found.outcome, found.reason
                    except MicahError as error:
                        end, reason = "error", str(error)
                    count += 1
                    ends[fast][end] += 1
                    over += hand.largest > hand.limit
                    worst = max(worst, hand.largest / hand.limit)
                    wrong = (end == "opened" and hand.widest < 0.5 * OPENING) or (end == "held" and not fast)
                    false += wrong
                    if given.runs:
                        held = f"stiffness {hand.stiffness:.0f} limit {hand.limit:.0f} largest {hand.largest:.1f}"
                        print(f"  {seed} fast {fast} measured {measured} {held} way {hand.widest:.3f} {end}: {reason}")
        said = ["  ".join(f"{name} {number}" for name, number in sorted(one.items())) for one in ends.values()]
        print(f"{kind:<14}{count:>5}{over:>6}{worst:>7.2f}{false:>7}  {said[0]:<34} {said[1]}", flush=True)


if __name__ == "__main__":
    main()
