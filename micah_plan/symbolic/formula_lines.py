"""The formulas of effects as instructions, each with its exact slope: read once by CasADi, with symbols throughout."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca

from micah_plan.automaton.effects.form import EffectForm
from micah_plan.symbolic.casadi_operations import CasadiOperations
from micah_plan.symbolic.straight_line import StraightLine, straight_line

# Forms whose instructions are kept: those of the library, and as many of users.
_KEPT = 256


def _symbols(form: EffectForm, *names: str) -> tuple[list[ca.SX], list[ca.SX]]:
    """Symbols of inputs, and of the parameters."""
    return [ca.SX.sym(name) for name in names], [ca.SX.sym(parameter.name) for parameter in form.parameters]


def _memory(form: EffectForm, c: ca.SX, p: Sequence[ca.SX]) -> list[ca.SX]:
    return [ca.SX.sym(f"memory_{k}") for k in range(len(form.at_rest_in(c, p)))]


@lru_cache(maxsize=_KEPT)
def at_rest_line(form: EffectForm) -> StraightLine:
    """Memory of a part that rests at c."""
    (c,), p = _symbols(form, "c")
    return straight_line([c], p, form.at_rest_in(c, p))


@lru_cache(maxsize=_KEPT)
def response_line(form: EffectForm) -> StraightLine:
    """Command out of a place, its slope along the configuration, and the memory after it."""
    (c, place), p = _symbols(form, "c", "place")
    memory = _memory(form, c, p)
    out, after = form.respond(CasadiOperations(), c, place - c, tuple(memory), p)
    return straight_line([c, place, *memory], p, [out, _slope(out, c), *after])


@lru_cache(maxsize=_KEPT)
def memory_line(form: EffectForm) -> StraightLine:
    """Command that comes out of one that goes in, its slope along that, and the memory after it."""
    (v,), p = _symbols(form, "v")
    memory = _memory(form, ca.SX(0.0), p)
    out, after = form.remember(CasadiOperations(), v, tuple(memory), p)
    return straight_line([v, *memory], p, [out, _slope(out, v), *after])


@lru_cache(maxsize=_KEPT)
def command_line(form: EffectForm) -> StraightLine:
    """What is left of a command, and its slope along that."""
    (v,), p = _symbols(form, "v")
    out = form.command(CasadiOperations(), v, p)
    return straight_line([v], p, [out, _slope(out, v)])


@lru_cache(maxsize=_KEPT)
def force_line(form: EffectForm) -> StraightLine:
    """What is added to a motion, and its slopes along configuration and command."""
    (c, v), p = _symbols(form, "c", "v")
    added = form.force(CasadiOperations(), c, v, p)
    return straight_line([c, v], p, [added, _slope(added, c), _slope(added, v)])


@lru_cache(maxsize=_KEPT)
def stops_line(form: EffectForm) -> StraightLine:
    """Ends of the range."""
    (low, high), p = _symbols(form, "low", "high")
    return straight_line([low, high], p, form.stops(CasadiOperations(), low, high, p))


@lru_cache(maxsize=_KEPT)
def reading_line(form: EffectForm) -> StraightLine:
    """What is read of a configuration, and its slope along that."""
    (c, time), p = _symbols(form, "c", "time")
    read = form.measured(CasadiOperations(), c, time, p)
    return straight_line([c, time], p, [read, _slope(read, c)])


def _slope(expression: ca.SX, symbol: ca.SX) -> ca.SX:
    return ca.densify(ca.jacobian(ca.SX(expression), symbol))
