"""Numbers as people read them, with their unit."""

from __future__ import annotations

import math


def quantity(value: float, unit: str) -> str:
    """A configuration with its unit: ``"0.785 rad (45.0°)"``, ``"0.123 m"``; below a centimetre in mm."""
    if unit == "rad":
        return f"{value:.3f} rad ({math.degrees(value):.1f}°)"
    if unit == "m" and abs(value) < 0.01:
        return f"{1000 * value:.1f} mm"
    return f"{value:.3f} {unit}".rstrip()


def short_quantity(value: float, unit: str) -> str:
    """The same without the degrees."""
    return f"{value:.3f} {unit}".rstrip()


def length(value: float) -> str:
    """A length in the unit that suits it: ``"5 mm"``, ``"2 cm"``, ``"1 m"``."""
    if value < 0.01:
        return f"{1000 * value:.3g} mm"
    return f"{100 * value:.3g} cm" if value < 1 else f"{value:.3g} m"


def percent(probability: float) -> str:
    return f"{100 * probability:.4g} %"
