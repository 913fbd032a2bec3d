"""JSON Schemas of the project's files, for editors and other programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from micah_plan.documents.fields import Document
from micah_plan.documents.model_document import ModelDocument
from micah_plan.documents.part_document import PartsDocument
from micah_plan.documents.plan_document import PlanDocument
from micah_plan.documents.problem_document import ProblemDocument
from micah_plan.documents.sweep_document import SweepDocument
from micah_plan.errors import InputError, shown

_DOCUMENTS: Mapping[str, type[Document]] = {
    "model": ModelDocument,
    "parts": PartsDocument,
    "problem": ProblemDocument,
    "sweep": SweepDocument,
    "plan": PlanDocument,
}


def schema(kind: str) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a file.

    Args:
        kind: ``"model"``, ``"parts"``, ``"problem"``, ``"sweep"`` or ``"plan"``.

    Raises:
        InputError: for another kind.
    """
    if kind not in _DOCUMENTS:
        raise InputError(f"unknown kind of file {shown(kind)}", remedy=f"choose one of {', '.join(_DOCUMENTS)}")
    generated = _DOCUMENTS[kind].model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **generated, "title": f"micah-plan {kind} file"}
