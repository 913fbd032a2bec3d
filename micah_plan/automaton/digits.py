"""Rounding of learned automata: each number to the digits that its std supports, once, when the model is built.

Six significant digits are a thousandth of the standard deviation of a joint with the best tracker. Rounding keeps the
order and the equality of numbers, so guards still end where ranges and pins do. Unit vectors have ten decimals, as a
length other than 1 would scale all motion. So files and models are identical: `load_model` returns the very same
values.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint

DIGITS = 6
UNIT_DECIMALS = 10


def rounded(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton with joints, boundaries, resets, pins and noise rounded; covariances keep all digits."""
    rounded_fields = {key: _rounded_numbers(getattr(automaton, key)) for key in ("modes", "edges", "noise")}
    return replace(automaton, **rounded_fields)


def _rounded_numbers(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, tuple):
        return tuple(_rounded_numbers(item) for item in value)
    if isinstance(value, Joint):
        # A path's pose at c = 0 is interpolated between its knots, so that rounding them would move it.
        kept = ("kind", "covariance") if value.kind != "path" else tuple(field.name for field in fields(Joint))
    elif is_dataclass(value) and not isinstance(value, type):
        kept = ()
    else:
        return value
    rounded_fields = {
        field.name: _rounded_numbers(getattr(value, field.name)) for field in fields(value) if field.name not in kept
    }
    if isinstance(value, Joint):
        units = {key: tuple(round(v, UNIT_DECIMALS) for v in getattr(value, key)) for key in ("axis", "quaternion")}
        rounded_fields |= {key: unit for key, unit in units.items() if key not in kept}
    return replace(value, **rounded_fields)
