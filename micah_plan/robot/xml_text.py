"""XML as plain elements with line numbers, of bounded size and depth, without document types and entities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from micah_plan.errors import InputError
from micah_plan.files import read_bytes

LARGEST_XML_BYTES = 8 * 1024 * 1024
MOST_ELEMENTS = 50_000
DEEPEST = 200


@dataclass
class Element:
    """An element without its text; robot files keep everything in attributes."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)

    def all(self, tag: str) -> list[Element]:
        """The children of a tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> Element | None:
        """The first child of a tag, if there is one."""
        return next((child for child in self.children if child.tag == tag), None)

    def alone(self) -> Element:
        """A copy without the children."""
        return Element(self.tag, dict(self.attributes), self.line)

    def walk(self) -> Iterator[Element]:
        """This element and all below it, in the order of the file."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting.extend(reversed(element.children))


def read_xml(path: str | Path, formats: str) -> str:
    """The text of an XML file.

    Args:
        formats: that it may have, for the message.

    Raises:
        InputError: if the file cannot be read, is too large or is no UTF-8 text.
    """
    try:
        return read_bytes(path, LARGEST_XML_BYTES).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError("expected UTF-8 text", source=path, remedy=f"give a {formats} file") from None


def parse_xml(text: str, source: str) -> Element:
    """The root element.

    Raises:
        InputError: if it is not well-formed, too large or deep, or has a document type (and so could have entities).
    """
    data = text.encode("utf-8", "surrogatepass")
    if len(data) > LARGEST_XML_BYTES:
        raise InputError(f"expected at most {LARGEST_XML_BYTES // 1024 // 1024} MiB of XML", source=source)
    builder = _Builder(source)
    try:
        builder.parser.Parse(data, True)
    except expat.ExpatError as error:
        said, where = expat.ErrorString(error.code), f"line {error.lineno}"
        raise InputError(f"not valid XML: {said}", source=source, where=where, remedy="correct the syntax") from None
    if builder.root is None:
        raise InputError("not valid XML: it is empty", source=source)
    return builder.root


def write_xml(root: Element) -> str:
    """Text of the elements and their attributes."""
    parts: list[str] = []

    def write(element: Element) -> None:
        attributes = "".join(f" {name}={quoteattr(value)}" for name, value in element.attributes.items())
        parts.append(f"<{element.tag}{attributes}>")
        for child in element.children:
            write(child)
        parts.append(f"</{element.tag}>")

    write(root)
    return "".join(parts)


class _Builder:
    """Collects what the parser reports."""

    def __init__(self, source: str) -> None:
        self.root: Element | None = None
        self._source, self._open, self._count = source, list[Element](), 0
        # The text was decoded before; a declaration of another encoding must not have it read again.
        self.parser = expat.ParserCreate("utf-8")
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.StartDoctypeDeclHandler = self._doctype

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MOST_ELEMENTS or len(self._open) >= DEEPEST:
            raise self._error(f"expected at most {MOST_ELEMENTS} elements, {DEEPEST} levels deep")
        element = Element(tag, attributes, self.parser.CurrentLineNumber)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def _end(self, _: str) -> None:
        self._open.pop()

    def _doctype(self, *_: object) -> None:
        raise self._error("document types and entities are not allowed")

    def _error(self, problem: str) -> InputError:
        where = f"line {self.parser.CurrentLineNumber}"
        return InputError(problem, source=self._source, where=where, remedy="write the values out")
