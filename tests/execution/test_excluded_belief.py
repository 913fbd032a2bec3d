"""A belief that excludes what is measured is no success, however sure it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micah_plan import execute, solve
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import Command, Measurement
from micah_plan.task.problem import Problem

PROBLEM = Path(__file__).resolve().parents[2] / "problems" / "drawer_open.yaml"


class Machine:
    """Carries out a share of each command, and knows no truth."""

    def __init__(self, problem: Problem, share: float) -> None:
        self._driver, self._share = NominalPlant.of(problem), share

    def reset(self, rng: np.random.Generator) -> Measurement:
        return self._seen(self._driver.reset(rng))

    def apply(self, command: Command) -> Measurement:
        return self._seen(self._driver.apply(replace(command, input=self._share * np.array(command.input))))

    def _seen(self, seen: Measurement) -> Measurement:
        return Measurement(time=seen.time, position=seen.position, quaternion=seen.quaternion)

    def close(self) -> None:
        self._driver.close()


@pytest.mark.sweep
@pytest.mark.parametrize(("share", "arrives"), [(1.0, True), (0.1, False)])
def test_a_machine_that_hardly_moves_is_not_believed_to_have_arrived(share: float, arrives: bool) -> None:
    """A model with little noise hardly looks: it was sure of the goal, 130 mm from where the drawer was seen."""
    plan = solve(PROBLEM, advise=False)
    automaton = plan.problem.automaton
    sure = replace(automaton, noise=replace(automaton.noise, process_std=(1e-4,)))
    runs = execute(replace(plan, problem=replace(plan.problem, automaton=sure)), plant=lambda p: Machine(p, share))
    assert runs.successes == int(arrives)
    assert all("calibrate the model with this run" in reason for _, reason in runs.failures)
