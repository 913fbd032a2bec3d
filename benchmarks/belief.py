"""Processor time of the hybrid filter along plans: over many roll-outs at once, and for one belief alone.

    python -m benchmarks belief [PROBLEM.yaml ...] [--trials 1000] [--seed 0] [--repeats 5] [--json FILE]

Every problem is planned, its plan is rolled out that many times, and what the filter was told then is told to it again:
once to all beliefs together, once to the first one alone. Times are of the processor, per step of the plan (set
OMP_NUM_THREADS=1 for one core), the least of the repeats, for a busy machine slows all. `share` is the filter's part of
the roll-outs' time.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from saving import add_json, save_json

from micah_plan.belief.filter import initial_belief, predict, repeated, update
from micah_plan.belief.hybrid_belief import BeliefBatch, HybridBelief
from micah_plan.documents.problem import load_problem
from micah_plan.planning import pomdp_hd, roll_outs
from micah_plan.planning.limits import with_input_memory
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem

ROOT = Path(__file__).resolve().parent.parent
DEFAULT = [ROOT / "problems" / f"{name}.yaml" for name in ("walled_domain", "microwave_close", "stapler_on_books")]
Told = list[tuple[str, np.ndarray]]
"""What the filter was told one after the other: "predict" and inputs (t, m), or "update" and measurements (t, n)."""


@dataclass(frozen=True)
class Row:
    """One problem; times in ms per step, those alone of one belief.

    Attributes:
        states: of the filter, uncertain boundaries and memories of inputs included.
        share: of the roll-outs' time that the filter takes.
    """

    problem: str
    modes: int
    states: int
    steps: int
    predict_ms: float
    update_ms: float
    share: float
    predict_alone_ms: float
    update_alone_ms: float


@contextmanager
def overheard(told: Told) -> Iterator[None]:
    """Keeps what roll-outs tell their filter."""
    own = {"predict": roll_outs.predict, "update": roll_outs.update}

    def listening(name: str) -> Callable[..., Any]:
        def call(automaton: object, beliefs: BeliefBatch, values: np.ndarray) -> BeliefBatch:
            told.append((name, values.copy()))
            return own[name](automaton, beliefs, values)

        return call

    vars(roll_outs).update({name: listening(name) for name in own})
    try:
        yield
    finally:
        vars(roll_outs).update(own)


def replayed(problem: Problem, mode: str, told: Told, alone: bool) -> dict[str, float]:
    """Seconds that all predictions, and all updates, take; `alone`: those of the first belief."""
    known = with_input_memory(problem)
    belief: HybridBelief | BeliefBatch
    belief = initial_belief(known.automaton, known.start.mean, known.start.std, mode)
    if not alone:
        belief = repeated(known.automaton, belief, len(told[0][1]))
    seconds = {"predict": 0.0, "update": 0.0}
    for name, values in told:
        begin = process_time()
        belief = (predict if name == "predict" else update)(known.automaton, belief, values[0] if alone else values)
        seconds[name] += process_time() - begin
    return seconds


def row_of(name: str, problem: Problem, trajectory: Trajectory, trials: int, seed: int, repeats: int) -> Row:
    """All times of one plan."""
    told: Told = []
    chances = roll_outs.draw_chances(problem, trajectory, trials, seed)
    with overheard(told):
        ends = roll_outs.roll_out(problem, trajectory, chances)
    whole, least = np.inf, dict[tuple[bool, str], float]()
    for _ in range(repeats):
        begin = process_time()
        roll_outs.roll_out(problem, trajectory, chances)
        whole = min(whole, process_time() - begin)
        for alone in (False, True):
            for call, seconds in replayed(problem, trajectory.modes[0], told, alone).items():
                least[alone, call] = min(least.get((alone, call), np.inf), seconds)
    steps = sum(call == "predict" for call, _ in told)
    of = {key: 1e3 * seconds / steps for key, seconds in least.items()}
    share = (least[False, "predict"] + least[False, "update"]) / whole
    _, q, size = ends.beliefs.joint_means.shape
    together, single = (of[False, "predict"], of[False, "update"]), (of[True, "predict"], of[True, "update"])
    return Row(name, q, size, steps, *together, share, *single)


def table(rows: list[Row], trials: int) -> str:
    """All problems, one line each."""
    lines = [
        f"{'':24}{'':22}{f'{trials} beliefs, ms per step':>32}{'one belief, ms per step':>26}",
        f"{'problem':24}{'modes':>6}{'states':>8}{'steps':>8}{'predict':>12}{'update':>10}{'share':>10}"
        f"{'predict':>16}{'update':>10}",
    ]
    lines += [
        f"{r.problem:24}{r.modes:6d}{r.states:8d}{r.steps:8d}{r.predict_ms:12.2f}{r.update_ms:10.2f}{r.share:10.0%}"
        f"{r.predict_alone_ms:16.3f}{r.update_alone_ms:10.3f}"
        for r in rows
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="*", type=Path, default=DEFAULT)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=5)
    add_json(parser)
    arguments = parser.parse_args()
    rows = []
    for file in arguments.problems:
        problem = load_problem(file)
        plan = pomdp_hd.plan(problem, arguments.seed)
        if plan.trajectory is None:
            print(f"{file.stem}: {plan.reason}")
            continue
        options = arguments.trials, arguments.seed, arguments.repeats
        rows.append(row_of(file.stem, problem, plan.trajectory, *options))
    print(table(rows, arguments.trials))
    save_json([asdict(row) for row in rows], arguments.json)


if __name__ == "__main__":
    main()
