"""Three rounds of calibration: executions of a plan, then the experiments that calibration writes; a device is hidden.

    python -m benchmarks experiment_loop [--plants nominal mujoco] [--devices late slow ...] [--seeds 2]

In round 1 the drawer's plan is executed three times. While the answer is open (nothing found, tied, partly,
unexplained) the experiment that `calibrate --experiment` writes is carried out, and all logs are calibrated together.
The devices are written here, between command and hand: the library's formulas are not used. `settled`: `explained`, and
tied with nothing; it is right if it names the device, and nothing else.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from micah_plan.api import stages
from micah_plan.api.inputs import joined
from micah_plan.documents.problem import load_problem
from micah_plan.execution.checked_plant import make_plant
from micah_plan.execution.open_loop import carry_out
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import Calibration, calibrate
from micah_plan.residual.next_experiment import next_experiment
from micah_plan.task.problem import Problem

ROOT = Path(__file__).resolve().parents[1]
ROUNDS, TRIALS = 3, 3
STEP = 0.03

Device = Callable[[float], float]


def late() -> Device:
    sent = [0.0, 0.0]

    def send(u: float) -> float:
        sent.append(u)
        return sent.pop(0)

    return send


def slow() -> Device:
    missing = [0.0]

    def send(u: float) -> float:
        whole = missing[0] + u
        missing[0] = 0.6 * whole
        return 0.4 * whole

    return send


def loose() -> Device:
    place = [0.5 * STEP]

    def send(u: float) -> float:
        moved = place[0] + u
        place[0] = min(max(moved, 0.0), STEP)
        return moved - place[0]

    return send


def cut(u: float) -> float:
    return float(np.clip(u, -0.5 * STEP, 0.5 * STEP))


def stuck(u: float) -> float:
    return u if abs(u) > 0.4 * STEP else 0.0


DEVICES: dict[str, tuple[str, Callable[[], Device]]] = {
    "late": ("delay", late),
    "slow": ("lag", slow),
    "loose": ("backlash", loose),
    "weak": ("gain", lambda: lambda u: 0.8 * u),
    "cut": ("saturation", lambda: cut),
    "stuck": ("dead_zone", lambda: stuck),
    "none": ("", lambda: float),
}


class Tampered:
    """A plant of the package with a device between command and hand, newly made for each run."""

    def __init__(self, problem: Problem, kind: str, make: Callable[[], Device]) -> None:
        self._plant, self._make = make_plant(problem, kind), make

    def reset(self, rng: np.random.Generator) -> Measurement:
        self._device = self._make()
        return self._plant.reset(rng)

    def apply(self, command: Command) -> Measurement:
        asked = float(command.input[0])
        # A command of no size leads nowhere, so the way of the last one is kept for what is still to come.
        if abs(asked) > 1e-9:
            self._way = command.handle[0] / asked
        done = self._device(asked)
        return self._plant.apply(replace(command, input=np.array([done]), handle=done * self._way[None]))

    def truth(self) -> Truth:
        return self._plant.truth()

    def close(self) -> None:
        self._plant.close()

    _way = np.zeros(3)


@dataclass(frozen=True)
class Told:
    """What a round said."""

    verdict: str
    said: str
    is_settled: bool
    is_right: bool


def told(found: Calibration, truth: str) -> Told:
    names = [one.effect.name for one in found.effects]
    said = " + ".join("/".join((one.effect.name, *one.tied)) for one in found.effects) or "nothing"
    is_tied = any(one.tied for one in found.effects)
    settled = found.verdict == "explained" and not is_tied
    return Told(found.verdict, said, settled, names == ([truth] if truth else []) and not is_tied)


def rounds(problem: Problem, plan: object, kind: str, device: str, seed: int) -> list[Told]:
    """What each round said, until the answer is settled."""
    truth, make = DEVICES[device]
    plant = lambda asked: Tampered(asked, kind, make)  # noqa: E731
    logs: list[Recording] = [stages.execute(problem, plan, plant=plant, trials=TRIALS, seed=seed).recording]
    answers: list[Told] = []
    for number in range(ROUNDS):
        recording = joined(logs)
        found = calibrate(problem.automaton, recording)
        answers.append(told(found, truth))
        designed = next_experiment(problem.automaton, recording, found)
        if answers[-1].is_settled or designed is None or number == ROUNDS - 1:
            break
        asked = replace(designed.experiment, plant=problem.plant)
        logs.append(carry_out(asked, plant=plant, seed=1000 * seed + number + 1)[0])
    return answers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="*", default=["nominal", "mujoco"])
    parser.add_argument("--devices", nargs="*", default=list(DEVICES))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0)
    asked = parser.parse_args()
    problem = load_problem(ROOT / "problems" / "drawer_open.yaml")
    plan = stages.solve(problem)
    print("| plant | device | seed | " + " | ".join(f"round {k + 1}" for k in range(ROUNDS)) + " |")
    print("| --- " * (3 + ROUNDS) + "|")
    ended: list[list[Told]] = []
    for kind in asked.plants:
        for device in asked.devices:
            for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
                answers = rounds(problem, plan, kind, device, seed)
                cells = [f"{one.verdict}: {one.said}" for one in answers] + [""] * (ROUNDS - len(answers))
                print(f"| {kind} | {DEVICES[device][0] or 'none'} | {seed} | " + " | ".join(cells) + " |", flush=True)
                if DEVICES[device][0]:
                    ended.append(answers)
    for number in range(ROUNDS):
        now = [answers[min(number, len(answers) - 1)] for answers in ended]
        settled, right = sum(one.is_settled for one in now), sum(one.is_settled and one.is_right for one in now)
        print(f"after round {number + 1}: {settled} of {len(now)} settled, {right} right")


if __name__ == "__main__":
    main()
