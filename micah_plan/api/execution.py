"""`execute`: from a plan to its runs."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from micah_plan.api.experiments import ExperimentResult, carry_out_experiment, refuse_options_of_plans
from micah_plan.api.inputs import Source
from micah_plan.api.result import Result
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.message import Message, code_of
from micah_plan.quantities import count, quantity, with_spread
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress, Table
from micah_plan.task.experiment import Experiment
from micah_plan.task.plants import DEFAULT_PLANT
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.execution.plant import Plant, PlantMaker
    from micah_plan.execution.trials import ErrorSummary, Keep, TrialStatistics
from micah_plan.api.planning import PlanningResult, plan_of

_MOST_FAILURES = 10


@dataclass(frozen=True, eq=False, repr=False)
class RunsResult(Result):
    """Result of `execute`: statistics over the trials, their recording, and the executed plan."""

    statistics: TrialStatistics
    planned: PlanningResult
    seconds: float = 0.0

    @property
    def success(self) -> bool:
        """Whether every trial of a verified plan reached the goal."""
        return self.planned.success and self.successes == self.trials

    @property
    def outcome(self) -> str:
        """``"reached"``, ``"partly"`` or ``"missed"``."""
        return "reached" if self.success else "partly" if self.successes else "missed"

    @property
    def reason(self) -> str:
        """Reasons of failed trials, the first of them."""
        return f"trial {self.failures[0][0]}: {self.failures[0][1]}" if self.failures else ""

    @property
    def title(self) -> str:
        """The name of the problem's file."""
        return self.planned.title

    @property
    def problem(self) -> Problem:
        """The problem of the executed plan."""
        return self.planned.problem

    @property
    def automaton(self) -> HybridAutomaton:
        """The problem's model."""
        return self.planned.automaton

    @property
    def trials(self) -> int:
        """Number of trials."""
        return self.statistics.trials

    @property
    def successes(self) -> int:
        """Number of successes."""
        return self.statistics.successes

    @property
    def failures(self) -> tuple[tuple[int, str], ...]:
        """(trial, reason) of the failed ones."""
        return self.statistics.failures

    @property
    def final_error(self) -> ErrorSummary:
        """Mean, std and maximum of the error at the end [rad or m]."""
        return self.statistics.final_error

    @property
    def recording(self) -> Recording:
        """All runs, as a recording that `learn`, `predict` and `calibrate` take."""
        return self.statistics.recording

    def report(self) -> list[str | Table]:
        """Successes, final errors, and why trials failed."""
        error, outcome, whose, unit = self.final_error, "reached the goal", "", self.planned.problem.goal_unit
        if self.statistics.believed:
            outcome, whose = "are believed to have reached the goal (the plant does not know the truth)", " (believed)"
        spread = with_spread(error.mean, error.std, unit)
        lines: list[str | Table] = [f"{self.successes} of {self.trials} trials {outcome}"]
        if not self.planned.success:
            lines.insert(0, f"this plan is not verified, and was executed anyway: {self.planned.reason}")
        if self.statistics.released is not None:
            released = f"{self.statistics.released} stand in the goal on their own, with nothing knocked over"
            lines.append(f"  released     {released}")
        lines.append(f"  final error  {spread}, at most {quantity(error.max, unit)}{whose}")
        lines += [f"  trial {trial}: {reason}" for trial, reason in self.failures[:_MOST_FAILURES]]
        hidden = len(self.failures) - _MOST_FAILURES
        return [*lines, *([f"  and {count(hidden, 'more failure')}"] if hidden > 0 else [])]

    def json(self) -> dict[str, Any]:
        """Successes, errors and failures. `believed`: without ground truth they are judged by the belief."""
        released = self.statistics.released
        return {
            "trials": self.trials,
            **(
                {}
                if self.planned.success
                else {"plan_outcome": self.planned.outcome, "plan_reason": self.planned.reason}
            ),
            "successes": self.successes,
            "believed": self.statistics.believed,
            "final_error": asdict(self.final_error),
            **({} if released is None else {"released": released}),
            "failures": [_failure(trial, reason) for trial, reason in self.failures],
            "seconds": self.seconds,
        }

    def plot(self) -> Figure:
        """The planned belief and the runs on top."""
        from micah_plan.view.figures import belief_figure

        return belief_figure(self.planned.problem, self.planned.plan, self.recording)

    def page(self, title: str = "", *, before: Recording | None = None) -> str:
        """The runs beside the plan in 3-D, with deviations and reasons of failure.

        Args:
            before: runs of the same plan before a change, for comparison; all are then judged by their last rows.
        """
        from micah_plan.view.plan_page import plan_page

        plan, problem, failures = self.planned.plan, self.planned.problem, dict(self.failures)
        if before is not None:
            both = {"before": before, "after": self.recording}
            return plan_page(plan, problem, title=title or self.title, executed=both)
        return plan_page(plan, problem, title=title or self.title, executed=self.recording, failures=failures)

    def save(self, path: str | Path) -> None:
        """Write the runs as a recording (CSV, NPZ, TUM or MCAP)."""
        from micah_plan.recording.read import write_recording

        write_recording(self.recording, path)


@overload
def execute(
    plan: Experiment,
    *,
    plant: str | PlantMaker | Plant = ...,
    trials: int | None = ...,
    seed: int = ...,
    progress: Progress | None = ...,
    keep: Keep | None = ...,
) -> ExperimentResult: ...


@overload
def execute(
    plan: Source | PlanningResult,
    *,
    plant: str | PlantMaker | Plant = ...,
    trials: int | None = ...,
    seed: int = ...,
    replan_every: int | None = ...,
    plant_parameters: Mapping[str, float] | None = ...,
    start: Mapping[str, float] | None = ...,
    anyway: bool = ...,
    progress: Progress | None = ...,
    keep: Keep | None = ...,
) -> RunsResult: ...


def execute(
    plan: Source | PlanningResult | Experiment,
    *,
    plant: str | PlantMaker | Plant = DEFAULT_PLANT,
    trials: int | None = None,
    seed: int = 0,
    replan_every: int | None = None,
    plant_parameters: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    anyway: bool = False,
    progress: Progress | None = None,
    keep: Keep | None = None,
) -> RunsResult | ExperimentResult:
    """The runs of a plan in closed loop, or of an experiment in open loop.

    Args:
        plan: a path or the result of `solve`; or an experiment, such as `CalibrationResult.experiment`, or its path.
        plant: ``"nominal"`` (the model itself), ``"mujoco"``, or a plant of your own: a class or an object.
        trials: how many, 1 if not given; of an experiment: repetitions of its motions.
        seed: of everything random; each trial has its own stream.
        replan_every: steps after which the rest of the plan is optimised again; 0: never; None: as in the problem.
        plant_parameters: physical parameters that differ from the problem's, e.g. ``{"friction": 25.0}``.
        start: true start of simulated trials, by coordinate, independent of the belief [rad or m].
        anyway: also execute an unverified plan, to see how it fails; in simulation only.
        progress: called with a message and the fraction done.
        keep: called with the log of every trial, also if an error or Ctrl-C ends it.

    Raises:
        InputError: if the plan is no solution, or the plant cannot be used.
        MissingDependencyError: if the plant needs a library that is not installed.
        PlantError: if the machine cannot be reset.
    """
    from micah_plan.documents.kind import kind_of
    from micah_plan.execution.trials import run_trials

    if isinstance(plan, Experiment) or (isinstance(plan, Source) and kind_of(plan) == "experiment"):
        of_plans = {"replan_every": replan_every, "plant_parameters": plant_parameters, "start": start}
        refuse_options_of_plans({**of_plans, "anyway": anyway or None})
        return carry_out_experiment(plan, plant=plant, repetitions=trials, seed=seed, progress=progress, keep=keep)
    chosen, begin = plan_of(plan), time.perf_counter()
    problem = replace(chosen.problem, plant={**chosen.problem.plant, **(plant_parameters or {})})
    true = {problem.automaton.index(name): value for name, value in (start or {}).items()}
    problem = replace(problem, start=replace(problem.start, true=tuple({**dict(problem.start.true), **true}.items())))
    if replan_every is not None:
        problem = replace(problem, settings=replace(problem.settings, replan_every=replan_every))
    trials = 1 if trials is None else trials
    run = partial(run_trials, problem, chosen.plan, plant=plant, trials=trials, seed=seed, anyway=anyway)
    statistics = run(progress=progress, keep=keep)
    return RunsResult(statistics, PlanningResult(chosen.plan, problem), time.perf_counter() - begin)


def _failure(trial: int, reason: str) -> dict[str, Any]:
    """A failed trial for JSON, with the codes of how it ended and of what was missed."""
    missed = reason.values.get("missed", ()) if isinstance(reason, Message) else ()
    return {"trial": trial, "reason": reason, "code": code_of(reason), "missed": list(missed)}
