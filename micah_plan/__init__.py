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
    from micah_plan.api.calibration import calibrate as calibrate
    from micah_plan.api.calibration import predict as predict
    from micah_plan.api.files import load as load
    from micah_plan.api.files import save as save
    from micah_plan.api.files import show as show
    from micah_plan.api.learning import explore as explore
    from micah_plan.api.learning import learn as learn
    from micah_plan.api.planning import execute as execute
    from micah_plan.api.planning import solve as solve
    from micah_plan.api.tracking import track as track
    from micah_plan.automaton.hybrid import HybridAutomaton as HybridAutomaton
    from micah_plan.errors import InputError as InputError
    from micah_plan.recording.value import Recording as Recording

__version__ = "0.1.0"

_PLACES = {
    "HybridAutomaton": "automaton.hybrid",
    "InputError": "errors",
    "Recording": "recording.value",
    **dict.fromkeys(("calibrate", "predict"), "api.calibration"),
    **dict.fromkeys(("execute", "solve"), "api.planning"),
    **dict.fromkeys(("explore", "learn"), "api.learning"),
    **dict.fromkeys(("load", "save", "show"), "api.files"),
    "track": "api.tracking",
}
__all__ = ["__version__", *sorted(_PLACES)]
_PACKAGES = ("explore", "learn")  # subpackages with the names of functions


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name in _PACKAGES:
        return import_module(f"{__name__}.{name}")
    attribute = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = attribute
    return attribute


def __dir__() -> list[str]:
    return list(__all__)


class _Verb(ModuleType):
    """A subpackage with the name of a function: it is called as that function (`micah_plan.learn(recording)`)."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._function(*args, **options)

    @property
    def __signature__(self) -> Any:
        from inspect import signature

        return signature(self._function)

    @property
    def _function(self) -> Any:
        name = self.__name__.rpartition(".")[2]
        return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)


class _Package(ModuleType):
    """This package, which makes its subpackages `learn` and `explore` callable when they are imported."""

    def __setattr__(self, name: str, value: object) -> None:
        if name in _PACKAGES and isinstance(value, ModuleType):
            value.__class__ = _Verb
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
