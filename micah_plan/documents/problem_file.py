"""Problem files (`problems/*.yaml`): `load_problem`."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from micah_plan.automaton.contacts.product import with_contacts
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.hold_values import hold_of
from micah_plan.documents.located import Located
from micah_plan.documents.model_file import usable_model
from micah_plan.documents.overrides import overridden
from micah_plan.documents.problem_checks import check_problem
from micah_plan.documents.problem_document import ProblemDocument
from micah_plan.documents.problem_values import problem_of
from micah_plan.documents.scene_values import scene_of
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml
from micah_plan.errors import InputError
from micah_plan.files import read_bytes
from micah_plan.scene.body import Body
from micah_plan.scene.surroundings import surroundings_of
from micah_plan.task.problem import Hold, Problem


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
            raise located.error(("model",), f"model {model_path}: {error.problem}", error.remedy) from None
        automaton = self._automaton(model, model_path, document, located)
        problem = problem_of(document, automaton, located, self._path.parent)
        digests = {"problem": _digest(content), "model": _digest(model)}
        if problem.robot is not None:
            digests["robot"] = _digest(problem.robot.text.encode())
        return replace(problem, source=self._source, digests=digests), located

    def _automaton(self, model: bytes, path: Path, document: ProblemDocument, located: Located) -> HybridAutomaton:
        """The model, times its contacts if the object is held."""
        hold = hold_of(document.hold, list(document.scene), located)
        scene = () if hold is None else scene_of(document.scene, located, self._path.parent)
        inputs = (model, path, hold, scene)
        if self._made is None or self._made[0] != inputs:
            automaton = usable_model(model, str(path))
            self._made = inputs, automaton if hold is None else _held(automaton, hold, scene, located)
        return self._made[1]


def _held(automaton: HybridAutomaton, hold: Hold, scene: tuple[Body, ...], located: Located) -> HybridAutomaton:
    try:
        around = surroundings_of(scene, hold.contacts, hold.lower, hold.upper)
        return with_contacts(automaton, hold.grip, around)
    except InputError as error:
        raise located.error(("hold",), error.problem, error.remedy) from None


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
