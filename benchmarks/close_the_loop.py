"""Plan, execute in MuJoCo where something acts that nobody declared, calibrate on the logs, plan and execute again.

    python -m benchmarks close_the_loop [seeds] [first seed] [drawer|door|stapler ...]

Every seed draws what acts, and how much: friction at the handle (physics), or what happens between the command and the
hand. The devices are written here, by themselves: nothing of them is shared with the library's effects, and two of
them have no effect there. Errors are those of the true state when all that was commanded has arrived. Needs the extra
`sim`.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from micah_plan.automaton.hybrid import Noise
from micah_plan.documents.model import load_model
from micah_plan.documents.problem import load_problem
from micah_plan.execution.closed_loop import Episode, execute_episode, true_state
from micah_plan.execution.log import concatenated_recordings
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.planning.solver import solve
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

ROOT = Path(__file__).resolve().parents[1]
TRIALS = 4
"""Executions before and after calibration."""
WAIT = 12
"""Steps without a command after each execution."""

Device = Callable[[float], float]


def delayed(steps: int) -> Device:
    """What was sent so many steps ago."""
    sent = [0.0] * steps

    def send(u: float) -> float:
        sent.append(u)
        return sent.pop(0)

    return send


def sluggish(share: float) -> Device:
    """A share of what has not arrived yet arrives in each step."""
    missing = 0.0

    def send(u: float) -> float:
        nonlocal missing
        missing += u
        now = share * missing
        missing -= now
        return now

    return send


def loose(width: float) -> Device:
    """The drive hangs in the middle of a gap and pushes at its ends."""
    place = 0.5 * width

    def send(u: float) -> float:
        nonlocal place
        place += u
        push = place - min(max(place, 0.0), width)
        place -= push
        return push

    return send


def drawn(rng: np.random.Generator, step: float) -> tuple[str, float, Device]:
    """Name, friction [N] and device of what acts, for a largest command per step [rad or m]."""
    kind = rng.choice(["friction", "weak", "strong", "delay", "sluggish", "loose", "weak and late", "rounded", "tired"])
    size, friction = float(rng.uniform()), 1.0
    device: Device = float
    if kind == "friction":
        friction = 15.0 + 15.0 * size
    elif kind in ("weak", "strong"):
        factor = 0.6 + 0.2 * size if kind == "weak" else 1.2 + 0.2 * size
        device = lambda u: factor * u  # noqa: E731
    elif kind == "delay":
        device = delayed(1 + int(3 * size))
    elif kind == "sluggish":
        device = sluggish(0.2 + 0.3 * size)
    elif kind == "loose":
        device = loose((1.0 + 3.0 * size) * step)
    elif kind == "weak and late":
        line = delayed(2)
        device = lambda u: line((0.6 + 0.2 * size) * u)  # noqa: E731
    elif kind == "rounded":
        grain = (0.3 + 0.4 * size) * step
        device = lambda u: grain * float(np.floor(u / grain))  # noqa: E731
    else:
        device = lambda u: u / (1.0 + (0.5 + size) * abs(u) / step)  # noqa: E731
    return str(kind), friction, device


class Tampered:
    """A MuJoCo plant of one joint with a device between command and hand, newly made for each run."""

    def __init__(self, problem: Problem, seed: int) -> None:
        step = float(np.max(problem.settings.max_step or (0.05,)))
        self._draw = lambda: drawn(np.random.default_rng([seed, 1]), step)
        self.name, friction, self._device = self._draw()
        parameters = PhysicalParameters.from_mapping({**problem.plant, "friction": friction})
        self._plant = StandingPlant(problem.automaton, problem.start, parameters)
        self._way = np.zeros(3)

    def reset(self, rng: np.random.Generator) -> Measurement:
        self._device = self._draw()[2]
        return self._plant.reset(rng)

    def apply(self, command: Command) -> Measurement:
        u = float(command.input[0])
        if abs(u) > 1e-6:
            self._way = command.handle[0] / u
        return self._plant.apply(replace(command, handle=self._device(u) * self._way[None]))

    def truth(self) -> Truth:
        return self._plant.truth()

    def close(self) -> None:
        self._plant.close()


def problems() -> dict[str, Problem]:
    """Drawer and door as shipped, and the stapler's lid turned down to short of its latch."""
    stapler = load_model(ROOT / "models" / "stapler.yaml")
    noise = Noise((0.005,), (0.012,))
    lid = Problem(
        replace(stapler, noise=noise),
        Start((0.05,), (0.02,)),
        Goal(((0, 0.45, 0.03),)),
        PlannerSettings(max_step=(0.05,)),
        {"position_noise": 0.001, "rotation_noise": 0.01, "mass": 0.2, "stiffness": 1000.0, "friction": 1.0},
    )
    found = {
        "drawer": load_problem(ROOT / "problems" / "drawer_open.yaml"),
        "door": load_problem(ROOT / "problems" / "microwave_open.yaml"),
        "stapler": lid,
    }
    return {name: replace(own, settings=_patient(own.settings)) for name, own in found.items()}


def _patient(settings: PlannerSettings) -> PlannerSettings:
    """Fewer roll-outs, and no limit that a busy machine would reach."""
    return replace(settings, verification_trials=200, tightening_rounds=1, solve_time_limit_s=900.0, time_limit_s=300.0)


@dataclass(frozen=True)
class Round:
    """Executions of one plan: final errors [rad or m], successes, steps, and their log."""

    errors: np.ndarray
    successes: int
    recording: Recording


def executed(problem: Problem, plan: Plan, plant: Tampered, seeds: range) -> Round:
    errors, successes, logs = [], 0, []
    if plan.trajectory is None:
        raise SystemExit(f"no plan: {plan.reason}")
    still = Command(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
    for run, seed in enumerate(seeds):
        result = execute_episode(Episode(problem, plan.trajectory, run=run), plant, np.random.default_rng([seed, 2]))
        for _ in range(WAIT):
            plant.apply(still)
        mode, x = true_state(problem.automaton, plant.truth())
        errors.append(problem.goal.error(x))
        successes += problem.goal.contains(mode, x)
        logs.append(result.recording)
    return Round(np.array(errors), successes, concatenated_recordings(logs))


def main(seeds: int = 20, first: int = 0, *names: str) -> None:
    for name, problem in problems().items():
        if names and name not in names:
            continue
        nominal, rounds, verdicts = solve(problem), [], Counter[str]()
        print(f"{name}: {'seed':>4} {'what acts':14} {'before':>8} {'after':>8}  reached     calibration")
        for seed in range(first, first + seeds):
            plant = Tampered(problem, seed)
            before = executed(problem, nominal, plant, range(100 * seed, 100 * seed + TRIALS))
            found = calibrate(problem.automaton, before.recording)
            improved = replace(problem, automaton=found.automaton)
            plan = solve(improved)
            again = range(100 * seed + 50, 100 * seed + 50 + TRIALS)
            # Without a new plan one goes on with the old one.
            planned = plan.outcome == "solved"
            after = executed(improved, plan, plant, again) if planned else executed(problem, nominal, plant, again)
            plant.close()
            verdicts[found.verdict] += 1
            effects = ", ".join(f"{e.effect.name} {e.effect.values[0]:.3g}" for e in found.effects)
            reached = f"{before.successes} -> {after.successes}"
            errors = f"{before.errors.mean():8.4f} {after.errors.mean():8.4f}"
            told = f"{found.verdict} {effects}" + ("" if planned else ", no plan")
            print(f"{name}: {seed:4} {plant.name:14} {errors}  {reached:10}  {told}", flush=True)
            rounds.append((before, after))
        means = np.array([[b.errors.mean(), a.errors.mean()] for b, a in rounds])
        wins = sum(b.successes for b, _ in rounds), sum(a.successes for _, a in rounds)
        better = int((means[:, 1] < means[:, 0]).sum())
        print(
            f"{name}: {seeds} seeds, mean final error {means[:, 0].mean():.4f} before, {means[:, 1].mean():.4f} after; "
            f"worst seed {means[:, 0].max():.4f}, {means[:, 1].max():.4f}; better in {better}; "
            f"reached {wins[0]}, then {wins[1]} of {TRIALS * len(rounds)}; {dict(verdicts)}"
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *sys.argv[3:])
