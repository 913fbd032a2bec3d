"""Formatting of amounts: the only place where numbers become text for messages, tables, pages and figures.

The rule:

- **Three significant digits**, without trailing zeros: ``0.785``, ``12.3``, ``1234``; below 0.0001 and from a million
  on with an exponent, ``1.2e-5``. What is not 0 is therefore never printed as ``0.000``.
- **Lengths** below a metre in mm, from a metre on in m: ``50 mm``, ``1.2 m``; so too per something, ``4 mm/rad``.
- **Angles** in rad with degrees in brackets, ``0.785 rad (45°)``; without them where space is scarce.
- **A spread** (one standard deviation, or a tolerance) has two significant digits, and its value ends at the same
  decimal: ``1.204 ± 0.012 rad (68.98 ± 0.69°)``. Source: JCGM 100:2008 (GUM), 7.2.6.
- **Shares** in percent, ``95 %``, with as many decimals as tell them from none and all: ``99.75 %``, ``>99.99 %``.

Files keep full precision and SI units, and so do numbers that a message asks somebody to write into a file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

LARGEST = 1e6
"""Of a coordinate or limit [m or rad]: beyond it a number is a mistake of units or of keys, not a place."""
FARTHEST_M = 50.0
"""Of a place from what it belongs to: the end of a large room; beyond it a number is a mistake of units."""
_DIGITS, _SPREAD_DIGITS, _MOST_DIGITS = 3, 2, 6
_ROUND_OFF = 1e-14  # m or rad: what is less is that of a sum of ones, so it is 0
_SMALL, _LARGE = -4, 6
"""Powers of ten between which numbers are written without an exponent."""
_NO_UNIT = ("", "1")


def plain(value: float, digits: int = _DIGITS) -> str:
    """A plain number with `digits` significant digits; digits before the decimal point are all kept."""
    if value == 0 or not math.isfinite(value):
        return f"{value + 0.0:g}".removeprefix("-") if value == 0 else f"{value:g}"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = int(exponent)
    if not _SMALL <= power < _LARGE:
        return f"{_stripped(mantissa)}e{power}"
    return _stripped(f"{value:.{max(digits - 1 - power, 0)}f}")


def quantity(value: float, unit: str, *, digits: int = _DIGITS, degrees: bool = True) -> str:
    """An amount with its unit: ``"50 mm"``, ``"1.2 m"``, ``"0.785 rad (45°)"``, ``"3.2 s"``.

    Args:
        value: in `unit`.
        unit: SI, such as m, rad, s, N, m/rad; "" or "1" for none.
        digits: significant ones; 2 for a spread that stands alone.
        degrees: whether an angle has them in brackets.
    """
    return _in_units(lambda amount: plain(amount, digits), unit, degrees, value)


def in_degrees(angle: float, spread: float | None = None, *, digits: int = _DIGITS) -> str:
    """An angle [rad] in degrees only, for text without computation: ``"45°"``, with its spread ``"24.0 ± 1.2°"``."""
    turned = math.degrees(angle)
    return f"{plain(turned, digits) if spread is None else _pair(turned, math.degrees(spread))}°"


def with_spread(value: float, spread: float, unit: str, *, degrees: bool = True) -> str:
    """An amount and its standard deviation or tolerance: ``"50 ± 2 mm"``, ``"1.204 ± 0.012 rad (68.98 ± 0.69°)"``."""
    return _in_units(_pair, unit, degrees, value, spread)


def interval(low: float, high: float, unit: str, *, degrees: bool = True) -> str:
    """A range between two amounts: ``"10 to 20 mm"``; with an infinite end ``"at least 10 mm"`` or ``"any"``."""
    finite = [end for end in (low, high) if math.isfinite(end)]
    if len(finite) < 2:
        end = quantity(finite[0], unit, degrees=degrees) if finite else ""
        return f"at {'least' if math.isfinite(low) else 'most'} {end}" if finite else "any"
    return _in_units(_ends, unit, degrees, low, high)


def progression(values: Sequence[float], unit: str) -> str:
    """A sequence of amounts: ``"0 → 1.2 rad"``, ``"0 → 250 → 3 mm"``.

    What is below a thousandth of the largest is 0.
    """
    largest = max(map(abs, values), default=0.0)
    scale, shown = _scaled(largest, unit)
    texts = [plain(0.0 if abs(value) < 1e-3 * largest else scale * value) for value in values]
    return _with_unit(" → ".join(texts), shown)


def percent(share: float, decimals: int | None = None) -> str:
    """A share or probability: ``"95 %"``, ``"99.75 %"``; only 0 and 1 are printed as 0 and 100.

    Args:
        share: 1 for all.
        decimals: None for one, and two below 1 % and above 99 %; 0 where space is scarce.
    """
    return f"{_percents(share, decimals)} %"


def percent_interval(low: float, high: float) -> str:
    """A range between two shares: ``"93.7 to 96.4 %"``."""
    return f"{_percents(low)} to {_percents(high)} %"


def duration(seconds: float) -> str:
    """A waiting time: ``"0.35 s"``, ``"2 min 5 s"``, ``"1 h 4 min"``."""
    whole = round(seconds)
    if whole < 60:
        return quantity(seconds, "s")
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def count(amount: int, noun: str, plural: str | None = None) -> str:
    """A number of things: ``"1 run"``, ``"1,200 rows"``."""
    return f"{amount:,} {noun if amount == 1 else plural or noun + 's'}"


def common_unit(units: Iterable[str]) -> str:
    """The common unit of combined amounts, else ``"m or rad"``."""
    return " or ".join(sorted(set(units)))


def _in_units(write: Callable[..., str], unit: str, degrees: bool, *values: float) -> str:
    """Numbers written by `write`, in the unit that suits the largest; angles with degrees in brackets."""
    if unit in ("m", "rad"):
        values = tuple(0.0 if abs(value) < _ROUND_OFF else value for value in values)
    scale, shown = _scaled(max(map(abs, values)), unit)
    text = _with_unit(write(*(scale * value for value in values)), shown)
    return f"{text} ({write(*map(math.degrees, values))}°)" if unit == "rad" and degrees and any(values) else text


def _scaled(value: float, unit: str) -> tuple[float, str]:
    """(factor, name) of the unit for printing an amount."""
    if (unit == "m" or unit.startswith("m/")) and float(f"{abs(value):.{_DIGITS - 1}e}") < 1.0:
        return 1e3, f"m{unit}"
    return 1.0, unit


def _with_unit(text: str, unit: str) -> str:
    return text if unit in _NO_UNIT else f"{text} {unit}"


def _pair(value: float, spread: float) -> str:
    if not spread or not math.isfinite(spread + value):
        return f"{plain(value)} ± {plain(spread)}"
    shown = plain(spread, _SPREAD_DIGITS)
    power = int(f"{abs(spread):.{_SPREAD_DIGITS - 1}e}".partition("e")[2])  # once it is rounded
    decimals = _SPREAD_DIGITS - 1 - power if "e" in shown else len(shown.partition(".")[2])
    digits = decimals + (math.floor(math.log10(abs(value))) + 1 if value else 1)
    if digits > _MOST_DIGITS or power < _SMALL or power >= _LARGE:
        return f"{plain(value, _MOST_DIGITS)} ± {shown}"  # no fixed number of decimals suits both
    text = f"{value:.{decimals}f}"
    return f"{text.removeprefix('-') if float(text) == 0 else text} ± {shown}"


def _ends(low: float, high: float) -> str:
    """Both ends with enough digits to differ."""
    for digits in range(_DIGITS, _MOST_DIGITS + 1):
        texts = plain(low, digits), plain(high, digits)
        if texts[0] != texts[1]:
            return " to ".join(texts)
    return plain(low)


def _percents(share: float, decimals: int | None = None) -> str:
    hundredfold = 100.0 * share
    if not 0.0 <= share <= 1.0:
        return plain(hundredfold)
    if decimals is None:
        decimals = 1 if 1.0 <= hundredfold <= 99.0 else 2
    least = 10.0**-decimals
    if 0.0 < hundredfold <= least / 2:
        return f"<{least:g}"
    if 100.0 - least / 2 <= hundredfold < 100.0:
        return f">{100.0 - least:g}"
    return _stripped(f"{hundredfold:.{decimals}f}")


def _stripped(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text
