"""The YAML reader: plain data with places, and nothing of YAML that a hostile file could use."""

from __future__ import annotations

import pytest
from attempts import attempt, told
from hypothesis import example, given, settings
from hypothesis import strategies as st

from micah_plan.documents import yaml_lines
from micah_plan.documents.located import Located
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml, write_yaml

CLEAN = st.text(st.characters(exclude_categories=["C", "Zl", "Zp"]), max_size=15)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**12), 10**12) | st.floats(allow_nan=False) | CLEAN,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(CLEAN, inner, max_size=4),
    max_leaves=12,
)


def message(content: bytes) -> str:
    return told(read_yaml, content, "f.yaml")


def test_scalars_follow_the_core_schema() -> None:
    text = b"a: 1e-3\nb: 010\nc: on\nd: '1'\ne: true\nf: ~\ng:\nh: -.5\ni: 1_000\n"
    text += b'j: .inf\nk: "x"\nl: 1.\nm: 2026-01-02\n'
    assert read_yaml(text, "f").data == {
        "a": 0.001,
        "b": 10,
        "c": "on",
        "d": "1",
        "e": True,
        "f": None,
        "g": None,
        "h": -0.5,
        "i": "1_000",
        "j": float("inf"),
        "k": "x",
        "l": 1.0,
        "m": "2026-01-02",
    }


def test_places_are_of_keys_and_items() -> None:
    located = read_yaml(b"a:\n  b: [1,\n    2]\nc: {d: 3}\n", "f")
    assert located.places[("a", "b")] == (2, 3)
    assert located.places[("a", "b", 1)] == (3, 5)
    assert located.places[("c", "d")] == (4, 5)
    assert located.at("a", "b", 7).where() == "line 2, column 3, key 'a.b.7'"
    assert located.at("nowhere").where() == "line 1, column 1, key 'nowhere'"


@pytest.mark.slow
@settings(max_examples=100)
@given(data=st.dictionaries(CLEAN, VALUES, min_size=1, max_size=4))
@example(data={"": ["?0"]})
def test_what_is_written_reads_back(data: dict[str, object]) -> None:
    assert read_yaml(write_yaml(data, "a remark").encode(), "f").data == data


def test_remarks_stand_at_the_end_of_their_line() -> None:
    text = write_yaml({"a": {"b": [1.0, 2.0], "c": [[1.0], [2.0]]}}, "first\nsecond", {("a", "b"): "std 0.1"})
    assert text == "# first\n# second\na:\n  b: [1.0, 2.0]  # std 0.1\n  c:\n    - [1.0]\n    - [2.0]\n"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "f.yaml: expected keys and values, found nothing"),
        (b"# only a remark\n", "found nothing"),
        (b"---\n", "expected a mapping of keys to values, found a single value"),
        (b"hello", "f.yaml, line 1, column 1: expected a mapping of keys to values, found a single value"),
        (b"- 1", "expected a mapping of keys to values, found a list"),
        (b"a: 1\nb: 2\na: 3", "f.yaml, line 3, column 1: duplicate key 'a', first on line 1; keep one of them"),
        (b"a: 1\nb: *x", "line 2, column 4: the alias '*x' refers to nothing before it; write '&x'"),
        (b"a: &a [*a]\n", "line 1, column 8: the alias '*a' refers to nothing"),
        (b"a: &x b\n*x : 1", "expected a name as key"),
        (b"a: !!python/object:os.system 1", "tags are not allowed"),
        (b"a: !mine {b: 1}", "tags are not allowed, found '!mine'"),
        (b"%YAML 1.1\n---\na: 1", "directives"),
        (b"a: 1\n---\nb: 2", "line 2, column 1: expected one document, found a second"),
        (b"a:\n\tb: 1", "line 2, column 1: tab in the indentation; indent with spaces"),
        (b"a: 1\nb: \xff", "line 2, column 4: expected UTF-8 text, found the byte 0xff"),
        ("a: 1".encode("utf-16"), "expected UTF-8 text, found the byte 0xff"),
        (b"\x7fELF\x02\x01\x00", "found a control character; is it a binary file?"),
        (b"a: [1\n", "not valid YAML"),
        (b"a: 'x\n", "not valid YAML"),
        (b"a: b: c", "line 1, column 5: not valid YAML: mapping values are not allowed in this context"),
        (b"? [1]\n: 2", "expected a name as key, found a list or mapping"),
        (b"a: 1\nb", "line 2, column 2: not valid YAML: could not find expected ':'"),
        (b"a: " + b"[" * 900, "expected at most 24 levels"),
        (b"a: " + b"[" * 100_000, "not valid YAML: exceeded maximum nesting depth"),
        (b"a: " + b"{a: " * 1000, "expected at most 24 levels"),
        (b"#" * (LARGEST_TEXT_BYTES + 1), "expected at most 4 MiB"),
    ],
)
def test_what_is_not_allowed_is_one_line(content: bytes, expected: str) -> None:
    assert expected in message(content)


def test_the_number_of_values_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_lines, "MOST_VALUES", 50)
    assert "line 48, column 3: expected at most 50 values" in message(b"a:\n" + b"- 1\n" * 1000)
    assert len(read_yaml(b"a:\n" + b"- 1\n" * 40, "f").data["a"]) == 40


def test_an_alias_means_what_its_anchor_marks() -> None:
    content = b"a: &joints\n  - {kind: rigid}\n  - [1, 2]\nb: {modes: *joints, x: &x 3, y: *x}\nc: *joints\n"
    located = read_yaml(content, "f.yaml")
    joints = [{"kind": "rigid"}, [1, 2]]
    assert located.data == {"a": joints, "b": {"modes": joints, "x": 3, "y": 3}, "c": joints}
    located.data["c"][1].append(3)
    assert located.data["a"] == joints  # a copy: who changes one does not change the other
    # A mistake is reported where it is written, the alias itself where it stands.
    assert str(located.at("b", "modes", 1, 0).error("no", None)).startswith("f.yaml, line 3, column 6")
    assert str(located.at("b", "modes").error("no", None)).startswith("f.yaml, line 4, column 5")


def test_an_anchor_given_twice_means_the_last_one() -> None:
    assert read_yaml(b"a: &x 1\nb: *x\nc: &x 2\nd: *x\n", "f").data == {"a": 1, "b": 1, "c": 2, "d": 2}


def test_aliases_nest_no_deeper_than_what_is_written_out() -> None:
    chain = b"a0: &a0 [1]\n" + b"".join(f"a{i}: &a{i} [*a{i - 1}]\n".encode() for i in range(1, 40))
    assert "expected at most 24 levels" in message(chain)


def test_an_alias_bomb_is_refused_when_it_has_grown_too_large() -> None:
    bomb = b"a: &a [x,x,x,x,x,x,x,x,x]\n"
    for last, name in zip("abcdefgh", "bcdefghi", strict=True):
        bomb += f"{name}: &{name} [{','.join(['*' + last] * 9)}]\n".encode()
    assert "line 6, column 17: aliases stand for more than 300000 values; write out what is needed" in message(bomb)


@pytest.mark.slow
@settings(max_examples=300)
@given(content=st.binary(max_size=80) | st.text(max_size=60).map(lambda s: s.encode("utf-8", "surrogatepass")))
def test_any_bytes_raise_only_input_errors(content: bytes) -> None:
    result = attempt(read_yaml, content, "f.yaml")
    assert isinstance(result, Located) or len(result.splitlines()) == 1


@settings(max_examples=300)
@given(text=st.text(":-[]{}#&*!|>'\"%@`\t\n\r ,?0e.<~\\ab\u0085\u2028\ufeff", max_size=40))
def test_any_yaml_like_text_raises_only_input_errors(text: str) -> None:
    result = attempt(read_yaml, text.encode(), "f.yaml")
    assert isinstance(result, Located) or len(result.splitlines()) == 1
