"""What a reader does with input that may be bad: a result, or the one line that it says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.model import automaton_of_document
from micah_plan.documents.yaml_lines import read_yaml
from micah_plan.errors import InputError


def attempt(reader: Callable[..., Any], *arguments: Any) -> Any:
    """The reader's result, or the text of its InputError; every other exception is the test's failure."""
    try:
        return reader(*arguments)
    except InputError as error:
        return str(error)


def told(reader: Callable[..., Any], *arguments: Any) -> str:
    """The one line that the reader refuses its input with."""
    result = attempt(reader, *arguments)
    assert isinstance(result, str), f"accepted: {result}"
    assert len(result.splitlines()) == 1
    return result


def parse_model(content: bytes, source: str) -> HybridAutomaton:
    """The automaton that the content of a model file describes, usable or not."""
    return automaton_of_document(read_yaml(content, source))
