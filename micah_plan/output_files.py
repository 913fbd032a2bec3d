"""Checks of output files before a command starts work: their kinds, and that no input is overwritten."""

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
    """An output of a command: the option, its path if given, and allowed suffixes."""

    option: str
    path: Path | None
    suffixes: Collection[str]


def check_outputs(inputs: Collection[Path | None], outputs: Collection[Output]) -> None:
    """Refuse outputs that would overwrite an input, or that cannot be written.

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
