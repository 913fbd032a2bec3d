"""Held objects put where they can only go by contact: plans and executions of three solvers in one table.

    python -m benchmarks placements [PROBLEM.yaml ...] [--trials 100] [--nominal 20] [--seed 1000] [--jobs 2]
                                    [--solvers contact no-contact rrt] [--json FILE]

`contact` is the planner as it is; `no-contact` is the same planner, but the object may touch nothing; `rrt` is the
kinodynamic RRT with as much time as `contact` took in all, its inputs with the same feedback around them. `predicted`
is the share of roll-outs in the model, `model` counts executions in closed loop on the nominal plant, `MuJoCo` those in
physics. One execution has the seed `--seed` plus its number. An execution succeeds if the hand truly ends within the
goal's tolerances and nothing was hit (a push on a body that may not be touched, or a contact deeper than 2 mm);
`latched` counts the successes in physics whose joint is latched. Failures are told one by one below their row.
"""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import baseline_rrt
from saving import add_json, save_json

from micah_plan.documents.plan import StoredPlan, load_plan, write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve
from micah_plan.task.problem import Problem

ROOT = Path(__file__).resolve().parent.parent
HELD = ("stapler_on_books", "foot_under_shelf", "box_under_bar", "stapler_in_shaft")
SOLVERS = ("contact", "no-contact", "rrt")


@dataclass(frozen=True)
class End:
    """How one execution ended."""

    seed: int
    success: bool
    latched: bool
    replans: int
    reason: str


@dataclass(frozen=True)
class Row:
    """One problem by one solver: process time [s] and wall time [s] of `solve`, executions in the model, in MuJoCo."""

    problem: str
    solver: str
    outcome: str
    seconds: float
    wall: float
    predicted: float | None
    reason: str
    model: tuple[End, ...] = ()
    physics: tuple[End, ...] = ()


def problem_for(path: Path, solver: str, seconds: float) -> Problem:
    """The problem as a solver gets it; `seconds` is what the RRT may take."""
    if solver == "no-contact":
        return load_problem(path, {"hold.contacts": []})
    if solver == "rrt":
        return load_problem(path, {"planner.solve_time_limit_s": seconds})
    return load_problem(path)


@cache
def stored(path: Path) -> StoredPlan:
    """A plan file, read once per process."""
    return load_plan(path)


def executed(path: Path, plant: str, seed: int) -> End:
    """One execution of a plan file. The RRT's plans are followed as they are, verified or not, and not replanned."""
    problem, plan = stored(path).problem, stored(path).plan
    asked, replans = replace(plan, outcome="solved"), path.stem != "rrt"
    result = run_trials(problem, asked, plant=plant, trials=1, seed=seed, replans=replans).results[0]
    held = {mode.name for mode in problem.automaton.modes if mode.pins}
    return End(seed, result.success, result.final_mode in held, result.replans, result.reason)


def measure(path: Path, solver: str, seconds: float, asked: argparse.Namespace, pool: ProcessPoolExecutor) -> Row:
    """Solve by one solver, and execute what it found."""
    problem, began = problem_for(path, solver, seconds), process_time()
    plan = solve(problem, planner=baseline_rrt.plan if solver == "rrt" else None)
    spent, wall = process_time() - began, plan.timings["total"]
    row = Row(path.stem, solver, plan.outcome, spent, wall, plan.success_probability, plan.reason.replace("\n", " "))
    if plan.trajectory is None:
        return row
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"{solver}.json"
        write_plan(plan, problem, file)
        model, physics = (
            tuple(pool.map(partial(executed, file, plant), range(asked.seed, asked.seed + count)))
            for plant, count in (("nominal", asked.nominal), ("mujoco", asked.trials))
        )
    return replace(row, model=model, physics=physics)


def lines(row: Row) -> list[str]:
    """The row and its failures."""
    counts = [
        f"{sum(end.success for end in ends)} of {len(ends)}" if ends else "-" for ends in (row.model, row.physics)
    ]
    latched = sum(end.success and end.latched for end in row.physics)
    predicted = "-" if row.predicted is None else f"{row.predicted:.3f}"
    replans = sum(end.replans > 0 for end in row.physics)
    found = [
        f"{row.problem:18} {row.solver:11} {row.outcome:13} {row.seconds:7.1f} {predicted:>9} "
        f"{counts[0]:>10} {counts[1]:>11} {latched:>8} {replans:>10}"
    ]
    found += [] if row.outcome == "solved" else [f"    {row.reason}"]
    for place, ends in (("model", row.model), ("MuJoCo", row.physics)):
        found += [f"    {place} {end.seed}: {end.reason}" for end in ends if not end.success]
    return found


HEADER = (
    f"{'problem':18} {'solver':11} {'outcome':13} {'seconds':>7} {'predicted':>9} {'model':>10} {'MuJoCo':>11} "
    f"{'latched':>8} {'replanned':>10}"
)


def table(paths: Sequence[Path], asked: argparse.Namespace) -> list[dict[str, Any]]:
    """Print the rows as they come, and return them as plain values."""
    rows = []
    print(HEADER, flush=True)
    # Fresh processes: a fork of one that has run several threads can hang.
    with ProcessPoolExecutor(asked.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for path in paths:
            seconds = 60.0
            for solver in asked.solvers:
                row = measure(path, solver, seconds, asked, pool)
                seconds = row.wall if solver == "contact" else seconds
                print("\n".join(lines(row)), flush=True)
                rows.append(asdict(row))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description="Placements of held objects.")
    parser.add_argument("problems", nargs="*", type=Path, help="default: all held problems of problems/")
    parser.add_argument("--trials", type=int, default=100, help="executions in MuJoCo")
    parser.add_argument("--nominal", type=int, default=20, help="executions on the nominal plant")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--solvers", nargs="*", choices=SOLVERS, default=SOLVERS)
    add_json(parser)
    asked = parser.parse_args()
    rows = table(asked.problems or [ROOT / "problems" / f"{name}.yaml" for name in HELD], asked)
    save_json(rows, asked.json)


if __name__ == "__main__":
    main()
