"""Sweep files (`problems/sweeps/*.yaml`): many problems, with values to try in them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from math import log10, prod
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.documents.fields import Line, Name
from micah_plan.documents.layout import Document, doc, is_document, kind_at
from micah_plan.documents.located import Located
from micah_plan.documents.problem import ProblemDocument, ProblemReader
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import read_yaml_file
from micah_plan.errors import InputError, nearest
from micah_plan.task.plants import DEFAULT_PLANT, SENTENCES, PlantName
from micah_plan.task.problem import Problem
from micah_plan.task.sweep import MOST_CASES, Digests, Sweep, SweptProblem


class ExecuteDocument(Document):
    plant: PlantName = doc(f"Where plans are executed; {SENTENCES}.", DEFAULT_PLANT)
    trials: Annotated[int, Field(ge=1, le=10_000)] = doc("Seeded trials of every plan.", 10)


class SweepDocument(Document):
    """Solve problems with every combination of values and every seed, and put the results into one table."""

    format: Literal["micah-plan/sweep/1"] = doc("Format and version of this file.")
    problems: Annotated[list[Line], Field(min_length=1, max_length=1000)] = doc("Problem files, relative to this file.")
    seeds: Annotated[int, Field(ge=1, le=1_000_000)] = doc("How many seeds.", 1)
    first_seed: Annotated[int, Field(ge=0, le=1_000_000_000)] = doc("The first seed.", 0)
    grid: dict[Name, Annotated[list[Any], Field(min_length=1)]] = doc(
        "Values to try instead of a problem's own, by dotted key of the problem file, e.g. `start.std.door: [0.02, "
        "0.05]`; every combination is a case.",
        dict,
        max_length=50,
    )
    execute: ExecuteDocument | None = doc("Execution of every plan; default: none.", None)


def load_sweep(path: str | Path) -> Sweep:
    """The sweep that a file describes.

    Every problem is loaded, and every value of the grid is put into every problem by itself: keys, types and names must
    be right. A combination that makes a problem impossible is a row of the results, not an error here.

    Raises:
        InputError: if the sweep, a problem or a value cannot be used; one line names the place in the sweep file.
    """
    return _sweep(read_yaml_file(path), Path(path).parent)


def sweep_of(data: Mapping[str, Any], folder: str | Path = ".") -> Sweep:
    """The sweep of plain data of a sweep file; problems are relative to a folder.

    Raises:
        InputError: as `load_sweep`.
    """
    return _sweep(Located(dict(data), ""), Path(folder))


def _sweep(located: Located, folder: Path) -> Sweep:
    document = validated(located, SweepDocument)
    lengths = [len(values) for values in document.grid.values()]
    size = len(document.problems) * prod(lengths) * document.seeds
    if size > MOST_CASES:
        count = f"{size:,}" if size < 10**15 else f"about 10^{log10(size):.0f}"
        lists = [*map(str, lengths[:8]), *["..."][: len(lengths[8:])]]
        shown = " x ".join([f"{len(document.problems)} problem(s)", *lists])
        problem = f"expected at most {MOST_CASES:,} cases, found {count} ({shown} x {document.seeds} seeds)"
        raise located.error(problem, "take fewer values or seeds, or make several sweeps of it")
    _check_grid(document, located)
    return Sweep(
        problems=tuple(_problem(document, number, located, folder) for number in range(len(document.problems))),
        grid=tuple((key, tuple(values)) for key, values in document.grid.items()),
        seeds=range(document.first_seed, document.first_seed + document.seeds),
        plant=DEFAULT_PLANT if document.execute is None else document.execute.plant,
        trials=0 if document.execute is None else document.execute.trials,
        source=located.source,
    )


def _check_grid(document: SweepDocument, located: Located) -> None:
    """Refuse grids with duplicate cases, or with values that no problem accepts."""
    _check_distinct(document.problems, "problem", located.at("problems"))
    keys = [key.split(".") for key in document.grid]
    for key, values in document.grid.items():
        names = key.split(".")
        if names[0] == "format":
            raise located.at("grid", key).error("the format is no value to vary", "take it out")
        if kind_at(ProblemDocument, names) is None:
            near = nearest(key, _dotted_paths(ProblemDocument))
            remedy = "see the page on the problem file" if near is None else f"did you mean '{near}'?"
            raise located.at("grid", key).error("no problem has this key", remedy)
        for other in keys:
            if len(other) < len(names) and names[: len(other)] == other:
                problem = f"lies within {'.'.join(other)}, which the grid varies too"
                raise located.at("grid", key).error(problem, "vary one of them")
        _check_distinct([json.dumps(value, sort_keys=True) for value in values], "value", located.at("grid", key))


def _dotted_paths(layout: type[Document], prefix: str = "") -> Iterator[str]:
    """The dotted paths of all values of a layout, without those below mappings and lists."""
    for name in layout.model_fields:
        yield prefix + name
        inner = kind_at(layout, [name])
        if is_document(inner):
            yield from _dotted_paths(inner, f"{prefix}{name}.")


def _check_distinct(texts: Sequence[str], what: str, located: Located) -> None:
    keys = set()
    for number, text in enumerate(texts):
        if text in keys:
            raise located.at(number).error(f"the same {what} twice", "keep one of them")
        keys.add(text)


def _problem(document: SweepDocument, number: int, located: Located, folder: Path) -> SweptProblem:
    name = document.problems[number]
    path = folder / name
    reader = ProblemReader(path)
    try:
        digests = _digests(reader.load())
    except InputError as error:
        within = "" if error.where is None else f", {error.where}"
        raise located.at("problems", number).error(f"{path}{within}: {error.problem}", error.remedy) from None
    others = {}
    for key, values in document.grid.items():
        for i, value in enumerate(values):
            try:
                found = _digests(reader.describe({key: value}))
            except InputError as error:
                problem = f"{name}: {error.problem}"
                raise located.at("grid", key, i).error(problem, error.remedy) from None
            others[key, i] = {role: digest for role, digest in found.items() if digests.get(role) != digest}
    changed = {place: digest for place, digest in others.items() if digest}
    return SweptProblem(name, path.resolve(), digests, changed)


def _digests(problem: Problem) -> Digests:
    """Digests of the files, including meshes of bodies around the object."""
    return {**problem.digests, "scene": hashlib.sha256(repr(problem.scene).encode()).hexdigest()}
