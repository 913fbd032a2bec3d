"""The JSON Schemas describe every field of the files."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from micah_plan.documents.kind import kind_of, schema
from micah_plan.documents.yaml_lines import read_yaml
from micah_plan.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("models", "models/parts", "problems", "problems/sweeps", "problems/experiments")
SHIPPED = [(kind_of(file), file) for place in FOLDERS for file in sorted((ROOT / place).glob("*.yaml"))]


def objects(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        if "properties" in node:
            yield node
        for child in node.values():
            yield from objects(child)
    elif isinstance(node, list):
        for child in node:
            yield from objects(child)


@pytest.mark.parametrize("kind", ["model", "parts", "problem", "scene", "sweep", "plan"])
def test_every_field_is_described_and_no_other_allowed(kind: str) -> None:
    described = schema(kind)
    assert described["properties"]["format"]["const"] == f"micah-plan/{kind}/1"
    found = list(objects(described))
    assert len(found) > 1
    for node in found:
        assert node["additionalProperties"] is False
        for name, field in node["properties"].items():
            assert len(field.get("description", "")) > 4, f"{node['title']}.{name}"
    assert json.loads(json.dumps(described)) == described


def test_a_half_space_is_text_or_named_text() -> None:
    mode = schema("model")["$defs"]["ModeDocument"]["properties"]
    assert [option["type"] for option in mode["invariant"]["items"]["anyOf"]] == ["string", "object"]


def test_another_kind_is_refused() -> None:
    with pytest.raises(
        InputError, match="choose one of model, parts, problem, scene, sweep, experiment, conventions, tags, plan"
    ):
        schema("robot")


@pytest.mark.sweep
@pytest.mark.parametrize(("kind", "file"), SHIPPED, ids=[file.stem for _, file in SHIPPED])
def test_files_that_ship_are_as_the_schemas_say(kind: str, file: Path) -> None:
    data = read_yaml(file.read_bytes(), str(file)).data
    validator = jsonschema.Draft202012Validator(schema(kind))
    assert [error.message for error in validator.iter_errors(data)] == []
    data["surprise"] = 1
    assert not validator.is_valid(data)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("confidence", 2, "maximum of 1.0"), ("model", 3, "is not of type 'string'"), ("goal", {"modes": "a"}, "'array'")],
)
def test_an_editor_marks_what_the_reader_refuses(key: str, value: object, said: str) -> None:
    data = read_yaml((ROOT / "problems" / "drawer_open.yaml").read_bytes(), "p").data
    data[key] = value
    (error,) = jsonschema.Draft202012Validator(schema("problem")).iter_errors(data)
    assert said in error.message


@pytest.mark.slow
def test_the_command_writes_the_schema(tmp_path: Path) -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "micah_plan", "schema", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    assert json.loads(run("problem").stdout) == schema("problem")
    assert run("model", "-o", "model.json").stdout == "wrote model.json\n"
    assert json.loads((tmp_path / "model.json").read_text()) == schema("model")
    refused = run("robot")
    assert refused.returncode == 2
    offered = re.findall(r"'([a-z]+)'", refused.stderr.partition(" is not one of ")[2])
    assert offered
    for kind in offered:
        json.loads(run(kind).stdout)
