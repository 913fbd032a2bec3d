"""Model files: every automaton reads back as it was, and every mistake is one line that says what and where."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from any_automaton import automata
from attempts import attempt, parse_model, told
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Noise, Reset
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.documents.located import Located
from micah_plan.documents.model import automaton_of_document, dump_model, load_model, model_data, model_text
from micah_plan.errors import InputError


def message(text: str | bytes) -> str:
    line = told(parse_model, text if isinstance(text, bytes) else text.encode(), "m.yaml")
    assert line.startswith("m.yaml")
    return line


@pytest.mark.slow
@settings(max_examples=30)
@given(automaton=automata())
def test_any_automaton_reads_back_exactly(automaton: HybridAutomaton) -> None:
    text = model_text(automaton)
    again = parse_model(text.encode(), "m.yaml")
    assert again == automaton
    assert parse_model(model_text(again).encode(), "m.yaml") == again
    own = [h.name for mode in automaton.modes for h in mode.invariant.half_spaces]
    read = [h.name for mode in again.modes for h in mode.invariant.half_spaces]
    assert [name for name in own if name] == [r for r, name in zip(read, own, strict=True) if name]


def test_door_reads_back_and_is_written_readably(door: HybridAutomaton, tmp_path: Path) -> None:
    dump_model(door, tmp_path / "door.yaml")
    assert load_model(tmp_path / "door.yaml") == door
    text = (tmp_path / "door.yaml").read_text()
    assert "invariant: [door >= 0.0, door < 1.2]" in text
    assert "guard: [input door < -0.01]" in text
    assert "step:\n      door: input door" in text
    assert "reset:\n      door: 1.2" in text
    assert "# std 0.01 rad, 0.002 m" in text
    assert model_text(load_model(tmp_path / "door.yaml")) == text


def test_written_floats_are_exact_and_numpy_numbers_plain(door: HybridAutomaton) -> None:
    std = np.float64(0.1) + np.float64(0.2)
    changed = replace(door, noise=Noise((std,), (np.float64(1e-12),)))
    assert "np." not in model_text(changed)
    assert parse_model(model_text(changed).encode(), "m").noise == Noise((0.30000000000000004,), (1e-12,))


@pytest.mark.parametrize(
    ("reset", "expected"),
    [
        (Reset(), None),
        (Reset(((0.0,),), None, (1.2,)), "door: 1.2"),
        (Reset(None, None, (0.1,)), "door: door + 0.1"),
        (Reset(((0.5,),), ((-2.0,),), None), "door: 0.5*door - 2.0*input door"),
        (Reset(((1.0,),), None, None), "reset_matrices:"),
        (Reset(((0.0,),), None, None), "reset_matrices:"),
        (Reset(None, None, (0.0,)), "reset_matrices:"),
    ],
)
def test_resets_are_expressions_where_that_is_exact(door: HybridAutomaton, reset: Reset, expected: str | None) -> None:
    changed = replace(door, edges=(Edge("rigid", "rigid", Region(), reset),))
    text = model_text(changed)
    assert ("reset" not in text) if expected is None else (expected in text)
    assert parse_model(text.encode(), "m") == changed


def test_a_person_can_edit_it(door: HybridAutomaton) -> None:
    text = model_text(door).replace("guard: [door >= 1.2]", "guard:\n      - shut: 2*door + 0.5 > 3 - input door\n")
    (half_space,) = parse_model(text.encode(), "m").edges[0].guard.half_spaces
    assert half_space == HalfSpace((2.0,), (1.0,), 2.5, strict=True)
    assert half_space.name == "shut"


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "kind: revolute",
            "kind: revolut",
            "line 17, column 9, key 'modes.revolute.joints.door.kind': expected 'rigid', ",
        ),
        ("kind: revolute", "kind: revolut", "did you mean 'revolute'?"),
        (
            "axis:",
            "axsi:",
            "line 19, column 9, key 'modes.revolute.joints.door.axsi': unknown key 'axsi'; did you mean 'axis'? ",
        ),
        ("axis: [0.0, 0.0, 1.0]", "axis: [0.0, 0.0, 2.0]", "expected unit length, found length 2; normalise it"),
        ("held: 1.2", "pitch: 1.2", "a rigid joint has no pitch; remove it"),
        ("std: 0.005", "std: -1", "key 'modes.rigid.pins.door.std': expected a number >= 0, found -1"),
        ("std: 0.005", "std: 'a'", "key 'modes.rigid.pins.door.std': expected a number, found 'a'"),
        ("std: 0.005", "std: .nan", "expected a finite number, found nan"),
        ("[door >= 1.2]", "[dor >= 1.2]", "unknown variable 'dor' in 'dor >= 1.2'; did you mean 'door'? "),
        ("[door >= 1.2]", "[door = 1.2]", "cannot read '= 1.2'"),
        ("[door >= 1.2]", "[0 <= door < 1.2]", "expected the end (one comparison per entry), found '<'"),
        ("[door >= 1.2]", "[1 >= 0]", "expected a variable with a weight"),
        ("[door >= 1.2]", "[3]", "expected a half-space such as 'door >= 1.2'"),
        ("[door >= 1.2]", "[door >= 1e999]", "a number is too large"),
        ("target: rigid", "target: rigd", "key 'transitions.0.target': unknown mode 'rigd'; did you mean 'rigid'?"),
        ("step: {}", "step: {dor: input door}", "unknown coordinate 'dor'"),
        ("step: {}", "step: {door: door}", "a step is affine in the inputs"),
        ("step: {}", "step:", "expected a mapping of names to values, found nothing"),
        ("door: 1.2", "door: door +", "expected a variable or a number, found the end"),
        ("model/1", "problem/1", "line 4, column 1, key 'format': expected a model file, found a problem file"),
        ("model/1", "model/2", "expected micah-plan/model/1, found 'micah-plan/model/2'; use the version"),
        ("format: ", "from: ", "missing key 'format'; a model file says 'format: micah-plan/model/1'"),
        ("- [0.0001, 2e-06]", "- [0.0001, 1.0]", "expected a symmetric positive semi-definite matrix"),
        ("- [0.0001, 2e-06]", "- [0.0001]", "expected 2 rows of 2, found 2 rows of 1, 2"),
        ("[axis_1, center_2]", "[axis_1, axis_1]", "a parameter is named twice"),
        ("handle: [0.0, 0.05, 0.0]", "handle: [0.0, 0.05]", "key 'parts.door.handle.2': too few entries"),
        ("size: [0.02, 0.3]", "size: [0.02]", "expected 2 sizes of a cylinder, found 1"),
        ("'#102030'", "red", "expected text of the form"),
        ("seed: '0'", "seed: 0", "key 'provenance.seed': expected text, found 0; put it in quotes"),
        ("process_std:\n    door", "process_std:\n    drawer", "unknown coordinate 'drawer'"),
        ("process_std:\n    door: 0.002", "process_std: {}", "missing value of coordinate 'door'"),
        ("parts:\n  base:", "parts:\n  bas:", "unknown part 'bas'; did you mean 'base'?"),
        ("parent: base", "parent: door", "a part moves itself"),
        ("coordinate: door", "coordinate: dor", "unknown coordinate 'dor'; did you mean 'door'?"),
        ("  door: rad\nlinks", "  door: deg\nlinks", "key 'inputs.door': expected 'rad' or 'm', found 'deg'"),
    ],
)
def test_a_mistake_is_one_line(door: HybridAutomaton, old: str, new: str, expected: str) -> None:
    text = model_text(door)
    assert old in text
    assert expected in message(text.replace(old, new, 1))


def test_line_numbers_are_those_of_the_file(door: HybridAutomaton) -> None:
    lines = model_text(door).splitlines()
    number = next(i for i, line in enumerate(lines, 1) if "std: 0.005" in line)
    lines[number - 1] = lines[number - 1].replace("0.005", "bad")
    assert f"line {number}, " in message("\n".join(lines))
    assert f"line {number + 3}, " in message("\n# a\n# b\n" + "\n".join(lines))


def test_several_mistakes_are_counted_and_the_first_is_reported(door: HybridAutomaton) -> None:
    text = model_text(door).replace("std: 0.005", "std: -1").replace("kind: box", "kind: bx")
    line = message(text)
    assert "modes.rigid.pins.door.std" in line
    assert "(and 1 more error)" in line


def test_a_typo_is_reported_before_the_key_that_it_makes_missing(door: HybridAutomaton) -> None:
    line = message(model_text(door).replace("transitions:", "transition:"))
    assert "unknown key 'transition'" in line
    assert "did you mean 'transitions'?" in line


def test_both_ways_to_write_a_reset_exclude_each_other(door: HybridAutomaton) -> None:
    text = model_text(door).replace("reset:\n      door: 1.2", "reset: {door: 1.2}\n    reset_matrices: {c: [1.2]}")
    assert "both 'reset' and 'reset_matrices'" in message(text)


def test_files_that_cannot_be_read_or_written(door: HybridAutomaton, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: the file does not exist"):
        load_model(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="expected a file, found a directory"):
        load_model(tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        dump_model(door, tmp_path / "none" / "m.yaml")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change",
    [
        {"noise": Noise((float("nan"),), (0.1,))},
        {"provenance": {"a": "two\nlines"}},
        {"edges": (Edge("rigid", "open", Region()),)},
        {"edges": (Edge("rigid", "rigid", Region((HalfSpace((0.0,), (0.0,), 1.0),))),)},
    ],
)
def test_what_a_file_cannot_hold_is_not_written(door: HybridAutomaton, change: dict[str, object]) -> None:
    with pytest.raises(InputError, match="automaton"):
        model_text(replace(door, **change))


def test_a_name_used_twice_is_not_written(door: HybridAutomaton) -> None:
    with pytest.raises(InputError, match="the name 'rigid' is used twice"):
        model_text(replace(door, modes=(*door.modes, door.modes[1])))


@pytest.mark.slow
@settings(max_examples=100)
@given(data=st.data())
def test_a_damaged_file_raises_only_input_errors(door: HybridAutomaton, data: st.DataObject) -> None:
    content = model_text(door).encode()
    start = data.draw(st.integers(0, len(content)))
    end = data.draw(st.integers(start, min(len(content), start + 40)))
    piece = data.draw(st.binary(max_size=8) | st.text(":-[]{}#&*!|>'\"%@`\t\n ,?0e.", max_size=8).map(str.encode))
    result = attempt(parse_model, content[:start] + piece + content[end:], "m.yaml")
    assert isinstance(result, HybridAutomaton) or (result.startswith("m.yaml") and len(result.splitlines()) == 1)


def test_shipped_models_read_back(repository: Path) -> None:
    for path in sorted((repository / "models").glob("*.yaml")):
        text = path.read_text()
        if "format: micah-plan/model/" in text:
            automaton = load_model(path)
            assert parse_model(model_text(automaton).encode(), "again") == automaton


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("value: 1.2", "value: 1.1", "key 'modes.rigid.pins.door.value': mode rigid: the pin of door, 1.1 rad, lies"),
        ("held: 1.2", "held: 1.1", "key 'modes.rigid.joints.door.held': mode rigid: the rigid joint of door is fixed"),
        (
            "guard: [door >= 1.2]",
            "guard: [door >= 1.0]",
            "key 'transitions.0.guard': edge revolute -> rigid: enters mode rigid at door = 1, outside of its "
            "invariant [1.2, inf]; move the guard or the invariant, or give a reset",
        ),
        (
            "[door >= 0.0, door < 1.2]",
            "[door >= 2.0, door < 1.2]",
            "key 'modes.revolute': mode revolute: invariant must",
        ),
        ("step: {}", "step: {door: input door}", "key 'modes.rigid': mode rigid: B must have a zero row"),
        ("    reset:\n      door: 0.0\n", "", "key 'transitions.2': edge revolute -> revolute: a self transition"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused_with_its_line(
    door: HybridAutomaton, tmp_path: Path, old: str, new: str, expected: str
) -> None:
    plain = replace(door, edges=(Edge("revolute", "rigid", door.edges[0].guard), *door.edges[1:]))
    text, file = model_text(plain), tmp_path / "door.yaml"
    assert text.count(old) == 1
    file.write_text(text)
    assert load_model(file) == plain
    file.write_text(text.replace(old, new))
    line = told(load_model, file)
    assert expected in line
    assert line.startswith(f"{file}, line ")
    if expected.startswith(("key 'modes.rigid.", "key 'transitions.0.guard")):
        number = int(line.removeprefix(f"{file}, line ").split(",")[0])
        assert new in file.read_text().splitlines()[number - 1]


def test_covariances_come_last_and_may_be_at_the_joints_as_in_older_files(door: HybridAutomaton) -> None:
    text = model_text(door)
    keys = [line.split(":")[0] for line in text.splitlines() if line and line[0].isalpha()]
    assert keys[:6] == ["format", "coordinates", "inputs", "links", "modes", "transitions"]
    assert keys[-1] == "covariances"
    data = model_data(door)
    older = json.loads(json.dumps(data))
    own = older.pop("covariances")["revolute"]["door"]
    older["modes"]["revolute"]["joints"]["door"]["covariance"] = own
    assert automaton_of_document(Located(older, "older")) == automaton_of_document(Located(data, "newer")) == door
    twice = data | {"modes": older["modes"]}
    assert "its joint has a covariance already; keep one of them" in told(
        automaton_of_document, Located(twice, "twice")
    )
