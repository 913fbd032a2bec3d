"""Deciding the input of each step: a plan is followed, and another asked for when it no longer serves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.follower import Advice, PlanFollower
from micah_plan.task.plan import ArmTrajectory, Trajectory
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    from micah_plan.robot.tool_path import ArmFailure

Floats = NDArray[np.float64]
Replan = Callable[[HybridBelief, tuple[Trajectory, int]], Trajectory | None]
ContinuePlan = Callable[[HybridBelief, Trajectory, int], Trajectory | None]
AskArm = Callable[[Trajectory, Floats | None], "ArmTrajectory | ArmFailure"]

MOST_REPLANS = 5
# Steps that a late transition or a belief held at the last knot may take before a new plan is asked for.
_PATIENCE = 3


@dataclass(frozen=True)
class Replanning:
    """Where new trajectories come from during an execution, and who may refuse them.

    Attributes:
        replan: gives a trajectory from a belief, or None if there is none, told the trajectory that is followed and the
            knot that the next input belongs to; None: never replan.
        continue_plan: the rest of a trajectory from a knot on, optimised again every `replan_every` steps; None: never.
        ask_arm: gives the arm's joints along a new trajectory, from the joints that it is at, or what stands in the
            way: such a trajectory is refused. None: new trajectories are followed without asking.
    """

    replan: Replan | None = None
    continue_plan: ContinuePlan | None = None
    ask_arm: AskArm | None = None


class Pilot:
    """Decides the input of each step: follows the plan, and asks for another when the plan no longer serves."""

    def __init__(
        self,
        problem: Problem,
        trajectory: Trajectory,
        arm: ArmTrajectory | None = None,
        replanning: Replanning | None = None,
    ) -> None:
        """Args: as of `closed_loop.Episode`, the problem with the memory of its inputs."""
        replanning = replanning or Replanning()
        self._problem = problem
        self._arm = arm
        self._ask_arm = replanning.ask_arm
        self._replan = replanning.replan
        self._continue_plan = replanning.continue_plan
        self._every = problem.settings.replan_every
        self._followed = 0
        self._waited = 0
        self._asked = 0
        self.replans = 0
        self.continuations = 0
        self.refusals: list[str] = []
        self.is_lost = False
        """Whether the belief has left the plan for good: none of the new plans asked for leads on."""
        self._follower = PlanFollower(self._problem, trajectory)

    def is_finished(self, belief: HybridBelief) -> bool:
        """Whether the plan that is followed has no further steps for this belief."""
        return self._follower.is_finished(belief)

    @property
    def posture(self) -> Floats | None:
        """(J,) joints that the arm shall come to by the next input, as the plan that is followed has them."""
        return None if self._arm is None else self._arm.positions[self._follower.place[1]]

    def input(self, belief: HybridBelief, joints: Floats | None = None) -> Floats:
        """(m,) the input to apply now; joints (J,): where the arm is, None: as planned."""
        self._look_ahead(belief, joints)
        self._followed += 1
        advice = self._follower.advise(belief)
        self._waited = 0 if advice.fit == "on_plan" else self._waited + 1
        if not self._wants_replan(advice) or self._replan is None:
            return advice.u
        if self._asked == MOST_REPLANS:
            self.is_lost = advice.fit in ("lagging", "off_plan")
            return advice.u
        self._asked += 1
        self._waited = 0
        fresh = self._replan(belief, self._follower.place)
        if fresh is None or not self._follow(fresh, joints):
            return advice.u
        self.replans += 1
        return self._follower.advise(belief).u

    def _follow(self, trajectory: Trajectory, joints: Floats | None) -> bool:
        """Whether a new trajectory is followed from now on: not if the arm cannot."""
        if self._ask_arm is not None:
            answer = self._ask_arm(trajectory, self.posture if joints is None else joints)
            if not isinstance(answer, ArmTrajectory):
                self.refusals.append(f"the arm cannot follow: {answer.sentence}")
                return False
            self._arm = answer
        self._follower = PlanFollower(self._problem, trajectory)
        self._followed = 0
        return True

    def _look_ahead(self, belief: HybridBelief, joints: Floats | None) -> None:
        """Where it is time to, optimise the rest of the plan from the belief."""
        due = self._continue_plan is not None and 0 < self._every <= self._followed
        if self._continue_plan is None or not due or self._follower.is_finished(belief):
            return
        fresh = self._continue_plan(belief, *self._follower.place)
        self._followed = 0
        if fresh is not None and self._follow(fresh, joints):
            self.continuations += 1

    def _wants_replan(self, advice: Advice) -> bool:
        return advice.fit in ("strayed", "off_plan") or self._waited > _PATIENCE
