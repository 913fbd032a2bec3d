"""From a recorded demonstration of an articulated object to a manipulation plan that holds under uncertainty.

    from micah_plan import learn, solve, execute

    learned = learn("examples/demonstrations/microwave.csv")
    plan = solve("problems/microwave_close.yaml", model=learned)
    print(execute(plan, trials=5))

Names are loaded when they are first used, so that `import micah_plan` is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from micah_plan.api.calibration import calibrate as calibrate
    from micah_plan.api.execution import execute as execute
    from micah_plan.api.exploration import explore as explore
    from micah_plan.api.files import load as load
    from micah_plan.api.files import save as save
    from micah_plan.api.files import show as show
    from micah_plan.api.learning import learn as learn
    from micah_plan.api.planning import solve as solve
    from micah_plan.api.prediction import predict as predict
    from micah_plan.api.tracking import track as track
    from micah_plan.automaton.hybrid import HybridAutomaton as HybridAutomaton
    from micah_plan.errors import InputError as InputError
    from micah_plan.recording.value import Recording as Recording

__version__ = "0.1.0"

_PLACES = {
    "HybridAutomaton": "automaton.hybrid",
    "InputError": "errors",
    "Recording": "recording.value",
    "calibrate": "api.calibration",
    "execute": "api.execution",
    "explore": "api.exploration",
    "learn": "api.learning",
    "predict": "api.prediction",
    "solve": "api.planning",
    "track": "api.tracking",
    **dict.fromkeys(("load", "save", "show"), "api.files"),
}
__all__ = ["__version__", *sorted(_PLACES)]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    attribute = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = attribute
    return attribute


def __dir__() -> list[str]:
    return list(__all__)
