"""Statistics over seeded trials of a plan."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from micah_plan.errors import InputError
from micah_plan.execution.checked_plant import CheckedPlant, make_plant
from micah_plan.execution.closed_loop import Episode, TrialResult, execute_batch
from micah_plan.execution.log import concatenated_recordings
from micah_plan.execution.pilot import Replanning
from micah_plan.execution.plant import Plant, PlantMaker
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress
from micah_plan.task.acceptance import executable_trajectory
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.plants import BUILT_IN, DEFAULT_PLANT
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem

Keep = Callable[[Recording], None]

# Trials in the model that run in step with each other.
_ABREAST = 50


@dataclass(frozen=True)
class ErrorSummary:
    """Mean, standard deviation and maximum over trials [rad or m]."""

    mean: float
    std: float
    max: float


@dataclass(frozen=True, eq=False)
class TrialStatistics:
    """Statistics over the trials of a plan.

    Attributes:
        trials, successes: counts.
        believed: whether success and error are from the belief, since the plant has no referee.
        final_error: of the state at the end, over all trials [rad or m].
        failures: (trial, reason) of those that did not reach the goal set.
        recording: the logs of all trials; the run is the trial's number.
        results: one per trial.
        released: after how many the object stands in the goal on its own; None where it stays in the hand.
    """

    trials: int
    successes: int
    believed: bool
    final_error: ErrorSummary
    failures: tuple[tuple[int, str], ...]
    recording: Recording
    results: tuple[TrialResult, ...]
    released: int | None = None


def run_trials(
    problem: Problem,
    plan: Plan,
    *,
    plant: str | PlantMaker | Plant = DEFAULT_PLANT,
    trials: int = 1,
    seed: int = 0,
    max_steps: int | None = None,
    replans: bool = True,
    anyway: bool = False,
    progress: Progress | None = None,
    keep: Keep | None = None,
) -> TrialStatistics:
    """Execute a plan several times; trial i has its own random stream, independent of earlier trials.

    Args:
        plant: name of a plant of the package, or a function that makes one from the problem: it is closed at the end in
            any case. Or a plant, which stays open.
        max_steps: control steps per trial at most; None: twice the plan's plus 20.
        replans: whether new plans are made after failures, and the rest of a plan is optimised again as often as the
            problem's settings require.
        anyway: whether a plan that is not verified is executed, too: by a plant of the package, which is no machine.
        progress: called with a message and the fraction done.
        keep: called with the log of every trial when it ends (of trials in step, when all of them have), and also when
            an error or Ctrl-C breaks it off.

    Raises:
        InputError: if the plan is not a solution, `trials` is less than 1, there is no such plant, or the plant's code
            raised an error or returned something that is not a measurement.
        MissingDependencyError: if the plant needs a library that is not installed.
        PlantError: if the machine cannot be reset.
    """
    trajectory = executable_trajectory(plan, anyway=anyway)
    if plan.outcome != "solved" and not (isinstance(plant, str) and plant in BUILT_IN):
        raise InputError("a plan that is not verified moves no machine", remedy=f"choose plant {' or '.join(BUILT_IN)}")
    if trials < 1:
        raise InputError(f"trials must be at least 1. Got {trials}")
    carried = pre_release_problem(problem)
    replanning = _replanning(carried, plan, trajectory) if replans else Replanning()
    posture = None if plan.arm is None else tuple(plan.arm.positions[0].tolist())
    problem = replace(problem, start=replace(problem.start, mode=trajectory.modes[0], posture=posture))

    make = partial(
        Episode, problem, trajectory, arm=plan.arm, replanning=replanning, max_steps=max_steps, release=plan.release
    )
    abreast = min(trials, _ABREAST) if isinstance(plant, str) and plant in BUILT_IN and BUILT_IN[plant].abreast else 1
    results, report = list[TrialResult](), _reporting(trials, progress)
    with ExitStack() as opened:
        machines = [opened.enter_context(_opened(problem, plant)) for _ in range(abreast)]
        for first in range(0, trials, abreast):
            turn = range(first, min(first + abreast, trials))
            episodes = [make(run=trial) for trial in turn]
            rngs = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial,))) for trial in turn]
            try:
                results += execute_batch(episodes, machines[: len(turn)], rngs, report)
            finally:
                for log in (episode.recording for episode in episodes):
                    if keep is not None and log is not None:
                        keep(log)
    return summarise(results)


def _opened(problem: Problem, plant: str | PlantMaker | Plant) -> AbstractContextManager[CheckedPlant]:
    """A checked plant; one created here is closed at the end."""
    parts = [link.child for link in problem.automaton.links]
    if isinstance(plant, str | type) or not isinstance(plant, Plant):
        return CheckedPlant(make_plant(problem, plant), parts)
    return nullcontext(CheckedPlant(plant, parts))


def _replanning(problem: Problem, plan: Plan, trajectory: Trajectory) -> Replanning:
    """Sources of new plans, which the arm must be able to follow if it follows the present one."""
    from micah_plan.planning.receding_horizon import RecedingHorizon
    from micah_plan.planning.replanning import replan

    proposed, rest = partial(replan, problem), RecedingHorizon(problem, trajectory)
    if problem.robot is None or plan.arm is None:
        return Replanning(proposed, rest)
    from micah_plan.robot.along_plan import arm_along  # Pinocchio is loaded only where there is an arm

    return Replanning(proposed, rest, lambda plan, joints: arm_along(problem, plan, start=joints))


def _reporting(trials: int, progress: Progress | None) -> Callable[[TrialResult], None]:
    """A callback that reports the progress when a trial has ended."""
    ended: list[bool] = []

    def report(result: TrialResult) -> None:
        ended.append(result.success)
        if progress is not None:
            progress(f"trial {len(ended)} of {trials}: {sum(ended)} successful", len(ended) / trials)

    return report


def summarise(results: list[TrialResult]) -> TrialStatistics:
    """Counts, errors, failures and the joined log of trials (at least one)."""
    errors = np.array([result.final_error for result in results])
    failures = tuple((trial, result.reason) for trial, result in enumerate(results) if not result.success)
    return TrialStatistics(
        trials=len(results),
        successes=len(results) - len(failures),
        believed=any(result.believed for result in results),
        final_error=ErrorSummary(float(errors.mean()), float(errors.std()), float(errors.max())),
        failures=failures,
        recording=concatenated_recordings([result.recording for result in results]),
        results=tuple(results),
        released=None if results[0].released is None else sum(bool(result.released) for result in results),
    )
