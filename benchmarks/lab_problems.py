"""Problems of a lab that need what happens between the knots, beside a script that looks at nothing.

    OMP_NUM_THREADS=1 python -m benchmarks lab_problems [--seeds K] [--executions N]

The problems are those of `tests/planning/test_between_knots.py`: a slot in a plate, a hole in a table, a hand that must
not let go too high, a speed limit near a wall, a gap and a way around it, a flap that falls shut, one hand and four
things. For each and every seed: the outcome, predicted success, and how many executions on the nominal plant succeed.
The script is written by hand: inputs that a person would send, in the model's own step and noise, without looking.
`CasADi` is the programme that a person would write who knows the way: told the modes, the knots of each leg and the
bounds that keep it, three stds wide; smallest inputs by IPOPT, sent without looking.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import process_time

import casadi as ca
import numpy as np
from numpy.typing import NDArray

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests" / "planning")]

import test_between_knots as lab  # noqa: E402

from micah_plan.automaton.drawn_thresholds import threshold_stds  # noqa: E402
from micah_plan.automaton.transition import TransitionBatch  # noqa: E402
from micah_plan.execution.trials import run_trials  # noqa: E402
from micah_plan.planning.solver import solve  # noqa: E402
from micah_plan.task.problem import Problem  # noqa: E402

Floats = NDArray[np.float64]

GENTLY = """\
start: {mean: {z: 0.2}, std: {z: 0.002}, mode: carries}
goal: {target: {z: {value: 0.1, tolerance: 0.02}}, modes: [stands]}
planner: {max_step: {z: 0.02, grip: 0.01}}
"""
SLOWLY = """\
start: {mean: {x: 0.0}, std: {x: 0.003}, mode: free}
goal: {target: {x: {value: 0.5, tolerance: 0.02}}, modes: [free]}
planner: {max_step: {x: 0.05}}
"""
GAP = """\
start: {mean: {x: -0.4, z: 0.0}, std: {x: 0.005, z: 0.005}, mode: free}
goal: {target: {x: {value: 0.4, tolerance: 0.04}, z: {value: 0.0, tolerance: 0.04}}, modes: [free]}
planner: {max_step: {x: 0.05, z: 0.05}}
"""


def moved(*legs: tuple[float, ...]) -> Floats:
    """(N, m) inputs of legs (steps, input, input, ...): each leg's inputs are made in that many equal steps."""
    return np.concatenate([np.tile(np.array(leg[1:]) / leg[0], (int(leg[0]), 1)) for leg in legs])


def _blocks() -> Floats:
    legs: list[tuple[float, ...]] = []
    hand = 0.4
    for i in range(4):
        at, to = 0.15 * i, 1.0 + 0.12 * i
        legs += [(12, at - hand, 0.0), (1, 0.0, 0.01), (12, to - at, 0.0), (1, 0.0, -0.01)]
        hand = to
    return moved(*legs)


CASES: dict[str, tuple[Callable[[Path], Problem], Floats]] = {
    "slot in a plate": (lab.in_slot, moved((10, 0.31, 0.0), (8, 0.0, -0.33))),
    "hole in a table": (lambda folder: lab.on_table(folder, 0.01), moved((6, 0.12, 0.0), (9, 0.0, -0.22))),
    "let go gently": (
        lambda folder: lab.problem_of(folder, lab.GENTLY, GENTLY),
        moved((12, -0.21, 0.0), (1, 0.0, -0.01), (8, 0.1, 0.0)),
    ),
    "slowly at the wall": (
        lambda folder: lab.problem_of(folder, lab.SLOWLY, SLOWLY),
        moved((7, 0.28), (22, 0.22)),
    ),
    "gap or way around": (
        lambda folder: lab.problem_of(folder, lab.GAP, GAP),
        moved((13, 0.0, 0.6), (17, 0.8, 0.0), (13, 0.0, -0.6)),
    ),
    "flap that falls shut": (
        lambda folder: lab.below_the_flap(folder, 0.1),
        np.concatenate([moved((20, 0.0, 2.0)), moved((16, 0.8, 16 * 0.04))]),
    ),
    "four things, one hand": (lambda folder: lab.problem_of(folder, *lab.blocks(4)), _blocks()),
}


Bounds = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Leg:
    """Steps in one mode: bounds of the state at each of their ends, and of the inputs."""

    mode: str
    steps: int
    state: Bounds = field(default_factory=dict)
    inputs: Bounds = field(default_factory=dict)


def _blocks_told() -> list[Leg]:
    legs = []
    for i in range(4):
        free, grip, let_go = {"grip": (0.0, 0.0)}, {"grip": (0.01, 0.01)}, {"grip": (-0.01, -0.01)}
        # The hand closes where it is near the block: the step before ends there.
        legs += [Leg("free", 7, {}, free), Leg("free", 1, {f"hand - b{i}": (-0.012, 0.012)}, free)]
        still = {"hand": (0.0, 0.0)}
        legs += [Leg("free", 1, {}, grip | still), Leg(f"has_b{i}", 12, {}, free)]
        legs += [Leg(f"has_b{i}", 1, {}, let_go | still)]
    return legs


IN_SLOT, AT_GAP = {"x": (-0.04, 0.04)}, {"x": (-1.0, -0.04)}
TOLD: dict[str, list[Leg]] = {
    "slot in a plate": [
        Leg("over", 9, {"z": (0.0, 0.4)}),
        Leg("over", 1, {"z": (0.0, 0.4)} | IN_SLOT),
        Leg("inside", 5, IN_SLOT),
    ],
    "hole in a table": [
        Leg("over", 8, {"z": (0.0, 0.4)}),
        Leg("over", 1, {"z": (0.0, 0.4), "x": (0.05, 1.0)}),
        Leg("over", 2, {"x": (0.05, 1.0)}),
        Leg("over", 1, {"x": (0.05, 1.0), "z": (-0.04, -0.005)}),
    ],
    "let go gently": [
        Leg("carries", 16, {"z": (-0.01, 0.4)}, {"grip": (0.0, 0.0)}),
        Leg("carries", 1, {"z": (-0.01, 0.002)}, {"grip": (0.0, 0.0)}),
        Leg("carries", 1, {}, {"grip": (-0.01, -0.01), "z": (0.0, 0.0)}),
        Leg("stands", 9, {}, {"grip": (0.0, 0.0)}),
    ],
    "slowly at the wall": [Leg("free", 9, {"x": (-0.1, 0.3)}), Leg("free", 22, {}, {"x": (-0.0119, 0.0119)})],
    "gap or way around": [
        Leg("free", 16, AT_GAP),
        Leg("free", 1, AT_GAP | {"z": (0.4, 0.9)}),
        Leg("free", 8, {"z": (0.4, 0.9)}),
        Leg("free", 17, {"x": (0.04, 1.0)}),
    ],
    "flap that falls shut": [
        Leg("free", 14, {"hand": (-0.2, 0.3), "flap": (0.0, 1.5)}),
        Leg("free", 1, {"hand": (-0.2, 0.3), "flap": (0.8, 1.5)}),
        Leg("free", 12, {"flap": (0.8, 1.5)}),
    ],
    "four things, one hand": _blocks_told(),
}


def by_hand(problem: Problem, legs: list[Leg]) -> Floats | None:
    """(N, m) inputs of the programme that is told the legs; None if it has no solution."""
    automaton, opti, steps = problem.automaton, ca.Opti(), sum(leg.steps for leg in legs)
    u, x = opti.variable(automaton.m, steps), ca.DM(problem.start.mean)
    largest, names = np.array(problem.settings.max_step), automaton.coordinate_names
    start, process = np.array(problem.start.std) ** 2, np.array(automaton.noise.process_std) ** 2
    opti.minimize(ca.sumsqr(u / np.tile(largest[:, None], steps)))
    k = 0
    for leg in legs:
        drift = np.sum(
            [e.values[0] * np.eye(automaton.n)[names.index(e.coordinate)] for e in automaton.effects], axis=0
        )
        for _ in range(leg.steps):
            x = x + ca.mtimes(ca.DM(automaton.mode(leg.mode).B), u[:, k]) + drift
            opti.subject_to(opti.bounded(-largest, u[:, k], largest))
            for name, (low, high) in leg.inputs.items():
                opti.subject_to(opti.bounded(low, u[automaton.input_names.index(name), k], high))
            k += 1
            std = np.sqrt(start + k * process)
            for name, (low, high) in leg.state.items():
                weights = np.array([(n == name.split(" - ")[0]) - float(name.endswith(f" - {n}")) for n in names])
                margin = min(3.0 * float(np.hypot.reduce(weights * std)), 0.45 * (high - low))
                opti.subject_to(opti.bounded(low + margin, ca.mtimes(weights[None], x), high - margin))
    for index, value, tolerance in problem.goal.target:
        low, high = legs[-1].state.get(names[index], (-np.inf, np.inf))
        if not low <= value <= high:  # a table ends the way
            continue
        opti.subject_to(opti.bounded(value - 0.1 * tolerance, x[index], value + 0.1 * tolerance))
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"})
    try:
        return np.array(opti.solve().value(u), dtype=float).reshape(automaton.m, steps).T
    except RuntimeError:
        return None


def script_succeeds(problem: Problem, inputs: Floats, trials: int, seed: int) -> float:
    """The share of trials in which the script ends in the goal."""
    automaton, rng = problem.automaton, np.random.default_rng(seed)
    objects = TransitionBatch(automaton, np.zeros((trials, threshold_stds(automaton).size)))
    modes = np.full(trials, automaton.mode_index(problem.start.mode or automaton.mode_names[0]))
    x = np.array(problem.start.mean) + np.array(problem.start.std) * rng.standard_normal((trials, automaton.n))
    for u in inputs:
        noise = np.array(automaton.noise.process_std) * rng.standard_normal(x.shape)
        modes, x = objects.step(modes, x, np.tile(u, (trials, 1)), noise)
    admitted = problem.goal.admitted(automaton.mode_names)[modes]
    return float((admitted & problem.goal.holds(x)).mean())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--executions", type=int, default=100)
    given = parser.parse_args()
    print(
        f"{'problem':<24}{'solved':>8}{'predicted':>18}{'executed':>14}{'seconds':>9}{'steps':>7}{'script':>9}{'steps':>7}{'CasADi':>9}{'steps':>7}{'seconds':>9}"
    )
    for name, (made, inputs) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            problem = made(Path(folder))
        plans, seconds = [], 0.0
        for seed in range(given.seeds):
            begin = process_time()
            plans.append(solve(problem, seed=seed, advise=False))
            seconds += (process_time() - begin) / given.seeds
        solved = [plan for plan in plans if plan.outcome == "solved"]
        shares = [plan.success_probability or 0.0 for plan in solved]
        ran = [run_trials(problem, plan, trials=given.executions, seed=7).successes for plan in solved]
        predicted = f"{min(shares):.3f} to {max(shares):.3f}" if shares else "-"
        executed = f"{sum(ran)} of {given.executions * len(ran)}" if ran else "-"
        steps = min((len(p.trajectory.inputs) for p in solved if p.trajectory), default=0)
        script = script_succeeds(problem, inputs, 1000, 0)
        count = f"{len(solved)} of {len(plans)}"
        begin = process_time()
        programmed = by_hand(problem, TOLD[name])
        took = process_time() - begin
        share, length = 0.0, 0
        if programmed is not None:
            share, length = script_succeeds(problem, programmed, 1000, 0), len(programmed)
        print(
            f"{name:<24}{count:>8}{predicted:>18}{executed:>14}{seconds:>9.2f}{steps:>7}{script:>9.3f}{len(inputs):>7}"
            f"{share:>9.3f}{length:>7}{took:>9.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
