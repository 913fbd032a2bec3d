"""Sweep files: what they mean, and errors that name the place and the nearest key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from sweep_examples import ROOT, SMALL

from micah_plan.documents.located import Located, overridden
from micah_plan.documents.problem import ProblemReader, load_problem
from micah_plan.documents.sweep import load_sweep, sweep_of
from micah_plan.errors import InputError


def test_cases_are_problems_times_values_times_seeds_in_order() -> None:
    problems = ["problems/drawer_close.yaml", "problems/drawer_open.yaml"]
    grid = {"confidence": [0.8, 0.9], "start.std": [{"drawer": 0.01}, {"drawer": 0.02}, {"drawer": 0.03}]}
    sweep = sweep_of({**SMALL, "problems": problems, "grid": grid, "seeds": 2, "first_seed": 5}, ROOT)
    cases = list(sweep.cases())
    assert len(cases) == len(sweep) == 2 * 2 * 3 * 2
    assert [case.seed for case in cases[:4]] == [5, 6, 5, 6]
    assert cases[2].overrides == (("confidence", 0.8), ("start.std", {"drawer": 0.02}))
    assert cases[6].overrides == (("confidence", 0.9), ("start.std", {"drawer": 0.01}))
    assert [case.problem for case in cases] == [problems[0]] * 12 + [problems[1]] * 12
    assert len({case.key for case in cases}) == len(cases)


def test_a_key_depends_on_content_alone(tmp_path: Path) -> None:
    def keys(folder: Path, **changes: Any) -> list[str]:
        return [case.key for case in sweep_of({**SMALL, **changes}, folder).cases()]

    for name in ("models", "problems"):
        (tmp_path / name).mkdir()
    for name in ("problems/drawer_close.yaml", "models/drawer.yaml"):
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    here = keys(ROOT)
    assert keys(tmp_path) == here
    assert keys(tmp_path, seeds=3)[:2] == here[:2]
    assert set(keys(tmp_path, execute={"trials": 3})).isdisjoint(here)
    (tmp_path / "models" / "drawer.yaml").write_bytes((ROOT / "models" / "drawer.yaml").read_bytes() + b"# mine\n")
    assert set(keys(tmp_path)).isdisjoint(here)


def test_a_model_in_the_grid_counts_with_its_content(tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_bytes((ROOT / "models" / "drawer.yaml").read_bytes() + b"# other\n")
    sweep = sweep_of({**SMALL, "grid": {"model": ["../models/drawer.yaml", str(other)]}, "seeds": 1}, ROOT)
    first, second = sweep.cases()
    assert first.digests["model"] != second.digests["model"]
    assert {**first.digests, "model": ""} == {**second.digests, "model": ""}


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        ("settings.confidence: [0.9]", "line 4, column 3, key 'grid.settings.confidence': no problem has this key; "
         "did you mean 'confidence'?"),
        ("start.std.drwer: [0.1]", "line 4, column 21, key 'grid.start.std.drwer.0': PROBLEM: unknown coordinate "
         "'drwer'; did you mean 'drawer'?"),
        ("start.sdt: [{drawer: 0.1}]", "did you mean 'start.std'?"),
        ("planner.candidate: [3]", "did you mean 'planner.candidates'?"),
        ("confidence.level: [0.9]", "no problem has this key; did you mean 'confidence'?"),
        ("confidence: [0.9, 2]", "line 4, column 21, key 'grid.confidence.1': PROBLEM: expected a number < 1, found 2"),
        ("start: [{mean: {drawer: 0.1}}]", "missing key 'std'"),
        ("model: [nowhere.yaml]", "the file does not exist"),
        ("goal.modes.first: [prismatic]", "no problem has this key; did you mean 'goal.modes'?"),
        ("confidence: []", "expected at least 1 entries, found a list of 0"),
        ("confidence: [0.9, 0.9]", "key 'grid.confidence.1': the same value twice; keep one of them"),
        ("start.std: [{drawer: 0.1}]\n  start.std.drawer: [0.1]", "lies within start.std, which the grid varies too"),
        ("format: [1]", "the format is no value to vary"),
    ],
)  # fmt: skip
def test_values_that_cannot_be_are_refused_with_their_place(tmp_path: Path, grid: str, said: str) -> None:
    problem = ROOT / "problems" / "drawer_open.yaml"
    file = tmp_path / "sweep.yaml"
    file.write_text(f"format: micah-plan/sweep/1\nproblems: [{problem}]\ngrid:\n  {grid}\n")
    with pytest.raises(InputError) as caught:
        load_sweep(file)
    assert str(caught.value).startswith(f"{file}, line ")
    assert said.replace("PROBLEM", str(problem)) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"problems": ["no.yaml"]}, "key 'problems.0': no.yaml: the file does not exist"),
        ({"problems": ["models/drawer.yaml"]}, "expected a problem file, found a model file"),
        ({"problems": SMALL["problems"] * 2}, "the same problem twice"),
        ({"problems": []}, "at least 1 entries"),
        ({"seeds": 0}, "expected a number >= 1"),
        ({"execute": {"plant": "mujocco"}}, "did you mean 'mujoco'?"),
        ({"execute": {"plant": "examples/own_plant.py:ProcessPlant"}}, "expected 'nominal' or 'mujoco', found"),
        ({"sedes": 3}, "unknown key 'sedes'; did you mean 'seeds'?"),
    ],
)
def test_a_sweep_that_cannot_be_is_refused(change: dict[str, Any], said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    with pytest.raises(InputError) as caught:
        sweep_of({**SMALL, **change})
    assert said in str(caught.value)


def test_huge_grids_are_refused_before_anything_is_made() -> None:
    lists = {f"k{i}": list(range(10)) for i in range(8)}
    for grid, found in ((lists, "200,000,000"), ({f"k{i}": list(range(100)) for i in range(50)}, "about 10^100")):
        with pytest.raises(InputError, match=r"expected at most 100,000 cases, found") as caught:
            sweep_of({**SMALL, "grid": grid}, ROOT)
        assert found in str(caught.value)
        assert "take fewer values or seeds" in str(caught.value)


def test_combinations_that_make_a_problem_impossible_are_no_fault_of_the_sweep() -> None:
    sweep = sweep_of({**SMALL, "grid": {"goal.target.drawer.value": [9.0]}}, ROOT)
    assert len(sweep) == 2


def test_overrides_reach_into_mappings_and_lists() -> None:
    located = Located({"a": {"b": [1, {"c": 2}]}}, "f", {("a",): (1, 1), ("a", "b", 1, "c"): (2, 3)})
    changed = overridden(located, "a.b.1.c", 5)
    assert changed.data == {"a": {"b": [1, {"c": 5}]}}
    assert located.data == {"a": {"b": [1, {"c": 2}]}}
    assert changed.at("a", "b", 1, "c").place() == (1, 1), "not in the file any more: the place of what holds it"
    assert overridden(located, "a.x.y", 1).data["a"]["x"] == {"y": 1}
    for key, said in (("a.b.2", "one of the 2 entries"), ("a.b.-1", "entries"), ("a.b.0.c", "'0' has no keys")):
        with pytest.raises(InputError, match=said):
            overridden(located, key, 1)


def test_a_reader_returns_what_loading_again_returns() -> None:
    reader = ProblemReader(ROOT / "problems" / "box_under_bar.yaml")
    first = reader.load()
    again = reader.load({"confidence": 0.8})
    assert first.settings.confidence != 0.8
    assert again == load_problem(ROOT / "problems" / "box_under_bar.yaml", {"confidence": 0.8})
