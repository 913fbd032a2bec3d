"""What stands in the way has a code that programmes can ask for: one problem for each, and none beside a plan."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import pytest
from planning_examples import (
    DOOR_SHUT,
    door_automaton,
    door_problem,
    planar_problem,
    with_settings,
)
from test_remedies import latched, of_file, with_root

from micah_plan.automaton.hybrid import Edge
from micah_plan.automaton.region import box
from micah_plan.planning.solver import solve
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Code


def with_edges(problem: Problem, *edges: Edge) -> Problem:
    return replace(problem, automaton=replace(problem.automaton, edges=edges))


def without_way_back() -> Problem:
    """A door that is shut for good."""
    swings, *others = door_automaton().edges
    kept = (swings, *(edge for edge in others if edge.is_self_transition))
    return with_edges(door_problem(DOOR_SHUT, 0.3, mode="shut"), *kept)


def beside_a_block(low: tuple[float, float], high: tuple[float, float], **start: float) -> Problem:
    """The plane with a block in its left room that nothing leaves."""
    problem = planar_problem(trap=False)
    block = Edge("left", "lost", box(list(low), list(high), 2, ["x", "y"]))
    mean = (start.get("x", -0.9), start.get("y", 0.0))
    problem = replace(problem, start=replace(problem.start, mean=mean), goal=Goal(((0, -0.2, 0.05), (1, 0.0, 0.05))))
    return with_edges(problem, *problem.automaton.edges, block)


def with_a_stuck_coordinate() -> Problem:
    """Nothing moves y."""
    problem = planar_problem(trap=False)
    modes = tuple(replace(mode, input_matrix=((1.0, 0.0), (0.0, 0.0))) for mode in problem.automaton.modes[:2])
    return replace(problem, automaton=replace(problem.automaton, modes=(*modes, problem.automaton.modes[2])))


REFUSED = {
    "start_in_no_mode": lambda: door_problem(1.5, 0.9),
    "start_outside_mode": lambda: door_problem(0.3, 0.9, mode="shut"),
    "start_in_obstacle": lambda: beside_a_block((-0.95, -0.1), (-0.8, 0.1)),
    "goal_outside_range": lambda: door_problem(0.2, 2.0),
    "goal_in_obstacle": lambda: beside_a_block((-0.4, -0.2), (-0.1, 0.2)),
    "no_transition_to_goal": without_way_back,
    "coordinate_not_moved": with_a_stuck_coordinate,
    "constraint_in_the_way": lambda: with_settings(beside_a_block((-0.5, -2.0), (-0.4, 2.0)), samples_per_mode=40),
    "guard_unreachable": lambda: latched(0.08, 1.0),
    "guard_empty": lambda: latched(None, 0.06),
    "too_few_knots": lambda: with_settings(door_problem(0.2, 0.9), max_knots=10),
    "too_many_trials": lambda: with_settings(door_problem(0.2, 0.5), confidence=0.999999),
    "time_limit_reached": lambda: with_settings(planar_problem(), solve_time_limit_s=1e-9),
    "misses_goal": lambda: door_problem(0.2, 0.5, tolerance=0.004),
}
SLOW = {
    "too_little_room": lambda: of_file("slot_unsure"),
    "too_few_revisits": lambda: with_settings(of_file("regrasp_rod"), revisits=0),
    "arm_cannot_follow": lambda: with_root(of_file("microwave_close_by_arm"), (0.15, 1.2, -0.15)),
}


@pytest.mark.parametrize("code", [*REFUSED, *(pytest.param(code, marks=pytest.mark.slow) for code in SLOW)])
def test_what_stands_in_the_way_has_its_code(code: Code) -> None:
    refused = solve({**REFUSED, **SLOW}[code](), advise=False)
    assert refused.outcome != "solved"
    assert refused.ranked_findings[0].code == code
    assert {finding.code for finding in refused.findings} <= set(get_args(Code))
