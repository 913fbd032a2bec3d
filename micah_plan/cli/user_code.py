"""Python files of a user: the option ``--code``, and machines of ``--plant FILE.py:CLASS``.

Code is loaded only because a command line names it, never because a data file does.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Annotated

import typer

from micah_plan.errors import InputError, MicahError

Code = Annotated[
    Path | None,
    typer.Option("--code", metavar="FILE.py", help="Python file that registers your effects and path functions."),
]


def load_code(file: Path | None) -> None:
    """Import the file of ``--code``, so that its effects and path functions are registered.

    Raises:
        InputError: if it cannot be loaded.
    """
    if file is not None:
        module_in(file, "give --code as FILE.py")


def module_in(file: Path, remedy: str) -> ModuleType:
    """The module that a file is, loaded once in a process.

    Args:
        remedy: what to do if there is no such file.

    Raises:
        InputError: if there is none, or its code fails.
    """
    if not file.is_file():
        raise InputError("the file does not exist", source=file, remedy=remedy)
    module = _loaded(str(file.resolve()), file.stat().st_mtime_ns)
    if module is None:
        raise InputError("expected a Python file", source=file, remedy=remedy)
    return module


@cache
def _loaded(path: str, _changed_ns: int) -> ModuleType | None:
    """The module of a file's present version; None if it is not Python."""
    from micah_plan.execution.checked_plant import error_in_user_code

    spec = spec_from_file_location(f"_code_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        return None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there
    sys.path.append(str(Path(path).parent))  # modules next to the file can be imported, and hide no others
    try:
        spec.loader.exec_module(module)
    except MicahError:
        raise
    except (Exception, SystemExit) as error:
        raise error_in_user_code(error, path, "loading it") from error
    return module
