"""From a recorded demonstration of an articulated object to a manipulation plan that holds under uncertainty.

    from micah_plan import learn, solve, execute

    learned = learn("examples/demonstrations/microwave.csv")
    plan = solve("problems/microwave_close.yaml", model=learned)
    print(execute(plan, trials=5))

Names are loaded when they are first used, so that `import micah_plan` is quick.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from micah_plan.automaton.hybrid import HybridAutomaton as HybridAutomaton
    from micah_plan.errors import InputError as InputError
    from micah_plan.front.functions import calibrate as calibrate
    from micah_plan.front.functions import execute as execute
    from micah_plan.front.functions import explore as explore
    from micah_plan.front.functions import learn as learn
    from micah_plan.front.functions import load as load
    from micah_plan.front.functions import predict as predict
    from micah_plan.front.functions import save as save
    from micah_plan.front.functions import show as show
    from micah_plan.front.functions import solve as solve
    from micah_plan.recording.value import Recording as Recording

__version__ = "0.1.0"

_PLACES = {
    "HybridAutomaton": "automaton.hybrid",
    "InputError": "errors",
    "Recording": "recording.value",
    **dict.fromkeys(
        ("calibrate", "execute", "explore", "learn", "load", "predict", "save", "show", "solve"), "front.functions"
    ),
}
__all__ = ["__version__", *sorted(_PLACES)]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return [*globals(), *_PLACES]


class _FrontDoor(ModuleType):
    """`learn` and `explore` are functions of the front door and names of subpackages, which would take their places.

    Subpackages are reached by their imports (`from micah_plan.learn.settings import LearnSettings`).
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _PLACES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _FrontDoor
