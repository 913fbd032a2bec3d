"""Following a plan: which knot the execution is at, the input there, and whether the plan still fits the belief."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.transition import step
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.pose import input_towards
from micah_plan.planning.limits import limited_input
from micah_plan.planning.plan import Trajectory
from micah_plan.planning.policy import feedback_input

Floats = NDArray[np.float64]
Fit = Literal["on_plan", "lagging", "finished", "off_plan"]

# A belief further from its knot than this happens once in 100,000 steps if the model is right (4.4 sigma in 1-D).
_OFF_PLAN_PROBABILITY = 1e-5


@dataclass(frozen=True, eq=False)
class Advice:
    """What the plan says now.

    Attributes:
        u: (m,) the input to apply, within the limits.
        fit: ``"on_plan"``; ``"lagging"``: a planned transition has not happened yet, u works towards it;
            ``"finished"``: the last knot was reached, u holds it; ``"off_plan"``: the belief has left the plan.
    """

    u: Floats
    fit: Fit


class PlanFollower:
    """Walks along one trajectory, a knot per call, waiting where a transition is late."""

    def __init__(self, automaton: HybridAutomaton, trajectory: Trajectory, max_step: Floats) -> None:
        self._automaton = automaton
        self._trajectory = trajectory
        self._max_step = max_step
        self._knot = 0

    def advise(self, belief: HybridBelief) -> Advice:
        """The input for the belief, and how well plan and belief agree. Advances along the plan."""
        plan = self._trajectory
        number = belief.most_likely
        mode, estimate = self._automaton.modes[number].name, belief.means[number]
        self._align(mode)
        knot = self._knot
        if knot == len(plan.inputs):
            if mode == plan.modes[knot]:
                return Advice(self._settle(belief, knot), "finished")
        else:
            u = self._limited(mode, estimate, feedback_input(plan, knot, estimate))
            agrees = mode == plan.modes[knot]
            if agrees or step(self._automaton, mode, estimate, u, np.zeros_like(estimate)).mode == plan.modes[knot]:
                self._knot += 1
                strayed = agrees and self._strayed(belief, knot)
                return Advice(u, "off_plan" if strayed else "on_plan")
        earlier = [k for k in range(knot) if plan.modes[k] == mode]
        if earlier:
            return Advice(self._towards(mode, estimate, earlier[-1]), "lagging")
        return Advice(self._towards(mode, estimate, knot), "off_plan")

    @property
    def place(self) -> tuple[Trajectory, int]:
        """The trajectory, and the knot that the next input belongs to."""
        return self._trajectory, self._knot

    def is_finished(self, belief: HybridBelief) -> bool:
        """Whether the plan has no further steps for this belief."""
        mode = self._automaton.modes[belief.most_likely].name
        self._align(mode)
        return self._knot == len(self._trajectory.inputs) and mode == self._trajectory.modes[-1]

    def _align(self, mode: str) -> None:
        """Move on to the knot that the next input belongs to."""
        self._skip_transitions()
        self._catch_up_with(mode)

    def _skip_transitions(self) -> None:
        while self._knot < len(self._trajectory.inputs) and self._trajectory.is_transition[self._knot]:
            self._knot += 1

    def _catch_up_with(self, mode: str) -> None:
        """If the object is already in a mode that the plan enters later, go on from there."""
        plan = self._trajectory
        if mode != plan.modes[self._knot] and mode not in plan.modes[: self._knot]:
            later = [k for k in range(self._knot, len(plan.modes)) if plan.modes[k] == mode]
            self._knot = later[0] if later else self._knot
            self._skip_transitions()

    def _strayed(self, belief: HybridBelief, knot: int) -> bool:
        """Whether the estimate is further from the knot than plan and belief together allow (Mahalanobis distance)."""
        number = belief.most_likely
        away = belief.means[number] - self._trajectory.means[knot]
        planned, actual = self._trajectory.factors[knot], belief.factors[number]
        measured = np.square(self._automaton.sensing(self._automaton.modes[number]).std_at(belief.means[number]))
        covariance = planned @ planned.T + actual @ actual.T + np.diag(np.where(np.isfinite(measured), measured, 0.0))
        distance = float(away @ np.linalg.pinv(covariance) @ away)
        return distance > float(chi2.isf(_OFF_PLAN_PROBABILITY, away.size))

    def _settle(self, belief: HybridBelief, knot: int) -> Floats:
        """The input at the end of the plan: repeat the last transition as long as it may not have happened, or hold.

        A door that is believed shut is pressed once more: if it was, nothing changes, and else it now is.
        """
        plan, number = self._trajectory, belief.most_likely
        mode, estimate = self._automaton.modes[number].name, belief.means[number]
        others = [q for q in np.argsort(-belief.weights, kind="stable") if q != number and belief.weights[q] > 0]
        for doubted in others[:1]:
            other = self._automaton.modes[doubted].name
            earlier = [k for k in range(knot) if plan.modes[k] == other]
            if earlier:
                again = self._towards(other, belief.means[doubted], earlier[-1])
                if step(self._automaton, mode, estimate, again, np.zeros_like(estimate)).mode == mode:
                    return again
        return self._towards(mode, estimate, knot)

    def _towards(self, mode: str, estimate: Floats, knot: int) -> Floats:
        """The input towards a knot; what the mode holds is not pulled at, which could release it."""
        away = self._trajectory.means[knot] - estimate
        away[[pin.coordinate for pin in self._automaton.mode(mode).pins]] = 0.0
        return self._limited(mode, estimate, input_towards(self._automaton, mode, away))

    def _limited(self, mode: str, estimate: Floats, u: Floats) -> Floats:
        return limited_input(self._automaton.mode(mode), estimate, u, self._max_step)
