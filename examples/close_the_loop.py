"""Plan, execute where more friction acts than the model knows, calibrate on the logs, plan and execute again.

    python examples/close_the_loop.py [drawer_open|microwave_close] [trials]

Needs the extra `sim` (MuJoCo).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from micah_plan.documents.problem import load_problem
from micah_plan.execution.trials import TrialStatistics, run_trials
from micah_plan.planning.solver import solve
from micah_plan.quantities import quantity, with_spread
from micah_plan.residual.calibrate import calibrate
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"
FRICTION = 25.0
"""Dry friction at the handle [N]; the hand yields by 3000 N/m."""


def executed(problem: Problem, plan: Plan, trials: int) -> TrialStatistics:
    """Runs in MuJoCo with the friction that no model knows."""
    rough = replace(problem, plant={**problem.plant, "friction": FRICTION})
    return run_trials(rough, plan, plant="mujoco", trials=trials)


def report(name: str, problem: Problem, statistics: TrialStatistics) -> None:
    """One line on the trials."""
    error = with_spread(statistics.final_error.mean, statistics.final_error.std, problem.goal_unit)
    print(f"{name}: {statistics.successes} of {statistics.trials} reach the goal, final error {error}")


def main(name: str = "drawer_open", trials: int = 8) -> None:
    problem = load_problem(PROBLEMS / f"{name}.yaml")
    first = executed(problem, solve(problem), trials)
    report("nominal model", problem, first)
    found = calibrate(problem.automaton, first.recording)
    print(f"calibration: {found.verdict}")
    for effect in found.effects:
        pairs = zip(effect.effect.parameters, effect.units, strict=True)
        values = ", ".join(f"{key} {quantity(value, unit)}" for (key, value), unit in pairs)
        print(f"  {effect.effect.name}: {values}" + (f" (or {', '.join(effect.tied)})" if effect.tied else ""))
    improved = replace(problem, automaton=found.automaton)
    report("calibrated model", improved, executed(improved, solve(improved), trials))


if __name__ == "__main__":
    main(*sys.argv[1:2], *map(int, sys.argv[2:3]))
