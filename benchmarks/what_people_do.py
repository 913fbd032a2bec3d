"""Problems that a person does without looking, and ways through random boxes: solved, predicted, executed, CPU.

    OMP_NUM_THREADS=1 python -m benchmarks what_people_do [--seeds K] [--executions N] [--fields F]

The problems are those of `tests/planning/test_executed_inputs.py` (speeds that spill or break, a lid that falls,
springs at stops, plates thinner than the belief, gates, belts, windows in plates) and fields of 64 random boxes
(`test_fields_of_boxes.py`), each with a way that is 30 mm wide on a grid. Nothing of them is tuned to its seed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from time import process_time

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests" / "planning")]

import test_executed_inputs as people  # noqa: E402
import test_fields_of_boxes as fields  # noqa: E402

from micah_plan.execution.trials import run_trials  # noqa: E402
from micah_plan.planning.solver import solve  # noqa: E402
from micah_plan.task.problem import Problem  # noqa: E402


def row(name: str, problems: list[tuple[Problem, int]], executions: int) -> str:
    """One line of the table: a problem and its seeds."""
    solved, seconds, predicted, executed = 0, 0.0, list[float](), 0
    for problem, seed in problems:
        begin = process_time()
        answer = solve(problem, seed=seed, advise=False)
        seconds += process_time() - begin
        if answer.outcome != "solved":
            continue
        solved += 1
        predicted.append(answer.success_probability or 0.0)
        executed += run_trials(problem, answer, trials=executions, seed=seed + 1).successes if executions else 0
    among = f"{min(predicted):.3f} to {max(predicted):.3f}" if predicted else "-"
    done = f"{executed} of {executions * solved}" if executions else "-"
    return f"{name:<12}{solved:>4} of {len(problems):<4}{among:>18}{done:>14}{seconds / len(problems):>10.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--executions", type=int, default=100)
    parser.add_argument("--fields", type=int, default=20)
    asked = parser.parse_args()
    print(f"{'problem':<12}{'solved':>11}{'predicted':>18}{'executed':>14}{'seconds':>10}")
    with tempfile.TemporaryDirectory() as folder:
        for name, texts in people.SOLVABLE.items():
            problem = people._problem(Path(folder), texts)
            print(row(name, [(problem, seed) for seed in range(asked.seeds)], asked.executions), flush=True)
        drawn = [(seed, fields._boxes(64, seed)) for seed in range(4 * asked.fields)]
        open_ones = [(seed, boxes) for seed, boxes in drawn if fields._has_way(boxes, fields.SURE)][: asked.fields]
        of_boxes = [(fields._field(Path(folder), boxes), seed) for seed, boxes in open_ones]
        if of_boxes:
            print(row("64 boxes", of_boxes, min(asked.executions, 20)), flush=True)


if __name__ == "__main__":
    main()
