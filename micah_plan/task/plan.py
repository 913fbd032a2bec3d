"""The plan: an outcome with a sentence, and if it is a success all that executing and viewing it needs.

**Acceptance.** With how many successes among roll-outs a plan is accepted: where it is verified, and where a plan file
is read.

**Contradictions.** Whether a plan that says it is solved can be the solution of its problem: what its numbers alone
contradict.

A file may have been written by anything, so a digest that fits says little. Nothing is simulated here: a share of
successes below the confidence, a last state that is not where the plan says, a step that the model does not make.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from micah_plan.arrays import EQUAL, Booleans, Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.quantities import Summarised
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Offer, Reason

Outcome = Literal["solved", "no_plan", "not_verified"]
Level = Literal["start", "goal", "search", "optimisation", "verification", "arm"]


@dataclass(frozen=True)
class Finding:
    """What stands in the way of a plan.

    Attributes:
        level: where it was found; start and goal are checked first.
        sentence: what is wrong, with its amount.
        remedy: the nearest change that could help.
        modes: the mode sequence that it is about; empty if it is about all.
        mode, knot: the place in it.
        constraint: the name of the one that does not hold.
        amount: by how much [unit].
        room, need: available and required room, where the belief's spread is the cause [unit].
        unit: of the three.
        ways: of which the remedy is one, changes that were not tried yet among them; no part of a plan file.
    """

    level: Level
    sentence: str
    remedy: str
    modes: tuple[str, ...] = ()
    mode: str = ""
    knot: int | None = None
    constraint: str = ""
    amount: float | None = None
    room: float | None = None
    need: float | None = None
    unit: str = ""
    ways: tuple[str | Offer, ...] = field(default=(), compare=False, repr=False)

    @classmethod
    def of(cls, level: Level, reason: Reason, modes: tuple[str, ...] = ()) -> Finding:
        """A reason at a level."""
        return cls(level, reason.sentence, reason.remedy, modes, ways=reason.ways)


@dataclass(frozen=True)
class Candidate:
    """One mode sequence that the search proposed and what became of it.

    Attributes:
        modes: the sequence.
        search_cost: of its best roadmap path, predicted uncertainty included, in steps.
        cost: optimised cost; None if the optimisation failed.
        message: how the optimisation ended, in plain words (the failed constraint by name).
    """

    modes: tuple[str, ...]
    search_cost: float
    cost: float | None
    message: str


@dataclass(frozen=True)
class ModePurpose:
    """Why a plan visits a mode: what the search finds, among the same states, where nothing leaves that mode.

    Attributes:
        mode: not the one that the plan starts in, which every plan visits.
        is_goal: whether the goal is in no other mode.
        why: why there is no way without it; empty if there is one.
        without: the cheapest mode sequence without it; empty if there is none.
        steps_without: what the search expects that to cost, as `Candidate.search_cost` [steps].
    """

    mode: str
    is_goal: bool = False
    why: str = ""
    without: tuple[str, ...] = ()
    steps_without: float | None = None


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The belief trajectory over K knots and the feedback around it.

    Attributes:
        modes: (K,) mode at each knot. At a transition two successive knots share one time: the belief before the guard
            and the belief after the reset; the input between them is zero and `is_transition` is true.
        means: (K, n) of the belief [rad or m]; the model's coordinates, then its memory of inputs if it has one.
        factors: (K, n, n) lower Cholesky factors of its covariance.
        inputs: (K-1, m) nominal input from knot to knot.
        gains: (K-1, m, n): executed input = inputs[k] + gains[k] @ (estimate - means[k]).
        is_transition: (K-1,) whether the step from knot to knot is a transition rather than a time step.
    """

    modes: tuple[str, ...]
    means: Floats
    factors: Floats
    inputs: Floats
    gains: Floats
    is_transition: Booleans

    def of_first(self, n: int) -> Trajectory:
        """The trajectory of the first n coordinates: of the object, without a memory of inputs."""
        return replace(self, means=self.means[:, :n], factors=self.factors[:, :n, :n], gains=self.gains[:, :, :n])


@dataclass(frozen=True, eq=False)
class ArmTrajectory:
    """The arm along a plan: joint positions at each of the K knots of its trajectory, straight lines in between.

    Attributes:
        joints: (J,) names, from the arm's root to its tool.
        positions: (K, J) [rad or m].
        manipulability: (K,) Yoshikawa's sqrt(det(J J')) of the tool; 0 at singularities.
        clearance: (K,) smallest distance at each knot between things that must not meet [m]; None where nothing can.
        least_clearance: the smallest distance at and between all knots [m]; None if nothing can meet.
        closest_pair: names of the two that come so close; empty if nothing can meet.
        closest_knot: the knot at or after which they do.
        deviation: largest distance of the tool, halfway between knots, from the middle of its positions at them [m].
        limit_margin: smallest distance of a joint from an end of its range [rad or m]; None if no joint has one.
        limit_joint, limit_unit: its name and unit.
    """

    joints: tuple[str, ...]
    positions: Floats
    manipulability: Floats
    clearance: tuple[float | None, ...]
    least_clearance: float | None
    closest_pair: tuple[str, ...]
    closest_knot: int
    deviation: float
    limit_margin: float | None = None
    limit_joint: str = ""
    limit_unit: str = "rad"


@dataclass(frozen=True, eq=False)
class ReleasePlan:
    """How the hand releases the object after the last knot: it is lowered until contact is felt, opens, and withdraws.

    Attributes:
        steps: at most so many go down; contact is felt earlier.
        contact: (n,) state in which it is expected [rad or m].
        rest: (n,) state of the object at rest that is expected then: where a hand would hold it there [rad or m].
        withdrawal: (W, 3) displacements of the hand, base frame [m].
        lowering, withdrawing: the arm meanwhile, from the last knot down to the lowest place where contact may be felt,
            and from the expected contact away with the gripper open; None without one.
    """

    steps: int
    contact: Floats
    rest: Floats
    withdrawal: Floats
    lowering: ArmTrajectory | None = None
    withdrawing: ArmTrajectory | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Summarised):
    """What `solve` returns. A plan without success has no trajectory, so it cannot be executed by mistake.

    Attributes:
        outcome: ``"solved"``, ``"no_plan"`` (nothing found; `reason` says why) or ``"not_verified"`` (found, but the
            roll-outs succeed too rarely for the asked confidence; it has a trajectory for viewing only).
        reason: one sentence, with the remedy if it failed.
        trajectory: None unless one was found.
        candidates: all mode sequences tried, cheapest search cost first.
        cost: total cost of the trajectory.
        goal_error: largest predicted |mean - target| over the goal's coordinates at the last knot [rad or m].
        goal_std: largest predicted std over the goal's coordinates there [rad or m].
        success_probability: share of verification roll-outs that ended in the goal set.
        verification_trials: how many roll-outs that share is of.
        seed: the seed of search and verification.
        timings: seconds by stage; kept out of the plan file.
        success_interval: 95 % interval of the probability of success, given that share; None if it was not verified.
        findings: what stands in the way, most important first; of a solved plan, which boundaries it keeps only in
            part.
        arm: the robot along the trajectory; None if the problem has none.
        release: how the hand releases the object in the end; None if it keeps the object.
        warnings: one line for each thing in the model that the plan does not take into account, or that learning
            was not sure of.
        purposes: why it visits its modes, as far as the search can tell.
        alternatives: plans along the other candidates, to be tried in this order where roll-outs refuse this one; kept
            out of the plan file.
    """

    outcome: Outcome
    reason: str
    trajectory: Trajectory | None = None
    candidates: tuple[Candidate, ...] = ()
    cost: float | None = None
    goal_error: float | None = None
    goal_std: float | None = None
    success_probability: float | None = None
    verification_trials: int = 0
    seed: int = 0
    timings: dict[str, float] = field(default_factory=dict)
    success_interval: tuple[float, float] | None = None
    findings: tuple[Finding, ...] = ()
    arm: ArmTrajectory | None = None
    release: ReleasePlan | None = None
    warnings: tuple[str, ...] = ()
    purposes: tuple[ModePurpose, ...] = ()
    alternatives: tuple[Plan, ...] = field(default=(), repr=False, compare=False)

    def summary(self) -> str:
        """Outcome and reason in one line."""
        return f"Plan, {self.outcome}: {self.reason}"

    @property
    def mode_sequence(self) -> tuple[str, ...]:
        """The modes visited, in order, without repetition of the same mode in a row."""
        if self.trajectory is None:
            return ()
        modes = self.trajectory.modes
        return tuple(q for i, q in enumerate(modes) if i == 0 or q != modes[i - 1])


# The share of successes may fall short of the confidence by that many of its standard errors.
_STANDARD_ERRORS = 2.0
# Probability that a plan just below a confidence passes as many roll-outs as show it.
_LUCK = 0.05


def least_trials(confidence: float) -> int:
    """How many roll-outs, all of them successes, it takes to show a confidence: fewer would do so by luck.

    With that many in a row, a plan that succeeds less often is excluded at 95 % (the exact rule of three).
    """
    return math.ceil(math.log(_LUCK) / math.log(confidence))


def least_share(confidence: float, trials: int) -> float:
    """The smallest share of successes among the roll-outs with which a plan is accepted.

    It lies two standard errors below the confidence, those of a plan whose true probability is the confidence: the
    standard error of the observed share would vanish where nothing succeeds.
    """
    return confidence - _STANDARD_ERRORS * math.sqrt(confidence * (1.0 - confidence) / max(trials, 1))


def executable_trajectory(plan: Plan, *, anyway: bool = False, source: str | None = None) -> Trajectory:
    """The trajectory of a plan that solves its problem.

    Args:
        anyway: whether one that was found but not verified will do.
        source: the file that the plan is in.

    Raises:
        InputError: if the plan has another outcome.
    """
    if plan.trajectory is not None and (plan.outcome == "solved" or anyway):
        return plan.trajectory
    remedy = "only a solved plan can be executed"
    if plan.trajectory is not None:
        remedy += "; `execute --anyway` shows in simulation how this one fails"
    raise InputError(f"plan has outcome {plan.outcome}: {plan.reason}", source=source, remedy=remedy)


def disagreement(plan: Plan, problem: Problem) -> tuple[str, str] | None:
    """The key of a plan file and what contradicts there; None where a plan is not solved, or agrees."""
    if plan.outcome != "solved" or plan.trajectory is None:
        return None
    share, confidence = plan.success_probability, problem.settings.confidence
    if share is not None and share < (least := least_share(confidence, plan.verification_trials)):
        said = f"outcome solved, but its share of successes {share:g} is less than the {least:.3g} that"
        return "success_probability", f"{said} the confidence {confidence:g} asks for"
    if (amiss := _belief_amiss(plan.trajectory.factors)) is not None:
        return "trajectory.factors", amiss
    return _step_amiss(plan.trajectory, problem) or _end_amiss(plan, plan.trajectory, problem)


def _belief_amiss(factors: Floats) -> str | None:
    """The first covariance (K, n, n) whose factor is none."""
    for k, factor in enumerate(factors):
        if np.triu(factor, 1).any() or (np.diag(factor) < 0).any():
            return f"knot {k}: expected a lower triangular factor with a diagonal of at least 0"
    return None


def _end_amiss(plan: Plan, trajectory: Trajectory, problem: Problem) -> tuple[str, str] | None:
    """The last knot against the goal; what is released comes to rest elsewhere."""
    goal, last = problem.goal, trajectory.modes[-1]
    if problem.release is not None:
        return None
    error = goal.error(trajectory.means[-1])
    if plan.goal_error is not None and abs(error - plan.goal_error) > EQUAL:
        return (
            "goal_error",
            f"expected the distance {error:g} of the last knot from the goal, found {plan.goal_error:g}",
        )
    std = goal.std(trajectory.factors[-1])
    if plan.goal_std is not None and abs(std - plan.goal_std) > EQUAL:
        return "goal_std", f"expected the std {std:g} of the last knot, found {plan.goal_std:g}"
    if not goal.contains(last, trajectory.means[-1]):
        return "trajectory", f"outcome solved, but its last knot, in mode '{last}', is not in the goal"
    return None


def _step_amiss(trajectory: Trajectory, problem: Problem) -> tuple[str, str] | None:
    """The first step that the model does not make."""
    automaton, largest = problem.automaton, problem.settings.max_step
    for k, u in enumerate(trajectory.inputs):
        before, after = trajectory.modes[k : k + 2]
        if trajectory.is_transition[k]:
            if after not in _reached_in_one_instant(automaton, before):
                return (
                    "trajectory",
                    f"knot {k}: no transition of the model leads from '{before}' to '{after}'",
                )
            continue
        if before != after:
            return "trajectory", f"knot {k}: the mode changes from '{before}' to '{after}' without a transition"
        if largest is not None and (np.abs(u) > np.array(largest) + EQUAL).any():
            return "trajectory", f"knot {k}: an input of {np.abs(u).max():g} is more than the largest step"
        moved = trajectory.means[k + 1] - trajectory.means[k]
        # Effects and memories change what an input does; the verification's roll-outs have them, this has not.
        if not automaton.effects and not np.allclose(moved, automaton.mode(before).B @ u, rtol=0, atol=EQUAL):
            return "trajectory", f"knot {k}: the model's step in mode '{before}' does not lead to the next knot"
    return None


def _reached_in_one_instant(automaton: HybridAutomaton, source: str) -> set[str]:
    """The modes behind a transition from `source`, and behind those that can follow it at the same instant.

    A plan has one transition between two knots, also where the model takes several
    (`planning.zero_time_transitions`): the input fires the first of them, the state that each leads to fires the next.
    """
    reached = {edge.target for edge in automaton.edges_from(source)}
    new = set(reached)
    while new:
        following = (edge for mode in new for edge in automaton.edges_from(mode))
        new = {edge.target for edge in following if edge.guard.on_state and not edge.guard.on_input} - reached
        reached |= new
    return reached
