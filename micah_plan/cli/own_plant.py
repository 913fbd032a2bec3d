"""A user's machine, named on the command line: ``FILE.py:CLASS``, or a name that an installed package registered.

This is the only place that loads code which is not the package's. It is above everything that reads files, so no
problem, sweep or plan can have code loaded.
"""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.errors import InputError, MicahError, shown
from micah_plan.task.plants import BUILT_IN

if TYPE_CHECKING:
    from micah_plan.execution.plant import PlantMaker

ENTRY_POINTS = "micah_plan.plants"
"""Group under which packages register plants: ``NAME = "module:CLASS"``."""


def named_plant(text: str) -> str | PlantMaker:
    """What ``--plant`` means: the name of a plant of the package, or a class or function that makes one of the problem.

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
    from micah_plan.execution.checked_plant import fault

    source = str(file)
    if not file.is_file():
        raise InputError("the file does not exist", source=file, remedy="give --plant as FILE.py:CLASS")
    path = str(file.resolve())
    spec = spec_from_file_location(f"_plant_{file.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError("expected a Python file", source=file, remedy="give --plant as FILE.py:CLASS")
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there
    sys.path.append(str(Path(path).parent))  # what lies beside the file can be imported, and hides nothing
    try:
        spec.loader.exec_module(module)
    except MicahError:
        raise
    except (Exception, SystemExit) as error:
        raise fault(error, path, "loading it") from error
    return _maker(getattr(module, name, None), name, source)


def _registered(point: EntryPoint) -> PlantMaker:
    from micah_plan.execution.checked_plant import fault

    try:
        found = point.load()
    except (Exception, SystemExit) as error:
        raise fault(error, None, f"loading the plant {shown(point.name)} ({point.value})") from error
    return _maker(found, point.attr, point.value)


def _maker(found: Any, name: str, source: str) -> PlantMaker:
    if found is None:
        raise InputError(f"there is no class {shown(name)}", source=source, remedy="check its name")
    if not callable(found):
        problem = f"{name} must be a class or function that is called with the problem. Got {type(found).__name__}"
        raise InputError(problem, source=source)
    made: PlantMaker = found
    return made
