"""Execution of releases: step down until contact is felt, open the gripper, step away.

Contact ends the way down: the hand finds the height of the support by force, not by position. A hand that feels nothing
down to the lowest place where the support may be releases nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.errors import InputError
from micah_plan.execution.plant import Command, Measurement
from micah_plan.execution.pose import command
from micah_plan.planning.limits import limits_of
from micah_plan.task.plan import ArmTrajectory, ReleasePlan
from micah_plan.task.problem import Problem, Release

# The hand stops at so many times the force that counts as contact, so that noise does not decide.
_SURE_STDS = 1.5

Phase = Literal["lowering", "opening", "withdrawing", "done"]


class ReleaseController:
    """Issues the commands after the last knot of a plan with a release.

    Attributes:
        phase: current phase.
        felt: whether contact was felt.
    """

    def __init__(self, problem: Problem, release: Release, plan: ReleasePlan) -> None:
        """Args: problem: with the release; plan: how."""
        self.phase: Phase = "lowering"
        self.felt = False
        self._problem, self._release, self._plan = problem, release, plan
        grip = problem.hold.grip if problem.hold is not None else None
        children = [link.child for link in problem.automaton.links]
        self._row = children.index(grip.held.name) if grip is not None else 0
        self._largest = limits_of(problem).max_step
        self._steps = 0
        self._force: float | None = None

    def command(self, belief: HybridBelief, measurement: Measurement) -> Command | None:
        """The next command; None when the release is complete.

        Args:
            belief: after the measurement, or after the opening, before it.

        Raises:
            InputError: if the plant does not measure the force.
        """
        if self.phase == "lowering":
            force = self._pull(measurement)
            self._force = force if self._force is None else self._force
            self.felt = force <= self._force - self._release.force
            if self.felt:
                self.phase, self._steps = "opening", 0
            elif self._steps == self._plan.steps:
                self.phase = "done"
        if self.phase == "done" or (self.phase == "withdrawing" and self._steps == len(self._plan.withdrawal)):
            self.phase = "done"
            return None
        automaton, number = self._problem.automaton, belief.most_likely
        name, mean = automaton.modes[number].name, belief.means[number][: automaton.n]
        order = command(automaton, name, mean, self._input(automaton, mean))
        if self.phase == "opening":
            self.phase = "withdrawing"
            return replace(order, opens=True, posture=self._posture(self._plan.withdrawing, 0))
        self._steps += 1
        if self.phase == "withdrawing":
            return replace(order, posture=self._posture(self._plan.withdrawing, self._steps))
        limit, posture = _SURE_STDS * self._release.force, self._posture(self._plan.lowering, self._steps)
        return replace(order, force_limit=limit, posture=posture)

    def _input(self, automaton: HybridAutomaton, mean: Floats) -> Floats:
        """(m,) displacement of the hand: down with a correction toward the planned position, or away."""
        u = np.zeros(automaton.m)
        if self.phase == "withdrawing":
            u[:3] = self._plan.withdrawal[self._steps]
        elif self.phase == "lowering":
            away = self._plan.contact[:2] - mean[:2]
            u[:2] = np.clip(away, -self._largest[:2], self._largest[:2])
            u[2] = -self._release.step
        return u

    def _pull(self, measurement: Measurement) -> float:
        """Upward force of the hand on the object [N]."""
        if measurement.force is None:
            text = "a release needs a plant that measures the force on the hand: Measurement.force is None"
            raise InputError(text, remedy="measure it, or leave 'release' out of the problem")
        return float(measurement.force[self._row, 2])

    @staticmethod
    def _posture(arm: ArmTrajectory | None, step: int) -> Floats | None:
        """(J,) joints at a step of the arm's path; None without one."""
        return None if arm is None else np.asarray(arm.positions[min(step, len(arm.positions) - 1)])
