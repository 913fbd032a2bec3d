"""Which keys a layout allows: along a key path, and all of them in dotted form."""

from __future__ import annotations

import types
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Union, get_args, get_origin

from micah_plan.documents.fields import Document
from micah_plan.documents.located import KeyPath


def document_at(document: type[Document], path: KeyPath) -> type[Document] | None:
    """The document type that stands at a key path; None if none does."""
    current: Any = document
    for part in path:
        if _is_document(current):
            field = current.model_fields.get(str(part))
            current = None if field is None else _plain(field.annotation)
        else:
            arguments = get_args(current)
            current = _plain(arguments[-1]) if arguments else None
    return current if _is_document(current) else None


def allows(kind: Any, path: Sequence[str]) -> bool:
    """Whether a layout can have a value at a key path; whatever names its mappings have."""
    kind = _plain(kind)
    if not path:
        return True
    if _is_document(kind):
        return path[0] in kind.model_fields and allows(kind.model_fields[path[0]].annotation, path[1:])
    origin, arguments = get_origin(kind), get_args(kind)
    if origin not in (dict, list, tuple):
        return kind is Any
    return (origin is dict or path[0].isdigit()) and allows(arguments[-1], path[1:])


def dotted_paths(kind: Any, prefix: str = "") -> Iterator[str]:
    """The dotted paths of all values that a layout has, without those below mappings and lists."""
    kind = _plain(kind)
    if _is_document(kind):
        for name, field in kind.model_fields.items():
            yield prefix + name
            yield from dotted_paths(field.annotation, f"{prefix}{name}.")


def _is_document(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Document)


def _plain(annotation: Any) -> Any:
    """An annotation without Annotated and `| None`."""
    if get_origin(annotation) is Annotated:
        return _plain(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return _plain(next(kind for kind in get_args(annotation) if kind is not type(None)))
    return annotation
