"""Planning over all problems by all planners: times, cost, the true state at the end, success predicted and observed.

    python -m benchmarks planning [PROBLEM.yaml ...] [--planners pomdp-hd direct rrt] [--trials 1000] [--executions 0]
                                  [--users 0] [--seed 0] [--jobs 1] [--json FILE]

`cost` is what POMDP-HD minimises (goal error, final variance, effort), computed alike for all planners.

`predicted` is the success probability in the plan, from roll-outs of its own seed. `observed` is the share of fresh
roll-outs with other seeds whose true state ends in the goal; goal error and std are of the true state in them.
`believed` is the mean probability of the goal in the filters' last beliefs, which do not see the truth: if the belief
is calibrated, it is what is observed. `executed` is the share in closed loop with poses, the stop rule and replanning
on the nominal plant; it may exceed the others, because it goes on until the goal is believed reached. `at stop` is the
mean probability of the goal that these executions believed in when they stopped.

With `--users N` a second table compares POMDP-HD with two programmes that a user would write (`user_code`) on N true
objects each, `open loop` and `filter`; beside them the plan followed as it is (`plan`) and executed with new plans
where it fails (`executed`).

Times are seconds of the processor, so that they do not depend on what else the machine does; for the same reason the
planners get more wall-clock time than they need. Jobs are processes; each solves a small problem first, so that loading
libraries is not counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time

import baseline_direct
import baseline_rrt
import numpy as np
from processor_clock import time_by_processor
from saving import add_json, save_json
from user_code import Reader, chances_for, filtered, open_loop, share_in_goal

from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.documents.kind import kind_of
from micah_plan.documents.problem import load_problem
from micah_plan.execution.closed_loop import goal_probability
from micah_plan.execution.trials import run_trials
from micah_plan.planning.findings import explain
from micah_plan.planning.limits import limits_of
from micah_plan.planning.plan_cost import cost_of
from micah_plan.planning.roll_outs import RollOuts, are_in_goal, draw_chances, roll_out
from micah_plan.planning.solver import solve
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem

ROOT = Path(__file__).resolve().parent.parent
PLANNERS = {"pomdp-hd": None, "direct": baseline_direct.plan, "rrt": baseline_rrt.plan}
# Added to the seed for the observed roll-outs, so that none of the plan's own are counted again.
FRESH = 10_000
# Of solving [s]: far more than is needed.
TIME_LIMIT_S = 3600.0


@dataclass(frozen=True)
class Row:
    """One problem; times in s, goal error (mean of the largest over the goal's coordinates) and std in their unit."""

    problem: str
    planner: str
    outcome: str
    modes: str
    search: float
    build: float
    optimise: float
    verify: float
    cost: float | None = None
    goal_error: float | None = None
    goal_std: float | None = None
    predicted: float | None = None
    observed: float | None = None
    believed: float | None = None
    executed: float | None = None
    at_stop: float | None = None
    roll_out_seconds: float | None = None
    reason: str = ""

    @property
    def difference(self) -> float | None:
        return None if self.predicted is None or self.observed is None else self.observed - self.predicted


def warm_up() -> None:
    """Load what planners load when they are first used, and let them time themselves by the processor."""
    time_by_processor()
    for planner in PLANNERS.values():
        solve(load_problem(ROOT / "problems" / "drawer_open.yaml"), planner=planner)


def measure(path: Path, planner: str, trials: int, executions: int, seed: int) -> Row:
    """Solve a problem by a planner, and roll the plan out with fresh seeds."""
    problem = load_problem(path, {"planner.solve_time_limit_s": TIME_LIMIT_S})
    plan = solve(problem, seed=seed, advise=False, planner=PLANNERS[planner])
    times = plan.timings
    basis = Row(
        problem=path.stem,
        planner=planner,
        outcome=plan.outcome,
        modes=" > ".join(plan.mode_sequence),
        search=times.get("search", 0.0),
        build=times.get("build", 0.0),
        optimise=times.get("optimise", 0.0),
        verify=times.get("verify", 0.0),
    )
    if plan.trajectory is None:
        findings = explain(problem, plan).findings
        return replace(basis, reason=findings[0].sentence if findings else plan.reason)
    begin = process_time()
    ends = roll_out(problem, plan.trajectory, draw_chances(problem, plan.trajectory, trials, FRESH + seed))
    spent = process_time() - begin
    error, std = goal_statistics(pre_release_problem(problem), ends)
    executed, at_stop = executed_success(problem, plan, executions, FRESH + seed)
    return replace(
        basis,
        cost=cost_of(pre_release_problem(problem), limits_of(problem), plan.trajectory),
        goal_error=error,
        goal_std=std,
        predicted=plan.success_probability,
        observed=float(are_in_goal(problem, ends).mean()),
        believed=believed_success(pre_release_problem(problem), ends),
        executed=executed,
        at_stop=at_stop,
        roll_out_seconds=spent,
    )


@dataclass(frozen=True)
class UserRow:
    """Shares of true objects that end in the goal of a problem; None: not tried."""

    problem: str
    open_loop: float
    filter: float
    plan: float | None
    executed: float | None


def measure_users(path: Path, trials: int, seed: int) -> UserRow | None:
    """What users' programmes and the planner make of a problem; None if there is nothing to write."""
    problem = load_problem(path)
    reader = Reader(problem)
    if not reader.can_move():
        return None
    chances = chances_for(reader, trials, FRESH + seed)
    plan = solve(problem, seed=seed, advise=False)
    found = None
    if plan.trajectory is not None:
        ends = roll_out(problem, plan.trajectory, draw_chances(problem, plan.trajectory, trials, FRESH + seed))
        found = float(are_in_goal(problem, ends).mean())
    return UserRow(
        problem=path.stem,
        open_loop=share_in_goal(problem, *open_loop(reader, chances)),
        filter=share_in_goal(problem, *filtered(reader, chances)),
        plan=found,
        executed=executed_success(problem, plan, trials, FRESH + seed)[0],
    )


def user_table(rows: Sequence[UserRow]) -> str:
    """One line per problem."""
    lines = [f"{'problem':22} {'open loop':>9} {'filter':>9} {'plan':>9} {'executed':>9}"]
    for row in rows:
        shares = (row.open_loop, row.filter, row.plan, row.executed)
        lines.append(f"{row.problem:22} " + " ".join(_text(share, 9, 3) for share in shares))
    return "\n".join(lines)


def goal_statistics(problem: Problem, ends: RollOuts) -> tuple[float, float]:
    """Mean of the largest true distance from the targets, and the largest std of a true goal coordinate."""
    target = problem.goal.target
    if not target:
        return 0.0, 0.0
    errors = np.abs(np.stack([ends.states[:, i] - value for i, value, _ in target]))
    return float(errors.max(axis=0).mean()), float(max(ends.states[:, i].std() for i, _, _ in target))


def believed_success(problem: Problem, ends: RollOuts) -> float:
    """Mean probability of the goal in the last beliefs."""
    beliefs = zip(ends.beliefs.weights, ends.beliefs.means, ends.beliefs.factors, strict=True)
    return float(np.mean([goal_probability(problem.automaton, problem.goal, HybridBelief(*one)) for one in beliefs]))


def executed_success(problem: Problem, plan: Plan, trials: int, seed: int) -> tuple[float | None, float | None]:
    """Share of closed-loop executions on the nominal plant that end in the goal, and what they believe it to be."""
    if trials < 1 or plan.outcome != "solved":
        return None, None
    found = run_trials(problem, plan, trials=trials, seed=seed)
    return found.successes / trials, float(np.mean([result.confidence for result in found.results]))


def table(rows: Sequence[Row]) -> str:
    """All problems, one line each."""
    header = (
        f"{'problem':22} {'planner':9} {'outcome':13} {'search':>7} {'build':>7} {'optim.':>7} {'verify':>7} "
        f"{'cost':>8} {'error':>8} {'std':>8} {'predicted':>10} {'observed':>9} {'believed':>9} "
        f"{'executed':>9} {'at stop':>8}"
    )
    lines = [header]
    for row in rows:
        times = " ".join(f"{t:7.3f}" for t in (row.search, row.build, row.optimise, row.verify))
        shares = f"{_text(row.predicted, 10, 3)} {_text(row.observed, 9, 3)} {_text(row.believed, 9, 3)}"
        numbers = f"{_text(row.cost, 8, 3)} {_text(row.goal_error, 8, 4)} {_text(row.goal_std, 8, 4)}"
        lines.append(
            f"{row.problem:22} {row.planner:9} {row.outcome:13} {times} {numbers} {shares} "
            f"{_text(row.executed, 9, 3)} {_text(row.at_stop, 8, 3)}"
        )
        lines += [f"{'':22} {row.reason}"] if row.reason else []
    differences = [abs(row.difference) for row in rows if row.difference is not None]
    if differences:
        lines.append(f"largest difference of predicted and observed success: {max(differences):.3f}")
    return "\n".join(lines)


def _text(value: float | None, width: int, digits: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:{width}.{digits}f}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Planning over all problems.")
    parser.add_argument("problems", nargs="*", type=Path, help="default: all of problems/")
    parser.add_argument("--trials", type=int, default=1000, help="fresh roll-outs per problem")
    parser.add_argument("--executions", type=int, default=0, help="closed-loop executions per problem")
    parser.add_argument("--users", type=int, default=0, help="true objects of the comparison with users' programmes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    add_json(parser)
    planners = list(PLANNERS)
    parser.add_argument("--planners", nargs="*", choices=planners, default=planners)
    options = parser.parse_args()
    paths = options.problems or sorted(p for p in (ROOT / "problems").glob("*.yaml") if kind_of(p) == "problem")
    cases = [(path, planner) for path in paths for planner in options.planners]
    one = partial(measure, trials=options.trials, executions=options.executions, seed=options.seed)
    with ProcessPoolExecutor(options.jobs, initializer=warm_up) as pool:
        rows = list(pool.map(one, *zip(*cases, strict=True))) if cases else []
        users = pool.map(
            partial(measure_users, trials=options.users, seed=options.seed), paths if options.users else []
        )
        against = [row for row in users if row is not None]
    print("\n\n".join([*([table(rows)] if rows else []), *([user_table(against)] if against else [])]))
    values = [{**asdict(row), "difference": row.difference} for row in rows]
    save_json([*values, *map(asdict, against)], options.json)


if __name__ == "__main__":
    main()
