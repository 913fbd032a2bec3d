"""Amounts in the words of messages."""

from __future__ import annotations

_SHORT_M = 1.0


def quantity(value: float, unit: str) -> str:
    """A length below a metre in mm, anything else in its unit, with three digits."""
    return f"{1e3 * value:.3g} mm" if unit == "m" and abs(value) < _SHORT_M else f"{value:.3g} {unit}".rstrip()


def percent(share: float) -> str:
    """A probability with the digits that tell it from 1: 95%, 99.75%."""
    return f"{100.0 * share:.4g}%"
