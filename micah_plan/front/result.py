"""What all results of the front door have in common."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.front.showing import Page
from micah_plan.summaries import Summarised

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Result(Summarised):
    """What a stage returns. The texts of `print` and of a notebook are its `summary`."""

    @property
    @abstractmethod
    def success(self) -> bool:
        """Whether there is what was asked for."""

    @property
    @abstractmethod
    def outcome(self) -> str:
        """How it ended, in one word that programs can compare."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """Why it ended so, in one sentence with the remedy if there is one; may be empty where it succeeded."""

    @property
    def title(self) -> str:
        """The title of its page."""
        return type(self).__name__.removesuffix("Result")

    @abstractmethod
    def plot(self) -> Figure:
        """A Matplotlib figure."""

    @abstractmethod
    def page(self) -> str:
        """The text of a page that needs no network."""

    @abstractmethod
    def save(self, path: str | Path) -> None:
        """Write it as the file that commands read: a model, a plan, a recording."""

    def show(self, path: str | Path | None = None) -> Page:
        """The page: opened in the browser, or within a notebook.

        Args:
            path: where to write it, and nothing is opened; None: a temporary file.
        """
        return Page(self.page()).opened(path)


def save_model(automaton: HybridAutomaton | None, reason: str, path: str | Path) -> None:
    """Write a model in the format that the ending names; refused with the reason where there is no model."""
    if automaton is None:
        raise InputError(f"there is no model to write: {reason}")
    from micah_plan.exchange.convert import write_model

    write_model(automaton, path, name=Path(path).stem)
