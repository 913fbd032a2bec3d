"""Problem files (`problems/*.yaml`): a model with a start, a goal and surroundings."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, WithJsonSchema
from pydantic_core import PydanticCustomError

from micah_plan.arrays import EQUAL, NEAR_STDS
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.region import Interval
from micah_plan.documents.expressions import short_number, short_text
from micah_plan.documents.fields import (
    BY_NAME,
    ITEMS,
    CoordinateName,
    Distance,
    EachCoordinate,
    Line,
    ModeName,
    ModeNames,
    Name,
    Names,
    Place,
    Std,
    checked_name,
)
from micah_plan.documents.hold import HoldDocument, ReleaseDocument
from micah_plan.documents.layout import Document, Scope, doc, plain_data
from micah_plan.documents.located import Located, overridden
from micah_plan.documents.model import model_text, scope_of, usable_model
from micah_plan.documents.noise import ProblemNoiseDocument, noise_with
from micah_plan.documents.planner import Confidence, PlannerDocument, PlantDocument
from micah_plan.documents.scene import BodyDocument, GraspDocument, RobotDocument
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml
from micah_plan.errors import InputError
from micah_plan.files import read_bytes
from micah_plan.task.body import Body
from micah_plan.task.goal import Goal, unharmed
from micah_plan.task.path import PathConstraint, check_constraint
from micah_plan.task.problem import Hold, Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start, start_mode, start_regions
from micah_plan.task.surroundings import surroundings_of

PROBLEM_FORMAT = "micah-plan/problem/1"
_MOST_LISTED = 6

# Not a union of kinds: errors would be reported twice, at places that the file does not have.
_SCHEMA = WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "maxLength": 100}]})


class StartDocument(Document):
    makes = Start

    mean: EachCoordinate[Place] = doc("Mean of every coordinate [rad or m].")
    std: EachCoordinate[Std] = doc("Standard deviation of every coordinate [rad or m].")
    mode: ModeName | None = doc("Mode at first; default: the first whose invariant holds the mean.", None)
    true: Annotated[dict[CoordinateName, Place], ITEMS] = doc(
        "True start of simulated trials, independent of the belief [rad or m]; others are drawn from the belief.", dict
    )


class TargetDocument(Document):
    value: Place = doc("Wanted value [rad or m].")
    tolerance: Distance = doc("Largest accepted distance from it [rad or m].")


class GoalDocument(Document):
    always_written = ("target", "modes")

    target: dict[CoordinateName, TargetDocument] = doc("Wanted value of any subset of the coordinates.", dict)
    modes: ModeNames = doc("Modes that count as reached; empty: any.", tuple)

    def read(self, at: Located, scope: Scope) -> Goal:
        target = self.meanings(at, scope)["target"]
        wanted = tuple((i, *each.values()) for i, each in target.items())
        return Goal(wanted, self.modes or unharmed(tuple(scope["mode"])))

    @classmethod
    def written(cls, value: Goal, scope: Scope) -> Mapping[str, Any]:
        target = {index: {"value": wanted, "tolerance": room} for index, wanted, room in value.target}
        return {"target": target, "modes": value.modes}


def _argument(value: object) -> float | str:
    if isinstance(value, str):
        return checked_name(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise PydanticCustomError("argument", "expected a finite number or a name")
    return float(value)


Argument = Annotated[Any, AfterValidator(_argument), _SCHEMA]


class PathDocument(Document):
    makes = PathConstraint
    always_written = ("arguments", "modes")

    name: Name = doc("Path function: stay_above, stay_below, keep_away, or one that Python code has registered.")
    arguments: Annotated[dict[Name, Argument], ITEMS] = doc(
        "Its arguments: numbers, or names of coordinates and inputs.", dict
    )
    modes: Names = doc("Modes in which it holds; empty: all.", tuple)


class ProblemDocument(Document):
    """Move an articulated object from an uncertain start into a goal set."""

    always_written = ("confidence", "planner", "plant")

    format: Literal["micah-plan/problem/1"] = doc("Format and version of this file.")
    model: Line = doc("Model file, relative to this file.")
    hold: HoldDocument | None = doc(
        "How a hand holds the object by one part; default: it stands, its joints are moved.", None
    )
    start: StartDocument = doc("Initial belief.")
    goal: GoalDocument = doc("Goal set.")
    noise: ProblemNoiseDocument = doc("Noise instead of the model's, for the named coordinates.", ProblemNoiseDocument)
    confidence: Confidence = doc(
        "Probability with which guards and invariants must hold, and roll-outs reach the goal.",
        PlannerSettings.confidence,
    )
    path: list[PathDocument] = doc("Constraints and costs on the path, beyond the boundaries of the model.", list)
    planner: PlannerDocument = doc("Settings of the planner.", PlannerDocument)
    scene: Annotated[dict[Name, BodyDocument], BY_NAME] = doc(
        "Bodies around the object, by name: table, shelf, book.", dict
    )
    robot: RobotDocument | None = doc("Arm that holds the object; default: none.", None)
    grasp: GraspDocument | None = doc("What the robot holds, and where; needed with a robot.", None)
    release: ReleaseDocument | None = doc(
        "How a held object is released in the end; the goal then speaks of it at rest. Default: it stays in the hand.",
        None,
    )
    plant: PlantDocument = doc("Physical parameters for MuJoCo.", PlantDocument)

    def check(self, at: Located) -> None:
        if self.robot is not None and self.grasp is None:
            raise at.at("robot").error("a robot without a grasp", "add 'grasp' with the part that it holds")
        if self.grasp is not None and self.robot is None:
            raise at.at("grasp").error("a grasp without a robot", "add 'robot' with the robot that holds it")
        if self.release is not None and self.hold is None:
            raise at.at("release").error("only what a hand holds can be released", "add 'hold', or drop 'release'")

    @classmethod
    def written(cls, value: Problem, scope: Scope) -> Mapping[str, Any]:
        """The problem's data with every setting; the noise is that of the model, and not repeated."""
        settings = {"confidence": value.settings.confidence, "planner": value.settings}
        return {"format": PROBLEM_FORMAT, **vars(value), **settings, "path": value.constraints}


def load_problem(
    path: str | Path, overrides: Mapping[str, Any] | None = None, *, model: HybridAutomaton | None = None
) -> Problem:
    """The problem that a file holds, with its model.

    Args:
        path: of the problem file.
        overrides: values to take instead of the file's, by dotted key, e.g. ``{"goal.target.door.value": 0.6}``.
        model: to use instead of the one that the file names.

    Raises:
        InputError: if the file or its model cannot be used; one line with file, line, key, expected and found content,
            and the remedy.
    """
    return ProblemReader(path, model).load(overrides)


def problem_from_text(content: bytes, source: str, automaton: HybridAutomaton) -> Problem:
    """The problem of a file's text, with the given model in place of the named one.

    Raises:
        InputError: as `load_problem` does.
    """
    located = read_yaml(content, source)
    problem = problem_of_document(validated(located, ProblemDocument), automaton, located)
    _check_possible(problem, located)
    return replace(problem, source=source)


def problem_of_data(data: Mapping[str, Any], model: HybridAutomaton | None = None) -> Problem:
    """The problem of data with the keys of a problem file.

    Args:
        data: dicts, lists, texts and numbers; `format` may be left out, and `model`, which is a path, if one is given.

    Raises:
        InputError: with the key, the expected and the found content, and the remedy.
    """
    unnamed = {"format": PROBLEM_FORMAT} | ({} if model is None else {"model": ""})
    located = Located(unnamed | dict(data), "problem")
    document = validated(located, ProblemDocument)
    if model is None:
        model = usable_model(read_bytes(document.model, LARGEST_TEXT_BYTES), document.model)
    hold, scene = _held(document, located)
    problem = problem_of_document(document, _with_contacts(model, hold, scene, located), located)
    _check_possible(problem, located)
    return problem


def check_possible(problem: Problem, where: str) -> None:
    """Refuse a start that no mode allows, and an unreachable goal; `where`: the source in messages.

    Raises:
        InputError: with the key that a file would have, and the nearest possible value.
    """
    _check_possible(problem, Located(problem_data(problem, "model"), where))


def _check_possible(problem: Problem, located: Located) -> None:
    check_start(problem.start, problem.automaton, located)
    if problem.release is None:
        _check_goal(problem.goal, problem.automaton, located)
        return
    from micah_plan.task.release import pre_release_problem  # SciPy is loaded only where it is needed

    # The goal speaks of the object at rest, not of the hand.
    with located.at("release").locating_errors():
        pre_release_problem(problem)


class ProblemReader:
    """Reads one problem file repeatedly with different overrides.

    The files are read every time. The values of their content are cached until it changes: parsing takes a hundred
    times as long as replacing a value, and the contacts of a held object take seconds.
    """

    def __init__(self, path: str | Path, model: HybridAutomaton | None = None) -> None:
        """Args: the problem file, and an optional model in place of the named one."""
        self._path = Path(path)
        self._model = None if model is None else model_text(model).encode()
        self._source = str(path)
        self._parsed: tuple[bytes, Located] | None = None
        self._made: tuple[tuple[object, ...], HybridAutomaton] | None = None

    def load(self, overrides: Mapping[str, Any] | None = None) -> Problem:
        """As `load_problem`."""
        problem, located = self._described(overrides or {})
        _check_possible(problem, located)
        return problem

    def describe(self, overrides: Mapping[str, Any] | None = None) -> Problem:
        """As `load` without checking that start and goal are possible; keys, types and names are checked."""
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
            model = self._model or read_bytes(model_path, LARGEST_TEXT_BYTES)
        except InputError as error:
            raise located.at("model").error(f"model {model_path}: {error.problem}", error.remedy) from None
        automaton = self._automaton(model, model_path, document, located)
        problem = problem_of_document(document, automaton, located)
        digests = {"problem": _digest(content), "model": _digest(model)}
        if problem.robot is not None:
            digests["robot"] = _digest(problem.robot.text.encode())
        return replace(problem, source=self._source, digests=digests), located

    def _automaton(self, model: bytes, path: Path, document: ProblemDocument, located: Located) -> HybridAutomaton:
        """The model, combined with its contacts for held objects."""
        hold, scene = _held(document, located)
        inputs = (model, path, hold, scene)
        if self._made is None or self._made[0] != inputs:
            self._made = inputs, _with_contacts(usable_model(model, str(path)), hold, scene, located)
        return self._made[1]


def _held(document: ProblemDocument, located: Located) -> tuple[Hold | None, tuple[Body, ...]]:
    """(grasp, bodies that may be touched); None and empty for a standing object."""
    if document.hold is None:
        return None, ()
    hold: Hold = document.hold.read(located.at("hold"), {"body": tuple(document.scene)})
    return hold, tuple(body.read(located.at("scene", name), {}) for name, body in document.scene.items())


def problem_of_document(document: ProblemDocument, automaton: HybridAutomaton, located: Located) -> Problem:
    """The problem of a document, without source and digests, and without checking feasibility.

    Args:
        document: the validated layout.
        automaton: the model that it names.
        located: the data that the document was validated from; the robot and meshes are searched relative to its file.

    Raises:
        InputError: for unknown names of coordinates, inputs, modes, parts or path functions, for missing values, and
            for files of the robot and the scene that cannot be used.
    """
    values = document.meanings(located, {**scope_of(automaton), "body": tuple(document.scene)})
    for i, constraint in enumerate(values["path"]):
        with located.at("path", i).locating_errors():
            check_constraint(constraint, automaton)
    return Problem(
        automaton=replace(automaton, noise=noise_with(automaton.noise, values["noise"])),
        settings=replace(values["planner"], confidence=document.confidence),
        constraints=values["path"],
        **{field.name: values[field.name] for field in fields(Problem) if field.name in values},
    )


def problem_data(problem: Problem, model: str) -> dict[str, Any]:
    """The plain data of a problem file with every setting written out, which `problem_of_document` reads back.

    Args:
        problem: its noise is that of its automaton and not repeated here.
        model: name of the model file to write.
    """
    data = plain_data(
        ProblemDocument, {**ProblemDocument.written(problem, {}), "model": model}, scope_of(problem.automaton)
    )
    for key, late in (("hold", "datum"), ("robot", "text")):
        if late in data.get(key, {}):
            data[key][late] = data[key].pop(late)
    first = (
        "format model start goal path confidence planner plant scene robot grasp hold release"  # as plan files have it
    )
    return {key: data[key] for key in (*first.split(), *data) if key in data}


def _with_contacts(
    automaton: HybridAutomaton, hold: Hold | None, scene: tuple[Body, ...], located: Located
) -> HybridAutomaton:
    """The model combined with the contacts of a held object; unchanged for a standing one."""
    if hold is None:
        return automaton
    from micah_plan.automaton.contacts.product import with_contacts

    with located.at("hold").locating_errors():
        around = surroundings_of(scene, hold.contacts, hold.lower, hold.upper)
        return with_contacts(automaton, hold.grip, around)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def check_start(start: Start, automaton: HybridAutomaton, located: Located) -> None:
    """Refuse a start that lies in no mode; `located`: the data with the key `start`."""
    names, mode = automaton.mode_names, start_mode(automaton, start)[0]
    if mode is not None:
        _check_ties(start, automaton, automaton.mode(mode), located)
        return
    allowed = [name for name in names if start_mode(automaton, replace(start, mode=name))[0] is not None]
    values = zip(automaton.coordinates, start.mean, strict=True)
    state = ", ".join(f"{item.name} = {short_number(value)} {item.unit}" for item, value in values)
    if start.mode is not None:
        remedy = f"start there in {' or '.join(allowed)}" if allowed else _invariants(automaton, [start.mode])
        raise located.at("start", "mode").error(f"mode '{start.mode}' does not allow the start {state}", remedy)
    problem = f"the start {state} lies in no mode's invariant"
    raise located.at("start", "mean").error(problem, _invariants(automaton, names))


def _check_ties(start: Start, automaton: HybridAutomaton, mode: Mode, located: Located) -> None:
    """Refuse a start that violates a tie of its mode beyond the coordinate's std."""
    for tie in mode.ties:
        coordinate, found = automaton.coordinates[tie.coordinate], start.mean[tie.coordinate]
        expected = float(tie.value(np.array(start.mean)))
        if abs(found - expected) > max(NEAR_STDS * start.std[tie.coordinate], EQUAL):
            words = tie.words(automaton.coordinate_names)
            problem = f"in mode '{mode.name}' {words}, so {short_number(expected)} {coordinate.unit} is expected"
            remedy = f"write {coordinate.name}: {short_number(expected)}"
            raise located.at("start", "mean").error(f"{problem}, found {short_number(found)} {coordinate.unit}", remedy)


def _invariants(automaton: HybridAutomaton, modes: Sequence[str]) -> str:
    """The remedy that lists the invariants of modes: ``allowed: swings (door >= 0, door <= 1.2)``."""
    scope, texts = scope_of(automaton), []
    for name in modes[:_MOST_LISTED]:
        mode = automaton.mode(name)
        pins = [f"{automaton.coordinate_names[pin.coordinate]} = {short_number(pin.value)}" for pin in mode.pins]
        regions = start_regions(automaton, mode)
        rows = [", ".join([*pins, *(short_text(h, scope) for h in r.half_spaces)]) or "everywhere" for r in regions]
        texts.append(f"{name} ({' or '.join(rows) or 'nowhere'})")
    return f"allowed: {'; '.join(texts)}{'; ...' if len(modes) > _MOST_LISTED else ''}"


def _check_goal(goal: Goal, automaton: HybridAutomaton, located: Located) -> None:
    """Refuse an empty goal, and a target outside the ranges of its modes."""
    if not goal.target and not goal.modes:
        raise located.at("goal").error("the goal is empty", "give a target, modes to end in, or both")
    modes = [mode for mode in automaton.modes if goal.admits(mode.name)]
    for index, value, tolerance in goal.target:
        name, unit = automaton.coordinates[index].name, automaton.coordinates[index].unit
        ranges = automaton.ranges(index, modes)
        clipped = [min(max(value, low), high) for low, high in ranges]
        nearest = min(clipped, key=lambda candidate: abs(candidate - value), default=np.inf)
        room = EQUAL * max((high - low for low, high in ranges if np.isfinite(high - low)), default=0.0)
        if abs(nearest - value) > tolerance + room:
            of = f"mode {' or '.join(goal.modes)}" if goal.modes else "the object"
            problem = f"expected a value that {of} can reach, {_written(ranges)} {unit}, found {short_number(value)}"
            remedy = f"the nearest possible value is {short_number(nearest)} {unit}"
            raise located.at("goal", "target", name, "value").error(problem, remedy)


def _written(ranges: Sequence[Interval]) -> str:
    texts = [(short_number(low), short_number(high)) for low, high in ranges]
    return " or ".join(low if low == high else f"{low} to {high}" for low, high in texts) or "none"
