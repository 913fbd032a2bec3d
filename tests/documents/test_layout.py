"""What all layouts share: writing by a layout, lists that become tuples, and places in a file."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from attempts import told

from micah_plan.documents.fields import Listed, Names, Positive, Vector3
from micah_plan.documents.layout import Document, doc, kind_at, plain_data
from micah_plan.documents.located import Located
from micah_plan.documents.validation import validated
from micah_plan.errors import InputError

FORMAT = "micah-plan/path/1"


class PointDocument(Document):
    at: Vector3 = doc("Where it is.")
    size: float = doc("Its size.", 1.0)


class PathDocument(Document):
    format: Literal["micah-plan/path/1"] = doc("Of this file.", FORMAT)
    points: list[PointDocument] = doc("On the way.", list)
    named: dict[str, PointDocument] = doc("By name.", dict)
    weights: Annotated[tuple[Positive, ...], Listed(1, 2)] = doc("Two at most.", (1.0,))
    names: Names = doc("Of all.", tuple)
    note: str | None = doc("Said of it.", None)


@dataclass(frozen=True)
class Point:
    at: tuple[float, float, float]
    size: float = 1.0
    further: str = "no key of the layout"


def test_values_are_written_in_the_layouts_order_without_defaults() -> None:
    start, end = Point((0, 0, 0)), Point((1.0, np.float64(2.0), 3.0), 4)
    data = plain_data(PathDocument, {"named": {"end": end}, "note": None, "points": (start, end), "weights": (1.0,)})
    assert data == {
        "points": [{"at": [0.0, 0.0, 0.0]}, {"at": [1.0, 2.0, 3.0], "size": 4.0}],
        "named": {"end": {"at": [1.0, 2.0, 3.0], "size": 4.0}},
    }
    assert list(data) == ["points", "named"]
    assert {type(value) for value in data["points"][1]["at"]} == {float}


def test_a_default_is_written_on_request() -> None:
    class SizedDocument(PointDocument):
        always_written = ("size",)

    assert plain_data(SizedDocument, Point((0.0, 0.0, 1.0))) == {"at": [0.0, 0.0, 1.0], "size": 1.0}


def test_an_inner_mapping_is_taken_as_it_is() -> None:
    assert plain_data(PathDocument, {"points": [{"at": "anything"}]}) == {"points": [{"at": "anything"}]}


def test_an_entry_reads_back_as_its_value() -> None:
    point = Point((1.0, 2.0, 3.0), 4.0)
    assert Point(**dict(PointDocument.model_validate(plain_data(PointDocument, point)))) == point


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        ([], "key 'weights': expected at least 1 entries, found a list of 0"),
        ([1.0, 2.0, 3.0], "key 'weights': expected at most 2 entries, found a list of 3"),
        ([-1.0], "key 'weights.0': expected a number > 0, found -1.0"),
        (["a", 2.0], "key 'weights.0': expected a number, found 'a'; put it"),
        ("ab", "key 'weights': expected a list, found 'ab'"),
    ],
)
def test_a_list_that_becomes_a_tuple_is_refused_like_any_list(weights: object, expected: str) -> None:
    line = told(validated, Located({"format": FORMAT, "weights": weights}, "f"), PathDocument)
    assert line == f"f, {expected.removesuffix('; put it')}"


def test_a_list_that_becomes_a_tuple_is_a_list_in_the_schema() -> None:
    properties = PathDocument.model_json_schema()["properties"]
    number = {"type": "number", "exclusiveMinimum": 0, "maximum": 1e12}
    written = {"type": "array", "items": number, "minItems": 1, "maxItems": 2}
    assert {key: properties["weights"][key] for key in written} == written
    assert properties["names"]["type"] == "array"
    assert validated(Located({"format": FORMAT, "weights": [2, 3.5]}, "f"), PathDocument).weights == (2.0, 3.5)


def test_the_kind_at_a_key_path() -> None:
    assert kind_at(PathDocument, ["points", "0"]) is PointDocument
    assert kind_at(PathDocument, ["named", "any name", "size"]) is float
    assert kind_at(PathDocument, ["points", 3, "at", 1]) is float
    assert kind_at(PathDocument, ["points", "first"]) is None
    assert kind_at(PathDocument, ["size"]) is None
    assert kind_at(PathDocument, ["note", "more"]) is None


def test_a_place_in_a_file_has_its_line_and_content() -> None:
    whole = Located({"a": {"b": [1, 2]}}, "f", {("a",): (1, 1), ("a", "b"): (2, 3)})
    assert whole.at("a").at("b", 1).data == 2
    assert whole.at("a", "b", 1).where() == "line 2, column 3, key 'a.b.1'"
    assert whole.at("a", "c", "d").data is None
    assert whole.at("a", "c", "d").where() == "line 1, column 1, key 'a.c.d'"
    with pytest.raises(InputError) as error, whole.at("a", "b").locating_errors():
        raise InputError("too long", source="elsewhere", remedy="shorten it")
    assert str(error.value) == "f, line 2, column 3, key 'a.b': too long; shorten it"


def test_names_are_numbered_and_put_in_order() -> None:
    at = Located({}, "f").at("x")
    assert at.number("b", ["a", "b"], "letter") == 1
    assert at.in_order({"b": 2.0, "a": 1.0}, ["a", "b"], "letter") == (1.0, 2.0)
    assert told(at.number, "door", ["doors"], "part") == (
        "f, key 'x': unknown part 'door'; did you mean 'doors'? choose one of doors"
    )
    assert "key 'x.c': unknown letter 'c'" in told(at.in_order, {"c": 1.0}, ["a"], "letter")
    assert "missing value of letter 'a', 'b'" in told(at.in_order, {}, ["a", "b"], "letter")


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("reader", "file", "others"),
    [
        ("model.load_model", "models/microwave.yaml", ("problem", "plan", "sweep", "scene", "hold")),
        ("problem.load_problem", "problems/microwave_close.yaml", ("plan", "sweep")),
        ("parts.load_parts", "models/parts/box.yaml", ("model", "problem", "plan")),
    ],
)
def test_reading_a_file_loads_neither_scipy_nor_other_kinds(
    repository: Path, reader: str, file: str, others: tuple[str, ...]
) -> None:
    module, name = reader.split(".")
    code = f"""
import sys
from micah_plan.documents.{module} import {name}
{name}({str(repository / file)!r})
unwanted = {{"scipy", *("micah_plan.documents." + other for other in {others!r})}}
print(*sorted(unwanted & set(sys.modules)))
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (result.stdout.strip(), result.stderr) == ("", "")
