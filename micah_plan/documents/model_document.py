"""The layout of a model file, `format: micah-plan/model/1`. What it means is built in `model_values`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from micah_plan.automaton.joint import JointKind
from micah_plan.documents.fields import (
    Document,
    Expression,
    Line,
    Matrix,
    Name,
    NonNegative,
    Positive,
    Quaternion,
    RegionEntries,
    Row,
    Unit,
    Vector3,
)
from micah_plan.documents.learned_document import LearnedEdgeDocument
from micah_plan.documents.part_document import IDENTITY, ZERO, PartDocument

MODEL_FORMAT = "micah-plan/model/1"
ParameterName = Literal[
    "axis_1",
    "axis_2",
    "center_1",
    "center_2",
    "pitch",
    "rotation_1",
    "rotation_2",
    "rotation_3",
    "position_1",
    "position_2",
    "position_3",
]


class LinkDocument(Document):
    parent: Name = Field(description="Part (or base) that the child's pose is relative to; a base or an earlier child.")
    child: Name = Field(description="Part that moves.")
    coordinate: Name = Field(description="Coordinate that its pose follows.")


class CovarianceDocument(Document):
    names: Annotated[list[ParameterName], Field(min_length=1)] = Field(
        description="Parameters: tilts of the axis [rad], shifts of the centre [m], pitch [m/rad], origin [rad, m]."
    )
    matrix: Matrix = Field(description="Symmetric positive semi-definite, one row per name.")


class JointDocument(Document):
    kind: JointKind = Field(description="rigid, prismatic, revolute or screw.")
    position: Vector3 = Field(description="Origin of the part in the base frame at configuration 0 [m].")
    quaternion: Quaternion = Field(default=IDENTITY, description="Its orientation there: unit quaternion, scalar last.")
    axis: Vector3 = Field(
        default=ZERO, description="Unit vector of motion or rotation in the base frame; not for rigid."
    )
    center: Vector3 = Field(
        default=ZERO, description="Point on the axis closest to `position` [m]; revolute and screw."
    )
    pitch: float = Field(default=0.0, description="Translation along the axis per angle [m/rad]; only for screw.")
    held: float = Field(default=0.0, description="Configuration that a rigid joint stands for [rad or m].")
    covariance: CovarianceDocument | None = Field(
        default=None, description="Covariance of the parameters, if estimated."
    )


class PinDocument(Document):
    value: float = Field(description="Configuration at which the mode holds the coordinate [rad or m].")
    std: NonNegative = Field(description="Standard deviation of that value [rad or m].")


class ModeDocument(Document):
    joints: dict[Name, JointDocument] = Field(description="The joint of every link in this mode, by child part.")
    step: dict[Name, Expression] = Field(
        description="Change of each coordinate in one step as a linear expression, e.g. `door: input door`; a "
        "coordinate that is left out does not move."
    )
    invariant: RegionEntries = Field(description="Half-spaces in all of which the mode's dynamics hold.")
    inputs: RegionEntries = Field(default_factory=list, description="Half-spaces that admissible inputs lie in.")
    pins: dict[Name, PinDocument] = Field(
        default_factory=dict, description="Coordinates that the mode holds fixed, e.g. by a latch."
    )
    ties: dict[Name, Expression] = Field(
        default_factory=dict,
        description="Coordinates that follow others, as an affine expression of them, e.g. `theta: 0.9 - 6.8*z`: an "
        "angle that follows a height while an edge touches a table.",
    )
    observation_std: dict[Name, Positive] = Field(
        default_factory=dict,
        description="Std of one measurement in this mode, of coordinates that it measures in its own way, wherever it "
        "is [rad or m]; default: as under `noise`.",
    )


class MatricesDocument(Document):
    A: Matrix | None = Field(default=None, description="(n, n); default: identity.")
    B: Matrix | None = Field(default=None, description="(n, m); default: zero.")
    c: Row | None = Field(default=None, description="(n); default: zero.")


class TransitionDocument(Document):
    source: Name = Field(description="Mode that it leaves.")
    target: Name = Field(description="Mode that it enters; the same as `source` for a clamp.")
    guard: RegionEntries = Field(description="Half-spaces that must all hold.")
    reset: dict[Name, Expression] = Field(
        default_factory=dict,
        description="New value of a coordinate as an affine expression, e.g. `door: 1.2` or `door: door + 0.1`; a "
        "coordinate that is left out keeps its value.",
    )
    reset_matrices: MatricesDocument | None = Field(
        default=None, description="The reset as x+ = A x + B u + c, instead of `reset`."
    )
    threshold_std: NonNegative = Field(
        default=0.0,
        description="How well the guard's thresholds on coordinates are known: their standard deviation [rad or m].",
    )


class LightDocument(Document):
    at: Annotated[dict[Name, float], Field(min_length=1)] = Field(
        description="The place, by coordinate [rad or m]; a coordinate that is left out does not count."
    )
    growth: dict[Name, NonNegative] = Field(
        description="Std that a measurement of a coordinate gains per unit of distance from there: its variance is "
        "observation_std² + (growth · distance)²."
    )


class NoiseDocument(Document):
    process_std: dict[Name, NonNegative] = Field(
        description="Std of what the dynamics leave unexplained, by coordinate [rad or m, per step]."
    )
    observation_std: dict[Name, Positive] = Field(
        description="Std of one measurement of the configuration, by coordinate [rad or m]."
    )
    light: LightDocument | None = Field(
        default=None, description="Where measurements are best; default: they are the same everywhere."
    )


class InitialDocument(Document):
    mode: Name = Field(description="Mode that the object may be in at first.")
    region: RegionEntries = Field(description="Half-spaces that the state then lies in.")


class EffectDocument(Document):
    name: Name = Field(description="Name of a registered form, e.g. `gain`.")
    coordinate: Name = Field(description="Coordinate that it acts on.")
    parameters: dict[Name, float] = Field(description="All parameters of the form, in its units.")
    std: dict[Name, NonNegative] = Field(default_factory=dict, description="Their standard deviations, if estimated.")
    modes: list[Name] = Field(default_factory=list, description="Modes in which it acts; absent: in all.")
    note: Line = Field(default="", description="What a person should know of it.")


class ModelDocument(Document):
    """The hybrid automaton of an articulated object."""

    format: Literal["micah-plan/model/1"] = Field(description="Format and version of this file.")
    provenance: dict[Name, Line] = Field(
        default_factory=dict, description="Where the model came from: recording digest, method, seed, versions."
    )
    coordinates: Annotated[dict[Name, Unit], Field(min_length=1)] = Field(
        description="The continuous states and their units (rad or m), in order."
    )
    inputs: Annotated[dict[Name, Unit], Field(min_length=1)] = Field(
        description="The inputs (displacements per step) and their units, in order."
    )
    links: list[LinkDocument] = Field(description="Which coordinate moves which part, parents first.")
    parts: dict[Name, PartDocument] = Field(default_factory=dict, description="Shapes and handles of the parts.")
    noise: NoiseDocument = Field(description="Process and observation noise.")
    modes: Annotated[dict[Name, ModeDocument], Field(min_length=1)] = Field(description="The discrete states.")
    transitions: list[TransitionDocument] = Field(
        description="Edges between modes; of several whose guards hold at once the first listed is taken."
    )
    init: list[InitialDocument] = Field(
        default_factory=list, description="Initial states; empty: wherever an invariant holds."
    )
    learned: list[LearnedEdgeDocument] = Field(
        default_factory=list, description="What learning was sure of, by edge of the kinematic graph."
    )
    effects: list[EffectDocument] = Field(
        default_factory=list,
        description="What calibration added. Those on guards and joints are already in modes and transitions; the "
        "others act in every step.",
    )
