"""Experiments as values: `calibrate` designs them, `execute` carries them out."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from micah_plan.api.inputs import Source
from micah_plan.api.result import RecordedResult
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.message import code_of
from micah_plan.quantities import count
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress, Table
from micah_plan.task.experiment import Experiment

if TYPE_CHECKING:
    from micah_plan.execution.plant import Plant, PlantMaker
    from micah_plan.execution.trials import Keep


@dataclass(frozen=True, eq=False, repr=False)
class ExperimentResult(RecordedResult):
    """Result of `execute` for an experiment: its runs as a recording, and the aborted ones.

    Attributes:
        log: all runs.
        failures: (run, reason).
    """

    experiment: Experiment
    log: Recording
    failures: tuple[tuple[int, str], ...] = ()
    seconds: float = 0.0

    @property
    def success(self) -> bool:
        """Whether all runs were completed."""
        return not self.failures

    @property
    def outcome(self) -> str:
        """``"carried_out"`` or ``"broken_off"``."""
        return "carried_out" if self.success else "broken_off"

    @property
    def reason(self) -> str:
        """Reason of an aborted run, the first of them."""
        return f"run {self.failures[0][0]}: {self.failures[0][1]}" if self.failures else ""

    @property
    def title(self) -> str:
        """Title of the page."""
        return "Experiment"

    @property
    def recording(self) -> Recording:
        """All runs, as a recording that `predict` and `calibrate` take."""
        return self.log

    @property
    def automaton(self) -> HybridAutomaton:
        """The model that the experiment tests."""
        return self.experiment.automaton

    def report(self) -> list[str | Table]:
        """Number of runs, and reasons of aborted ones."""
        made = f"{count(len(self.recording.runs), 'run')} carried out, {len(self.failures)} aborted"
        return [made, *(f"  run {run}: {reason}" for run, reason in self.failures)]

    def json(self) -> dict[str, Any]:
        """Runs, rows and failures."""
        return {
            "trials": len(self.recording.runs),
            "rows": len(self.recording),
            "failures": [{"trial": run, "reason": reason, "code": code_of(reason)} for run, reason in self.failures],
            "seconds": self.seconds,
        }


def carry_out_experiment(
    experiment: Experiment | Source,
    *,
    plant: str | PlantMaker | Plant,
    repetitions: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    keep: Keep | None = None,
) -> ExperimentResult:
    """Carry out an experiment: its commands do not depend on measurements.

    Args:
        experiment: a value or the path of one. repetitions: of all of its motions; None: its own number.
        plant, seed, progress, keep: as of `execute`.

    Raises:
        InputError, MissingDependencyError, PlantError: as `execute`.
    """
    from micah_plan.execution.open_loop import carry_out
    from micah_plan.execution.plant import Plant

    if isinstance(plant, Plant) and not isinstance(plant, str | type):
        raise InputError(
            "a plant that is an object does not know where each motion of an experiment starts",
            remedy="give its class, or a function that makes one of a problem",
        )
    if isinstance(experiment, Source):
        from micah_plan.documents.experiment import load_experiment

        experiment = load_experiment(experiment)
    asked = experiment if repetitions is None else replace(experiment, repetitions=repetitions)
    begin = time.perf_counter()
    recording, failures = carry_out(asked, plant=plant, seed=seed, progress=progress, keep=keep)
    return ExperimentResult(asked, recording, tuple(failures), time.perf_counter() - begin)


def refuse_options_of_plans(options: Mapping[str, object], source: Source | None = None) -> None:
    """Refuse options that have no meaning for open-loop commands; `source`: the experiment's file, for the message.

    Raises:
        InputError: for the first option that is not None.
    """
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} is for plans, this is an experiment", source=source, remedy=f"omit {name}")
