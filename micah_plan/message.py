"""Messages: sentences for people that carry a code and their values for programmes.

Each package has the sentences of its results in one module ``messages``, as functions of values:

    @message
    def one_run(coordinate: str) -> str:
        return f"{coordinate}: only one run"

``one_run("door")`` is the sentence, with ``code == "one_run"`` and ``values == {"coordinate": "door"}``. Sentences may
be reworded at any time; codes and values do not change with them.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ParamSpec

P = ParamSpec("P")


class Message(str):
    """A sentence with the code and the values that it was made of; a plain string to everything else.

    Attributes:
        code: what the sentence says, for programmes.
        values: of the sentence, by name.
    """

    __slots__ = ("code", "values")

    code: str
    values: Mapping[str, Any]

    def __new__(cls, sentence: str, code: str, values: Mapping[str, Any] = MappingProxyType({})) -> Message:
        self = super().__new__(cls, sentence)
        self.code, self.values = code, values
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return Message, (str(self), self.code, dict(self.values))


def message(sentence: Callable[P, str]) -> Callable[P, Message]:
    """A function of values that returns a `Message`; the code is the function's name."""
    signature = inspect.signature(sentence)

    @functools.wraps(sentence)
    def with_code(*args: P.args, **kwargs: P.kwargs) -> Message:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return Message(sentence(*args, **kwargs), sentence.__name__, MappingProxyType(bound.arguments))

    return with_code


def code_of(text: str) -> str:
    """The code of a message, empty for a plain string."""
    return text.code if isinstance(text, Message) else ""


def codes_of(messages: Sequence[str]) -> list[str]:
    """The codes of messages, empty for plain strings, in their order."""
    return [code_of(text) for text in messages]
