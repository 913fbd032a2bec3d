"""Other placements of held objects, by problem files alone: against a wall, under a bar, one that must be opened."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from micah_plan.documents.problem import load_problem
from micah_plan.planning.pomdp_hd import plan

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"


@cache
def solved(name: str):
    problem = load_problem(PROBLEMS / f"{name}.yaml")
    return problem, plan(problem, 0)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("name", "modes"),
    [
        ("stapler_in_shaft", ("free", "line", "surface", "rigid")),
        ("box_under_bar", ("free", "line", "rigid")),
        ("foot_under_shelf", ("free", "line")),
    ],
)
def test_the_planner_finds_the_contact_that_helps(name, modes):
    _, found = solved(name)
    assert found.outcome == "solved", found.reason
    assert found.mode_sequence == modes


@pytest.mark.slow
def test_the_foot_is_opened_and_the_others_are_shut():
    for name, opens in (("foot_under_shelf", True), ("box_under_bar", False)):
        problem, found = solved(name)
        assert found.trajectory is not None
        theta = found.trajectory.means[:, 3]
        assert (theta[-1] < problem.start.mean[3] - 0.1) == opens
        assert (theta[-1] > problem.start.mean[3] + 0.1) != opens


@pytest.mark.slow
def test_under_a_high_bar_the_lid_stays_open():
    high = {"scene.bar.position": [0.32, 0.0, 0.6]}
    held = plan(load_problem(PROBLEMS / "box_under_bar.yaml", {**high, "release": None}), 0)
    assert held.outcome == "solved"
    assert held.mode_sequence == ("free",)
    # But an open lid would fall when the box is released.
    let_go = plan(load_problem(PROBLEMS / "box_under_bar.yaml", high), 0)
    assert let_go.mode_sequence == ("free", "line", "rigid")
