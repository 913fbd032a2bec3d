"""Values that print as a few lines, tables of text, and progress callbacks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from html import escape

Progress = Callable[[str, float], None]
"""Is called during long work with a message and the fraction that is done."""


class Summarised(ABC):
    """A value whose text in consoles, `print` and notebooks is its `summary`."""

    @abstractmethod
    def summary(self) -> str:
        """The essentials in a few lines."""

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        return f"<pre>{escape(self.summary())}</pre>"


@dataclass(frozen=True)
class Table:
    """Texts in named columns.

    Attributes:
        rows: a text for each column; it may have two lines, which are one where there is room.
        title: what stands above; empty: nothing.
        firm: names of columns that are never folded.
        numeric: columns (from 0) of numbers, which pages set to the right.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""
    firm: tuple[str, ...] = ()
    numeric: tuple[int, ...] = ()

    def lines(self) -> list[str]:
        """The table as plain text, each row on one line."""
        cells = [[" ".join(text.split("\n")) for text in row] for row in (self.columns, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        texts = ["  ".join(f"{text:{width}}" for text, width in zip(row, widths, strict=True)) for row in cells]
        return [*([self.title] if self.title else []), *(f"  {text}".rstrip() for text in texts)]


def aligned(title: str, rows: dict[str, str]) -> str:
    """A title with aligned rows of name and text; empty texts are omitted."""
    width = max(map(len, rows), default=0) + 2
    return "\n".join([title, *(f"  {name:{width}}{text}" for name, text in rows.items() if text)])


def listed(texts: list[str] | tuple[str, ...], most: int = 6) -> str:
    """Texts joined by commas; long lists are cut with the number of omitted ones."""
    more = f", and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more
