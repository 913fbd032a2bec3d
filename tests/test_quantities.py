"""Numbers in words: they read back as what they were, never as 0, never as certainty, and by one rule."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from micah_plan.quantities import (
    common_unit,
    count,
    duration,
    in_degrees,
    interval,
    percent,
    percent_interval,
    plain,
    progression,
    quantity,
    with_spread,
)

AMOUNTS = st.floats(-1e9, 1e9, allow_subnormal=False).filter(lambda value: value == 0 or abs(value) > 1e-12)
SPREADS = st.floats(1e-12, 1e6)
UNITS = st.sampled_from(["m", "rad", "s", "N", "m/rad", "rad/m", "", "1"])
NUMBER = r"-?[0-9.]+(?:e-?[0-9]+)?"


def metres(text: str) -> float:
    """A length as it is read."""
    value, unit = text.split(" ")
    return float(value) / {"mm": 1000.0, "m": 1.0}[unit]


@given(AMOUNTS)
def test_a_number_reads_back_to_three_digits(value: float) -> None:
    text = plain(value)
    assert re.fullmatch(NUMBER, text)
    assert float(text) == pytest.approx(value, rel=5.01e-3)
    assert (float(text) == 0) == (value == 0)
    assert text == f"{'-' if value < 0 else ''}{plain(abs(value))}"


@given(AMOUNTS)
def test_a_number_has_no_idle_zeros_and_is_short(value: float) -> None:
    text = plain(value)
    assert len(text) <= 10
    assert not re.search(r"\.[0-9]*0(e|$)|\.$|^-0$", text)
    assert not re.search(r"e-?0", text)


@given(AMOUNTS)
def test_lengths_are_in_millimetres_below_a_metre(value: float) -> None:
    text = quantity(value, "m")
    assert metres(text) == pytest.approx(value, rel=5.01e-3)
    assert text.endswith(" mm") == (abs(float(f"{value:.2e}")) < 1.0)
    assert not text.startswith("1000 mm")


@given(AMOUNTS)
def test_angles_have_degrees_in_brackets(value: float) -> None:
    text = quantity(value, "rad")
    if value == 0:
        assert text == "0 rad"
        return
    found = re.fullmatch(rf"({NUMBER}) rad \(({NUMBER})°\)", text)
    assert found is not None
    assert math.radians(float(found[2])) == pytest.approx(value, rel=5.01e-3)
    assert quantity(value, "rad", degrees=False) == text.partition(" (")[0]
    assert in_degrees(value) == f"{found[2]}°"


@given(AMOUNTS, SPREADS, UNITS)
def test_a_spread_is_never_nought_and_never_finer_than_its_value(value: float, spread: float, unit: str) -> None:
    found = re.match(rf"({NUMBER}) ± ({NUMBER})", with_spread(value, spread, unit))
    assert found is not None
    shown = [float(text) for text in found.groups()]
    scale = 1000.0 if unit.startswith("m") and max(abs(value), spread) < 0.99 else 1.0
    assume(not unit.startswith("m") or not 0.99 <= max(abs(value), spread) <= 1.01)
    assert shown[1] == pytest.approx(scale * spread, rel=5.01e-2)
    assert abs(shown[0] - scale * value) <= max(0.51 * shown[1], 1e-5 * abs(scale * value))
    if "e" not in found[0] and abs(value) < 1e5 * spread:
        decimals = [len(text.partition(".")[2]) for text in found.groups()]
        assert decimals[0] == decimals[1]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((0.05, 0.002, "m"), "50 ± 2 mm"),
        ((1.2, 0.003, "m"), "1.200 ± 0.003 m"),
        ((1.204, 0.0123, "rad"), "1.204 ± 0.012 rad (69.0 ± 0.7°)"),
        ((0.3, 1e-9, "m"), "300 ± 1e-6 mm"),
        ((1e-9, 1e-12, "m"), "1e-6 ± 1e-9 mm"),
        ((12.0, 0.0, "s"), "12 ± 0 s"),
        ((-0.0001, 0.3, ""), "0.0 ± 0.3"),
        ((5.0, math.inf, "N"), "5 ± inf N"),
        ((1234.0, 120.0, "N"), "1234 ± 120 N"),
        ((0.0, 995000.0, "m"), "0 ± 1e6 m"),
        ((1.0, 9.96e-5, "s"), "1.0000 ± 0.0001 s"),
    ],
)
def test_values_end_where_their_spread_does(arguments: tuple[float, float, str], text: str) -> None:
    assert with_spread(*arguments) == text


@given(st.floats(0.0, 1.0), st.sampled_from([None, 0]))
def test_percents_claim_no_certainty(share: float, decimals: int | None) -> None:
    text = percent(share, decimals)
    assert text.endswith(" %")
    assert (text == "0 %") == (share == 0)
    assert (text == "100 %") == (share == 1)
    shown = float(text.removesuffix(" %").lstrip("<>"))
    assert abs(shown - 100 * share) <= (1.0 if decimals == 0 else 0.051)


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.95, "95 %"), (0.9975, "99.75 %"), (0.99999, ">99.99 %"), (1e-6, "<0.01 %"), (2 / 3, "66.7 %"), (1.2, "120 %")],
)
def test_percents_keep_the_digits_that_separate_them_from_all(share: float, text: str) -> None:
    assert percent(share) == text


@given(AMOUNTS, st.floats(0.0, 1e6), UNITS)
def test_the_ends_of_an_interval_are_printed_differently(low: float, width: float, unit: str) -> None:
    high = low + width
    assume(high - low > 1e-4 * max(abs(low), abs(high)))
    first, _, rest = interval(low, high, unit, degrees=False).partition(" to ")
    assert float(first) < float(rest.split(" ")[0])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((0.01, 0.02, "m"), "10 to 20 mm"),
        ((0.5, 2.0, "m"), "0.5 to 2 m"),
        ((-1.0, 1.0, "rad"), "-1 to 1 rad (-57.3 to 57.3°)"),
        ((1.0, math.inf, "m"), "at least 1 m"),
        ((-math.inf, 0.2, "m"), "at most 200 mm"),
        ((-math.inf, math.inf, "m"), "any"),
        ((1.0, 1.0, "s"), "1 s"),
    ],
)
def test_intervals(arguments: tuple[float, float, str], text: str) -> None:
    assert interval(*arguments) == text
    assert percent_interval(0.937, 0.964) == "93.7 to 96.4 %"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.35, "0.35 s"),
        (12.34, "12.3 s"),
        (59.7, "1 min 0 s"),
        (125, "2 min 5 s"),
        (3599.8, "1 h 0 min"),
        (3840, "1 h 4 min"),
    ],
)
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_counts_ways_and_common_units() -> None:
    assert [count(1, "row"), count(1200, "row"), count(2, "stretch", "stretches")] == [
        "1 row",
        "1,200 rows",
        "2 stretches",
    ]
    assert progression([0.0, 0.25, 1e-5], "m") == "0 → 250 → 0 mm"
    assert progression([-0.3, 1.2], "rad") == "-0.3 → 1.2 rad"
    assert [common_unit(units) for units in (["m", "m"], ["rad", "m"], [])] == ["m", "m or rad", ""]
