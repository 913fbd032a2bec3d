"""Coordinates that follow others: problems are made, checked and solved by those that lead."""

from __future__ import annotations

from pathlib import Path

import pytest

from micah_plan import solve
from micah_plan.automaton.hybrid import Tie
from micah_plan.documents.model import load_model
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.exchange.convert import convert
from micah_plan.planning.limits import limits_of
from micah_plan.templates.first_problem import first_problem, problem_for

BIFOLD = """<robot name="closet">
  <link name="base"/>
  <link name="inner"/>
  <link name="outer"/>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="inner"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="1.4" effort="1" velocity="1"/></joint>
  <joint name="fold" type="revolute"><parent link="inner"/><child link="outer"/><origin xyz="0.3 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="0.3" effort="1" velocity="1"/>
    <mimic joint="hinge" multiplier="{multiplier}" offset="{offset}"/></joint>
</robot>"""


@pytest.fixture(params=[(-2.0, 0.0), (0.2, -0.1)], ids=["folds", "with an offset"])
def model(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    multiplier, offset = request.param
    (tmp_path / "closet.urdf").write_text(BIFOLD.format(multiplier=multiplier, offset=offset))
    convert(tmp_path / "closet.urdf", tmp_path / "model.yaml")
    return tmp_path / "model.yaml"


def test_the_first_problem_of_a_model_moves_what_leads(model: Path) -> None:
    problem = problem_for(load_model(model))
    (tie,) = problem.automaton.modes[0].ties
    assert [index for index, _, _ in problem.goal.target] == [0]
    assert problem.start.mean[tie.coordinate] == pytest.approx(float(tie.value(problem.start.mean)), abs=1e-3)
    plan = solve(problem)
    assert plan.outcome == "solved", plan.reason


def test_ranges_of_what_follows_are_those_of_what_leads(model: Path) -> None:
    problem = problem_for(load_model(model))
    (tie,) = problem.automaton.modes[0].ties
    limits = limits_of(problem)
    for value in (0.0, 1.4):
        followed = tie.offset + tie.weights[0] * value
        assert limits.lower[tie.coordinate] <= followed <= limits.upper[tie.coordinate]


def test_a_start_off_the_tie_is_named_and_one_within_its_std_is_taken(model: Path, tmp_path: Path) -> None:
    file = tmp_path / "problem.yaml"
    file.write_text(first_problem(load_model(model)))
    text, problem = file.read_text(), load_problem(file)
    (tie,) = problem.automaton.modes[0].ties
    name, value = problem.automaton.coordinates[tie.coordinate].name, problem.start.mean[tie.coordinate]
    std = problem.start.std[tie.coordinate]
    for off, is_refused in ((2.0 * std, False), (10.0 * std, True)):
        file.write_text(text.replace(f"{name}: {value:.4g}}}", f"{name}: {value + off:.6g}}}", 1))
        assert file.read_text() != text
        if not is_refused:
            load_problem(file)
            continue
        with pytest.raises(InputError, match=rf"key 'start.mean'.*{name} = .*is expected, found .*; write {name}: "):
            load_problem(file)


def test_a_tie_reads_as_an_equation() -> None:
    assert Tie(1, (-2.0, 0.0), 0.0).words(["h1", "h2"]) == "h2 = -2 h1"
    assert Tie(0, (0.0, 1.0, -0.5), 0.25).words(["a", "b", "c"]) == "a = 1 b - 0.5 c + 0.25"
    assert Tie(0, (0.0,), -1.0).words(["a"]) == "a = -1"
