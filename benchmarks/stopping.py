"""Whether executions that stop are in the goal as often as they believe; and the walled domain in closed loop.

    python -m benchmarks stopping [--trials 120] [--walled 100] [--seed 0]

First table: a low confidence and goals made smaller, so that failures are frequent enough to count. Of the executions
that stop because they believe to be in the goal: the mean probability that they believe in, and the share that is
there; `excess` is the difference in standard deviations of a count with those probabilities.

Second: the walled domain from the paper's true start, and from starts drawn from the belief; replans included.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from micah_plan.documents.problem import load_problem
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.trials import TrialStatistics, run_trials
from micah_plan.planning.solver import solve
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

PROBLEMS = Path(__file__).resolve().parent.parent / "problems"
CONFIDENCE = 0.7
# Shares of the problems' tolerances.
SMALLER = {"microwave_close": 1.0, "microwave_open": 0.4, "light_dark": 0.5}
PAPERS_START = (35.0, 20.0)


def with_smaller_goal(name: str, share: float) -> Problem:
    """A problem with so much of its goal's tolerance, and the low confidence."""
    problem = load_problem(PROBLEMS / f"{name}.yaml")
    target = tuple((i, value, share * tolerance) for i, value, tolerance in problem.goal.target)
    settings = replace(problem.settings, confidence=CONFIDENCE)
    return replace(problem, goal=replace(problem.goal, target=target), settings=settings)


def executed(problem: Problem, trials: int, seed: int, start: Start | None = None) -> TrialStatistics:
    """Executions on the nominal plant, from starts drawn from the belief or from another one."""
    plan = solve(problem, seed=seed)
    plant = NominalPlant(problem.automaton, start or problem.start)
    return run_trials(problem, plan, plant=plant, trials=trials, seed=seed)


def stop_rule(name: str, share: float, trials: int, seed: int) -> str:
    """A line of the first table."""
    found = executed(with_smaller_goal(name, share), trials, seed).results
    stopped = [result for result in found if result.confidence >= CONFIDENCE]
    believed, there = (np.array(column) for column in zip(*((r.confidence, r.success) for r in stopped), strict=True))
    excess = (there.sum() - believed.sum()) / np.sqrt((believed * (1.0 - believed)).sum())
    shares = f"{believed.mean():8.3f} {there.mean():8.3f} {excess:+7.1f}"
    return f"{name:18} {share:9.1f} {len(stopped):5} of {trials:<5} {shares}"


def walled(trials: int, seed: int) -> list[str]:
    """The second table."""
    problem = load_problem(PROBLEMS / "walled_domain.yaml")
    starts = {"the paper's": Start(PAPERS_START, (0.0, 0.0), "free"), "drawn": problem.start}
    lines = [
        f"{'true start':18} {'in the goal':>12} {'error < 2 m':>12} {'mean error':>11} {'largest':>8} {'replans':>8}"
    ]
    for name, start in starts.items():
        found = executed(problem, trials, seed, start)
        errors = np.array([np.linalg.norm(result.final_x[:2]) for result in found.results])
        replans = sum(result.replans for result in found.results)
        lines.append(
            f"{name:18} {found.successes:5} of {trials:3} {int((errors < 2.0).sum()):5} of {trials:3} "
            f"{errors.mean():11.2f} {errors.max():8.2f} {replans:8}"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description="The stop rule, and the walled domain in closed loop.")
    parser.add_argument("--trials", type=int, default=120, help="executions per problem of the first table; 0: none")
    parser.add_argument("--walled", type=int, default=100, help="executions per start of the second; 0: none")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.trials:
        print(f"{'problem':18} {'tolerance':>9} {'stopped':>14} {'believed':>8} {'there':>8} {'excess':>7}")
        for name, share in SMALLER.items():
            print(stop_rule(name, share, options.trials, options.seed), flush=True)
    if options.walled:
        print("\n".join(walled(options.walled, options.seed)))


if __name__ == "__main__":
    main()
