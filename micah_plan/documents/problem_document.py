"""The layout of a problem file, `format: micah-plan/problem/1`. What it means is built in `problem_values`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from micah_plan.documents.fields import Document, Line, Name, NonNegative, Positive
from micah_plan.documents.hold_document import HoldDocument
from micah_plan.documents.model_document import LightDocument
from micah_plan.documents.scene_document import BodyDocument, GraspDocument, RobotDocument
from micah_plan.task.settings import Method, PlannerSettings

PROBLEM_FORMAT = "micah-plan/problem/1"
Confidence = Annotated[float, Field(gt=0.5, lt=1.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


class StartDocument(Document):
    mean: dict[Name, float] = Field(description="Mean of every coordinate [rad or m].")
    std: dict[Name, Positive] = Field(description="Standard deviation of every coordinate [rad or m].")
    mode: Name | None = Field(
        default=None, description="Mode at first; default: the first whose invariant holds the mean."
    )


class TargetDocument(Document):
    value: float = Field(description="Wanted value [rad or m].")
    tolerance: Positive = Field(description="Largest accepted distance from it [rad or m].")


class GoalDocument(Document):
    target: dict[Name, TargetDocument] = Field(
        default_factory=dict, description="Wanted value of any subset of the coordinates."
    )
    modes: list[Name] = Field(default_factory=list, description="Modes that count as reached; empty: any.")


class ProblemNoiseDocument(Document):
    process_std: dict[Name, NonNegative] = Field(
        default_factory=dict, description="Std of what the dynamics leave unexplained [rad or m, per step]."
    )
    observation_std: dict[Name, Positive] = Field(
        default_factory=dict, description="Std of one measurement of the configuration [rad or m]."
    )
    light: LightDocument | None = Field(
        default=None, description="Where measurements are best, instead of the model's."
    )


class PlannerDocument(Document):
    method: Method = Field(
        default=PlannerSettings.method,
        description="The planner: POMDP-HD, or a baseline to compare it with; all are verified alike.",
    )
    samples_per_mode: Count = Field(
        default=PlannerSettings.samples_per_mode, description="Roadmap states per mode of the high-level search."
    )
    candidates: Count = Field(
        default=PlannerSettings.candidates, description="How many of the cheapest mode sequences are optimised."
    )
    revisits: Annotated[int, Field(ge=0, le=10)] = Field(
        default=PlannerSettings.revisits,
        description="How many times a mode sequence may come back to a mode that it has been in, e.g. to leave a wall.",
    )
    max_step: dict[Name, Positive] | None = Field(
        default=None, description="Largest input per step, by input [rad or m]; default: from the model."
    )
    max_knots: Annotated[int, Field(ge=2, le=100_000)] = Field(
        default=PlannerSettings.max_knots, description="Upper limit of knots over the whole plan."
    )
    weight_goal: NonNegative = Field(
        default=PlannerSettings.weight_goal,
        description="Weight of the final squared goal error over the squared tolerance.",
    )
    weight_covariance: NonNegative = Field(
        default=PlannerSettings.weight_covariance,
        description="Weight of the final variance over the squared tolerance.",
    )
    weight_effort: NonNegative = Field(
        default=PlannerSettings.weight_effort, description="Weight of the squared inputs over the squared largest step."
    )
    time_limit_s: Positive = Field(
        default=PlannerSettings.time_limit_s, description="Wall-clock limit of each optimisation [s]."
    )
    solve_time_limit_s: Positive = Field(
        default=PlannerSettings.solve_time_limit_s,
        description="Wall-clock limit of search, optimisations, verification and the arm together [s].",
    )
    verification_trials: Count = Field(
        default=PlannerSettings.verification_trials, description="Roll-outs that check a plan."
    )
    tightening_rounds: Annotated[int, Field(ge=0, le=100)] = Field(
        default=PlannerSettings.tightening_rounds,
        description="How often a plan that roll-outs fail too often is made anew with more room.",
    )
    replan_every: Annotated[int, Field(ge=0, le=100_000)] = Field(
        default=PlannerSettings.replan_every,
        description="Steps after which execution plans anew from its belief; 0: only where the belief leaves the plan.",
    )


class PlantDocument(Document):
    """Standing objects know the keys down to `wander_time`; held ones all but those of handle, gravity and wander."""

    mass: Positive | None = Field(default=None, description="Of each moving part, or of each part held [kg].")
    damping: NonNegative | None = Field(default=None, description="Viscous resistance at the handle [N s/m].")
    friction: NonNegative | None = Field(default=None, description="Dry friction at the handle [N].")
    latch_force: NonNegative | None = Field(default=None, description="Pull at the handle that opens a latch [N].")
    latch_capture: NonNegative | None = Field(
        default=None,
        description="Distance of the handle from the latched position within which the latch catches [m]; "
        "of the joint of a held object [rad or m].",
    )
    stiffness: Positive | None = Field(default=None, description="Of the hand [N/m]; with a robot that of its joints.")
    max_force: Positive | None = Field(default=None, description="Largest force of the hand [N].")
    control_period: Positive | None = Field(default=None, description="Duration of one control step [s].")
    motion_share: Annotated[float, Field(gt=0, le=1)] | None = Field(
        default=None, description="Share of the control step in which the hand's target moves."
    )
    gravity: NonNegative | None = Field(default=None, description="Acceleration along -z of the base frame [m/s^2].")
    position_noise: NonNegative | None = Field(default=None, description="White tracker noise per axis, std [m].")
    rotation_noise: NonNegative | None = Field(default=None, description="White tracker noise per axis, std [rad].")
    position_wander: NonNegative | None = Field(default=None, description="Slowly wandering tracker error, std [m].")
    rotation_wander: NonNegative | None = Field(default=None, description="Slowly wandering tracker error, std [rad].")
    wander_time: Positive | None = Field(default=None, description="Correlation time of the wander [s].")
    contact_friction: NonNegative | None = Field(
        default=None, description="Coefficient, of a held object and the scene."
    )
    spread: Annotated[float, Field(ge=0, le=1)] | None = Field(
        default=None, description="Share by which mass and friction of a held object vary from trial to trial."
    )
    joint_friction: NonNegative | None = Field(
        default=None, description="Dry friction of a held object's joint [N m or N]."
    )
    joint_damping: NonNegative | None = Field(
        default=None, description="Damping of a held object's joint [N m s/rad or N s/m]."
    )
    pivot_stiffness: NonNegative | None = Field(
        default=None, description="Of the part held, where it turns in the hand [N m/rad]."
    )
    pivot_damping: NonNegative | None = Field(default=None, description="Its damping there [N m s/rad].")
    joint_deflection: Positive | None = Field(
        default=None, description="Error at which a joint of the robot pushes with all its effort [rad or m]."
    )
    joint_effort: Positive | None = Field(
        default=None, description="Of the robot's joints whose file states none [N m or N]."
    )
    rotor_inertia: NonNegative | None = Field(
        default=None, description="Of the robot's motors, as the joints feel it [kg m^2 or kg]."
    )


class ProblemDocument(Document):
    """Move an articulated object from an uncertain start into a goal set."""

    format: Literal["micah-plan/problem/1"] = Field(description="Format and version of this file.")
    model: Line = Field(description="Model file, relative to this file.")
    hold: HoldDocument | None = Field(
        default=None, description="How a hand holds the object by one part; default: it stands, its joints are moved."
    )
    start: StartDocument = Field(description="Initial belief.")
    goal: GoalDocument = Field(description="Goal set.")
    noise: ProblemNoiseDocument = Field(
        default_factory=ProblemNoiseDocument, description="Noise instead of the model's, for the named coordinates."
    )
    confidence: Confidence = Field(
        default=PlannerSettings.confidence,
        description="Probability that guards and invariants are planned to hold with and roll-outs must reach.",
    )
    planner: PlannerDocument = Field(default_factory=PlannerDocument, description="Settings of the planner.")
    scene: dict[Name, BodyDocument] = Field(
        default_factory=dict, description="Bodies around the object, by name: table, shelf, book."
    )
    robot: RobotDocument | None = Field(default=None, description="Arm that holds the object; default: none.")
    grasp: GraspDocument | None = Field(default=None, description="What it holds; needed with a robot.")
    plant: PlantDocument = Field(default_factory=PlantDocument, description="Physical parameters for MuJoCo.")
