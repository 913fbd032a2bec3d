"""What `solve` and `explain` say of a plan."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from micah_plan.cli.console import out, print_files, print_lines
from micah_plan.planning.explain import Explanation, explain
from micah_plan.quantities import count, duration, percent, percent_interval, quantity
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem


def solved(plan: Plan) -> dict[str, Any]:
    """Keys of `solve`."""
    return {
        "outcome": plan.outcome,
        "reason": plan.reason,
        "modes": list(plan.mode_sequence),
        "cost": plan.cost,
        "goal_error": plan.goal_error,
        "goal_std": plan.goal_std,
        "success_probability": plan.success_probability,
        "success_interval": None if plan.success_interval is None else list(plan.success_interval),
        "verification_trials": plan.verification_trials,
        "findings": findings(plan),
        "warnings": list(plan.warnings),
        "arm": None
        if plan.arm is None
        else {
            "least_clearance": plan.arm.least_clearance,
            "closest_pair": list(plan.arm.closest_pair),
            "closest_knot": plan.arm.closest_knot,
            "least_manipulability": float(plan.arm.manipulability.min()),
            "deviation": plan.arm.deviation,
        },
        "seconds": dict(plan.timings),
        "seed": plan.seed,
    }


def findings(plan: Plan) -> list[dict[str, Any]]:
    """What stands in the way of a plan."""
    return [asdict(finding) for finding in plan.findings]


def explained(explanation: Explanation) -> dict[str, Any]:
    """Keys of `explain`."""
    return asdict(explanation)


def print_solved(plan: Plan, problem: Problem, files: tuple[Path | None, ...]) -> None:
    """Outcome and figures of a plan; of one that failed, what stands in the way."""
    solved = plan.outcome == "solved"
    out.print(f"{plan.outcome}: {plan.reason}", markup=False, style="green" if solved else "yellow")
    if not solved:
        print_lines(explain(problem, plan).lines[1:])
    if plan.trajectory is not None:
        _print_figures(plan, problem)
    named = ", ".join(f"{stage} {duration(seconds)}" for stage, seconds in plan.timings.items())
    out.print(f"  time         {named}")
    print_files(files)


def _print_figures(plan: Plan, problem: Problem) -> None:
    unit = problem.goal_unit
    out.print(f"  modes        {' -> '.join(plan.mode_sequence)}", markup=False)
    if plan.goal_error is not None and plan.goal_std is not None:
        distance = f"{quantity(plan.goal_error, unit)} from the target, σ {quantity(plan.goal_std, unit)}"
        out.print(f"  at the end   {distance}")
    if plan.success_probability is not None:
        share = f"{percent(plan.success_probability)} of {count(plan.verification_trials, 'roll-out')}"
        sure = "" if plan.success_interval is None else f" (95 % interval: {percent_interval(*plan.success_interval)})"
        out.print(f"  success      {share}{sure}")
