"""Optimising the rest of a plan again: with the programme kept, and with a new one each time.

    python -m benchmarks resolves [PROBLEM.yaml ...] [--beliefs 10] [--sequences] [--seed 0] [--json FILE]

The rest of each plan is optimised from beliefs next to it, their means off by half of their stds at random. `new` and
`kept` are the median seconds of the processor of one answer, feedback left out; `first` builds what is kept.
Solutions are compared by what they cost: `dearer` is the largest excess of the kept programme's answer.

`--sequences` asks instead whether candidates should start from each other: the iterations over all mode sequences whose
first modes another one before has gone through in as many steps, from their own search paths and from its optimum.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from planning_growth import cabinet_problem
from saving import add_json, save_json

from micah_plan.documents.kind import kind_of
from micah_plan.documents.problem import load_problem
from micah_plan.planning.limits import NoWayError, limits_of, with_input_memory, without_input_memory
from micah_plan.planning.path_constraints import cost_of
from micah_plan.planning.pomdp_hd import plan, trajectory_of, with_memory
from micah_plan.planning.replanning import RecedingHorizon, from_new
from micah_plan.planning.search.mode_search import search_modes
from micah_plan.planning.transcription.corridor import pack
from micah_plan.planning.transcription.guess import PhaseGuess, guess
from micah_plan.planning.transcription.programme import transcribe
from micah_plan.planning.transcription.solve import BeliefPath, solve
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start, start_mode

ROOT = Path(__file__).resolve().parent.parent
OFF = 0.5


@dataclass(frozen=True)
class Row:
    """One problem; seconds, iterations of IPOPT, and how many rests either way found."""

    problem: str
    knots: int
    beliefs: int
    new_found: int
    kept_found: int
    new: float
    kept: float
    first: float
    new_iterations: float
    kept_iterations: float
    dearer: float


def beside(problem: Problem, trajectory: Trajectory, knot: int, rng: np.random.Generator) -> Problem:
    """The problem with its start beside a knot of a plan."""
    mode, stds = trajectory.modes[knot], np.linalg.norm(trajectory.factors[knot], axis=1)
    moves = problem.automaton.mode(mode).B.any(axis=1)
    mean = trajectory.means[knot] + OFF * stds * moves * rng.standard_normal(len(stds))
    return replace(problem, start=Start(tuple(map(float, mean)), tuple(map(float, stds)), mode))


def timed(answer: Callable[[], BeliefPath]) -> tuple[BeliefPath, float]:
    begin = process_time()
    return answer(), process_time() - begin


def measure(path: Path, beliefs: int, seed: int) -> Row | None:
    """Both ways from the same beliefs; None if there is no plan."""
    problem = with_input_memory(load_problem(path))
    trajectory = plan(problem, seed).trajectory
    if trajectory is None:
        return None
    rng, limits, last = np.random.default_rng(seed), limits_of(problem), len(trajectory.modes) - 1
    horizon = RecedingHorizon(problem, trajectory)
    start = beside(problem, trajectory, 1, rng)
    first = timed(lambda: horizon.from_plan(start.start, trajectory, 1))[1]
    from_new(start, trajectory, 1)
    new, kept, dearer = [], [], []
    for knot in np.linspace(1, last - 1, beliefs).astype(int).tolist():
        here = beside(problem, trajectory, knot, rng)
        new.append(timed(lambda here=here, knot=knot: from_new(here, trajectory, knot)))  # type: ignore[misc]
        kept.append(timed(lambda here=here, knot=knot: horizon.from_plan(here.start, trajectory, knot)))  # type: ignore[misc]
        if new[-1][0].feasible and kept[-1][0].feasible:
            costs = [cost_of(here, limits, trajectory_of(here, limits, found[-1][0])) for found in (kept, new)]
            dearer.append(costs[0] - costs[1])
    return Row(
        problem=path.stem,
        knots=last + 1,
        beliefs=beliefs,
        new_found=sum(found.feasible for found, _ in new),
        kept_found=sum(found.feasible for found, _ in kept),
        new=float(np.median([spent for _, spent in new])),
        kept=float(np.median([spent for _, spent in kept])),
        first=first,
        new_iterations=float(np.median([found.iterations for found, _ in new])),
        kept_iterations=float(np.median([found.iterations for found, _ in kept])),
        dearer=max(dearer, default=0.0),
    )


def sequences(name: str, problem: Problem, seed: int) -> str:
    """A line: iterations of the mode sequences that share their first modes with one before, started in two ways."""
    problem = with_input_memory(problem)
    mode = start_mode(problem.automaton, problem.start)[0]
    problem = replace(problem, start=replace(problem.start, mode=mode))
    limits, plain = limits_of(problem), without_input_memory(problem)
    found = search_modes(plain, limits_of(plain), mode or "", seed).sequences
    before: list[tuple[tuple[PhaseGuess, ...], BeliefPath]] = []
    own, other = [], []
    for sequence in found:
        try:
            phases = guess(problem, limits, with_memory(problem, sequence))
        except NoWayError:
            continue
        nlp, limit_s = transcribe(problem, limits, phases), problem.settings.time_limit_s
        path = solve(nlp, limit_s)
        best = max(before, key=lambda known: _shared(known[0], phases), default=None)  # used at once
        if best is not None and best[1].feasible and (count := _shared(best[0], phases)):
            own.append(path.iterations)
            for i, phase in enumerate(phases[:count]):
                begin, end = phase.first_knot, phase.first_knot + phase.steps
                knots = slice(begin, end + 1)
                states = pack(best[1].means[knots], best[1].factors[knots], nlp.pattern)
                nlp.w_start[3 * i : 3 * i + 2] = states.ravel(order="F"), best[1].inputs[begin:end].ravel()
            other.append(solve(nlp, limit_s).iterations)
        before.append((phases, path))
    return f"{name:22} {len(found):10} {len(own):8} {sum(own):16} {sum(other):18}"


def _shared(one: Sequence[PhaseGuess], two: Sequence[PhaseGuess]) -> int:
    """How many first phases of two sequences are in the same mode for as many steps, to the first other transition."""
    for count, (a, b) in enumerate(zip(one, two, strict=False)):
        if (a.mode, a.steps) != (b.mode, b.steps):
            return count
        if a.edge != b.edge:
            return count + 1
    return min(len(one), len(two))


def sequences_table(paths: Sequence[Path], seed: int) -> str:
    """The problems whose candidates share anything, and the large cabinets of `planning_growth`."""
    cases = {path.stem: load_problem(path) for path in paths}
    cases |= {f"cabinet, {n} coordinates": cabinet_problem(6, n - 6, 6, 10) for n in (6, 12)}
    lines = [f"{'problem':22} {'candidates':>10} {'sharing':>8} {'from own search':>16} {'from other optimum':>18}"]
    return "\n".join(lines + [sequences(name, problem, seed) for name, problem in cases.items()])


def table(rows: Sequence[Row]) -> str:
    lines = [
        f"{'problem':22} {'knots':>5} {'found new':>10} {'kept':>6} {'new ms':>8} {'kept ms':>8} {'ratio':>6} "
        f"{'first ms':>9} {'iterations':>10} {'kept':>5} {'dearer':>8}"
    ]
    lines += [
        f"{row.problem:22} {row.knots:5} {row.new_found:4} of {row.beliefs:<2} {row.kept_found:6} "
        f"{1e3 * row.new:8.1f} {1e3 * row.kept:8.1f} {row.kept / row.new:6.2f} {1e3 * row.first:9.1f} "
        f"{row.new_iterations:10.0f} {row.kept_iterations:5.0f} {row.dearer:8.4f}"
        for row in rows
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Optimising the rest of a plan again.")
    parser.add_argument("problems", nargs="*", type=Path, help="default: all of problems/")
    parser.add_argument("--beliefs", type=int, default=10, help="per problem")
    parser.add_argument("--sequences", action="store_true", help="whether candidates should start from each other")
    parser.add_argument("--seed", type=int, default=0)
    add_json(parser)
    options = parser.parse_args()
    paths = options.problems or sorted(p for p in (ROOT / "problems").glob("*.yaml") if kind_of(p) == "problem")
    if options.sequences:
        print(sequences_table(paths, options.seed))
        return
    rows = [row for path in paths if (row := measure(path, options.beliefs, options.seed)) is not None]
    print(table(rows))
    save_json([asdict(row) for row in rows], options.json)


if __name__ == "__main__":
    main()
