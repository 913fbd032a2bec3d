"""Formulas of effects as instructions with exact derivatives, traced once by CasADi.

Parameters are symbols, except neutral ones: they are numbers, which simplify a formula.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca

from micah_plan.automaton.effects.form import EffectForm, InForce, Value
from micah_plan.symbolic.casadi_operations import CasadiOperations
from micah_plan.symbolic.straight_line import StraightLine, straight_line

# Forms whose instructions are kept: those of the library, and as many of users, with some of their parameters neutral.
_KEPT = 1024

Neutral = tuple[bool, ...]
"""Whether each parameter of a form has its neutral value."""


def _symbols(form: EffectForm, neutral: Neutral, *names: str) -> tuple[list[ca.SX], list[ca.SX], list[Value]]:
    """(symbols of inputs, symbols of parameters, parameters as the formula receives them)."""
    symbols = [ca.SX.sym(parameter.name) for parameter in form.parameters]
    given = [
        parameter.neutral if is_neutral else symbol
        for parameter, symbol, is_neutral in zip(form.parameters, symbols, neutral, strict=True)
    ]
    return [ca.SX.sym(name) for name in names], symbols, given


def is_late(form: EffectForm, neutral: Neutral) -> bool:
    """Whether commands are delayed.

    Its lines have the newer and the older command in force where others have the command, and behind the parameters
    the share of a step that has the older one.
    """
    return form.late_by is not None and not neutral[form.late_by]


def _begun(form: EffectForm, c: ca.SX, step: ca.SX, p: Sequence[Value]) -> list[Value]:
    """The memory of a part that has just moved by a step to c, without the delay line."""
    return list(form.in_motion(c, step, [0.0 if k == form.late_by else value for k, value in enumerate(p)]))


def _memory(form: EffectForm, p: Sequence[Value]) -> list[ca.SX]:
    """Symbols of a form's memory."""
    return [ca.SX.sym(f"memory_{k}") for k in range(len(_begun(form, ca.SX(0.0), ca.SX(0.0), p)))]


@lru_cache(maxsize=_KEPT)
def begun_line(form: EffectForm, neutral: Neutral) -> StraightLine:
    """The memory of a part that has just moved by a step to c.

    For a form whose commands act later, the command before the first step is the last of it: the one that left it at
    rest.
    """
    (c, step), symbols, p = _symbols(form, neutral, "c", "step")
    kept = [form.commanded_at_rest(c - step, p)] if is_late(form, neutral) else []
    return straight_line([c, step], symbols, [*_begun(form, c, step, p), *kept])


@lru_cache(maxsize=_KEPT)
def response_line(form: EffectForm, neutral: Neutral) -> StraightLine:
    """(output command, its slope along the configuration, next memory) for a position command."""
    (c, place, older, late), symbols, p = _symbols(form, neutral, "c", "place", "older", "late")
    memory = _memory(form, p)
    if is_late(form, neutral):
        out, after = form.respond_late(CasadiOperations(), c, InForce(place, older, late), tuple(memory), p)
        return straight_line([c, place, older, *memory], [*symbols, late], [out, _slope(out, c), *after])
    out, after = form.respond(CasadiOperations(), c, place - c, tuple(memory), p)
    return straight_line([c, place, *memory], symbols, [out, _slope(out, c), *after])


@lru_cache(maxsize=_KEPT)
def memory_line(form: EffectForm, neutral: Neutral) -> StraightLine:
    """(output command, its slope, next memory) for an input command."""
    (v, older, late), symbols, p = _symbols(form, neutral, "v", "older", "late")
    memory = _memory(form, p)
    if is_late(form, neutral):
        out, after = form.remember_late(CasadiOperations(), InForce(v, older, late), tuple(memory), p)
        return straight_line([v, older, *memory], [*symbols, late], [out, _slope(out, v), *after])
    out, after = form.remember(CasadiOperations(), v, tuple(memory), p)
    return straight_line([v, *memory], symbols, [out, _slope(out, v), *after])


@lru_cache(maxsize=_KEPT)
def command_line(form: EffectForm, neutral: Neutral) -> StraightLine:
    """(output command, its slope)."""
    (v,), symbols, p = _symbols(form, neutral, "v")
    out = form.command(CasadiOperations(), v, p)
    return straight_line([v], symbols, [out, _slope(out, v)])


@lru_cache(maxsize=_KEPT)
def force_line(form: EffectForm, neutral: Neutral) -> StraightLine:
    """(added motion, its slopes along configuration and command)."""
    (c, v), symbols, p = _symbols(form, neutral, "c", "v")
    added = form.force(CasadiOperations(), c, v, p)
    return straight_line([c, v], symbols, [added, _slope(added, c), _slope(added, v)])


@lru_cache(maxsize=_KEPT)
def stops_line(form: EffectForm, neutral: Neutral) -> StraightLine:
    """Ends of the range."""
    (low, high), symbols, p = _symbols(form, neutral, "low", "high")
    return straight_line([low, high], symbols, form.stops(CasadiOperations(), low, high, p))


@lru_cache(maxsize=_KEPT)
def reading_line(form: EffectForm, neutral: Neutral) -> StraightLine:
    """(reading of a configuration, its slope)."""
    (c, time), symbols, p = _symbols(form, neutral, "c", "time")
    read = form.measured(CasadiOperations(), c, time, p)
    return straight_line([c, time], symbols, [read, _slope(read, c)])


def _slope(expression: ca.SX, symbol: ca.SX) -> ca.SX:
    """(k, 1) derivative of an expression by a symbol."""
    return ca.densify(ca.jacobian(ca.SX(expression), symbol))
