"""Experiment files, which `micah-plan calibrate --experiment` writes and `micah-plan execute` carries out.

**Scene files** (`problems/explore_handle.yaml`): a hand that holds a handle of which nothing else is known.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.documents.fields import ITEMS, Distance, Line, Name, Place, Positive, Quaternion, Vector3, numbered
from micah_plan.documents.layout import Document, Scope, doc, plain_data
from micah_plan.documents.located import Located
from micah_plan.documents.model import load_model, scope_of
from micah_plan.documents.planner import PlantDocument
from micah_plan.documents.problem import StartDocument, check_start, load_problem
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import read_yaml_file, write_yaml
from micah_plan.errors import InputError
from micah_plan.task.experiment import SMALLER, Experiment, Motion, Scene, too_large

EXPERIMENT_FORMAT = "micah-plan/experiment/1"
_MOST_STEPS = 100_000

InputName = Annotated[Name, numbered("input")]
Commands = Annotated[list[Place], Field(min_length=1, max_length=_MOST_STEPS)]


class MotionDocument(Document):
    makes = Motion

    start: StartDocument = doc("Where the object is brought to, and with which std.")
    commands: Annotated[dict[InputName, Commands], ITEMS] = doc(
        "What is commanded of each input in each control step, whatever is measured [rad or m]; of those left out: 0."
    )

    def check(self, at: Located) -> None:
        lengths = {len(values) for values in self.commands.values()}
        if len(lengths) != 1:
            shape = " and ".join(map(str, sorted(lengths))) or "none"
            raise at.at("commands").error(f"expected as many commands of each input, found {shape}", "add zeros")

    def read(self, at: Located, scope: Scope) -> Motion:
        values = self.meanings(at, scope)
        columns = dict(values["commands"])
        none = [0.0] * len(next(iter(columns.values())))
        rows = zip(*(columns.get(number, none) for number in range(len(scope["input"]))), strict=True)
        return Motion(values["start"], tuple(rows))

    @classmethod
    def written(cls, value: Motion, scope: Scope) -> dict[str, Any]:
        columns = dict(enumerate(map(list, zip(*value.commands, strict=True))))
        moved = {number: column for number, column in columns.items() if any(column)}
        return {"start": value.start, "commands": (moved or columns).items()}


class ExperimentDocument(Document):
    """Motions in open loop that are to tell apart what a model may lack."""

    format: Literal["micah-plan/experiment/1"] = doc("Format and version of this file.")
    model: Line = doc("Model file, relative to this file.")
    repetitions: Annotated[int, Field(ge=1, le=10_000)] = doc("How often all motions are made.", 1)
    motions: Annotated[list[MotionDocument], Field(min_length=1, max_length=1000)] = doc("Motions, in their order.")
    plant: PlantDocument = doc("Physical parameters for MuJoCo.", PlantDocument)


def load_experiment(path: str | Path) -> Experiment:
    """The experiment that a file describes, with its model.

    Raises:
        InputError: if it cannot be used; one line names file, line, key, what was expected and found, and the remedy.
    """
    located = read_yaml_file(path)
    document = validated(located, ExperimentDocument)
    model = Path(path).parent / document.model
    try:
        automaton = load_model(model)
    except InputError as error:
        within = "" if error.where is None else f", {error.where}"
        raise located.at("model").error(f"model {model}{within}: {error.problem}", error.remedy) from None
    values = document.meanings(located, scope_of(automaton))
    for number, motion in enumerate(values["motions"]):
        check_start(motion.start, automaton, located.at("motions", number))
        if fault := too_large(automaton, motion):
            raise located.at("motions", number, "commands").error(fault, SMALLER)
    return Experiment(automaton, tuple(values["motions"]), values["repetitions"], values["plant"])


def experiment_text(experiment: Experiment, model: Path, at: Path, comment: str) -> str:
    """What to write at a path of an experiment on a model file, which is named relative to it.

    Args:
        comment: the first line, for people.
    """
    scope = scope_of(experiment.automaton)
    name = os.path.relpath(os.path.realpath(model), os.path.realpath(at.parent))
    data = plain_data(ExperimentDocument, {**vars(experiment), "format": EXPERIMENT_FORMAT, "model": name}, scope)
    return write_yaml(data, comment)


class HoldsDocument(Document):
    position: Vector3 = doc("Place of the handle in the base frame [m].")
    quaternion: Quaternion | None = doc("Its orientation, scalar last; default: as first measured.", None)


class WorkspaceDocument(Document):
    low: Vector3 = doc("The corner with the smallest coordinates, base frame [m].")
    high: Vector3 = doc("The corner with the largest coordinates [m].")

    def check(self, at: Located) -> None:
        for axis, low, high in zip("xyz", self.low, self.high, strict=True):
            if not low < high:
                raise at.at("high").error(f"expected a corner above {low:g} in {axis}, found {high:g}", "swap them")


class SceneDocument(Document):
    """A handle in the hand, of an object without a model: within which limits `micah-plan explore` may open it."""

    makes = Scene

    format: Literal["micah-plan/scene/1"] = doc("Format and version of this file.")
    largest_force: Positive = doc("The largest force that the hand may exert [N].", 45.0)
    largest_stiffness: Positive | None = doc(
        "The largest stiffness of the hand, as its controller is set [N/m]: commands stay below the largest force with "
        "it, whatever the force sensor tells. Absent: as pushes tell it.",
        None,
    )
    largest_step: Distance = doc("The largest displacement of the hand that one command may ask for [m].", 0.05)
    steps: Annotated[int, Field(ge=1, le=10_000)] = doc("How many commands may be given.", 300)
    opening: Distance = doc("The way of the handle after which the object counts as opened [m].", 0.2)
    holds: HoldsDocument | None = doc(
        "Where the hand holds the handle; a first measurement more than 5 cm from there is refused. Default: where it "
        "is first measured.",
        None,
    )
    workspace: WorkspaceDocument | None = doc("A box which the handle is not led out of; default: none.", None)
    simulated: Line | None = doc(
        "A problem file, relative to this one, whose object the plants `nominal` and `mujoco` put into the hand, where "
        "the problem starts; other plants ignore it.",
        None,
    )

    def read(self, at: Located, scope: Scope) -> Any:
        self.check(at)
        if self.workspace is not None:
            self.workspace.check(at.at("workspace"))
        holds, box = self.holds, self.workspace
        simulated = None
        if self.simulated is not None:
            path = Path(at.source).parent / self.simulated
            try:
                simulated = load_problem(path)
            except InputError as error:
                within = "" if error.where is None else f", {error.where}"
                raise at.at("simulated").error(f"{path}{within}: {error.problem}", error.remedy) from None
            if simulated.hold is not None or len(simulated.automaton.links) != 1:
                raise at.at("simulated").error("expected an object that stands and has one moving part", "name another")
        return Scene(
            largest_force=self.largest_force,
            largest_stiffness=self.largest_stiffness,
            largest_step=self.largest_step,
            steps=self.steps,
            opening=self.opening,
            position=None if holds is None else holds.position,
            quaternion=None if holds is None else holds.meanings(at.at("holds"), scope)["quaternion"],
            low=None if box is None else box.low,
            high=None if box is None else box.high,
            simulated=simulated,
        )


def load_scene(path: str | Path) -> Scene:
    """The scene that a file describes.

    Raises:
        InputError: if it cannot be used; one line names file, line, key, what was expected and found, and the remedy.
    """
    located = read_yaml_file(path)
    scene: Scene = validated(located, SceneDocument).read(located, {})
    return scene
