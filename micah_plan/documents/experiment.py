"""Experiment files, which `micah-plan calibrate --experiment` writes and `micah-plan execute` carries out."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.documents.fields import ITEMS, Line, Name, Place, numbered
from micah_plan.documents.layout import Document, Scope, doc, plain_data
from micah_plan.documents.located import Located
from micah_plan.documents.model import load_model, scope_of
from micah_plan.documents.planner import PlantDocument
from micah_plan.documents.problem import StartDocument, check_start
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import read_yaml_file, write_yaml
from micah_plan.errors import InputError
from micah_plan.task.experiment import SMALLER, Experiment, Motion, too_large

EXPERIMENT_FORMAT = "micah-plan/experiment/1"
_MOST_STEPS = 100_000

InputName = Annotated[Name, numbered("input")]
Commands = Annotated[list[Place], Field(min_length=1, max_length=_MOST_STEPS)]


class MotionDocument(Document):
    makes = Motion

    start: StartDocument = doc("Where the object is brought to, and with which std.")
    commands: Annotated[dict[InputName, Commands], ITEMS] = doc(
        "Command of each input in each control step, independent of measurements [rad or m]; missing inputs: 0."
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
    """Open-loop motions that separate hypotheses about a model."""

    format: Literal["micah-plan/experiment/1"] = doc("Format and version of this file.")
    model: Line = doc("Model file, relative to this file.")
    repetitions: Annotated[int, Field(ge=1, le=10_000)] = doc("How often all motions are made.", 1)
    motions: Annotated[list[MotionDocument], Field(min_length=1, max_length=1000)] = doc("Motions, in their order.")
    plant: PlantDocument = doc("Physical parameters for MuJoCo.", PlantDocument)


def load_experiment(path: str | Path) -> Experiment:
    """The experiment that a file describes, with its model.

    Raises:
        InputError: if it cannot be used; one line with file, line, key, expected and found content, and the remedy.
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
    """The text of an experiment file for a path, with the model named relative to it.

    Args:
        comment: the first line, for people.
    """
    scope = scope_of(experiment.automaton)
    name = os.path.relpath(os.path.realpath(model), os.path.realpath(at.parent))
    data = plain_data(ExperimentDocument, {**vars(experiment), "format": EXPERIMENT_FORMAT, "model": name}, scope)
    return write_yaml(data, comment)
