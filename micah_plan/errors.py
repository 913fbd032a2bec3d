"""The errors that micah_plan raises on purpose.

Every message is one line that says which file, which key or row, what was expected, what was found and what to do.
The command line turns them into exit codes: 2 for bad input, 1 where no plan, joint or explanation was found.
"""

from __future__ import annotations

import difflib
import re
import shlex
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

_LONGEST_VALUE = 60
_LONGEST_LIST = 200
_LONGEST_NAME = 120
_LONGEST_LINE = 1000

TAKE_CODE = ("solve", "explain", "execute", "predict", "calibrate", "check", "show")
"""Commands that load a user's Python file."""
OF_YOUR_OWN = (
    f"one of your own is registered in a file that {', '.join(TAKE_CODE[:-1])} and {TAKE_CODE[-1]} take as --code"
)
"""Remedy for a name of an effect or path function that nothing registered."""


class MicahError(Exception):
    """Root of all errors raised on purpose by micah_plan."""


class InputError(MicahError):
    """Input that cannot be used: a file, a key, a row or an argument.

    Args:
        problem: what was expected and what was found, e.g. ``"expected a number, found 'abc'"``.
        source: the file, if the input came from one.
        where: the place in it, e.g. ``"line 7, column 'x'"`` or ``"line 3, key 'goal.target'"``.
        remedy: what the user can do about it.
        position: line and column of the place, both from 1, where both are known.
        further: what else is wrong with the same input, found at the same time.
    """

    def __init__(
        self,
        problem: str,
        *,
        source: str | Path | None = None,
        where: str | None = None,
        remedy: str | None = None,
        position: tuple[int, int] | None = None,
        further: Sequence[InputError] = (),
    ) -> None:
        self.problem = problem
        self.source = None if source is None else str(source)
        self.where = where
        self.remedy = remedy
        self.position = position
        self.further = tuple(further)
        place = ", ".join(part for part in (self.source, where) if part)
        text = f"{place}: {problem}" if place else problem
        if further:
            text += f" (and {len(further)} more error{'s' if len(further) > 1 else ''})"
        line = f"{text}; {remedy}" if remedy else text
        line = line if len(line) <= _LONGEST_LINE else f"{line[: _LONGEST_LINE - 3]}..."
        super().__init__("".join(c if c.isprintable() else "?" for c in line))  # a path may hold a line break

    def _with(self, further: Sequence[InputError], source: str | Path | None = None) -> InputError:
        """The same error with other further errors, and a default source."""
        return InputError(
            self.problem,
            source=self.source or source,
            where=self.where,
            remedy=self.remedy,
            position=self.position,
            further=further,
        )

    def located(self, source: str | Path) -> InputError:
        """The same error and its further ones, with a default source."""
        return self._with([error.located(source) for error in self.further], source)

    def each(self) -> tuple[InputError, ...]:
        """This error and the further ones, separately."""
        return (self._with(()), *self.further)


@contextmanager
def located_in(source: str | Path) -> Iterator[None]:
    """A context that adds a file to input errors without a source."""
    try:
        yield
    except InputError as error:
        raise error.located(source) from None


def together(errors: Sequence[InputError]) -> InputError:
    """Several errors of the same input as one: the first, which carries the others and their number."""
    return errors[0]._with(errors[1:])


class MissingDependencyError(MicahError):
    """An optional library is missing; the message explains how to install it."""

    @classmethod
    def of(cls, extra: str, problem: str) -> MissingDependencyError:
        """The error for an extra, with its installation command."""
        return cls(f"{problem}: {pip_install(extra)}")


def pip_install(extra: str) -> str:
    """The command that installs an extra, for any kind of installation: it lists the libraries.

    An extra can be named only where pip finds the project itself, in its checkout; that is said only where what is
    installed does not know which libraries those are.
    """
    from importlib.metadata import PackageNotFoundError, requires

    try:
        needed = requires("micah-plan") or []
    except PackageNotFoundError:
        needed = []
    mark = re.compile(rf"extra == ['\"]{re.escape(extra)}['\"]")
    names = sorted(line.partition(";")[0].strip() for line in needed if mark.search(line))
    if not names:
        return f"pip install -e '.[{extra}]' in the checkout"
    return f"pip install {shlex.join(names)}"


def printable(text: str) -> str:
    """A text with control characters made visible; line breaks and tabs are kept.

    Directions of writing are control characters too: they make a name look like another.
    """
    return "".join(
        c if c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cf") else c.encode("unicode_escape").decode()
        for c in text
    )


def shown(value: object) -> str:
    """A value for error messages: its repr on one line, shortened."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."


def choices(name: str, allowed: Iterable[str]) -> str:
    """The remedy for an unknown name: ``did you mean 'door'? choose one of door, drawer``."""
    names = list(allowed)
    if not names:
        return "none is allowed here"
    listed = ", ".join(names)
    listed = listed if len(listed) <= _LONGEST_LIST else listed[: _LONGEST_LIST - 3] + "..."
    near = nearest(name, names)
    return (f"did you mean '{near}'? " if near is not None else "") + f"choose one of {listed}"


def nearest(name: str, allowed: Iterable[str]) -> str | None:
    """The allowed name that looks most like this one, if any does."""
    near = difflib.get_close_matches(name[:_LONGEST_NAME], list(allowed), n=1)
    return near[0] if near else None
