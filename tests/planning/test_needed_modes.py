"""Why a plan visits its modes: what is said is asked of the same problem in which nothing leaves the mode."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_hybrids import is_clearly_reachable, is_clearly_unreachable, random_problem

from micah_plan import load, show, solve
from micah_plan.documents.plan import load_plan, write_plan
from micah_plan.planning import messages
from micah_plan.planning.limits import limits_of
from micah_plan.planning.purposes import purpose_sentences
from micah_plan.planning.search.mode_search import search_modes
from micah_plan.planning.solver import solve as solve_problem
from micah_plan.task.deadline import Deadline, TimeLimitError
from micah_plan.task.plan import Candidate, ModePurpose, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.start import start_mode

FEW = {"verification_trials": 50}
QUICK = ("folding_rule", "microwave_close", "regrasp_rod", "walled_domain", "drawer_behind_door", "over_a_sill")


def _problem(repository: Path, name: str) -> Problem:
    problem = load(repository / "problems" / f"{name}.yaml")
    assert isinstance(problem, Problem)
    return problem


def _never_left(problem: Problem, mode: str) -> Problem:
    """The problem in which nothing leaves a mode, and the goal is not in it."""
    edges = tuple(edge for edge in problem.automaton.edges if edge.source != mode)
    others = tuple(name for name in problem.goal.modes or problem.automaton.mode_names if name != mode)
    return replace(problem, automaton=replace(problem.automaton, edges=edges), goal=replace(problem.goal, modes=others))


@pytest.mark.parametrize("name", QUICK)
def test_the_purpose_of_a_mode_holds_without_transitions_out_of_it(repository: Path, name: str) -> None:
    problem = _problem(repository, name)
    plan = solve(problem, **FEW).plan
    first = start_mode(problem.automaton, problem.start)[0]
    assert first == plan.mode_sequence[0]
    assert {purpose.mode for purpose in plan.purposes} == set(plan.mode_sequence) - {first}
    for purpose in plan.purposes:
        if purpose.is_goal:
            assert not purpose.why
            assert not purpose.without
            assert {mode.name for mode in problem.automaton.modes if problem.goal.admits(mode.name)} >= {purpose.mode}
            continue
        reduced = _never_left(problem, purpose.mode)
        found = search_modes(reduced, limits_of(reduced), first)
        assert bool(found.sequences) == bool(purpose.without)
        if found.reason is not None:
            assert purpose.why == found.reason.sentence
        else:
            assert purpose.without in [sequence.modes for sequence in found.sequences]
            assert purpose.mode not in purpose.without[:-1]


def test_a_plan_of_one_mode_has_no_purposes(repository: Path) -> None:
    plan = solve(_problem(repository, "light_dark"), **FEW).plan
    assert len(plan.mode_sequence) == 1
    assert plan.purposes == ()
    assert purpose_sentences(plan) == ()


def test_the_corner_is_left_out_at_a_price(repository: Path) -> None:
    plan = solve(_problem(repository, "walled_domain"), **FEW).plan
    (corner,) = (purpose for purpose in plan.purposes if purpose.mode == "corner")
    own = next(one.search_cost for one in plan.candidates if one.modes == plan.mode_sequence)
    assert corner.steps_without is not None
    assert corner.steps_without > 2.0 * own  # it localises
    assert (
        f"was expected to cost {corner.steps_without:.3g} steps instead of {own:.3g}"
        in dict(purpose_sentences(plan))["corner"]
    )


@pytest.mark.slow
def test_the_stapler_is_shut_since_it_would_meet_the_shaft(repository: Path, tmp_path: Path) -> None:
    problem = _problem(repository, "stapler_in_shaft")
    result = solve(problem, **FEW)
    assert [purpose.mode for purpose in result.plan.purposes] == ["line", "surface", "rigid"]
    assert all("only without 'lower_arm at left'" in purpose.why for purpose in result.plan.purposes)
    write_plan(result.plan, result.problem, tmp_path / "plan.json")
    assert load_plan(tmp_path / "plan.json").plan.purposes == result.plan.purposes
    page = show(result, tmp_path / "page.html").text
    assert "lead to the goal only without" in page
    assert messages.same_reason("line") in page


def test_the_purpose_of_a_mode_is_the_result_of_the_path_without_it() -> None:
    plan = _by("a", "b", "c")
    assert plan.mode_sequence == ("a", "b", "c")
    own = Candidate(("a", "b", "c"), 10.0, 2.0, "locally optimal")

    def said(*others: Candidate) -> str:
        purpose = ModePurpose("b", without=("a", "c"), steps_without=12.0)
        return dict(purpose_sentences(replace(plan, purposes=(purpose,), candidates=(own, *others))))["b"]

    without = ("a", "c")
    assert said() == messages.costs_more_without(without, 12.0, 10.0)
    assert said(Candidate(without, 12.0, None, "none")) == messages.no_plan_without(without)
    assert said(Candidate(without, 12.0, 3.0, "")) == messages.plan_costs_more_without(without, 3.0, 2.0)
    assert said(Candidate(without, 12.0, 1.0, "")) == messages.plan_fails_without(without, 1.0)


def _by(*modes: str) -> Plan:
    knots = len(modes)
    trajectory = Trajectory(
        modes,
        means=np.zeros((knots, 1)),
        factors=np.zeros((knots, 1, 1)),
        inputs=np.zeros((knots - 1, 1)),
        gains=np.zeros((knots - 1, 1, 1)),
        is_transition=np.ones(knots - 1, dtype=bool),
    )
    return Plan("solved", "", trajectory, cost=2.0)


def test_a_search_that_runs_out_of_time_has_no_purposes(repository: Path) -> None:
    """Where time passes while it is asked, that no way was found would be no reason."""
    problem = _problem(repository, "folding_rule")
    first = start_mode(problem.automaton, problem.start)[0]
    assert first is not None
    for ticks in (3, 8, 20, 60, 200, 10_000):
        passing = iter(range(10**6))
        deadline = Deadline(float(ticks), lambda passing=passing: float(next(passing)))
        try:
            found = search_modes(problem, limits_of(problem), first, deadline=deadline)
        except TimeLimitError:
            continue
        said = {purpose.mode: purpose for way in found.sequences for purpose in way.purposes}
        assert said.keys() <= {"one_straight", "two_straight"}
        assert all(purpose.is_goal for mode, purpose in said.items() if mode == "two_straight")
        assert all("no transitions lead" in purpose.why for mode, purpose in said.items() if mode == "one_straight")
    assert len(said) == 2


@pytest.mark.parametrize("seed", [17, 27, 28, 31, 43, 71, 80, 82, 84, 106])
def test_reasons_of_random_hybrids_hold_on_a_grid(seed: int) -> None:
    """Those of the first 120 whose plans say of a mode that there is no way without it, or which."""
    problem = random_problem(seed)
    said = [purpose for purpose in solve_problem(problem, advise=False).purposes if not purpose.is_goal]
    assert said
    for purpose in said:
        without = _never_left(problem, purpose.mode)
        assert not (is_clearly_reachable(without) if purpose.why else is_clearly_unreachable(without))
