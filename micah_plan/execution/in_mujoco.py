"""The plant in MuJoCo for a problem: its object on its joints, or held by a hand among the bodies of its scene."""

from __future__ import annotations

import numpy as np

from micah_plan.execution.mujoco.held import HeldPlant
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.plant import Plant
from micah_plan.task.problem import Problem


def in_mujoco(problem: Problem) -> Plant:
    """Physics with the problem's parameters; an arm starts in the posture of the problem's start.

    Raises:
        MissingDependencyError: if MuJoCo is not installed.
        InputError: if the problem cannot be simulated.
    """
    if problem.hold is None:
        return StandingPlant(problem.automaton, problem.start, parameters_of(problem))
    posture = problem.start.posture
    return HeldPlant(problem, posture=None if posture is None else np.array(posture))
