"""Memoisation of functions of an automaton, with the cache in the automaton."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

from micah_plan.automaton.hybrid import HybridAutomaton, Mode

_Function = TypeVar("_Function", bound=Callable[..., Any])
_OF_MOTION = "of motion"


def memoised(function: _Function) -> _Function:
    """A memoised function of an automaton and optionally of a mode."""
    return _memoised(function, lambda automaton: automaton.derived)


def memoised_of_motion(function: _Function) -> _Function:
    """`memoised`, shared by all automata with the same motion (`sharing_motion`)."""
    return _memoised(function, _of_motion)


def sharing_motion(automaton: HybridAutomaton, template: HybridAutomaton) -> HybridAutomaton:
    """The automaton with another's cache of `memoised_of_motion` functions.

    Modes of both must have the same motion and measurements. They may differ in where their boundaries and pins are.
    """
    automaton.derived[_OF_MOTION] = _of_motion(template)
    return automaton


def _of_motion(automaton: HybridAutomaton) -> dict[Any, Any]:
    return cast(dict[Any, Any], automaton.derived.setdefault(_OF_MOTION, {}))


def _memoised(function: _Function, cache_of: Callable[[HybridAutomaton], dict[Any, Any]]) -> _Function:
    @wraps(function)
    def cached(automaton: HybridAutomaton, *mode: Mode | str) -> Any:
        key, cache = (function, getattr(mode[0], "name", mode[0]) if mode else ""), cache_of(automaton)
        if key not in cache:
            cache[key] = function(automaton, *mode)
        return cache[key]

    return cast(_Function, cached)
