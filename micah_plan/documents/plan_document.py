"""The layout of a plan file, `format: micah-plan/plan/1` (JSON, written and read by `plan_file`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AliasChoices, Field

from micah_plan.documents.fields import Document, Line, Name, NonNegative
from micah_plan.task.plan import Level, Outcome

PLAN_FORMAT = "micah-plan/plan/1"
Probability = Annotated[float, Field(ge=0, le=1)]


class CandidateDocument(Document):
    modes: list[Name] = Field(description="Mode sequence.")
    search_cost: float = Field(description="Cost of its cheapest roadmap path.")
    cost: float | None = Field(description="Optimised cost; null if the optimisation failed.")
    message: str = Field(description="What became of it.")


class FindingDocument(Document):
    level: Level = Field(description="Where it was found.")
    sentence: str = Field(description="What is wrong.")
    remedy: str = Field(description="The nearest change that could help.")
    modes: list[Name] = Field(description="The mode sequence that it is about; empty: all.")
    mode: str = Field(description="The mode in it; may be empty.")
    knot: Annotated[int, Field(ge=0)] | None = Field(description="The knot in it.")
    constraint: str = Field(description="What does not hold.")
    amount: float | None = Field(description="By how much [unit].")
    room: float | None = Field(description="What there is [unit].")
    need: float | None = Field(description="What is needed [unit].")
    unit: str = Field(description="Of the three.")


class TrajectoryDocument(Document):
    modes: Annotated[list[Name], Field(min_length=1)] = Field(description="(K) mode at each knot.")
    means: list[list[float]] = Field(description="(K, n) of the belief [rad or m].")
    factors: list[list[list[float]]] = Field(description="(K, n, n) lower Cholesky factors of its covariance.")
    inputs: list[list[float]] = Field(description="(K-1, m) from knot to knot [rad or m].")
    gains: list[list[list[float]]] = Field(description="(K-1, m, n) feedback gains.")
    is_transition: list[bool] = Field(description="(K-1) whether the step is a transition.")


class ArmDocument(Document):
    joints: Annotated[list[Name], Field(min_length=1)] = Field(description="(J) names, from the root to the tool.")
    positions: list[list[float]] = Field(description="(K, J) at the knots, straight lines in between [rad or m].")
    manipulability: list[NonNegative] = Field(description="(K) Yoshikawa's measure; 0 at singularities.")
    clearance: list[float | None] = Field(description="(K) smallest distance at each knot [m]; null: nothing to meet.")
    least_clearance: float | None = Field(description="Smallest distance at and between all knots [m].")
    closest_pair: list[Line] = Field(description="The two that come so close.")
    closest_knot: Annotated[int, Field(ge=0)] = Field(description="The knot at or after which they do.")
    deviation: NonNegative = Field(description="How far the tool strays between knots from a straight line [m].")


class PlanDocument(Document):
    """A plan with the whole problem that it solves, so that it can be executed and shown without other files."""

    format: Literal["micah-plan/plan/1"] = Field(description="Format and version of this file.")
    version: Line = Field(description="Version of micah_plan that wrote it.")
    digest: str = Field(description="SHA-256 of everything else in this file.")
    outcome: Outcome = Field(description="solved, no_plan or not_verified.")
    reason: str = Field(description="One sentence.")
    mode_sequence: list[Name] = Field(description="Modes visited, in order.")
    cost: float | None = Field(description="Total cost of the trajectory.")
    goal_error: NonNegative | None = Field(description="Largest predicted distance from the goal [rad or m].")
    goal_std: NonNegative | None = Field(description="Largest predicted std at the goal [rad or m].")
    success_probability: Probability | None = Field(description="Share of roll-outs that ended in the goal set.")
    success_interval: Annotated[list[Probability], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="95 % interval of the probability of success, given that share."
    )
    verification_trials: Annotated[int, Field(ge=0)] = Field(description="Number of roll-outs.")
    seed: int = Field(description="Seed of search and verification.")
    candidates: list[CandidateDocument] = Field(description="Mode sequences tried, cheapest search cost first.")
    findings: list[FindingDocument] = Field(
        default_factory=list,
        validation_alias=AliasChoices("findings", "obstacles"),  # as files before version 0.2 call them
        description="What stands in the way; of a solved plan, what it keeps only in part.",
    )
    warnings: list[Line] = Field(default_factory=list, description="What of the model the plan leaves out.")
    trajectory: TrajectoryDocument | None = Field(description="Belief trajectory and feedback; null without a plan.")
    arm: ArmDocument | None = Field(default=None, description="The robot along the trajectory; null without a robot.")
    problem_file: Line = Field(description="Name of the problem file that was solved; empty if made in Python.")
    digests: dict[Name, Line] = Field(description="SHA-256 of the input files, by role.")
    problem: dict[str, Any] = Field(description="The problem, laid out as a problem file.")
    model: dict[str, Any] = Field(description="Its model with the noise planned with, laid out as a model file.")
