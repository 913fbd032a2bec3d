"""Kinds of files: detection by path, and the JSON Schema of each kind for editors and other programs.

YAML files are identified by their key `format`, other files by their ending.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from micah_plan.documents.layout import Document
from micah_plan.documents.yaml_lines import read_yaml_file
from micah_plan.errors import InputError, choices, shown

FileKind = Literal[
    "model", "parts", "problem", "scene", "sweep", "experiment", "conventions", "tags", "plan", "recording"
]
_YAML_KINDS: tuple[FileKind, ...] = (
    "model",
    "parts",
    "problem",
    "scene",
    "sweep",
    "experiment",
    "conventions",
    "tags",
)


_YAML = (".yaml", ".yml")
_MOST_NAMED = 1000
_NAME_NOTHING = ("model", "parts", "conventions", "tags")  # models may be large, and are read once


def kind_of(path: str | Path) -> FileKind:
    """The kind of a file, without validating it.

    Raises:
        InputError: if it is YAML that cannot be read up to its `format`, or this is of no kind.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        return "plan"
    if suffix not in _YAML:
        return "recording"
    located = read_yaml_file(path, until="format")
    formats = [f"micah-plan/{kind}/1" for kind in _YAML_KINDS]
    if "format" not in located.data:
        raise located.error("missing key 'format'", f"name the kind of file: one of {', '.join(formats)}")
    stated = str(located.data["format"])
    for kind in _YAML_KINDS:
        if stated.startswith(f"micah-plan/{kind}/"):
            return kind
    raise located.at("format").error(f"unknown format {stated[:60]!r}", choices(stated, formats))


def files_named_by(path: str | Path) -> list[Path]:
    """A file and all files linked to it by name: the model of a problem, the problem of a scene.

    Errors in them are left to their readers.
    """
    kinds: dict[str, Path] = {}
    waiting = [Path(path)]
    while waiting:
        file = waiting.pop()
        if os.path.realpath(file) in kinds or len(kinds) >= _MOST_NAMED:
            continue
        kinds[os.path.realpath(file)] = file
        with suppress(InputError, OSError, ValueError):
            if file.suffix.lower() in _YAML and kind_of(file) not in _NAME_NOTHING:
                texts = _texts(read_yaml_file(file).data)
                waiting += [file.parent / text for text in texts if len(text) < 300 and (file.parent / text).is_file()]
    return list(kinds.values())


def _texts(data: Any) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        for value in data.values():
            yield from _texts(value)
    elif isinstance(data, list | tuple):
        for value in data:
            yield from _texts(value)


def schema(kind: str) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a file.

    Args:
        kind: ``"model"``, ``"parts"``, ``"problem"``, ``"scene"``, ``"sweep"``, ``"experiment"``,
            ``"conventions"``, ``"tags"`` or ``"plan"``.

    Raises:
        InputError: for another kind.
    """
    from micah_plan.documents.conventions import ConventionsDocument
    from micah_plan.documents.experiment import ExperimentDocument
    from micah_plan.documents.exploration_scene import SceneDocument
    from micah_plan.documents.model import ModelDocument
    from micah_plan.documents.parts import PartsDocument
    from micah_plan.documents.plan import PlanDocument
    from micah_plan.documents.problem import ProblemDocument
    from micah_plan.documents.sweep import SweepDocument
    from micah_plan.documents.tags import TagsDocument

    layouts: dict[str, type[Document]] = {
        "model": ModelDocument,
        "parts": PartsDocument,
        "problem": ProblemDocument,
        "scene": SceneDocument,
        "sweep": SweepDocument,
        "experiment": ExperimentDocument,
        "conventions": ConventionsDocument,
        "tags": TagsDocument,
        "plan": PlanDocument,
    }
    if kind not in layouts:
        raise InputError(f"unknown kind of file {shown(kind)}", remedy=f"choose one of {', '.join(layouts)}")
    generated = layouts[kind].model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **generated, "title": f"micah-plan {kind} file"}
