"""Shared parts of the commands: options, exit codes, and output: results on stdout, progress on stderr."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from micah_plan.errors import MicahError, printable
from micah_plan.files import replace_files
from micah_plan.summaries import Table

if TYPE_CHECKING:
    from rich.table import Table as RichTable

    from micah_plan.api.result import Result


JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Random seed; the same seed gives the same files.")]
OutputPath = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]

NO_RESULT = 1
"""The command worked, and found nothing: no plan, no joint that fits, no effect that explains."""
BAD_INPUT = 2
OUR_BUG = 70
"""A bug: an error that no input should cause (EX_SOFTWARE of sysexits.h)."""


class _PlainConsole(Console):
    """Prints text verbatim: brackets and colons have no meaning, control characters are made visible."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, soft_wrap=True, highlight=False, markup=False, emoji=False)

    def render_str(self, text: str, **style: Any) -> Text:
        """Convert every string before it is printed, also in tables."""
        return super().render_str(printable(text), **style)


out = _PlainConsole()
err = _PlainConsole(stderr=True)


class Interrupted(MicahError):  # noqa: N818 - it is no mistake
    """Ctrl-C in a resumable command; the message explains how to resume."""


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """Progress callback with message and fraction, shown on a terminal unless quiet.

    With the time that has passed and, once it can be told, about how much is left.
    """
    if quiet or not err.is_terminal:
        yield lambda *_: None
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from micah_plan.cli.time_left import TimeLeft

    described = TextColumn("{task.description}", markup=False)
    columns = (SpinnerColumn(), described, BarColumn(), TimeElapsedColumn(), TimeLeft())
    with Progress(*columns, console=err, transient=True) as bars:
        task = bars.add_task("starting", total=1.0)
        yield lambda message, fraction: bars.update(task, description=printable(message), completed=fraction)


def print_summary(as_json: bool, summary: dict[str, Any], human: Callable[[], None]) -> None:
    """Print a summary as one JSON object, or by calling `human`."""
    if as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        human()


def title_of(file: Path) -> str:
    """Title of a file's page: its name, or its folder's for problem.yaml and model.yaml."""
    return file.resolve().parent.name if file.stem in ("problem", "model") else file.stem


def print_warnings(warnings: Iterable[str]) -> None:
    """One line each on stderr."""
    for warning in warnings:
        err.print(f"warning: {warning}", style="yellow")


def table(*columns: str, **style: Any) -> RichTable:
    """An empty table in the common style, as wide as the terminal; longer text is folded."""
    from rich.box import SIMPLE
    from rich.table import Column
    from rich.table import Table as RichTable

    return RichTable(*(Column(name, overflow="fold") for name in columns), box=SIMPLE, **style)


def drawn(result: Result, title: str, html: Path | None, figure: Path | None = None) -> dict[Path, bytes]:
    """Contents of the requested page and figure of a result, by path."""
    contents = dict[Path, bytes]()
    if html is not None:
        contents[html] = result.page(title).encode()
    if figure is not None:
        from micah_plan.view.figures import png

        contents[figure] = png(result.plot())
    return contents


def write_and_print(
    result: Result, contents: Mapping[Path, bytes], as_json: bool, more: Mapping[str, Any] | None = None
) -> None:
    """Write the files of a result atomically and print it: warnings on stderr, the rest on stdout.

    Args:
        more: further keys of the JSON object.
    """
    print_warnings(result.warnings)
    replace_files(contents)
    if as_json:
        print(json.dumps(result.json() | dict(more or {}), allow_nan=False))
        return
    for item in result.report():
        out.print(_as_wide_as_the_terminal(item) if isinstance(item, Table) else item)
    print_files(contents)


def _as_wide_as_the_terminal(value: Table) -> RichTable:
    """A table that uses one line per cell where the terminal is wide enough."""
    line = " " if out.width >= max(map(len, value.lines())) + 3 * len(value.columns) else "\n"
    shown = table(*(name.replace("\n", line) for name in value.columns), padding=(0, 1, 0, 0), title_justify="left")
    shown.title = value.title or None
    for name in value.firm:
        shown.columns[value.columns.index(name)].no_wrap = True
    for row in value.rows:
        shown.add_row(*(cell.replace("\n", line) for cell in row))
    return shown


def print_lines(lines: Iterable[str]) -> None:
    """Lines as they are."""
    for line in lines:
        out.print(line)


def print_files(files: Iterable[Path | None]) -> None:
    """Prints which files were written."""
    for path in files:
        if path is not None:
            out.print(f"wrote {path}")
