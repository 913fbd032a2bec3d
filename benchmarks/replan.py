"""Planning anew while a plan is being executed: what a control step has to wait for.

    python benchmarks/replan.py [PROBLEM.yaml ...] [--beliefs 6] [--seed 0] [--json FILE]

New plans are asked for from beliefs next to the knots of each plan, their means off by half of their stds at random.
Times are the median milliseconds of the processor of one answer: search, building and optimising the programme, and the
roll-outs that confirm it, as many as it takes (`turns`) or all that the settings ask for (`all`). `ratio` compares the
two answers as wholes; `alike` counts how often both say the same.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
from processor_clock import time_by_processor
from resolves import beside
from saving import add_json, save_json

from micah_plan.documents.problem import load_problem
from micah_plan.planning import pomdp_hd
from micah_plan.planning.input_memory import with_input_memory
from micah_plan.planning.tightening import Verifier, verified_plan
from micah_plan.planning.verification import verify
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Row:
    """One problem; milliseconds of the processor."""

    problem: str
    beliefs: int
    found: int
    plan: float
    turns: float
    all: float
    whole: float
    ratio: float
    trials: float
    alike: int


def answered(problem: Problem, seed: int, verifier: Verifier) -> tuple[Plan, float, float]:
    """The new plan, its seconds without roll-outs, and those of the roll-outs."""

    def planner(task: Problem, *, deadline: Deadline) -> Plan:
        return pomdp_hd.plan(task, seed, deadline=deadline)

    begin = process_time()
    found = verified_plan(problem, planner, seed, verifier=verifier)
    spent, verified = process_time() - begin, found.timings.get("verify", 0.0)
    return found, spent - verified, verified


def measure(path: Path, beliefs: int, seed: int) -> Row | None:
    """Both ways from the same beliefs; None if there is no plan."""
    problem = with_input_memory(load_problem(path))
    trajectory = pomdp_hd.plan(problem, seed).trajectory
    if trajectory is None:
        return None
    problem, rng = replace(problem, robot=None), np.random.default_rng(seed)
    steps = [k for k in range(1, len(trajectory.modes) - 1) if not trajectory.is_transition[k]]
    spent, trials, found, alike = [], [], 0, 0
    for k in np.linspace(0, len(steps) - 1, beliefs).astype(int).tolist():
        here = beside(problem, trajectory, steps[k], rng)
        quick, planned, turns = answered(here, seed, partial(verify, sequential=True))
        full, again, whole = answered(here, seed, verify)
        spent.append((planned, turns, whole, planned + turns, (planned + turns) / (again + whole)))
        trials.append(quick.verification_trials)
        found += quick.outcome == "solved"
        alike += quick.outcome == full.outcome
    plan, turns, full_time, whole, ratio = np.median(spent, axis=0).tolist()
    row = Row(path.stem, beliefs, found, plan, turns, full_time, whole, ratio, float(np.median(trials)), alike)
    return replace(row, **{name: 1e3 * getattr(row, name) for name in ("plan", "turns", "all", "whole")})


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="*", type=Path, help="default: all that the project ships")
    parser.add_argument("--beliefs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    add_json(parser)
    options = parser.parse_args(arguments)
    time_by_processor()
    rows = []
    heads = ("found", "plan ms", "turns ms", "all ms", "whole ms", "ratio", "trials", "alike")
    print(f"{'problem':24}" + "".join(f"{head:>10}" for head in heads))
    for path in options.problems or sorted((ROOT / "problems").glob("*.yaml")):
        row = measure(path, options.beliefs, options.seed)
        if row is None:
            print(f"{path.stem:24}  no plan")
            continue
        rows.append(row)
        times = f"{row.plan:10.0f}{row.turns:10.0f}{row.all:10.0f}{row.whole:10.0f}{row.ratio:10.2f}{row.trials:10.0f}"
        print(f"{row.problem:24}{row.found:>7}/{row.beliefs}{times}{row.alike:>8}/{row.beliefs}", flush=True)
    save_json([asdict(row) for row in rows], options.json)


if __name__ == "__main__":
    main()
