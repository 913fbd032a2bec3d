"""Whether what an exploration left is a model to plan with: objects that were opened are closed and opened again by it.

    python -m benchmarks explore_handover [--objects 44] [--first-seed 20000] [--rounds 3]

The plant is the same one, as it was left. `solve` plans to 20 % of the way and back to 90 %; `execute` carries both
out. Done: the true way ends within 6 % of the range and 1 cm of what was asked. With more rounds, `calibrate` gets the
runs of all but the last one; before and after it, `predict` rolls the runs of the last one out from their first row.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from explore_plants import LATCHED, MOVING, HandlePlant, Thing, drawn

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.model import model_text
from micah_plan.documents.problem import load_problem
from micah_plan.execution.handle import HandlePlant as Checked
from micah_plan.execution.log import concatenated_recordings
from micah_plan.execution.plant import Measurement
from micah_plan.execution.trials import run_trials
from micah_plan.exploration.run import explore
from micah_plan.planning.solver import solve
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.prediction import predict_recording
from micah_plan.task.exploration_scene import Scene

_LOW, _HIGH, _TOLERANCE = 0.2, 0.9, 0.06


class Left(HandlePlant):
    """A plant that begins a trial as it was left, after its first."""

    def reset(self, rng: np.random.Generator) -> Measurement:
        if self.seen is None:
            return super().reset(rng)
        self.rng, self.time, self.force = rng, 0.0, np.zeros(3)
        self.seen = self._measure()
        return self.seen


def top_of(model: HybridAutomaton) -> float:
    """The largest configuration that the model allows [rad or m]."""
    return max(mode.interval(0)[1] for mode in model.modes)


def problem_text(model: Path, top: float, start: float, goal: float) -> str:
    """A problem from one share of the range to another."""
    return f"""format: micah-plan/problem/1
model: {model.name}
start: {{mean: {{handle: {start * top}}}, std: {{handle: {0.02 * top}}}}}
goal: {{target: {{handle: {{value: {goal * top}, tolerance: {_TOLERANCE * top}}}}}}}
planner: {{max_step: {{handle: {0.2 * top}}}}}
"""


class Handover:
    """An object that was explored, and what its model is worth.

    Attributes:
        said: why it was not closed and opened again; empty if it was.
        model: as the exploration left it.
        rounds: a recording of each closing and opening.
    """

    def __init__(self, thing: Thing, seed: int, folder: Path, rounds: int = 1) -> None:
        self.plant, self.seed, self.folder = Left(None, thing), seed, folder
        self.rounds, self.runs = list[Recording](), 0
        found = explore(Scene(), Checked(self.plant), np.random.default_rng(seed))
        self.said, self.model = "", found.model
        if found.outcome != "opened" or found.model is None:
            self.said = f"not opened: {found.reason}"
            return
        (folder / "model.yaml").write_text(model_text(found.model), encoding="utf-8")
        start = 0.98
        for _ in range(rounds):
            closed, opened = self._done(start, _LOW), self._done(_LOW, _HIGH)
            start = _HIGH
            if closed is None or opened is None:
                return
            self.rounds.append(concatenated_recordings([closed, opened]))
        went = self.plant.way - thing.start
        went, asked = abs(went), _HIGH * found.travel
        if abs(went - asked) > _TOLERANCE * found.travel + 0.015:
            self.said = f"went {went:.3f} m for {asked:.3f}"

    def _done(self, start: float, goal: float) -> Recording | None:
        """The run of a plan from one share of the range to another; None, and why, if there is none."""
        if self.said:
            return None
        text = problem_text(self.folder / "model.yaml", top_of(self.model), start, goal)
        (self.folder / "problem.yaml").write_text(text)
        problem = load_problem(self.folder / "problem.yaml")
        plan = solve(problem, seed=self.seed)
        if plan.trajectory is None:
            self.said = f"no plan to {goal:.0%}"
            return None
        statistics = run_trials(problem, plan, plant=self.plant, seed=self.seed)
        result = statistics.results[0]
        self.said = "" if result.success else f"to {goal:.0%}: {result.reason}"
        self.runs += 1
        return replace(statistics.recording, run=np.full_like(statistics.recording.run, self.runs))

    def calibrated(self) -> tuple[str, float, float]:
        """The verdict on all rounds but the last, and how far off roll-outs of that one are before and after [m]."""
        found = calibrate(self.model, concatenated_recordings(self.rounds[:-1]))
        before, after = (_rolled(model, self.rounds[-1]) for model in (self.model, found.automaton))
        return found.verdict, before, after


def _rolled(model: HybridAutomaton, recording: Recording) -> float:
    """Root mean square of the place of the handle in roll-outs [m]."""
    return float(
        np.sqrt(np.mean(np.concatenate([run.rollout.position**2 for run in predict_recording(model, recording)])))
    )


def closed_and_reopened(thing: Thing, seed: int, folder: Path) -> str:
    """Empty if both were done, else what was not."""
    return Handover(thing, seed, folder).said


def main() -> None:
    parser = argparse.ArgumentParser(description="Models that explorations left, planned with and executed.")
    parser.add_argument("--objects", type=int, default=45)
    parser.add_argument("--first-seed", type=int, default=20000)
    parser.add_argument("--rounds", type=int, default=1)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    families, failed, verdicts, errors = (*MOVING, *LATCHED), [], Counter[str](), []
    for i in range(options.objects):
        family, seed = families[i % len(families)], options.first_seed + i
        with tempfile.TemporaryDirectory() as folder:
            left = Handover(drawn(seed, family), seed, Path(folder), options.rounds)
        if left.said:
            failed.append(f"{seed} {family}: {left.said}")
        elif options.rounds > 1:
            verdict, before, after = left.calibrated()
            verdicts[verdict] += 1
            errors.append((before, after))
            print(f"{seed} {family}: {verdict}, {1000 * before:.1f} -> {1000 * after:.1f} mm", flush=True)
    print(f"opened, closed again and reopened: {options.objects - len(failed)} of {options.objects}")
    print("\n".join(failed))
    if errors:
        before, after = 1000 * np.array(errors).T
        better, worse = np.sum(after < 0.95 * before), np.sum(after > 1.05 * before)
        print(f"calibrate: {dict(verdicts)}; roll-outs of runs that it did not get: median {np.median(before):.1f} mm")
        print(f"before and {np.median(after):.1f} mm after it; better in {better}, worse in {worse} of {len(errors)}")


if __name__ == "__main__":
    main()
