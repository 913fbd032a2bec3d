"""The paper's manipulation experiment in MuJoCo: five tasks each on a microwave door and on a drawer.

    python -m benchmarks manipulation [--trials 20] [--seed 0] [--json FILE]

Plans are made with the models that were learned from the shipped demonstrations, `models/microwave.yaml` and
`models/drawer.yaml`. They are executed on the true objects of `examples/objects.py`, whose parameters the models only
estimate, with friction, damping, a latch, a compliant hand, and a tracker with white and wandering errors. Errors are
those of the true pose, as the model reads it. The paper (section "Object Manipulation Using Learned Models") reports
0.05 +- 0.01 rad and 0.005 +- 0.003 m, "average of 5 different tasks".
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "examples"))

from objects import DOOR_OPEN, drawer, microwave  # noqa: E402
from saving import add_json, save_json  # noqa: E402

from micah_plan.automaton.hybrid import HybridAutomaton, Noise  # noqa: E402
from micah_plan.documents.model import load_model  # noqa: E402
from micah_plan.execution.mujoco.parameters import PhysicalParameters  # noqa: E402
from micah_plan.execution.mujoco.standing import StandingPlant  # noqa: E402
from micah_plan.execution.trials import run_trials  # noqa: E402
from micah_plan.planning.solver import solve  # noqa: E402
from micah_plan.task.goal import Goal  # noqa: E402
from micah_plan.task.problem import Problem  # noqa: E402
from micah_plan.task.settings import PlannerSettings  # noqa: E402
from micah_plan.task.start import Start  # noqa: E402

TRACKER = {"position_noise": 0.003, "rotation_noise": 0.03, "position_wander": 0.001, "rotation_wander": 0.01}


@dataclass(frozen=True)
class Subject:
    """An object of the experiment.

    Attributes:
        model: file of the learned model.
        truth: the true object.
        process_std: what a control step of half a second may leave undone [rad or m]; the demonstrations, with 18
            short steps per second, do not show it. Dry friction and the hand's stiffness let 0.3 mm be expected.
        observation_std: of one measured configuration with this tracker [rad or m].
        start_std: uncertainty of the start [rad or m].
        tolerance: of the goal [rad or m].
        max_step: largest displacement per control step [rad or m].
        paper: mean and std of the final error that the paper reports [rad or m].
        unit: of all these.
    """

    model: Path
    truth: HybridAutomaton
    process_std: float
    observation_std: float
    start_std: float
    tolerance: float
    max_step: float
    paper: tuple[float, float]
    unit: str


@dataclass(frozen=True)
class Task:
    """From one configuration to another [rad or m]; `latched` where the object is held by its latch."""

    name: str
    start: float
    target: float
    starts_latched: bool = False
    ends_latched: bool = False


@dataclass(frozen=True)
class Row:
    """One line of the table; errors in the subject's unit, over all trials of a task."""

    task: str
    planned: bool
    trials: int
    successes: int
    error_mean: float
    error_std: float
    error_max: float
    steps: float
    replans: int
    solve_seconds: float
    seconds: float


DOOR_TASKS = (
    Task("shut from wide open", 0.0, DOOR_OPEN, ends_latched=True),
    Task("shut from half open", 0.6, DOOR_OPEN, ends_latched=True),
    Task("open wide", DOOR_OPEN, 0.2, starts_latched=True),
    Task("open a little", DOOR_OPEN, 0.8, starts_latched=True),
    Task("move further shut", 0.3, 0.9),
)
DRAWER_TASKS = (
    Task("open wide", 0.0, 0.25),
    Task("open a little", 0.0, 0.1),
    Task("open further", 0.08, 0.2),
    Task("shut nearly", 0.25, 0.02),
    Task("half shut", 0.22, 0.1),
)


def subjects() -> tuple[tuple[Subject, tuple[Task, ...]], ...]:
    """The two objects with their tasks."""
    door = Subject(ROOT / "models/microwave.yaml", microwave(), 0.003, 0.011, 0.03, 0.03, 0.12, (0.05, 0.01), "rad")
    slide = Subject(ROOT / "models/drawer.yaml", drawer(), 0.001, 0.003, 0.005, 0.005, 0.03, (0.005, 0.003), "m")
    return (door, DOOR_TASKS), (slide, DRAWER_TASKS)


def problem_of(subject: Subject, model: HybridAutomaton, task: Task) -> Problem:
    """The planning problem of a task on the learned model."""
    latched = next((mode for mode in model.modes if mode.pins), None)
    free = next(mode for mode in model.modes if not mode.pins)
    held = latched.pins[0].value if latched is not None else np.nan
    start = held if task.starts_latched else task.start
    target = held if task.ends_latched else task.target
    start_mode = latched if task.starts_latched and latched is not None else free
    end_mode = latched if task.ends_latched and latched is not None else free
    return Problem(
        automaton=replace(model, noise=Noise((subject.process_std,), (subject.observation_std,))),
        start=Start((start,), (subject.start_std,), start_mode.name),
        goal=Goal(((0, target, subject.tolerance),), (end_mode.name,)),
        settings=PlannerSettings(max_step=(subject.max_step,)),
    )


def true_start(subject: Subject, task: Task) -> Start:
    """Where trials start on the true object: drawn around the task's start, or latched."""
    pinned = next((mode for mode in subject.truth.modes if mode.pins), None)
    if task.starts_latched and pinned is not None:
        return Start((pinned.pins[0].value,), (0.0,), pinned.name)
    free = next(mode for mode in subject.truth.modes if not mode.pins)
    return Start((task.start,), (subject.start_std,), free.name)


def run_task(subject: Subject, model: HybridAutomaton, task: Task, trials: int, seed: int) -> Row:
    """Plan once, execute `trials` times."""
    problem = problem_of(subject, model, task)
    begin = perf_counter()
    plan = solve(problem, seed=seed)
    solved = perf_counter() - begin
    if plan.outcome != "solved":
        print(f"{task.name}: {plan.outcome}: {plan.reason}", file=sys.stderr)
        nothing = float("nan")
        return Row(task.name, False, trials, 0, nothing, nothing, nothing, nothing, 0, solved, 0.0)
    plant = StandingPlant(subject.truth, true_start(subject, task), PhysicalParameters.from_mapping(TRACKER))
    begin = perf_counter()
    statistics = run_trials(problem, plan, plant=plant, trials=trials, seed=seed)
    for trial, reason in statistics.failures:
        print(f"{task.name}, trial {trial}: {reason}", file=sys.stderr)
    error = statistics.final_error
    return Row(
        task=task.name,
        planned=True,
        trials=trials,
        successes=statistics.successes,
        error_mean=error.mean,
        error_std=error.std,
        error_max=error.max,
        steps=float(np.mean([result.steps for result in statistics.results])),
        replans=sum(result.replans for result in statistics.results),
        solve_seconds=solved,
        seconds=perf_counter() - begin,
    )


def table(subject: Subject, rows: Sequence[Row]) -> str:
    """The lines of one object's table, the paper's number beside ours."""
    unit = subject.unit
    header = f"{'task':24} {'success':>8} {f'final error [{unit}]':>20}"
    lines = [f"{header} {'max':>8} {'steps':>6} {'replans':>8} {'solve s':>8}"]
    for row in rows:
        error = f"{row.error_mean:.4f} +- {row.error_std:.4f}"
        counts = f"{row.successes}/{row.trials}"
        lines.append(
            f"{row.task:24} {counts:>8} {error:>20} {row.error_max:8.4f} {row.steps:6.1f} {row.replans:8d} "
            f"{row.solve_seconds:8.2f}"
        )
    means = np.array([row.error_mean for row in rows])
    done, trials = sum(row.successes for row in rows), sum(row.trials for row in rows)
    average = f"{means.mean():.4f} +- {means.std():.4f}"
    lines.append(f"{'average of the 5 tasks':24} {f'{done}/{trials}':>8} {average:>20}")
    mean, std = subject.paper
    lines.append(f"{'the paper':24} {'':>8} {f'{mean} +- {std}':>20}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="The paper's manipulation experiment in MuJoCo.")
    parser.add_argument("--trials", type=int, default=20, help="seeds per task")
    parser.add_argument("--seed", type=int, default=0)
    add_json(parser)
    options = parser.parse_args()
    results = {}
    for subject, tasks in subjects():
        model = load_model(subject.model)
        rows = [run_task(subject, model, task, options.trials, options.seed) for task in tasks]
        print(table(subject, rows), end="\n\n")
        results[subject.model.stem] = [asdict(row) for row in rows]
    save_json(results, options.json)


if __name__ == "__main__":
    main()
