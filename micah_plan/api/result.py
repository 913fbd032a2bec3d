"""Results of the public functions: values that print, plot, show and save themselves.

Pages open in the browser, or within a notebook.
"""

from __future__ import annotations

import sys
import tempfile
from abc import abstractmethod
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.files import replace_file
from micah_plan.recording.value import Recording
from micah_plan.summaries import Summarised, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUREST = 0.999
"""A recording is never surer than ">99 %", whatever is left of the odds in floating point."""


class Result(Summarised):
    """Base of results: consoles print `report` as text, commands as tables, `--json` prints `json`."""

    @property
    @abstractmethod
    def success(self) -> bool:
        """Whether the request was fulfilled."""

    @property
    @abstractmethod
    def outcome(self) -> str:
        """The outcome in one word, for programs."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """The reason in one sentence with its remedy; may be empty on success."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Caveats of the result, one line each."""
        return ()

    @abstractmethod
    def report(self) -> list[str | Table]:
        """The human-readable report, in order."""

    @abstractmethod
    def json(self) -> dict[str, Any]:
        """The object that the command prints with ``--json``."""

    def summary(self) -> str:
        """The report as text."""
        lines = [f"warning: {text}" for text in self.warnings]
        for item in self.report():
            lines += item.lines() if isinstance(item, Table) else [item]
        return "\n".join(lines)

    @property
    def title(self) -> str:
        """The title of its page."""
        return type(self).__name__.removesuffix("Result")

    @abstractmethod
    def plot(self) -> Figure:
        """A Matplotlib figure."""

    @abstractmethod
    def page(self, title: str = "") -> str:
        """The text of a page that needs no network; without a title it has that of the result."""

    @abstractmethod
    def save(self, path: str | Path) -> None:
        """Write the main file of the result: a model, a plan, or a recording."""

    def show(self, path: str | Path | None = None) -> Page:
        """Show the page in the browser, or within a notebook.

        Args:
            path: of the page to write, without opening it; None: a temporary file.
        """
        return Page(self.page()).opened(path)


class RecordedResult(Result):
    """A result whose page, figure and file are those of its recording."""

    @property
    @abstractmethod
    def recording(self) -> Recording:
        """The recording."""

    def plot(self) -> Figure:
        """The tracks over time."""
        from micah_plan.view.learning_figure import learning_figure

        return learning_figure(self.recording)

    def page(self, title: str = "") -> str:
        """The tracks in 3-D."""
        from micah_plan.view.recording_page import recording_page

        return recording_page(self.recording, title=title or self.title)

    def save(self, path: str | Path) -> None:
        """Write the recording (CSV, NPZ, TUM or MCAP)."""
        from micah_plan.recording.read import write_recording

        write_recording(self.recording, path)


@dataclass(frozen=True, repr=False)
class Page:
    """A page that needs no network.

    Attributes:
        text: its HTML.
        height: in a notebook [px].
    """

    text: str
    height: int = 620

    def __repr__(self) -> str:
        return f"a page of {len(self.text) // 1024} kB"

    def _repr_html_(self) -> str:
        frame = f'<iframe width="100%" height="{self.height}" style="border:0" srcdoc="'
        return f'{frame}{escape(self.text)}"></iframe>'

    def save(self, path: str | Path) -> None:
        """Write the page atomically."""
        replace_file(path, self.text.encode())

    def opened(self, path: str | Path | None = None) -> Page:
        """Write the page to `path` if given, else open it in a browser; notebooks display it themselves."""
        if path is not None:
            self.save(path)
        elif not _in_notebook():
            import webbrowser

            file = Path(tempfile.mkdtemp(prefix="micah_plan_")) / "page.html"
            self.save(file)
            webbrowser.open(file.as_uri())
        return self


def _in_notebook() -> bool:
    """Whether an IPython kernel displays results of cells."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


def save_model(automaton: HybridAutomaton | None, reason: str, path: str | Path) -> None:
    """Write a model in the format of the suffix; refused with the reason if there is none."""
    if automaton is None:
        raise InputError(f"there is no model to write: {reason}")
    from micah_plan.exchange.convert import write_model

    write_model(automaton, path, name=Path(path).stem)
