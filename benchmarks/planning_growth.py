"""How planning grows with knots, dimensions and modes: seconds by stage and memory, one fresh process per case.

    python -m benchmarks planning_growth [--figure FILE.png] [--seed 0]

The model is a cabinet: doors that latch shut until they are pulled, which gives two modes each, and drawers. Knots: one
drawer with ever smaller steps. Dimensions: drawers that all open. Modes: six coordinates (or more), ever more of them
latched doors, one of which opens. The largest: six latched doors and six drawers, 64 modes, all twelve open.
"""

from __future__ import annotations

import argparse
import itertools
import json
import resource
import subprocess
import sys
from pathlib import Path

from processor_clock import time_by_processor

from micah_plan.api.stages import solve
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import Region, below, box, input_above
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

OPEN, TOLERANCE = 0.5, 0.05
STAGES = ("search", "build", "optimise", "verify")
# (what grows, its value, doors, drawers, how many open, steps to open)
CASES = (
    *(("knots", k, 0, 1, 1, k) for k in (10, 20, 40, 80, 160)),
    *(("dimensions", n, 0, n, n, 10) for n in (1, 2, 4, 8, 12)),
    *(("modes", 2**d, d, max(0, 6 - d), 1, 10) for d in (1, 2, 3, 4, 5, 6, 8, 10)),
    ("largest", 64, 6, 6, 12, 10),
)


def cabinet(doors: int, drawers: int) -> HybridAutomaton:
    """Doors that latch at 0 and drawers; a mode per subset of latched doors."""
    n = doors + drawers
    names = [f"door {i + 1}" for i in range(doors)] + [f"drawer {i + 1}" for i in range(drawers)]
    still = Joint("rigid", (0.0, 0.0, 0.0))
    modes, edges = [], []
    for latched in itertools.product((True, False), repeat=doors):
        free = [not shut for shut in latched] + [True] * drawers
        rows = tuple(tuple(float(i == j and free[i]) for j in range(n)) for i in range(n))
        pins = tuple(Pin(i, 0.0, 0.002) for i, shut in enumerate(latched) if shut)
        modes.append(Mode(_name(latched), (still,), rows, box([0.0] * n, [1.0] * n, n, names), Region(), pins))
        for i, shut in enumerate(latched):
            other = _name(tuple(not q if k == i else q for k, q in enumerate(latched)))
            pulled = input_above(i, 0.0, n, n, strict=True, name=f"input {names[i]}")
            guard = Region((pulled if shut else below(i, 0.0, n, n, name=names[i]),))
            edges.append(Edge(_name(latched), other, guard))
    coordinates = tuple(Coordinate(name, "m") for name in names)
    noise = Noise((0.002,) * n, (0.01,) * n)
    links = (Link("base", "body", 0),)
    return HybridAutomaton(coordinates, coordinates, links, (Part("body"),), tuple(modes), tuple(edges), noise)


def _name(latched: tuple[bool, ...]) -> str:
    return "".join("L" if shut else "o" for shut in latched) or "free"


def cabinet_problem(doors: int, drawers: int, opened: int, steps: int) -> Problem:
    """Open the first `opened` doors and drawers, in about so many steps."""
    automaton = cabinet(doors, drawers)
    n = automaton.n
    settings = PlannerSettings(max_step=(OPEN / steps / 0.6,) * n, max_knots=4 * steps + 40)
    start = Start((0.0 if doors else 0.05,) * n, (0.01,) * n, automaton.modes[0].name)
    return Problem(automaton, start, Goal(tuple((i, OPEN, TOLERANCE) for i in range(opened))), settings)


def measured(case: int, seed: int) -> dict[str, float | str]:
    """One case in this process: the processor's seconds by stage, knots, memory [MB] and what planning added to it."""
    time_by_processor()
    what, value, doors, drawers, opened, steps = CASES[case]
    # What loading the libraries takes is not counted: a first, tiny problem is solved before.
    solve(cabinet_problem(0, 1, 1, 5), seed=seed)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = solve(cabinet_problem(doors, drawers, opened, steps), seed=seed)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    knots = 0 if found.trajectory is None else len(found.trajectory.modes)
    times = {stage: found.timings.get(stage, 0.0) for stage in STAGES}
    shape = {"dimensions": doors + drawers, "modes": 2**doors, "knots": knots, "candidates": len(found.candidates)}
    outcome = {"success": found.success_probability or 0.0, "memory": peak, "added": peak - before}
    return {"grows": what, "value": value, "outcome": found.outcome, **shape, **times, **outcome}


def in_fresh_process(case: int, seed: int) -> dict[str, float | str]:
    command = [sys.executable, __file__, "--case", str(case), "--seed", str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603  # this very file
    row: dict[str, float | str] = json.loads(done.stdout)
    return row


def table(rows: list[dict[str, float | str]]) -> str:
    header = (
        f"{'grows':11} {'n':>3} {'modes':>5} {'knots':>5} {'outcome':8} {'tried':>5} {'search':>7} {'build':>7} "
        f"{'optim.':>7} {'verify':>7} {'success':>7} {'MB':>5} {'added':>6}"
    )
    lines = [header]
    for row in rows:
        times = " ".join(f"{row[stage]:7.3f}" for stage in STAGES)
        lines.append(
            f"{row['grows']:11} {row['dimensions']:3} {row['modes']:5} {row['knots']:5} {row['outcome']:8} "
            f"{row['candidates']:5} {times} {row['success']:7.3f} {row['memory']:5.0f} {row['added']:6.1f}"
        )
    return "\n".join(lines)


def save_figure(rows: list[dict[str, float | str]], file: Path) -> None:
    """Seconds by stage and memory over what grows, on logarithmic axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.4), layout="constrained")
    for axes, what in zip(figure.subplots(1, 3), ("knots", "dimensions", "modes"), strict=True):
        chosen = [row for row in rows if row["grows"] == what]
        for stage in STAGES:
            axes.loglog([row[what] for row in chosen], [row[stage] for row in chosen], "o-", label=stage)
        axes.set_xlabel(what)
        axes.set_xticks([row[what] for row in chosen], [str(row[what]) for row in chosen], minor=False)
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("seconds")
    figure.axes[0].legend()
    figure.savefig(file, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description="How planning grows with knots, dimensions and modes.")
    parser.add_argument("--figure", type=Path, help="also draw the growth into this file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, help="measure one case in this process and print it as JSON")
    options = parser.parse_args()
    if options.case is not None:
        print(json.dumps(measured(options.case, options.seed)))
        return
    rows = [in_fresh_process(case, options.seed) for case in range(len(CASES))]
    print(table(rows))
    if options.figure is not None:
        save_figure(rows, options.figure)


if __name__ == "__main__":
    main()
