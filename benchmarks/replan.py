"""Planning anew while a plan is being executed: what a control step has to wait for.

    python -m benchmarks replan [PROBLEM.yaml ...] [--beliefs 6] [--seed 0] [--json FILE]

New plans are asked for from beliefs next to the knots of each plan, their means off by half of their stds at random.
Times are the median milliseconds of the processor of one answer: `rest`, as executions ask for it, through the modes
that the plan still leads through and confirmed by as many roll-outs as it takes; `searched`, the same without a plan
that was followed; `whole`, searched, and confirmed by all roll-outs that the settings ask for. `ratio` is rest to
whole; `alike` counts how often they agree whether there is a new plan.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from resolves import beside
from saving import add_json, save_json

from micah_plan.belief.filter import initial_belief
from micah_plan.documents.kind import kind_of
from micah_plan.documents.problem import load_problem
from micah_plan.planning import pomdp_hd, replanning
from micah_plan.planning.limits import with_input_memory
from micah_plan.planning.tightening import verified_plan
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Row:
    """One problem; milliseconds of the processor."""

    problem: str
    beliefs: int
    found: int
    rest: float
    searched: float
    whole: float
    ratio: float
    alike: int


def timed(answer: Callable[[], Trajectory | None]) -> tuple[bool, float]:
    """Whether there is a new plan, and the milliseconds that it took."""
    begin = process_time()
    return answer() is not None, 1e3 * (process_time() - begin)


def fully_verified(here: Problem, seed: int) -> Trajectory | None:
    """A new plan as `solve` makes it."""
    found = verified_plan(here, lambda task, deadline: pomdp_hd.plan(task, seed, deadline=deadline), seed)
    return found.trajectory if found.outcome == "solved" else None


def measure(path: Path, beliefs: int, seed: int) -> Row | None:
    """All ways from the same beliefs; None if there is no plan."""
    problem = with_input_memory(load_problem(path))
    trajectory = pomdp_hd.plan(problem, seed).trajectory
    if trajectory is None:
        return None
    problem, rng = replace(problem, robot=None), np.random.default_rng(seed)
    steps = [k for k in range(1, len(trajectory.modes) - 1) if not trajectory.is_transition[k]]
    rows = []
    for number in np.linspace(0, len(steps) - 1, beliefs).astype(int).tolist():
        here, knot = beside(problem, trajectory, steps[number], rng), steps[number]
        belief = initial_belief(here.automaton, here.start.mean, here.start.std, here.start.mode)
        rest = timed(lambda b=belief, k=knot: replanning.replan(problem, b, (trajectory, k), seed))
        searched = timed(lambda b=belief: replanning.replan(problem, b, seed=seed))
        whole = timed(lambda h=here: fully_verified(h, seed))
        rows.append(
            (*(spent for _, spent in (rest, searched, whole)), rest[1] / whole[1], rest[0], rest[0] == whole[0])
        )
    *medians, found, alike = (*np.median(rows, axis=0)[:4].tolist(), *np.sum(rows, axis=0)[4:].astype(int).tolist())
    return Row(path.stem, beliefs, found, *medians, alike)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="*", type=Path, help="default: all that the project ships")
    parser.add_argument("--beliefs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    add_json(parser)
    options = parser.parse_args(arguments)
    rows = []
    print(f"{'problem':24}{'found':>9}{'rest ms':>10}{'searched':>10}{'whole':>10}{'ratio':>10}{'alike':>10}")
    for path in options.problems or sorted(p for p in (ROOT / "problems").glob("*.yaml") if kind_of(p) == "problem"):
        row = measure(path, options.beliefs, options.seed)
        if row is None:
            print(f"{path.stem:24}  no plan")
            continue
        rows.append(row)
        times = f"{row.rest:10.0f}{row.searched:10.0f}{row.whole:10.0f}{row.ratio:10.2f}"
        print(f"{row.problem:24}{row.found:>7}/{row.beliefs}{times}{row.alike:>8}/{row.beliefs}", flush=True)
    save_json([asdict(row) for row in rows], options.json)


if __name__ == "__main__":
    main()
