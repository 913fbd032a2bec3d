"""Choice of each step's input: `PlanFollower` follows a plan, `Pilot` requests another when it fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.special import chdtri

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.input_memory import own_size
from micah_plan.automaton.transition import step
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution import messages
from micah_plan.planning.avoided_inputs import cut_off
from micah_plan.planning.feedback import feedback_input
from micah_plan.planning.input_memories import after_memories_run_out
from micah_plan.planning.limits import limited_input, limits_of
from micah_plan.task.plan import ArmTrajectory, Trajectory
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    from micah_plan.robot.tool_path import ArmFailure

Fit = Literal["on_plan", "strayed", "lagging", "finished", "off_plan"]
Replan = Callable[[HybridBelief, tuple[Trajectory, int]], Trajectory | None]
ContinuePlan = Callable[[HybridBelief, Trajectory, int], Trajectory | None]
AskArm = Callable[[Trajectory, Floats | None], "ArmTrajectory | ArmFailure"]

MOST_REPLANS = 5
# Steps that a late transition or a belief that waits at the last knot may take before a new plan is requested.
_PATIENCE = 3
# A belief further from its knot than this happens once in 100,000 steps if the model is right (4.4 sigma in 1-D).
_OFF_PLAN_PROBABILITY = 1e-5


@dataclass(frozen=True, eq=False)
class Advice:
    """The plan's advice for the present step.

    Attributes:
        u: (m,) the input to apply, within the limits.
        fit: ``"on_plan"``; ``"strayed"``: in the planned mode, but far from the knot; ``"lagging"``: a planned
            transition was missed, u works towards it; ``"finished"``: the last knot was reached, u holds it;
            ``"off_plan"``: the plan does not lead through this mode.
    """

    u: Floats
    fit: Fit


class PlanFollower:
    """Follows one trajectory knot by knot, as in the roll-outs of its verification.

    A belief in another mode than the knot's may still be in transition: transitions come a little earlier or later than
    planned, since plans go deeper into a guard than necessary. So the plan continues as long as its rest takes the
    estimate to the goal; otherwise the last transition is tried again.
    """

    def __init__(self, problem: Problem, trajectory: Trajectory) -> None:
        self._problem, self._automaton = problem, problem.automaton
        self._trajectory = trajectory
        self._max_step = limits_of(problem).max_step
        self._size = own_size(problem.automaton)
        self._knot = 0

    def advise(self, belief: HybridBelief) -> Advice:
        """The input for the belief, with the agreement of plan and belief; advances along the plan."""
        plan = self._trajectory
        number = belief.most_likely
        mode, estimate = self._automaton.modes[number].name, belief.means[number]
        self._skip_transitions()
        knot, agrees = self._knot, mode == plan.modes[self._knot]
        if knot == len(plan.inputs):
            if self._has_arrived(belief):
                return Advice(
                    self._without_unplanned_transitions(belief, self._input_at_end(belief, knot), knot - 1), "finished"
                )
        elif agrees or self._reaches_goal(mode, estimate):
            self._knot += 1
            strayed = agrees and self._is_off_plan(belief, knot)
            u = self._without_unplanned_transitions(belief, self._planned(mode, estimate, knot), knot)
            return Advice(u, "strayed" if strayed else "on_plan")
        earlier = [k for k in range(knot) if plan.modes[k] == mode]
        aim = earlier[-1] if earlier else knot
        fit: Fit = "lagging" if earlier else "off_plan"
        return Advice(
            self._without_unplanned_transitions(belief, self._input_towards(mode, estimate, aim), aim - 1), fit
        )

    @property
    def place(self) -> tuple[Trajectory, int]:
        """The trajectory, and the knot that the next input belongs to."""
        return self._trajectory, self._knot

    def is_finished(self, belief: HybridBelief) -> bool:
        """Whether the plan has no further steps for this belief."""
        self._skip_transitions()
        return self._knot == len(self._trajectory.inputs) and self._has_arrived(belief)

    def _has_arrived(self, belief: HybridBelief) -> bool:
        """Whether the belief is in the plan's final mode, or in another one within the goal."""
        number = belief.most_likely
        mode = self._automaton.modes[number].name
        return mode == self._trajectory.modes[-1] or self._problem.goal.contains(mode, belief.means[number])

    def _skip_transitions(self) -> None:
        """Advance to the knot of the next input."""
        while self._knot < len(self._trajectory.inputs) and self._trajectory.is_transition[self._knot]:
            self._knot += 1

    def _reaches_goal(self, mode: str, estimate: Floats) -> bool:
        """Whether the remaining plan with feedback leads a state to the goal without noise."""
        plan, x = self._trajectory, estimate
        for knot in range(self._knot, len(plan.inputs)):
            if not plan.is_transition[knot]:
                after = step(self._automaton, mode, x, self._planned(mode, x, knot), np.zeros_like(x))
                mode, x = after.mode, after.x
        return self._problem.goal.contains(mode, x)

    def _planned(self, mode: str, estimate: Floats, knot: int) -> Floats:
        """(m,) planned input at a knot with its feedback, within the limits."""
        return self._limited(mode, estimate, feedback_input(self._trajectory, knot, estimate))

    def _is_off_plan(self, belief: HybridBelief, knot: int) -> bool:
        """Whether the estimate is farther from the knot than plan and belief allow (Mahalanobis distance)."""
        number = belief.most_likely
        n = self._size  # a memory of inputs is known exactly
        away = belief.means[number][:n] - self._trajectory.means[knot][:n]
        planned, actual = self._trajectory.factors[knot][:n, :n], belief.factors[number][:n, :n]
        measured = np.square(self._automaton.sensing(self._automaton.modes[number]).std_at(belief.means[number]))[:n]
        covariance = planned @ planned.T + actual @ actual.T + np.diag(np.where(np.isfinite(measured), measured, 0.0))
        distance = float(away @ np.linalg.pinv(covariance) @ away)
        return distance > float(chdtri(away.size, _OFF_PLAN_PROBABILITY))

    def _input_at_end(self, belief: HybridBelief, knot: int) -> Floats:
        """The input at the end of the plan: repeat the last transition while it may not have occurred, else hold.

        A door that is believed shut is pressed once more: if it was shut, nothing changes, otherwise it now is. If the
        press would move a coordinate away from its goal, it is not repeated.
        """
        plan, number = self._trajectory, belief.most_likely
        mode, estimate = self._automaton.modes[number].name, belief.means[number]
        others = [q for q in np.argsort(-belief.weights, kind="stable") if q != number and belief.weights[q] > 0]
        for doubted in others[:1]:
            rival = self._automaton.modes[doubted].name
            earlier = [k for k in range(knot) if plan.modes[k] == rival]
            if earlier:
                again = self._input_towards(rival, belief.means[doubted], earlier[-1])
                after = step(self._automaton, mode, estimate, again, np.zeros_like(estimate))
                moved = np.abs(after.x - estimate)[: self._size].max(initial=0.0)
                if after.mode == mode and moved <= ROUND_OFF:
                    return again
        return self._input_towards(mode, estimate, knot)

    def _input_towards(self, mode: str, estimate: Floats, knot: int) -> Floats:
        """The smallest input that moves the driven coordinates closest to a knot."""
        effect, away = np.array(self._automaton.mode(mode).B), np.zeros_like(estimate)
        ahead = after_memories_run_out(
            self._automaton, mode, estimate
        )  # commands that have not arrived yet need not be repeated
        away[: self._size] = self._trajectory.means[knot][: self._size] - ahead[: self._size]
        u = np.linalg.pinv(effect) @ np.where(effect.any(axis=1), away, 0.0)
        return self._limited(mode, estimate, np.asarray(u, dtype=float))

    def _without_unplanned_transitions(self, belief: HybridBelief, u: Floats, knot: int) -> Floats:
        """An input outside the guards that the planned input of a knot is outside of; knot -1: at rest."""
        planned = self._trajectory.inputs[knot] if knot >= 0 else np.zeros_like(u)
        return np.asarray(cut_off(self._automaton, belief.weights[None], u[None], self._max_step, planned)[0])

    def _limited(self, mode: str, estimate: Floats, u: Floats) -> Floats:
        """(m,) input within the limits of a mode."""
        return limited_input(self._automaton.mode(mode), estimate, u, self._max_step)


@dataclass(frozen=True)
class Replanning:
    """Sources of new trajectories during an execution, and their acceptance test.

    Attributes:
        replan: returns a trajectory from a belief, or None if there is none, given the trajectory that is followed and
            the knot of the next input; None: never replan.
        continue_plan: the rest of a trajectory from a knot on, optimised again every `replan_every` steps; None: never.
        ask_arm: returns the arm's joints along a new trajectory, from the current joints, or its failure: such a
            trajectory is refused. None: new trajectories are followed unchecked.
    """

    replan: Replan | None = None
    continue_plan: ContinuePlan | None = None
    ask_arm: AskArm | None = None


class Pilot:
    """Decides the input of each step.

    Attributes:
        replans, continuations: how many new plans, and optimised rests of plans, are and were followed.
        refusals: why others were not.
        is_lost: whether the belief has left the plan for good and no new plan was found.
    """

    def __init__(
        self,
        problem: Problem,
        trajectory: Trajectory,
        arm: ArmTrajectory | None = None,
        replanning: Replanning | None = None,
    ) -> None:
        """Args: as for `closed_loop.Episode`, the problem including memories of inputs."""
        self._problem, self._arm, self._replanning = problem, arm, replanning or Replanning()
        self._follower = PlanFollower(problem, trajectory)
        self._followed = self._waited = self._asked = 0
        self.replans = self.continuations = 0
        self.refusals: list[str] = []
        self.is_lost = False

    def is_finished(self, belief: HybridBelief) -> bool:
        """Whether the plan that is followed has no further steps for this belief."""
        return self._follower.is_finished(belief)

    @property
    def posture(self) -> Floats | None:
        """(J,) joints of the arm after the next input, as in the plan."""
        return None if self._arm is None else self._arm.positions[self._follower.place[1]]

    def input(self, belief: HybridBelief, joints: Floats | None = None) -> Floats:
        """(m,) the input to apply now; joints (J,): where the arm is, None: as planned."""
        self._look_ahead(belief, joints)
        self._followed += 1
        advice, replan = self._follower.advise(belief), self._replanning.replan
        self._waited = 0 if advice.fit == "on_plan" else self._waited + 1
        serves = advice.fit not in ("strayed", "off_plan") and self._waited <= _PATIENCE
        if serves or replan is None:
            return advice.u
        if self._asked == MOST_REPLANS:
            self.is_lost = advice.fit in ("lagging", "off_plan")
            return advice.u
        self._asked += 1
        self._waited = 0
        fresh = replan(belief, self._follower.place)
        if fresh is None or not self._follow(fresh, joints):
            return advice.u
        self.replans += 1
        return self._follower.advise(belief).u

    def _follow(self, trajectory: Trajectory, joints: Floats | None) -> bool:
        """Switch to a new trajectory unless the arm cannot follow it; returns whether it did."""
        if self._replanning.ask_arm is not None:
            answer = self._replanning.ask_arm(trajectory, self.posture if joints is None else joints)
            if not isinstance(answer, ArmTrajectory):
                self.refusals.append(messages.arm_cannot_follow(answer.sentence))
                return False
            self._arm = answer
        self._follower = PlanFollower(self._problem, trajectory)
        self._followed = 0
        return True

    def _look_ahead(self, belief: HybridBelief, joints: Floats | None) -> None:
        """Every `replan_every` steps, optimise the rest of the plan from the belief."""
        continue_plan, due = self._replanning.continue_plan, 0 < self._problem.settings.replan_every <= self._followed
        if continue_plan is None or not due or self._follower.is_finished(belief):
            return
        fresh = continue_plan(belief, *self._follower.place)
        self._followed = 0
        if fresh is not None and self._follow(fresh, joints):
            self.continuations += 1
