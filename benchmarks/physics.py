"""What an execution in MuJoCo takes beside the engine.

    python -m benchmarks physics [PROBLEM.yaml ...] [--repeats 5] [--seed 0] [--json FILE]

One seeded trial of each problem's plan is executed and its controls are recorded at every physics step. `engine` is a
plain loop of `mj_step` over these controls, `plant` repeats the trial's commands on the plant (hand, latches, contacts,
tracker), `trial` is the execution with filter and follower. All are microseconds of the processor per physics step, the
least of the repeats, which take turns. That loop and plant end in the same state is checked.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from saving import add_json, save_json

from micah_plan.api.stages import solve
from micah_plan.documents.problem import load_problem
from micah_plan.execution.checked_plant import make_plant
from micah_plan.execution.plant import Command
from micah_plan.execution.trials import run_trials

ROOT = Path(__file__).resolve().parent.parent
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """One problem: control steps of the trial, physics steps in each, and microseconds per physics step."""

    problem: str
    control_steps: int
    physics_steps: int
    engine: float
    plant: float
    trial: float


class Recorder:
    """Stands in for the library MuJoCo of a plant and notes what the engine is given at every step."""

    def __init__(self, plant: Any) -> None:
        self._plant, self._mujoco, self._free_steps = plant, plant.mujoco, plant._free_steps
        self.given: list[tuple[Floats, NDArray[np.uint8]]] = []
        self._leapt = 0

    def __enter__(self) -> Recorder:
        self._plant.mujoco, self._plant._free_steps = self, self.free_steps
        return self

    def __exit__(self, *_: object) -> None:
        self._plant.mujoco, self._plant._free_steps = self._mujoco, self._free_steps

    def __getattr__(self, name: str) -> Any:
        return getattr(self._mujoco, name)

    def mj_step(self, model: Any, data: Any) -> None:
        self.given.append((data.ctrl.copy(), data.eq_active.copy()))
        self._mujoco.mj_step(model, data)

    def mj_step1(self, model: Any, data: Any) -> None:
        self._active = data.eq_active.copy()  # constraints are made in the first half of a step
        self._mujoco.mj_step1(model, data)

    def mj_step2(self, model: Any, data: Any) -> None:
        self.given.append((data.ctrl.copy(), self._active))
        self._mujoco.mj_step2(model, data)

    def free_steps(self, controls: Floats) -> Floats:
        self._leapt = len(controls)
        self.given += [(row, self._plant.data.eq_active.copy()) for row in controls]
        return self._free_steps(controls)

    def mj_setState(self, *arguments: Any) -> None:  # noqa: N802
        """Going back from a leap."""
        del self.given[-self._leapt :]
        self._mujoco.mj_setState(*arguments)


def seconds(run: Callable[[], object]) -> float:
    begin = process_time()
    run()
    return process_time() - begin


def measured(path: Path, repeats: int, seed: int) -> Row:
    """One problem's row."""
    problem = load_problem(path)
    plan = solve(problem, seed=seed)
    if plan.trajectory is None:
        raise SystemExit(f"{path}: {plan.reason}")
    posture = None if plan.arm is None else tuple(plan.arm.positions[0].tolist())
    start = replace(problem.start, mode=plan.trajectory.modes[0], posture=posture)
    plant: Any = make_plant(replace(problem, start=start), "mujoco")
    commands, apply = [], plant.apply

    def noted(command: Command) -> Any:
        commands.append(command)
        return apply(command)

    def execute() -> None:
        run_trials(problem, plan, plant=plant, trials=1, seed=seed)

    def begin() -> None:
        plant.reset(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,))))

    def loop() -> None:
        model, data, step = plant.model, plant.data, plant.mujoco.mj_step
        control, active = data.ctrl, data.eq_active
        for given, closed in recorder.given:
            control[:] = given
            active[:] = closed
            step(model, data)

    def repeat() -> None:
        for command in commands:
            plant.apply(command)

    plant.apply = noted
    with Recorder(plant) as recorder:
        execute()
    plant.apply = apply
    best, ends = [np.inf] * 3, {}
    for _ in range(repeats):
        for number, run in enumerate((loop, repeat)):
            begin()
            best[number] = min(best[number], seconds(run))
            ends[number] = plant.data.qpos.copy()
        best[2] = min(best[2], seconds(execute))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    plant.close()
    engine, alone, trial = 1e6 * np.array(best) / len(recorder.given)
    return Row(path.stem, len(commands), len(recorder.given) // len(commands), engine, alone, trial)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="*", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    add_json(parser)
    options = parser.parse_args(arguments)
    names = ("microwave_close", "cabinet_close", "light_dark", "stapler_on_books", "foot_under_shelf")
    default = [ROOT / "problems" / f"{name}.yaml" for name in names]
    rows = []
    print("| problem | physics steps | engine, us | plant, us | trial, us | plant / engine | trial / engine |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for path in options.problems or default:
        row = measured(path, options.repeats, options.seed)
        rows.append(row)
        numbers = f"{row.engine:.1f} | {row.plant:.1f} | {row.trial:.1f}"
        ratios = f"{row.plant / row.engine:.2f} | {row.trial / row.engine:.2f}"
        print(f"| {row.problem} | {row.control_steps} x {row.physics_steps} | {numbers} | {ratios} |", flush=True)
    save_json([asdict(row) for row in rows], options.json)


if __name__ == "__main__":
    main()
