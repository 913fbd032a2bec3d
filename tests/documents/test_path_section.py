"""What a problem file asks of the path: registered functions by name, written and read back, never any code."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from attempts import told

from micah_plan.documents.plan import load_plan, plan_text, write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.planning.solver import solve
from micah_plan.task.path import PathConstraint, Require, path_function, remove_path_function

ROOT = Path(__file__).resolve().parents[2]
ABOVE = PathConstraint("stay_above", (("coordinate", "door"), ("value", 0.2)), ("revolute",))


def file(folder: Path, entry: str) -> Path:
    text = (ROOT / "problems" / "microwave_close.yaml").read_text()
    (folder / "p.yaml").write_text(text.replace("../models", str(ROOT / "models")) + f"path:\n{entry}\n")
    return folder / "p.yaml"


@pytest.fixture
def gentle() -> Iterator[None]:
    @path_function
    def gentle(ops, step, *, largest):  # type: ignore[no-untyped-def]
        return [Require("gentle", largest - ops.abs(step.u["door"]), step.unit["door"])]

    yield
    remove_path_function("gentle")


def test_a_file_names_a_function_with_arguments_and_modes(tmp_path: Path) -> None:
    entry = "- {name: stay_above, arguments: {coordinate: door, value: 0.2}, modes: [revolute]}"
    assert load_problem(file(tmp_path, entry)).constraints == (ABOVE,)
    assert load_problem(ROOT / "problems" / "microwave_close.yaml").constraints == ()


@pytest.mark.usefixtures("gentle")
def test_a_plan_file_has_the_constraints_of_its_problem(tmp_path: Path) -> None:
    problem = load_problem(file(tmp_path, "- {name: gentle, arguments: {largest: 0.05}}"))
    problem = replace(problem, settings=replace(problem.settings, verification_trials=50))
    write_plan(solve(problem), problem, tmp_path / "plan.json")
    stored = load_plan(tmp_path / "plan.json")
    assert stored.problem.constraints == problem.constraints == (PathConstraint("gentle", (("largest", 0.05),)),)
    remove_path_function("gentle")  # as in a process that has not imported the function: the file brings none along
    with pytest.raises(
        InputError, match=r"key 'problem\.path\.0': unknown path constraint 'gentle'; choose one of stay_above"
    ):
        load_plan(tmp_path / "plan.json")
    with pytest.raises(InputError, match="unknown path constraint 'gentle'"):
        plan_text(stored.plan, problem)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("- {name: os.system}", "key 'path.0': unknown path constraint 'os.system'"),
        ("- {name: stay_above}", "path constraint 'stay_above' takes coordinate, value. Got none"),
        (
            "- {name: stay_above, arguments: {coordinate: lid, value: 0.2}}",
            "key 'path.0': path constraint 'stay_above': there is no 'lid'; choose one of door",
        ),
        (
            "- {name: stay_above, arguments: {coordinate: door, value: 0.2}, modes: [ajar]}",
            "unknown mode 'ajar'; choose one of",
        ),
        (
            "- {name: stay_above, arguments: {coordinate: [door]}}",
            "'path.0.arguments.coordinate': expected a finite number or a name",
        ),
        ("- {name: stay_above, arguments: {value: .inf}}", "expected a finite number or a name"),
        ("- {name: stay_above, arguments: {value: true}}", "expected a finite number or a name"),
    ],
)
def test_mistakes_are_reported_with_their_place(tmp_path: Path, entry: str, message: str) -> None:
    said = told(load_problem, file(tmp_path, entry))
    assert message in said
    assert "line 20" in said
