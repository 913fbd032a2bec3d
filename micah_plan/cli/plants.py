"""Machines of users, named on the command line: ``FILE.py:CLASS``, or the name under which a package registers one.

This is the only place that loads code which is not the package's. It is above everything that reads files, so no
problem, sweep or plan can have code loaded.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.cli.user_code import module_in
from micah_plan.errors import InputError, shown
from micah_plan.task.plants import BUILT_IN

if TYPE_CHECKING:
    from micah_plan.execution.plant import PlantMaker

ENTRY_POINTS = "micah_plan.plants"
"""Group under which packages register plants: ``NAME = "module:CLASS"``."""


def named_plant(text: str) -> str | PlantMaker:
    """The plant of ``--plant``: a built-in name, or a class or function that makes one from the problem.

    Raises:
        InputError: if there is none, or its code cannot be loaded.
    """
    if text in BUILT_IN:
        return text
    place, _, name = text.rpartition(":")
    if place:
        return _in_file(Path(place), name)
    if text.endswith(".py"):
        raise InputError(f"expected FILE.py:CLASS, found {shown(text)}", remedy="name the class after a colon")
    registered = {point.name: point for point in entry_points(group=ENTRY_POINTS)}
    if text not in registered:
        names = ", ".join([*BUILT_IN, *sorted(registered.keys() - BUILT_IN.keys())])
        raise InputError(f"there is no plant {shown(text)}", remedy=f"choose among {names}, or give FILE.py:CLASS")
    return _registered(registered[text])


def _in_file(file: Path, name: str) -> PlantMaker:
    module = module_in(file, "give --plant as FILE.py:CLASS")
    return _maker(getattr(module, name, None), name, str(file))


def _registered(point: EntryPoint) -> PlantMaker:
    from micah_plan.execution.checked_plant import error_in_user_code

    try:
        maker = point.load()
    except (Exception, SystemExit) as error:
        raise error_in_user_code(error, None, f"loading the plant {shown(point.name)} ({point.value})") from error
    return _maker(maker, point.attr, point.value)


def _maker(maker: Any, name: str, source: str) -> PlantMaker:
    if maker is None:
        raise InputError(f"there is no class {shown(name)}", source=source, remedy="check its name")
    if not callable(maker):
        problem = f"{name} must be a class or function that is called with the problem. Got {type(maker).__name__}"
        raise InputError(problem, source=source)
    made: PlantMaker = maker
    return made
