"""Runs of every shipped problem on the nominal plant, which is the model itself: nothing may be found in them.

    python -m benchmarks own_runs [--problems drawer_open ...] [--trials 4] [--seed 0] [--logs FOLDER]

`predict` should say noise (or that it cannot be sure), and `calibrate` `none`. What a hand holds is predicted, not
calibrated. With `--logs`, runs are kept in a folder, and those that are there are not made again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.exchange.load import load_recording
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve
from micah_plan.recording.read import write_recording
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.judgement import judge
from micah_plan.residual.prediction import predict_recording
from micah_plan.task.problem import Problem

FOLDER = Path(__file__).resolve().parents[1] / "problems"


def recorded(problem: Problem, file: Path | None, trials: int, seed: int) -> Recording | str:
    """Runs of the problem's plan; why there are none."""
    if file is not None and file.exists():
        return load_recording(file)
    plan = solve(problem, seed=seed, advise=False)
    if plan.outcome != "solved":
        return plan.reason
    recording = run_trials(problem, plan, trials=trials, seed=seed).recording
    if file is not None:
        write_recording(recording, file)
    return recording


def answered(problem: Problem, recording: Recording) -> tuple[str, str]:
    """What `predict` and `calibrate` say."""
    try:
        runs = predict_recording(problem.automaton, recording)
    except InputError as refused:
        return f"refused: {refused.problem}", "refused"
    judged = judge(problem.automaton, recording, runs)
    told = {True: "noise", False: judged.sentence, None: "not sure"}[judged.is_noise]
    try:
        found = calibrate(problem.automaton, recording)
    except InputError as refused:
        return told, f"refused: {refused.problem}"
    names = ", ".join(one.effect.name for one in found.effects)
    return told, f"{found.verdict}{': ' if names else ''}{names}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    shipped = sorted(file.stem for file in FOLDER.glob("*.yaml") if "scene/1" not in file.read_text())
    parser.add_argument("--problems", nargs="*", default=shipped)
    parser.add_argument("--trials", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--logs", type=Path)
    asked = parser.parse_args()
    print("| problem | rows | predict | calibrate |")
    print("| --- | --- | --- | --- |")
    alarms = 0
    for name in asked.problems:
        problem = load_problem(FOLDER / f"{name}.yaml")
        file = None if asked.logs is None else asked.logs / f"{name}.csv"
        recording = recorded(problem, file, asked.trials, asked.seed)
        if isinstance(recording, str):
            print(f"| {name} | | no plan: {recording} | |", flush=True)
            continue
        told, verdict = answered(problem, recording)
        alarms += told.partition(":")[0] not in ("noise", "not sure", "refused") or verdict.partition(":")[0] not in (
            "none",
            "refused",
        )
        print(f"| {name} | {len(recording.time)} | {told} | {verdict} |", flush=True)
    print(f"{alarms} alarms in {len(asked.problems)} problems")


if __name__ == "__main__":
    main()
