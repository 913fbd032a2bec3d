"""Statistics over seeded trials of a plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.errors import InputError
from micah_plan.execution.closed_loop import TrialResult, execute
from micah_plan.execution.held_parameters import parameters_of
from micah_plan.execution.held_plant import HeldPlant
from micah_plan.execution.log import concatenated
from micah_plan.execution.mujoco_plant import MujocoPlant
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.physical_parameters import PhysicalParameters
from micah_plan.execution.pilot import AskArm, ContinuePlan
from micah_plan.execution.plant import Plant
from micah_plan.recording.value import Recording
from micah_plan.task.plan import ArmTrajectory, Plan, Trajectory
from micah_plan.task.problem import Problem

Floats = NDArray[np.float64]
PlantKind = Literal["nominal", "mujoco"]
ProblemReplan = Callable[[Problem, HybridBelief], Trajectory | None]
Continuation = Callable[[Problem, Trajectory], ContinuePlan]
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class ErrorSummary:
    """Mean, standard deviation and maximum over trials [rad or m]."""

    mean: float
    std: float
    max: float


@dataclass(frozen=True, eq=False)
class TrialStatistics:
    """How a plan fared.

    Attributes:
        trials, successes: counts.
        final_error: of the true state, over all trials [rad or m].
        failures: (trial, reason) of those that did not end in the goal set.
        recording: the logs of all trials; the run is the trial's number.
        results: one per trial.
    """

    trials: int
    successes: int
    final_error: ErrorSummary
    failures: tuple[tuple[int, str], ...]
    recording: Recording
    results: tuple[TrialResult, ...]


def run_trials(
    problem: Problem,
    plan: Plan,
    *,
    plant: PlantKind | Plant = "nominal",
    trials: int = 1,
    seed: int = 0,
    max_steps: int | None = None,
    replan: ProblemReplan | None = None,
    continuation: Continuation | None = None,
    progress: Progress | None = None,
) -> TrialStatistics:
    """Execute a plan several times; trial i has its own random stream, the same whatever runs before it.

    Args:
        plant: which plant to build from the problem, or a plant.
        max_steps: control steps per trial at most; None: twice the plan's plus 20.
        replan: gives a trajectory from a belief; None: never replan.
        continuation: makes for a plan's trajectory what optimises the rest of it again; None: never.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if the plan is not a solution, or `trials` is less than 1.
        MissingDependencyError: if the plant needs a library that is not installed.
    """
    trajectory = plan.trajectory
    if plan.outcome != "solved" or trajectory is None:
        raise InputError(f"only a solved plan can be executed, this one is '{plan.outcome}': {plan.reason}")
    if trials < 1:
        raise InputError(f"trials must be at least 1. Got {trials}")
    again = None if replan is None else partial(replan, problem)
    onward = None if continuation is None else continuation(problem, trajectory)
    problem = replace(problem, start=replace(problem.start, mode=trajectory.modes[0]))
    machine = make_plant(problem, plant, plan.arm) if isinstance(plant, str) else plant
    results = []
    try:
        for trial in range(trials):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial,)))
            ways = partial(execute, arm=plan.arm, ask_arm=_arm_of(problem, plan), replan=again, continue_plan=onward)
            results.append(ways(problem, trajectory, machine, rng, run=trial, max_steps=max_steps))
            if progress is not None:
                done = sum(result.success for result in results)
                progress(f"trial {trial + 1} of {trials}: {done} successful", (trial + 1) / trials)
    finally:
        if isinstance(plant, str):
            machine.close()
    return summarise(results)


def _arm_of(problem: Problem, plan: Plan) -> AskArm | None:
    """Asks the arm of a problem whether it can follow a new plan, where it follows the present one."""
    if problem.robot is None or plan.arm is None:
        return None
    from micah_plan.robot.along_plan import arm_along  # Pinocchio is loaded only where there is an arm

    return lambda trajectory, joints: arm_along(problem, trajectory, start=joints)


def make_plant(problem: Problem, kind: PlantKind, arm: ArmTrajectory | None = None) -> Plant:
    """The plant of that kind for a problem's model, start belief and physical parameters; an arm starts as planned."""
    if kind == "mujoco" and problem.hold is not None:
        return HeldPlant(problem, posture=None if arm is None else arm.positions[0])
    if kind == "mujoco":
        return MujocoPlant(problem.automaton, problem.start, PhysicalParameters.from_mapping(problem.plant))
    if kind == "nominal":
        return NominalPlant(problem.automaton, problem.start, parameters_of(problem).control_period)
    raise InputError(f"unknown plant '{kind}'", remedy="choose nominal or mujoco")


def summarise(results: list[TrialResult]) -> TrialStatistics:
    """Counts, errors, failures and the joined log of trials (at least one)."""
    errors = np.array([result.final_error for result in results])
    failures = tuple((trial, result.reason) for trial, result in enumerate(results) if not result.success)
    return TrialStatistics(
        trials=len(results),
        successes=len(results) - len(failures),
        final_error=ErrorSummary(float(errors.mean()), float(errors.std()), float(errors.max())),
        failures=failures,
        recording=concatenated([result.recording for result in results]),
        results=tuple(results),
    )
