"""The plan: an outcome with a sentence and, if solved, everything needed to execute and view it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from micah_plan.arrays import Booleans, Floats
from micah_plan.summaries import Summarised
from micah_plan.task.reason import Code, Offer, Reason

Outcome = Literal["solved", "no_plan", "not_verified"]
Level = Literal["start", "goal", "search", "optimisation", "verification", "arm"]
LEVELS: tuple[Level, ...] = get_args(Level)
"""In the order of planning."""


@dataclass(frozen=True)
class Finding:
    """An obstacle to a plan.

    Attributes:
        level: where it was found; start and goal are checked first.
        code: of the obstacle, for programmes; empty in files of older versions.
        sentence: the obstacle with its amount.
        remedy: the nearest change that could help.
        modes: the mode sequence that it is about; empty if it is about all.
        mode, knot: the place in it.
        constraint: the name of the one that does not hold.
        amount: of the violation [unit].
        room, need: available and required room, where the belief's spread is the cause [unit].
        unit: of the three.
        ways: candidates of the remedy, untested changes among them; not in plan files.
    """

    level: Level
    code: Code | Literal[""]
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
        """The finding of a reason at a level."""
        return cls(level, reason.code, reason.sentence, reason.remedy, modes, ways=reason.ways)


@dataclass(frozen=True)
class Candidate:
    """A mode sequence of the search with the result of its optimisation.

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
    """Purpose of a mode in a plan: the best alternative that never leaves through it.

    Attributes:
        mode: not the one that the plan starts in, which every plan visits.
        is_goal: whether the goal is in no other mode.
        why: the reason why there is no path without it; empty if there is one.
        without: the cheapest mode sequence without it; empty if there is none.
        steps_without: expected cost of that sequence, as `Candidate.search_cost` [steps].
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
    """Release after the last knot: the hand lowers until contact is felt, opens, and withdraws.

    Attributes:
        steps: largest number of steps down; contact is felt earlier.
        contact: (n,) state in which it is expected [rad or m].
        rest: (n,) expected state of the object at rest: where a hand would hold it there [rad or m].
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
    """Result of planning. Failed plans have no trajectory, so they cannot be executed by mistake.

    Attributes:
        outcome: ``"solved"``, ``"no_plan"`` (with the `reason`) or ``"not_verified"`` (found, but the roll-outs succeed
            too rarely for the required confidence; it has a trajectory for viewing only).
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
        findings: obstacles, most important first; of a solved plan, boundaries that it satisfies only in part.
        arm: the robot along the trajectory; None if the problem has none.
        release: how the hand releases the object in the end; None if it keeps the object.
        warnings: one line for each thing in the model that the plan does not take into account, or that learning
            was not sure of.
        purposes: of its modes, as far as the search could determine.
        alternatives: plans along the other candidates, to be verified in this order if roll-outs refuse this one; not
            in plan files.
        before_remedy: beginning of the reason, up to the remedy of the first finding; None: the reason has no remedy.
            Not in plan files.
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
    before_remedy: str | None = field(default=None, repr=False, compare=False)

    def summary(self) -> str:
        """Outcome and reason in one line."""
        return f"Plan, {self.outcome}: {self.reason}"

    @property
    def ranked_findings(self) -> tuple[Finding, ...]:
        """The findings in the order of planning; those of roll-outs or of the arm first where they decided."""
        ranked = sorted(self.findings, key=lambda finding: LEVELS.index(finding.level))
        if self.outcome == "not_verified":  # that is the reason; the boundaries may be the cause
            ranked.sort(key=lambda finding: finding.level not in ("verification", "arm"))
        return tuple(ranked)

    def refused_for(self, finding: Finding, before: str = "", *, outcome: Outcome = "not_verified") -> Plan:
        """The plan refused for an additional finding, whose sentence and remedy become the reason.

        Args:
            before: beginning of the reason.
        """
        beginning, findings = f"{before}{finding.sentence}; ", (finding, *self.findings)
        return replace(
            self, outcome=outcome, reason=f"{beginning}{finding.remedy}", findings=findings, before_remedy=beginning
        )

    @property
    def mode_sequence(self) -> tuple[str, ...]:
        """The modes visited, in order, without repetition of the same mode in a row."""
        if self.trajectory is None:
            return ()
        modes = self.trajectory.modes
        return tuple(q for i, q in enumerate(modes) if i == 0 or q != modes[i - 1])
