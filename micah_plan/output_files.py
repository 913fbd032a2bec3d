"""The files that a command will write, checked before it works: their kinds, and that they destroy nothing."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from micah_plan.errors import InputError, shown
from micah_plan.files import require_directory

PAGE = (".html",)
FIGURE = (".png",)
MODEL = (".yaml", ".yml")
PLAN = (".json",)
TABLE = (".csv", ".parquet")
RUNS = (".csv", ".npz")  # a TUM trajectory cannot hold the actions of a run


class Output(NamedTuple):
    """A file that a command will write: the option that names it, its path if it was asked for, what it may end in."""

    option: str
    path: Path | None
    suffixes: Collection[str]


def check_outputs(inputs: Collection[Path | None], outputs: Collection[Output]) -> None:
    """Refuse, before any work, outputs that would destroy a file of this command or that cannot be written.

    Args:
        inputs: files that the command reads; None for those not given.
        outputs: files that it will write.

    Raises:
        InputError: if an output is an input or another output (links followed), has no directory to be in, or ends in
            none of its suffixes.
    """
    read = {os.path.realpath(path) for path in inputs if path is not None}
    taken: dict[str, str] = {}
    for option, path, suffixes in outputs:
        if path is None:
            continue
        place = os.path.realpath(path)
        if place in read:
            raise InputError(
                f"{option} would overwrite an input", source=path, remedy=f"name another file for {option}"
            )
        if place in taken:
            problem = f"{taken[place]} and {option} would write the same file"
            raise InputError(problem, source=path, remedy="give each a name of its own")
        taken[place] = option
        require_directory(path)
        if path.suffix.lower() not in suffixes:
            problem = f"{option} must end in {' or '.join(suffixes)}, found {shown(path.suffix)}"
            raise InputError(problem, source=path, remedy="rename it")
