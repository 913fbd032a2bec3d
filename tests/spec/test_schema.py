"""The JSON Schemas describe every field of the files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from micah_plan.errors import InputError
from micah_plan.spec.schema import schema


def objects(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        if "properties" in node:
            yield node
        for child in node.values():
            yield from objects(child)
    elif isinstance(node, list):
        for child in node:
            yield from objects(child)


@pytest.mark.parametrize("kind", ["model", "parts", "problem", "plan"])
def test_every_field_is_described_and_no_other_allowed(kind: str) -> None:
    described = schema(kind)
    assert described["properties"]["format"]["const"] == f"micah-plan/{kind}/1"
    found = list(objects(described))
    assert len(found) > 2
    for node in found:
        assert node["additionalProperties"] is False
        for name, field in node["properties"].items():
            assert len(field.get("description", "")) > 4, f"{node['title']}.{name}"
    assert json.loads(json.dumps(described)) == described


def test_a_half_space_is_text_or_named_text() -> None:
    mode = schema("model")["$defs"]["ModeDocument"]["properties"]
    assert [option["type"] for option in mode["invariant"]["items"]["anyOf"]] == ["string", "object"]


def test_another_kind_is_refused() -> None:
    with pytest.raises(InputError, match="choose one of model, parts, problem, plan"):
        schema("robot")
