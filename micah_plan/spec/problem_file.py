"""Problem files (`problems/*.yaml`): `load_problem`."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from micah_plan.automaton.contacts.product import with_contacts
from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes
from micah_plan.planning.problem import Problem
from micah_plan.scene.surroundings import surroundings_of
from micah_plan.spec.hold_values import hold_of
from micah_plan.spec.located import Located
from micah_plan.spec.model_file import usable_model
from micah_plan.spec.problem_checks import check_problem
from micah_plan.spec.problem_document import ProblemDocument
from micah_plan.spec.problem_values import problem_of
from micah_plan.spec.scene_values import scene_of
from micah_plan.spec.validation import validated
from micah_plan.spec.yaml_lines import LARGEST_TEXT_BYTES, read_yaml


def load_problem(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Problem:
    """The problem that a file holds, with its model.

    Args:
        path: of the problem file.
        overrides: values to take instead of the file's, by dotted key, e.g. ``{"goal.target.door.value": 0.6}``.

    Raises:
        InputError: if the file or its model cannot be used; one line names file, line, key, what was expected and
            found, and the remedy.
    """
    content = read_bytes(path, LARGEST_TEXT_BYTES)
    located = read_yaml(content, str(path))
    for key, value in (overrides or {}).items():
        located = _overridden(located, key, value)
    document = validated(located, ProblemDocument)
    model_path = Path(path).parent / document.model
    try:
        model = read_bytes(model_path, LARGEST_TEXT_BYTES)
    except InputError as error:
        raise located.error(("model",), f"model {model_path}: {error.problem}", error.remedy) from None
    automaton = usable_model(model, str(model_path))
    hold = hold_of(document.hold, list(document.scene), located)
    if hold is not None:
        scene = scene_of(document.scene, located, Path(path).parent)
        try:
            around = surroundings_of(scene, hold.contacts, hold.lower, hold.upper)
            automaton = with_contacts(automaton, hold.grip, around)
        except InputError as error:
            raise located.error(("hold",), error.problem, error.remedy) from None
    problem = problem_of(document, automaton, located, Path(path).parent)
    check_problem(problem, located)
    digests = {"problem": _digest(content), "model": _digest(model)}
    if problem.robot is not None:
        digests["robot"] = _digest(problem.robot.text.encode())
    return replace(problem, source=str(path), digests=digests)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _overridden(located: Located, key: str, value: Any) -> Located:
    data = copy.deepcopy(located.data)
    *parents, last = key.split(".")
    current = data
    for name in parents:
        current = current.setdefault(name, {})
        if not isinstance(current, dict):
            raise InputError(f"cannot override {shown(key)}: '{name}' has no keys", source=located.source)
    current[last] = value
    path = tuple(key.split("."))
    places = {place: at for place, at in located.places.items() if place[: len(path)] != path}
    return replace(located, data=data, places=places)
