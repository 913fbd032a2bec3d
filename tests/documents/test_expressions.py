"""Half-spaces and affine expressions as text."""

from __future__ import annotations

import pytest
from attempts import attempt
from hypothesis import given
from hypothesis import strategies as st

from micah_plan.automaton.region import HalfSpace, above, below, input_above, input_below
from micah_plan.documents.expressions import (
    Affine,
    affine_text,
    canonical_name,
    half_space_text,
    parse_affine,
    parse_half_space,
)
from micah_plan.errors import InputError

XZ = {"coordinate": ("x", "z", "upper arm", "input"), "input": ("x", "input")}
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
WEIGHTS = st.sampled_from([0.0, 1.0, -1.0, 0.5]) | NUMBERS


@pytest.mark.parametrize(
    ("text", "a", "b", "c", "strict"),
    [
        ("x >= 1.2", (1, 0, 0, 0), (0, 0), 1.2, False),
        ("x<1.2", (-1, 0, 0, 0), (0, 0), -1.2, True),
        ("input x < -0.01", (0, 0, 0, 0), (-1, 0), 0.01, True),
        ("0.5*x + 2*z - input x >= 1e-1", (0.5, 2, 0, 0), (-1, 0), 0.1, False),
        ('"upper arm" <= 3', (0, 0, -1, 0), (0, 0), -3, False),
        ('"input" - input "input" > 0', (0, 0, 0, 1), (0, -1), 0, True),
        ("x >= z + 0.1", (1, -1, 0, 0), (0, 0), 0.1, False),
        ("1 + x >= 3", (1, 0, 0, 0), (0, 0), 2, False),
        ("x + x > 1", (2, 0, 0, 0), (0, 0), 1, True),
        ("3 >= x", (-1, 0, 0, 0), (0, 0), -3, False),
    ],
)
def test_half_spaces(text: str, a: tuple, b: tuple, c: float, strict: bool) -> None:
    assert parse_half_space(text, XZ) == HalfSpace(a, b, c, strict)


@given(st.tuples(*[WEIGHTS] * 6).filter(any), NUMBERS, st.booleans())
def test_half_space_text_is_exact(row: tuple[float, ...], c: float, strict: bool) -> None:
    half_space = HalfSpace(row[:4], row[4:], c, strict)
    assert parse_half_space(half_space_text(half_space, XZ), XZ) == half_space


@given(st.tuples(*[WEIGHTS] * 6), st.none() | NUMBERS)
def test_affine_text_is_exact(row: tuple[float, ...], constant: float | None) -> None:
    read = parse_affine(affine_text(row[:4], row[4:], constant, XZ), XZ)
    assert (read.a, read.b, read.constant) == (row[:4], row[4:], constant or 0.0)


def test_a_written_zero_is_a_constant() -> None:
    assert parse_affine("0.0", XZ) == Affine((0.0,) * 4, (0.0,) * 2, 0.0, True)
    assert not parse_affine("x", XZ).has_constant


@pytest.mark.parametrize("strict", [False, True])
def test_names_are_those_of_the_region_builders(strict: bool) -> None:
    built = [
        above(1, 1 / 3, 4, 2, strict=strict, name="z"),
        below(1, 0.0, 4, 2, strict=strict, name="z"),
        input_above(0, -0.01, 4, 2, strict=strict, name="input x"),
        input_below(0, 1e-7, 4, 2, strict=strict, name="input x"),
    ]
    for half_space in built:
        assert canonical_name(half_space, XZ) == half_space.name
        assert parse_half_space(half_space_text(half_space, XZ), XZ).name == half_space.name


@pytest.mark.slow
@given(st.text(max_size=30) | st.text('xz01.e+-*<>=" input', max_size=30))
def test_any_text_raises_only_input_errors(text: str) -> None:
    result = attempt(parse_half_space, text, XZ)
    assert isinstance(result, HalfSpace) or len(result.splitlines()) == 1


def test_unknown_variables_name_the_allowed() -> None:
    with pytest.raises(InputError) as caught:
        parse_half_space("input y > 0", XZ)
    assert str(caught.value) == (
        "unknown variable 'input y' in 'input y > 0'; did you mean 'input x'? "
        'choose one of x, z, "upper arm", "input", input x, input "input"'
    )


def test_a_very_long_expression_is_refused() -> None:
    with pytest.raises(InputError, match="at most 4000 characters"):
        parse_half_space("+x" * 5000 + " > 0", XZ)
