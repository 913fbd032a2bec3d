"""Planning now against planning at an earlier commit, in one run.

    python -m benchmarks against REVISION [PROBLEM.yaml ...] [--repeats 3] [--seed 0] [--json FILE]

Both states plan the same problems in turn, each in processes of its own with one thread, and the least of the repeats
counts. Times are milliseconds of the processor, before and after, with after : before.

    plan      search, transcription and optimisation
    verify    all roll-outs that the problem's settings ask for
    replan    a new plan during an execution, the mean over four beliefs beside knots of the plan
    command   `micah-plan solve`, start-up and import included

`alike`: outcome and modes are the same, cost and success probability to 1e-6.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import process_time
from typing import Any

from saving import add_json, save_json

ROOT = Path(__file__).resolve().parent.parent
STAGES = ("plan", "verify", "replan", "command")
# Where problems are read and new plans are made, newest place first.
PLACES = {
    "load_problem": ("micah_plan.documents.problem", "micah_plan.spec.problem_file"),
    "replan": ("micah_plan.planning.replanning", "micah_plan.planning.pomdp_hd"),
}


def found(name: str) -> Any:
    """A function of the state that is imported here, wherever it is in it."""
    for place in PLACES[name]:
        try:
            return getattr(importlib.import_module(place), name)
        except (ModuleNotFoundError, AttributeError):
            continue
    raise SystemExit(f"this commit has {name} in none of {', '.join(PLACES[name])}")


def measured_here(path: str, seed: int) -> dict[str, Any]:
    """What one state needs for one problem, by names that all states have; runs in a process of its own."""
    from micah_plan.belief.filter import initial_belief
    from micah_plan.planning import pomdp_hd, verification

    load, replan = found("load_problem"), found("replan")
    problem = load(Path(path))
    pomdp_hd.plan(problem, seed)  # libraries are loaded and functions compiled
    begin = process_time()
    first = pomdp_hd.plan(load(Path(path)), seed)
    spent = {"plan": process_time() - begin}
    if first.trajectory is None:
        return {"outcome": first.outcome, "modes": [], "cost": None, "success": None, **spent}
    begin = process_time()
    plan = verification.verify(problem, first, seed=seed)
    spent["verify"] = process_time() - begin
    way = first.trajectory
    knots = [k for k in range(1, len(way.modes) - 1) if not way.is_transition[k]]
    if way.means.shape[1] == problem.automaton.n:  # without a memory of inputs
        newest = "followed" in replan.__annotations__
        begin = process_time()
        for knot in [knots[i * (len(knots) - 1) // 3] for i in range(4)]:
            std = [math.sqrt(float(row @ row)) for row in way.factors[knot]]
            belief = initial_belief(problem.automaton, way.means[knot], std, way.modes[knot])
            replan(problem, belief, **({"followed": (way, knot)} if newest else {}))
        spent["replan"] = (process_time() - begin) / 4
    modes = list(first.mode_sequence)
    return {"outcome": plan.outcome, "modes": modes, "cost": plan.cost, "success": plan.success_probability, **spent}


def measured_in(tree: Path, problem: Path, seed: int) -> dict[str, Any]:
    """The same of the state in a folder, with the time of the command."""
    path = tree / "problems" / problem.name
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}

    def run(*arguments: str) -> tuple[str, float]:
        before = os.times()
        command = [sys.executable, *arguments]
        done = subprocess.run(command, env=environment, cwd=tree, capture_output=True, text=True)  # noqa: S603 - own code
        after = os.times()
        if done.returncode not in (0, 1):
            raise SystemExit(f"{tree}: {done.stderr.strip().splitlines()[-1]}")
        return done.stdout, sum(after[2:4]) - sum(before[2:4])

    with tempfile.TemporaryDirectory() as folder:
        command = ("-m", "micah_plan", "solve", str(path), "-o", f"{folder}/plan.json", "--seed", str(seed))
        spent = run(*command)[1]
    return {**json.loads(run(__file__, "--measure", str(path), str(seed))[0]), "command": spent}


def compared(problem: Path, trees: tuple[Path, Path], repeats: int, seed: int) -> dict[str, Any]:
    """One row: milliseconds before and after of each stage, and whether the answers are alike."""
    rounds = [tuple(measured_in(tree, problem, seed) for tree in trees) for _ in range(repeats)]
    before, after = rounds[0]
    alike = all(before[key] == after[key] for key in ("outcome", "modes"))
    for key in ("cost", "success"):
        pair = before[key], after[key]
        alike = alike and (pair[0] == pair[1] or (None not in pair and math.isclose(*pair, abs_tol=1e-6)))
    row: dict[str, Any] = {"problem": problem.stem, "alike": alike}
    for stage in STAGES:
        if stage in before and stage in after:
            row[stage] = [1e3 * min(answers[side][stage] for answers in rounds) for side in (0, 1)]
    return row


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", help="the commit to compare with")
    parser.add_argument("problems", nargs="*", type=Path, help="default: all that it had")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    add_json(parser)
    options = parser.parse_args(arguments)
    rows = []
    print(f"{'problem':24}" + "".join(f"{stage:>20}" for stage in STAGES) + f"{'alike':>8}")
    with tempfile.TemporaryDirectory() as folder:
        old = Path(folder) / "before"
        git = ("git", "-C", str(ROOT), "worktree")
        subprocess.run([*git, "add", "--quiet", "--detach", str(old), options.revision], check=True)  # noqa: S603 - git
        try:
            for problem in options.problems or sorted((old / "problems").glob("*.yaml")):
                row = compared(problem, (old, ROOT), options.repeats, options.seed)
                rows.append(row)
                cells = [row.get(stage) for stage in STAGES]
                texts = [f"{b:.0f} > {a:.0f}  {a / b:.2f}" if (b, a) != (0, 0) else "" for b, a in filter(None, cells)]
                print(
                    f"{row['problem']:24}" + "".join(f"{text:>20}" for text in texts) + f"{row['alike']!s:>8}",
                    flush=True,
                )
        finally:
            subprocess.run([*git, "remove", "--force", str(old)], check=True)  # noqa: S603 - git
    save_json(rows, options.json)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        print(json.dumps(measured_here(sys.argv[2], int(sys.argv[3]))))
    else:
        main()
