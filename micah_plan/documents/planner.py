"""Settings of the planner and physical parameters: `planner`, `confidence` and `plant` of a problem file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.documents.fields import Distance, EachInput, NonNegative, Positive
from micah_plan.documents.layout import Document, Scope, doc, plain_data
from micah_plan.documents.located import Located
from micah_plan.documents.validation import validated
from micah_plan.task.settings import PlannerSettings

Confidence = Annotated[float, Field(gt=0.5, lt=1.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


class PlannerDocument(Document):
    makes = PlannerSettings

    method: Literal["pomdp-hd"] | None = doc("The one planner that there is, which older files name.", None)
    samples_per_mode: Count = doc("Roadmap states per mode of the high-level search.", PlannerSettings.samples_per_mode)
    search_limit: Count = doc(
        "Linear programmes that the search for sequences of grasps solves at most.", PlannerSettings.search_limit
    )
    candidates: Count = doc("How many of the cheapest mode sequences are optimised.", PlannerSettings.candidates)
    revisits: Annotated[int, Field(ge=0, le=10)] = doc(
        "How many times a mode sequence may come back to a mode that it has been in, e.g. to leave a wall.",
        PlannerSettings.revisits,
    )
    max_step: EachInput[Distance] | None = doc(
        "Largest input per step, by input [rad or m]; default: from the model.", None
    )
    max_knots: Annotated[int, Field(ge=2, le=100_000)] = doc(
        "Upper limit of knots over the whole plan.", PlannerSettings.max_knots
    )
    pace: Annotated[float, Field(gt=0, le=1)] = doc(
        "Share of the largest step that a path is planned with; 1: as fast as it may be.", PlannerSettings.pace
    )
    weight_goal: NonNegative = doc(
        "Weight of the final squared goal error over the squared tolerance, and of missing a guard or a boundary.",
        PlannerSettings.weight_goal,
    )
    weight_covariance: NonNegative = doc(
        "Weight of the final variance over the squared tolerance.", PlannerSettings.weight_covariance
    )
    weight_effort: NonNegative = doc(
        "Weight of the squared inputs over the squared largest step.", PlannerSettings.weight_effort
    )
    time_limit_s: Positive = doc("Limit of processor time of each optimisation [s].", PlannerSettings.time_limit_s)
    solve_time_limit_s: Positive = doc(
        "Limit of processor time of search, optimisations, verification and the arm together [s].",
        PlannerSettings.solve_time_limit_s,
    )
    verification_trials: Count = doc("Roll-outs that check a plan.", PlannerSettings.verification_trials)
    tightening_rounds: Annotated[int, Field(ge=0, le=100)] = doc(
        "How often planning is repeated with more room after too many roll-outs failed.",
        PlannerSettings.tightening_rounds,
    )
    replan_every: Annotated[int, Field(ge=0, le=100_000)] = doc(
        "Steps after which execution optimises the rest of the plan again; 0: never.",
        PlannerSettings.replan_every,
    )

    def meanings(self, at: Located, scope: Scope) -> dict[str, Any]:
        """As for any layout, without keys of older files."""
        return {key: value for key, value in super().meanings(at, scope).items() if key != "method"}

    @classmethod
    def written(cls, value: Any, scope: Scope) -> Mapping[str, Any]:
        return {key: getattr(value, key) for key in cls.model_fields if key != "method"}


PlannerDocument.always_written = PlannerDocument.model_fields.keys() - {"max_step", "method"}


class SettingsDocument(PlannerDocument):
    """All settings of a problem in one place."""

    confidence: Confidence = doc("As the problem's.", PlannerSettings.confidence)


def settings_with(settings: PlannerSettings, changes: Mapping[str, Any], inputs: tuple[str, ...]) -> PlannerSettings:
    """Settings with some of them changed.

    Args:
        settings: the others.
        changes: by the names that files give them; `max_step` by input, or one number for all.
        inputs: names of the model's inputs.

    Raises:
        InputError: for an unknown name, and a value that a file could not have.
    """
    if not changes:
        return settings
    given, scope = dict(changes), {"input": inputs}
    if isinstance(given.get("max_step"), int | float):
        given["max_step"] = dict.fromkeys(inputs, given["max_step"])
    data = plain_data(SettingsDocument, settings, scope) | given
    located = Located(data, "settings")
    changed: PlannerSettings = validated(located, SettingsDocument).read(located, scope)
    return changed


class PlantDocument(Document):
    """Standing objects use the keys down to `wander_time`; held ones all but those of handle, gravity and wander."""

    mass: Positive | None = doc("Mass of each moving part, or of each held part [kg].", None)
    damping: NonNegative | None = doc("Viscous resistance at the handle [N s/m].", None)
    friction: NonNegative | None = doc("Dry friction at the handle [N].", None)
    latch_force: NonNegative | None = doc("Pull at the handle that opens a latch [N].", None)
    latch_capture: NonNegative | None = doc(
        "Distance of the handle from the latched position within which the latch catches [m]; of the joint of a held "
        "object [rad or m].",
        None,
    )
    stiffness: Positive | None = doc("Stiffness of the hand [N/m]; with a robot that of its joints.", None)
    max_force: Positive | None = doc("Largest force of the hand [N].", None)
    control_period: Positive | None = doc("Duration of one control step [s].", None)
    motion_share: Annotated[float, Field(gt=0, le=1)] | None = doc(
        "Share of the control step in which the hand's target moves.", None
    )
    gravity: NonNegative | None = doc("Acceleration along -z of the base frame [m/s^2].", None)
    position_noise: NonNegative | None = doc("White tracker noise per axis, std [m].", None)
    rotation_noise: NonNegative | None = doc("White tracker noise per axis, std [rad].", None)
    position_wander: NonNegative | None = doc("Slowly wandering tracker error, std [m].", None)
    rotation_wander: NonNegative | None = doc("Slowly wandering tracker error, std [rad].", None)
    wander_time: Positive | None = doc("Correlation time of the wander [s].", None)
    contact_friction: NonNegative | None = doc("Friction coefficient of a held object and the scene.", None)
    spread: Annotated[float, Field(ge=0, le=1)] | None = doc(
        "Share by which mass and friction of a held object vary from trial to trial.", None
    )
    joint_friction: NonNegative | None = doc("Dry friction of a held object's joint [N m or N].", None)
    joint_damping: NonNegative | None = doc("Damping of a held object's joint [N m s/rad or N s/m].", None)
    pivot_stiffness: NonNegative | None = doc("Stiffness of the held part where it turns in the hand [N m/rad].", None)
    pivot_damping: NonNegative | None = doc("Its damping there [N m s/rad].", None)
    joint_deflection: Positive | None = doc(
        "Error at which a joint of the robot pushes with all its effort [rad or m].", None
    )
    joint_effort: Positive | None = doc("Effort of the robot's joints whose file states none [N m or N].", None)
    rotor_inertia: NonNegative | None = doc(
        "Inertia of the robot's motors, as the joints feel it [kg m^2 or kg].", None
    )
    grip_force: Positive | None = doc("Force with which each finger holds an object [N].", None)
    grip_deflection: Positive | None = doc("Error at which a finger pushes with all its force [m].", None)
    grip_unevenness: NonNegative | None = doc("Most by which a finger opens later than the other [s].", None)
    force_noise: NonNegative | None = doc("Noise of the force that a hand feels (std) [N].", None)

    def read(self, at: Located, scope: Scope) -> dict[str, float]:
        return self.model_dump(exclude_none=True)
