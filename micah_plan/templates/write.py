"""Templates by kind, and writing them into a folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Literal

from micah_plan.documents.kind import schema
from micah_plan.documents.model import load_model
from micah_plan.errors import InputError, shown
from micah_plan.files import replace_file
from micah_plan.templates.first_problem import first_problem

TemplateKind = Literal["problem", "effect", "robot", "sweep", "tags"]

# The name that each file gets, by the name that it has here.
_FILES: Mapping[TemplateKind, Mapping[str, str]] = {
    "problem": {"problem.yaml": "problem.yaml", "model.yaml": "model.yaml"},
    "effect": {"effect.py": "effect.py", "model.yaml": "model.yaml"},
    "robot": {"problem_with_arm.yaml": "problem.yaml", "model.yaml": "model.yaml", "robot.urdf": "robot.urdf"},
    "sweep": {"sweep.yaml": "sweep.yaml", "problem.yaml": "problem.yaml", "model.yaml": "model.yaml"},
    "tags": {"tags.yaml": "tags.yaml", "tags.svg": "tags.svg"},
}


def write_template(kind: TemplateKind, folder: str | Path, *, model: str | Path | None = None) -> tuple[Path, ...]:
    """Write the template of a kind and the JSON Schemas that its YAML files name.

    Args:
        kind: ``"problem"``, ``"effect"``, ``"robot"``, ``"sweep"`` or ``"tags"``.
        model: of a problem: the model that it shall be about, copied into the folder; None for a drawer.
        folder: is made if it is not there; the folder around it must be.

    Returns:
        The files, the one to begin with first.

    Raises:
        InputError: for another kind, for a model that cannot be used or in which nothing moves, if one of the files is
            there already, or if they cannot be written.
    """
    if kind not in _FILES:
        raise InputError(f"unknown template {shown(kind)}", remedy=f"choose one of {', '.join(_FILES)}")
    place = Path(folder)
    contents = {target: (files("micah_plan.templates") / name).read_bytes() for name, target in _FILES[kind].items()}
    if model is not None:
        if kind != "problem":
            raise InputError(f"a {kind} is not made from a model", remedy="leave out --model")
        contents["problem.yaml"] = first_problem(load_model(model)).encode()
        contents["model.yaml"] = Path(model).read_bytes()
    for described in ("sweep", "problem", "model", "tags"):
        if f"{described}.yaml" in contents:
            contents[f"{described}.schema.json"] = (json.dumps(schema(described), indent=2) + "\n").encode()
    for name in contents:
        if (place / name).exists():
            raise InputError("is there already", source=place / name, remedy="name another folder")
    try:
        place.mkdir(exist_ok=True)
    except OSError as error:
        problem = f"cannot be made ({error.strerror})"
        raise InputError(problem, source=place, remedy="name a folder in one that exists") from None
    for name, content in contents.items():
        replace_file(place / name, content)
    return tuple(place / name for name in contents)
