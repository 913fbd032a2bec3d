"""Belief trajectories of POMDP-HD beside the same programme in SciPy (`tests/reference/direct_transcription.py`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning_examples import drawer_problem, one_dimensional
from reference.direct_transcription import Phase, Task, cost, margins, plan

from micah_plan.automaton.hybrid import Noise
from micah_plan.planning.pomdp_hd import plan as planned
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

THRESHOLD = 0.3


def two_segments() -> Problem:
    """A slide in two segments, the second one long enough that nothing leads back over the threshold."""
    automaton = replace(one_dimensional(0.0, THRESHOLD, 1.0), noise=Noise((0.002,), (0.005,)))
    settings = PlannerSettings(max_step=(0.05,), samples_per_mode=40)
    goal = Goal(((0, 0.4, 0.01),), ("second",))
    return Problem(automaton, Start((0.1,), (0.02,)), goal, settings)


def as_task(problem: Problem, max_step: float) -> Task:
    ((_, target, tolerance),) = problem.goal.target
    settings, noise = problem.settings, problem.automaton.noise
    return Task(
        mean=problem.start.mean[0],
        std=problem.start.std[0],
        target=target,
        tolerance=tolerance,
        process=noise.process_std[0],
        observation=noise.observation_std[0],
        max_step=max_step,
        kappa=settings.sigmas,
        goal=settings.weight_goal,
        covariance=settings.weight_covariance,
        effort=settings.weight_effort,
    )


def compared(problem: Problem, max_step: float, gains: dict[str, float], ends: dict[str, float]) -> None:
    """Ours keeps the constraints of theirs, and is no dearer."""
    found = planned(problem)
    assert found.outcome == "solved"
    moved = ~found.trajectory.is_transition
    modes = np.array(found.trajectory.modes[:-1])[moved]
    phases = [Phase(gains[mode], int((modes == mode).sum()), ends.get(mode)) for mode in dict.fromkeys(modes)]
    task, ours = as_task(problem, max_step), found.trajectory.inputs[moved, 0]
    theirs = plan(task, phases)
    assert margins(task, phases, ours).min() > -1e-4 * task.tolerance
    assert cost(task, phases, ours) == pytest.approx(cost(task, phases, theirs), rel=0.02)


def test_one_mode_costs_what_it_costs_in_scipy() -> None:
    problem = drawer_problem(0.05, 0.2)
    settings = replace(problem.settings, max_step=(0.02,))
    compared(replace(problem, settings=settings), 0.02, {"slides": 1.0}, {})


def test_two_modes_with_a_guard_between_cost_what_they_cost_in_scipy() -> None:
    compared(two_segments(), 0.05, {"first": 1.0, "second": 1.0}, {"first": THRESHOLD})


def test_a_goal_out_of_reach_has_no_inputs() -> None:
    task = as_task(drawer_problem(0.05, 0.2), 0.02)
    with pytest.raises(ValueError, match="no inputs keep all constraints"):
        plan(task, [Phase(1.0, 3)])
