"""The whole loop in physics: a delay that nobody declared is found in the logs, and the next plan counts with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from extras import requires

from micah_plan.documents.problem import load_problem
from micah_plan.execution.closed_loop import Episode, execute_episode
from micah_plan.execution.log import concatenated_recordings
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.plant import Command
from micah_plan.planning.solver import solve
from micah_plan.residual.calibrate import calibrate

pytestmark = requires("sim")
LATE = 2


class LatePlant(StandingPlant):
    """Whose hand carries out what it was told two steps before."""

    def reset(self, rng):
        self._queue = [np.zeros((1, 3))] * LATE
        return super().reset(rng)

    def apply(self, order):
        self._queue.append(order.handle)
        return super().apply(replace(order, handle=self._queue.pop(0)))


def executed(problem, plan, seeds):
    """(log, errors when everything commanded has arrived, steps) of one run per seed."""
    plant = LatePlant(problem.automaton, problem.start, PhysicalParameters.from_mapping(problem.plant))
    logs, errors, steps = [], [], []
    for run, seed in enumerate(seeds):
        result = execute_episode(Episode(problem, plan.trajectory, run=run), plant, np.random.default_rng(seed))
        logs.append(result.recording)
        steps.append(result.steps)
        for _ in range(LATE + 1):
            plant.apply(Command(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3))))
        errors.append(problem.goal.error(plant.truth().x))
    plant.close()
    return concatenated_recordings(logs), np.array(errors), np.array(steps)


@pytest.mark.slow
def test_a_delay_is_found_and_planned_with(repository) -> None:
    problem = load_problem(repository / "problems" / "drawer_open.yaml")
    logs, _, before = executed(problem, solve(problem), range(4))
    found = calibrate(problem.automaton, logs)
    (effect,) = found.automaton.effects
    assert effect.name == "delay"
    assert effect.values[0] == pytest.approx(LATE, abs=0.2)
    improved = replace(problem, automaton=found.automaton)
    _, errors, after = executed(improved, solve(improved), range(10, 14))
    assert errors.max() < 0.01
    # Who does not know of it is surprised, waits before the goal is believed, and corrects what came too late.
    assert after.mean() < before.mean() - 2
