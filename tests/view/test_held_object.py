"""What a page shows of a held object: the object and its scene once, no boxes for the hand's carriages."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from micah_plan.documents.problem import load_problem
from micah_plan.task.plan import Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.view.drawing import fixed_shapes, object_size, shown_links
from micah_plan.view.plan_page import plan_page, with_shown_points
from micah_plan.view.solids import straightened

ROOT = Path(__file__).resolve().parents[2]


def stapler() -> Problem:
    return load_problem(ROOT / "problems" / "stapler_on_books.yaml")


def held_still(problem: Problem) -> Plan:
    """A plan that moves the hand up by 3 cm and then latches by miracle: enough to be drawn."""
    n, m = problem.automaton.n, problem.automaton.m
    means = np.tile(problem.start.mean, (4, 1))
    means[1:, 2] += 0.03
    means[2:, 3] = 0.573
    trajectory = Trajectory(
        ("free", "free", "rigid", "rigid"),
        means,
        np.tile(0.01 * np.eye(n), (4, 1, 1)),
        np.zeros((3, m)),
        np.zeros((3, m, n)),
        np.array([False, True, False]),
    )
    return Plan(outcome="solved", reason="", trajectory=trajectory)


def test_only_the_parts_that_have_shapes_are_drawn() -> None:
    automaton = stapler().automaton
    assert [link.child for _, link in shown_links(automaton)] == ["upper_arm", "lower_arm"]
    assert fixed_shapes(automaton) == ()
    assert 0.1 < object_size(automaton) < 0.2  # the stapler, not the room in which the hand moves


def test_hand_and_far_end_carry_the_belief() -> None:
    problem = stapler()
    assert problem.hold is not None
    shown = with_shown_points(problem).automaton
    assert shown.part("upper_arm").handle == problem.hold.grip.point
    np.testing.assert_allclose(shown.part("lower_arm").handle, (0.155, 0.0, -0.01))
    drawer = load_problem(ROOT / "problems" / "drawer_close.yaml")
    assert with_shown_points(drawer) is drawer


def test_the_page_holds_the_object_where_it_enters_a_mode_and_stays_small() -> None:
    problem = stapler()
    page = plan_page(held_still(problem), problem)
    assert "object where it enters a mode" in page
    assert "mode collided" not in page
    assert len(page) < 2_000_000


def test_straightened_lines_keep_their_corners() -> None:
    line = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [2, 2, 0], [2, 1, 0.0]])
    np.testing.assert_array_equal(straightened(line), line[[0, 2, 4, 5]])
    np.testing.assert_array_equal(straightened(line[:1]), line[:1])
