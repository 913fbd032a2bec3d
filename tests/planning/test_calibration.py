"""A plan's success probability is what fresh roll-outs show, for every problem that the project ships."""

from __future__ import annotations

from pathlib import Path

import pytest

from micah_plan.documents.kind import kind_of
from micah_plan.documents.problem import load_problem
from micah_plan.planning.roll_outs import are_in_goal, draw_chances, roll_out
from micah_plan.planning.solver import solve

FOLDER = Path(__file__).resolve().parents[2] / "problems"
PROBLEMS = sorted(path for path in FOLDER.glob("*.yaml") if kind_of(path) == "problem")


@pytest.mark.evidence
@pytest.mark.parametrize("path", PROBLEMS, ids=lambda path: path.stem)
def test_predicted_success_is_observed(path: Path) -> None:
    problem = load_problem(path)
    found = solve(problem)
    if found.trajectory is None:
        assert found.findings
        return
    ends = roll_out(problem, found.trajectory, draw_chances(problem, found.trajectory, 1000, seed=12345))
    assert found.success_probability == pytest.approx(are_in_goal(problem, ends).mean(), abs=0.03)
    assert found.outcome == "solved"
