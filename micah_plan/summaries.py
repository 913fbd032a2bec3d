"""What is said while work goes on and of what came out: progress, and values that print as a few lines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from html import escape

Progress = Callable[[str, float], None]
"""Is called during long work with a message and the fraction that is done."""


class Summarised(ABC):
    """A value whose text, at a prompt, in `print` and in a notebook, is its `summary`."""

    @abstractmethod
    def summary(self) -> str:
        """What matters, in a few lines."""

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        return f"<pre>{escape(self.summary())}</pre>"


def aligned(title: str, rows: dict[str, str]) -> str:
    """A title, and below it a line for each name and its text, which are indented alike; empty texts are left out."""
    width = max(map(len, rows), default=0) + 2
    return "\n".join([title, *(f"  {name:{width}}{text}" for name, text in rows.items() if text)])


def listed(texts: list[str] | tuple[str, ...], most: int = 6) -> str:
    """Texts behind each other; of many the first, and how many more."""
    more = f", and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more
