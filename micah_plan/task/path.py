"""Path constraints and costs: registered functions of a user, evaluated by NumPy and CasADi.

A path function gets one step of control, and returns what it requires and what it costs:

    @path_function
    def slow_near_frame(ops, step, *, largest):
        '''Near its frame the door moves by at most `largest` per step, further away by more.'''
        room = ops.maximum(0.0, 1.0 - step.x["door"])
        return [Require("slow near the frame", largest + 0.1 * room - ops.abs(step.u["door"]), "rad")]

A problem uses it by name, ``PathConstraint("slow_near_frame", (("largest", 0.01),))``: files can name a function, but
not define one. Planning requires each margin with the problem's confidence, like a boundary of the model; roll-outs and
executions fail where the true state violates it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from micah_plan.automaton.effects.form import Operations, Value
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import OF_YOUR_OWN, InputError, MicahError, shown

Argument = float | str


@dataclass(frozen=True, eq=False)
class PathStep:
    """One control step. Knot 0 has none, so the start cannot be constrained.

    Attributes:
        x: by coordinate, the state that the step arrives at [rad or m].
        u: by input, the input that was commanded for it [rad or m].
        std: by coordinate, standard deviation of the belief there [rad or m].
        unit: by coordinate, ``"rad"`` or ``"m"``.
    """

    x: Mapping[str, Value]
    u: Mapping[str, Value]
    std: Mapping[str, Value]
    unit: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Require:
    """``margin >= 0`` must hold. The name is that of messages, the unit that of the margin; empty if none applies."""

    name: str
    margin: Value
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Pay:
    """A cost per step, added to that of the plan; the sum must be bounded below."""

    amount: Value


Terms = Sequence[Require | Pay]
PathFunction = Callable[..., Iterable[Require | Pay]]


@dataclass(frozen=True)
class PathConstraint:
    """A path constraint or cost, as an entry of a problem.

    Attributes:
        name: of a registered path function.
        arguments: (keyword, value) of the function; a value is a number or the name of a coordinate or input.
        modes: in which it holds; empty: in all.
    """

    name: str
    arguments: tuple[tuple[str, Argument], ...] = ()
    modes: tuple[str, ...] = ()

    def acts_in(self, mode: str) -> bool:
        """Whether it is active in a mode."""
        return not self.modes or mode in self.modes


_FUNCTIONS: dict[str, PathFunction] = {}


def path_function(function: PathFunction) -> PathFunction:
    """Register a path function under its own name: a decorator.

    It is called as ``function(ops, step, **arguments)`` with a `PathStep` and gives `Require` and `Pay`. It uses the
    functions of `ops` (`automaton.effects.form.Operations`) and has no ``if`` on values, for it is read with arrays and
    with expressions.

    Raises:
        InputError: if the name is taken, or the function cannot be called so.
    """
    name, parameters = function.__name__, list(inspect.signature(function).parameters.values())
    if name in _FUNCTIONS:
        raise InputError(f"a path function {shown(name)} exists already", remedy="choose another name")
    if len(parameters) < 2 or any(parameter.kind is not parameter.KEYWORD_ONLY for parameter in parameters[2:]):
        raise InputError(
            f"path function {shown(name)}: expected (ops, step, *, keywords), found {inspect.signature(function)}"
        )
    _FUNCTIONS[name] = function
    return function


def remove_path_function(name: str) -> None:
    """Remove a function that `path_function` added."""
    if name not in _LIBRARY:
        _FUNCTIONS.pop(name, None)


def check_constraint(constraint: PathConstraint, automaton: HybridAutomaton) -> None:
    """Refuse a constraint that does not fit the model.

    Raises:
        InputError: for an unknown function, mode, coordinate or argument, or a result that is not one number per state.
    """
    for mode in constraint.modes:
        automaton.mode(mode)
    function, named = _function(constraint.name), f"path constraint {shown(constraint.name)}"
    keywords = list(inspect.signature(function).parameters.values())[2:]
    allowed, names_used = [keyword.name for keyword in keywords], [name for name, _ in constraint.arguments]
    needed = [keyword.name for keyword in keywords if keyword.default is keyword.empty]
    if len(set(names_used)) < len(names_used) or set(names_used) - set(allowed) or set(needed) - set(names_used):
        raise InputError(f"{named} takes {', '.join(allowed) or 'no arguments'}. Got {', '.join(names_used) or 'none'}")
    if any(not isinstance(value, str) and not np.isfinite(value) for _, value in constraint.arguments):
        raise InputError(f"{named}: arguments must be finite. Got {shown(dict(constraint.arguments))}")
    points = np.zeros((automaton.n, 2)), np.zeros((automaton.m, 2)), np.zeros((automaton.n, 2))
    with np.errstate(all="ignore"):  # what is not a number at 0 may be one elsewhere
        terms = path_terms(constraint, np, automaton, *points)
    for term in terms:
        value = term.margin if isinstance(term, Require) else term.amount
        if np.shape(value) not in ((), (2,)):
            raise InputError(f"{named} must give one number per state. Got the shape {np.shape(value)} for 2 states")


def path_terms(
    constraint: PathConstraint, ops: Operations, automaton: HybridAutomaton, x: Any, u: Any, std: Any
) -> Terms:
    """Requirements and costs of a constraint for given steps.

    Args:
        ops: numpy, or `symbolic.effects.CasadiOperations`.
        x, u, std: of `PathStep`, by number of coordinate or input: arrays (n, ...) or expressions (n, 1).

    Raises:
        InputError: if there is no such function, or it cannot be evaluated.
    """
    function, named = _function(constraint.name), f"path constraint {shown(constraint.name)}"
    states, inputs = ([item.name for item in items] for items in (automaton.coordinates, automaton.inputs))
    values = (states, x), (inputs, u), (states, std), (states, [item.unit for item in automaton.coordinates])
    step = PathStep(*(_Named(named, names, entries) for names, entries in values))
    try:
        terms = tuple(function(ops, step, **dict(constraint.arguments)))
    except MicahError:
        raise
    except Exception as error:  # it is the user's code: anything may go wrong in it
        raise InputError(
            f"{named} cannot be evaluated: {error}", remedy="use the functions of `ops`, such as ops.where for an if"
        ) from error
    names = [term.name for term in terms if isinstance(term, Require)]
    if not all(isinstance(term, Require | Pay) for term in terms) or len(set(names)) < len(names) or "" in names:
        raise InputError(f"{named} must give Require and Pay, each Require with a name of its own")
    return terms


def _function(name: str) -> PathFunction:
    if name not in _FUNCTIONS:
        remedy = f"choose one of {', '.join(_FUNCTIONS)}; {OF_YOUR_OWN}"
        raise InputError(f"unknown path constraint {shown(name)}", remedy=remedy)
    return _FUNCTIONS[name]


class _Named(dict[str, Any]):
    """Values by name; an unknown name is an input error."""

    def __init__(self, named: str, names: Sequence[str], values: Any) -> None:
        super().__init__((name, values[i]) for i, name in enumerate(names))
        self._said = named

    def __missing__(self, name: str) -> Any:
        raise InputError(f"{self._said}: there is no {shown(name)}", remedy=f"choose one of {', '.join(self)}")


@path_function
def stay_above(_ops: Operations, step: PathStep, *, coordinate: str, value: float) -> Terms:
    """A coordinate stays above a value [rad or m]."""
    return [Require(f"{coordinate} stays above {value:g}", step.x[coordinate] - value, step.unit[coordinate])]


@path_function
def stay_below(_ops: Operations, step: PathStep, *, coordinate: str, value: float) -> Terms:
    """A coordinate stays below a value [rad or m]."""
    return [Require(f"{coordinate} stays below {value:g}", value - step.x[coordinate], step.unit[coordinate])]


@path_function
def keep_away(
    _ops: Operations, step: PathStep, *, first: str, second: str, at_first: float, at_second: float, distance: float
) -> Terms:
    """Two coordinates keep a distance from a point [rad or m]."""
    squared = (step.x[first] - at_first) ** 2 + (step.x[second] - at_second) ** 2
    # The distance beyond the required one where that is small, and smooth in the point itself.
    margin = (squared - distance**2) / (2 * distance)
    return [Require(f"{distance:g} from {first} = {at_first:g}, {second} = {at_second:g}", margin, step.unit[first])]


_LIBRARY = tuple(_FUNCTIONS)
