"""The page of a folder of work: a card for each file, links to the pages of it, and the next command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

from micah_plan.view.page import Status, render


@dataclass(frozen=True)
class Card:
    """A file.

    Attributes:
        name: of the file.
        words: its main facts, in a few lines.
        badge: one word on whether it is good; None: none.
        pages: names of its pages.
    """

    name: str
    words: str
    badge: tuple[str, Status] | None = None
    pages: tuple[str, ...] = ()


def folder_page(
    title: str, cards: Sequence[tuple[str, Sequence[Card]]], pages: Sequence[str], step: tuple[str, str]
) -> str:
    """The page as HTML text.

    Args:
        cards: by heading, in the order in which work goes on.
        pages: names of further pages in the folder.
        step: the next command, and why; empty: none.
    """
    return render("folder.html.j2", page=_FolderPage(title, "folder of work", cards, pages, step), link=quote)


@dataclass(frozen=True)
class _FolderPage:
    """Values of the template."""

    title: str
    kind: str
    cards: Sequence[tuple[str, Sequence[Card]]]
    pages: Sequence[str]
    step: tuple[str, str]
