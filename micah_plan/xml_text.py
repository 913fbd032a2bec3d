"""XML as plain elements with line numbers, of bounded size and depth, without document types and entities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes

LARGEST_XML_BYTES = 8 * 1024 * 1024
MOST_ELEMENTS = 50_000
DEEPEST = 200
MOST_INCLUDED = 50
_MISPLACED = expat.errors.XML_ERROR_MISPLACED_XML_PI


@dataclass
class Element:
    """An element. Robot files keep everything in attributes, SDF in `text`. Line and source are for messages."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)
    source: str = ""
    text: str = ""

    def all(self, tag: str) -> list[Element]:
        """The children of a tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> Element | None:
        """The first child of a tag, if there is one."""
        return next((child for child in self.children if child.tag == tag), None)

    def alone(self) -> Element:
        """A copy without the children."""
        return Element(self.tag, dict(self.attributes), self.line, source=self.source, text=self.text)

    def walk(self) -> Iterator[Element]:
        """This element and all below it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()

    def error(self, problem: str, remedy: str) -> InputError:
        """The error that something is wrong with this element."""
        return InputError(problem, source=self.source, where=f"line {self.line}, <{self.tag}>", remedy=remedy)


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
    roots: list[Element] = []
    opened: list[Element] = []
    count = 0
    # The text was decoded before; a declaration of another encoding must not have it read again.
    parser = expat.ParserCreate("utf-8")

    def refused(problem: str) -> InputError:
        where = f"line {parser.CurrentLineNumber}"
        return InputError(problem, source=source, where=where, remedy="write the values out")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS or len(opened) >= DEEPEST:
            raise refused(f"expected at most {MOST_ELEMENTS} elements, {DEEPEST} levels deep")
        element = Element(tag, attributes, parser.CurrentLineNumber, source=source)
        (opened[-1].children if opened else roots).append(element)
        opened.append(element)

    def characters(words: str) -> None:
        if opened:
            opened[-1].text += words

    def doctype(*_: object) -> None:
        raise refused("document types and entities are not allowed")

    parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, doctype
    parser.CharacterDataHandler, parser.buffer_text = characters, True
    parser.EndElementHandler = lambda _: opened.pop()
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        message, where = expat.ErrorString(error.code), f"line {error.lineno}"
        remedy = "put <?xml ...?> first, with nothing before it" if message == _MISPLACED else "correct the syntax"
        raise InputError(f"not valid XML: {message}", source=source, where=where, remedy=remedy) from None
    if not roots:
        raise InputError("not valid XML: it is empty", source=source)
    return roots[0]


def with_includes(root: Element, folder: str | Path, roots: tuple[str, ...]) -> Element:
    """The elements with each `<include file="..."/>` replaced by the content of its file, as MuJoCo does.

    Args:
        folder: of the file; what is included lies in it or below, and in no file twice.
        roots: tags that the root of an included file may have.

    Raises:
        InputError: for a file that lies elsewhere, is not there, was included before or has another root.
    """
    top, seen = Path(folder).resolve(), set[Path]()

    def expanded(element: Element) -> Element:
        copy = element.alone()
        for child in element.children:
            copy.children += included(child) if child.tag == "include" else [expanded(child)]
        return copy

    def included(element: Element) -> list[Element]:
        named = element.attributes.get("file", "")
        path = (top / named).resolve()
        if not named or not path.is_relative_to(top):
            raise element.error(
                f"the file {shown(named)} lies outside of the folder", "put it beside or below this file"
            )
        if path in seen:
            raise element.error(f"the file {shown(named)} was included before", "include it once")
        if len(seen) >= MOST_INCLUDED:
            raise element.error(f"more than {MOST_INCLUDED} files are included", "put some of them together")
        seen.add(path)
        try:
            inner = parse_xml(read_xml(path, "MJCF"), str(Path(folder) / named))
        except InputError as error:
            if error.source != str(path):
                raise
            raise element.error(f"the file {shown(named)}: {error.problem}", error.remedy or "correct it") from None
        if inner.tag not in roots:
            raise element.error(f"the file {shown(named)} has the root <{inner.tag[:40]}>", f"give it <{roots[0]}>")
        return expanded(inner).children

    return expanded(root)


def write_xml(element: Element) -> str:
    """Text of the elements and their attributes."""
    attributes = "".join(f" {name}={quoteattr(value)}" for name, value in element.attributes.items())
    return f"<{element.tag}{attributes}>{''.join(map(write_xml, element.children))}</{element.tag}>"
