"""Problem files (`problems/*.yaml`): what to do with which model, from where to where."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.hold import HoldDocument, hold_data, hold_of
from micah_plan.documents.layout import Document, Line, Name, Names, Positive, doc
from micah_plan.documents.located import Located, overridden
from micah_plan.documents.model import usable_model
from micah_plan.documents.noise import ProblemNoiseDocument, noise_of
from micah_plan.documents.path import PathDocument, path_data, path_of
from micah_plan.documents.planner import Confidence, PlannerDocument, PlantDocument, settings_data, settings_of
from micah_plan.documents.problem_checks import check_problem
from micah_plan.documents.scene import (
    BodyDocument,
    GraspDocument,
    RobotDocument,
    grasp_data,
    grasp_of,
    robot_data,
    robot_of,
    scene_data,
    scene_of,
)
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml
from micah_plan.errors import InputError
from micah_plan.files import read_bytes
from micah_plan.scene.body import Body
from micah_plan.scene.surroundings import surroundings_of
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Hold, Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

PROBLEM_FORMAT = "micah-plan/problem/1"


class StartDocument(Document):
    mean: dict[Name, float] = doc("Mean of every coordinate [rad or m].")
    std: dict[Name, Positive] = doc("Standard deviation of every coordinate [rad or m].")
    mode: Name | None = doc("Mode at first; default: the first whose invariant holds the mean.", None)


class TargetDocument(Document):
    value: float = doc("Wanted value [rad or m].")
    tolerance: Positive = doc("Largest accepted distance from it [rad or m].")


class GoalDocument(Document):
    target: dict[Name, TargetDocument] = doc("Wanted value of any subset of the coordinates.", dict)
    modes: Names = doc("Modes that count as reached; empty: any.", tuple)


class ProblemDocument(Document):
    """Move an articulated object from an uncertain start into a goal set."""

    format: Literal["micah-plan/problem/1"] = doc("Format and version of this file.")
    model: Line = doc("Model file, relative to this file.")
    hold: HoldDocument | None = doc(
        "How a hand holds the object by one part; default: it stands, its joints are moved.", None
    )
    start: StartDocument = doc("Initial belief.")
    goal: GoalDocument = doc("Goal set.")
    noise: ProblemNoiseDocument = doc("Noise instead of the model's, for the named coordinates.", ProblemNoiseDocument)
    confidence: Confidence = doc(
        "Probability that guards and invariants are planned to hold with and roll-outs must reach.",
        PlannerSettings.confidence,
    )
    path: list[PathDocument] = doc("What is asked of the path, beyond the boundaries of the model.", list)
    planner: PlannerDocument = doc("Settings of the planner.", PlannerDocument)
    scene: dict[Name, BodyDocument] = doc("Bodies around the object, by name: table, shelf, book.", dict)
    robot: RobotDocument | None = doc("Arm that holds the object; default: none.", None)
    grasp: GraspDocument | None = doc("What it holds; needed with a robot.", None)
    plant: PlantDocument = doc("Physical parameters for MuJoCo.", PlantDocument)


def load_problem(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Problem:
    """The problem that a file holds, with its model.

    Args:
        path: of the problem file.
        overrides: values to take instead of the file's, by dotted key, e.g. ``{"goal.target.door.value": 0.6}``.

    Raises:
        InputError: if the file or its model cannot be used; one line names file, line, key, what was expected and
            found, and the remedy.
    """
    return ProblemReader(path).load(overrides)


class ProblemReader:
    """Reads one problem file again and again, with other overrides each time.

    The files are read anew every time. What is made of their content is kept until it changes: parsing takes a hundred
    times as long as replacing a value, and the contacts of a held object take seconds.
    """

    def __init__(self, path: str | Path) -> None:
        """Args: the problem file."""
        self._path = Path(path)
        self._source = str(path)
        self._parsed: tuple[bytes, Located] | None = None
        self._made: tuple[tuple[object, ...], HybridAutomaton] | None = None

    def load(self, overrides: Mapping[str, Any] | None = None) -> Problem:
        """As `load_problem`."""
        problem, located = self._described(overrides or {})
        check_problem(problem, located)
        return problem

    def describe(self, overrides: Mapping[str, Any] | None = None) -> Problem:
        """As `load`, but start and goal need not be possible for the object; keys, types and names must be right."""
        return self._described(overrides or {})[0]

    def _described(self, overrides: Mapping[str, Any]) -> tuple[Problem, Located]:
        content = read_bytes(self._source, LARGEST_TEXT_BYTES)
        if self._parsed is None or self._parsed[0] != content:
            self._parsed = content, read_yaml(content, self._source)
        located = self._parsed[1]
        for key, value in overrides.items():
            located = overridden(located, key, value)
        document = validated(located, ProblemDocument)
        model_path = self._path.parent / document.model
        try:
            model = read_bytes(model_path, LARGEST_TEXT_BYTES)
        except InputError as error:
            raise located.at("model").error(f"model {model_path}: {error.problem}", error.remedy) from None
        automaton = self._automaton(model, model_path, document, located)
        problem = problem_of(document, automaton, located, self._path.parent)
        digests = {"problem": _digest(content), "model": _digest(model)}
        if problem.robot is not None:
            digests["robot"] = _digest(problem.robot.text.encode())
        return replace(problem, source=self._source, digests=digests), located

    def _automaton(self, model: bytes, path: Path, document: ProblemDocument, located: Located) -> HybridAutomaton:
        """The model, times its contacts if the object is held."""
        hold = hold_of(document.hold, list(document.scene), located.at("hold"))
        scene = () if hold is None else scene_of(document.scene, located.at("scene"), self._path.parent)
        inputs = (model, path, hold, scene)
        if self._made is None or self._made[0] != inputs:
            automaton = usable_model(model, str(path))
            self._made = inputs, automaton if hold is None else _with_contacts(automaton, hold, scene, located)
        return self._made[1]


def problem_of(
    document: ProblemDocument, automaton: HybridAutomaton, located: Located, folder: Path = Path()
) -> Problem:
    """The problem that a file describes, without its source and digests; whether it is possible is not checked here.

    Args:
        document: the validated layout.
        automaton: the model that it names.
        located: the data that the document was validated from, for the places in messages.
        folder: of the file; the robot and meshes are looked for from there.

    Raises:
        InputError: for unknown names of coordinates, inputs, modes, parts or path functions, for missing values, and
            for files of the robot and the scene that cannot be used.
    """
    settings = settings_of(document.planner, document.confidence, automaton.input_names, located.at("planner"))
    robot = robot_of(document.robot, located.at("robot"), folder)
    noise = noise_of(document.noise, automaton.coordinate_names, located.at("noise"), automaton.noise)
    return Problem(
        automaton=replace(automaton, noise=noise),
        start=_start_of(document.start, automaton, located.at("start")),
        goal=_goal_of(document.goal, automaton, located.at("goal")),
        settings=settings,
        plant={key: value for key, value in document.plant if value is not None},
        scene=scene_of(document.scene, located.at("scene"), folder),
        robot=robot,
        grasp=grasp_of(document.grasp, robot, automaton, located),
        hold=hold_of(document.hold, list(document.scene), located.at("hold")),
        constraints=path_of(document.path, automaton, located.at("path")),
    )


def problem_data(problem: Problem, model: str) -> dict[str, Any]:
    """The plain data of a problem file with every setting written out, which `problem_of` reads back.

    Args:
        problem: its noise is that of its automaton and not repeated here.
        model: what to write as the name of the model file.
    """
    names = problem.automaton.coordinate_names
    start = {key: dict(zip(names, getattr(problem.start, key), strict=True)) for key in ("mean", "std")}
    target = {names[index]: {"value": value, "tolerance": room} for index, value, room in problem.goal.target}
    return {
        "format": PROBLEM_FORMAT,
        "model": model,
        "start": start if problem.start.mode is None else {**start, "mode": problem.start.mode},
        "goal": {"target": target, "modes": list(problem.goal.modes)},
        **({"path": path_data(problem.constraints)} if problem.constraints else {}),
        **settings_data(problem.settings, problem.automaton.input_names),
        "plant": dict(problem.plant),
        **({"scene": scene_data(problem.scene)} if problem.scene else {}),
        **({} if problem.robot is None else {"robot": robot_data(problem.robot)}),
        **({} if problem.grasp is None else {"grasp": grasp_data(problem.grasp)}),
        **({} if problem.hold is None else {"hold": hold_data(problem.hold)}),
    }


def _start_of(document: StartDocument, automaton: HybridAutomaton, located: Located) -> Start:
    names = automaton.coordinate_names
    mean, std = (located.at(key).in_order(getattr(document, key), names, "coordinate") for key in ("mean", "std"))
    if document.mode is not None:
        located.at("mode").number(document.mode, automaton.mode_names, "mode")
    return Start(mean, std, document.mode)


def _goal_of(document: GoalDocument, automaton: HybridAutomaton, located: Located) -> Goal:
    names, modes = automaton.coordinate_names, automaton.mode_names
    for i, mode in enumerate(document.modes):
        located.at("modes", i).number(mode, modes, "mode")
    target = tuple(
        (located.at("target", name).number(name, names, "coordinate"), wanted.value, wanted.tolerance)
        for name, wanted in document.target.items()
    )
    # An object that has hit something has not arrived, wherever it is.
    unharmed = tuple(mode for mode in modes if mode != COLLIDED) if COLLIDED in modes else ()
    return Goal(target, document.modes or unharmed)


def _with_contacts(
    automaton: HybridAutomaton, hold: Hold, scene: tuple[Body, ...], located: Located
) -> HybridAutomaton:
    from micah_plan.automaton.contacts.product import with_contacts

    with located.at("hold").locating_errors():
        around = surroundings_of(scene, hold.contacts, hold.lower, hold.upper)
        return with_contacts(automaton, hold.grip, around)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
