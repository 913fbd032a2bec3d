"""Explanations: the level, the place, the amount and a remedy that helps, checked by taking it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planning_examples import DOOR_SHUT, door_automaton, door_problem, one_dimensional, planar_problem, with_settings

from micah_plan.automaton.hybrid import Noise
from micah_plan.automaton.region import above
from micah_plan.documents.problem import load_problem
from micah_plan.planning import messages
from micah_plan.planning.findings import explain, finding_of
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.solver import solve
from micah_plan.planning.transcription.rows import Row, Shortfall
from micah_plan.planning.verification import verify
from micah_plan.quantities import quantity
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Finding, Plan
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start


def first(problem: Problem) -> Finding:
    found = plan(problem)
    assert found.outcome == "no_plan"
    return explain(problem, found).findings[0]


def test_a_start_out_of_range_is_named_before_the_goal() -> None:
    finding = first(door_problem(1.5, 2.0))
    assert (finding.level, finding.unit) == ("start", "rad")
    assert finding.amount == pytest.approx(0.3)
    assert "it misses mode 'swings' by 0.3 rad" in finding.sentence
    # With the start alone the goal is still out of range, so no number is named.
    assert finding.remedy.startswith("start door within the range, or")
    assert solve(door_problem(1.5, 2.0)).findings[0].remedy == finding.remedy
    assert solve(door_problem(1.5, 0.9)).findings[0].remedy.startswith("start door at 1.2 rad, or")
    assert solve(door_problem(1.2, 0.9)).outcome == "solved"


def test_a_start_outside_of_its_named_mode_is_measured_against_that_mode() -> None:
    finding = first(door_problem(0.3, 0.9, mode="shut"))
    assert finding.mode == "shut"
    assert finding.amount == pytest.approx(0.9)


def test_a_goal_out_of_range_reports_how_far_and_where_the_range_ends() -> None:
    finding = first(door_problem(0.2, 2.0))
    assert finding.level == "goal"
    assert finding.amount == pytest.approx(0.75)
    assert solve(door_problem(0.2, 2.0)).findings[0].remedy == "move its target to 1.2 rad"
    assert solve(door_problem(0.2, 1.2)).outcome == "solved"


def test_the_search_names_the_guard() -> None:
    finding = first(door_problem(DOOR_SHUT, 0.3, mode="shut", automaton=door_automaton(release=0.1)))
    assert finding.level == "search"
    assert "the guard of 'shut -> swings' ('input door < -0.1') holds nowhere" in finding.sentence
    assert finding.remedy == messages.CORRECT_GUARD


def test_too_few_knots_are_an_finding_of_the_optimisation() -> None:
    finding = first(with_settings(door_problem(0.2, 0.9), max_knots=10))
    assert (finding.level, finding.modes) == ("optimisation", ("swings",))
    assert "needs at least 13 knots" in finding.sentence
    assert plan(with_settings(door_problem(0.2, 0.9), max_knots=20)).outcome == "solved"


@pytest.mark.slow
def test_a_narrow_corridor_is_reported_with_its_width_and_the_required_room(repository) -> None:  # type: ignore[no-untyped-def]
    problem = load_problem(repository / "problems" / "slot_unsure.yaml")
    found = plan(problem)
    (finding,) = found.findings
    assert (finding.level, finding.modes, finding.mode) == ("optimisation", ("table", "slot"), "table")
    assert finding.room == pytest.approx(0.012)
    assert finding.need is not None
    assert finding.amount is not None
    assert 0.012 < finding.need < 0.03
    # Both sides together miss what the corridor lacks.
    assert 0 < finding.amount <= finding.need - finding.room + 1e-6
    assert finding.sentence.code == "corridor_too_narrow"
    assert "is 12 mm wide, but the belief needs" in finding.sentence
    # Room and need speak of a confidence of 0.89, but roll-outs touch a wall more often: it is not offered.
    assert finding.remedy.endswith("or lower `confidence`")
    assert solve(problem).findings[0].remedy == "lower the noise (half of it suffices)"
    lower = solve(with_settings(problem, confidence=0.88), advise=False)
    assert (lower.outcome, (lower.success_probability or 0.0) < 0.7) == ("not_verified", True)


def test_roll_outs_that_miss_the_goal_say_what_tolerance_they_need() -> None:
    problem = door_problem(0.2, 0.5, tolerance=0.004)
    found = verify(problem, plan(problem), trials=400)
    assert found.outcome == "not_verified"
    finding = explain(problem, found).findings[0]
    assert (finding.level, finding.room) == ("verification", 0.004)
    assert finding.need is not None
    wider = replace(problem, goal=Goal(((0, 0.5, finding.need),)))
    share = verify(wider, found, trials=400).success_probability
    assert share == pytest.approx(0.95, abs=0.01)


def test_a_time_limit_is_named_without_further_claims() -> None:
    for limits in ({"time_limit_s": 1e-9}, {"solve_time_limit_s": 1e-9}):
        (finding, *_) = plan(with_settings(planar_problem(), **limits)).findings
        assert next(iter(limits)) in finding.sentence
        assert next(iter(limits)) in finding.remedy
        assert finding.knot is None


def test_a_solved_plan_is_explained_as_solved() -> None:
    problem = door_problem(0.2, 0.5)
    told = explain(problem, verify(problem, plan(problem), trials=50))
    assert (told.outcome, told.level) == ("solved", None)
    assert told.lines[0].startswith("solved through swings, ")


def test_a_plan_of_an_older_version_is_checked_again_or_reports_missing_details() -> None:
    old = Plan("no_plan", "reason of then")
    assert explain(door_problem(0.2, 2.0), old).level == "goal"
    told = explain(door_problem(0.2, 0.9), old)
    assert told.level is None
    assert "reason of then" in told.lines[0]
    assert "solve the problem again" in told.lines[1]


def test_short_lengths_are_in_millimetres() -> None:
    assert [quantity(0.012, "m"), quantity(1.5, "m"), quantity(0.3, "rad"), quantity(2.0, "")] == [
        "12 mm", "1.5 m", "0.3 rad (17.2°)", "2"
    ]  # fmt: skip


def turned(step: float, process: float = 0.001) -> Problem:
    """Behind the threshold the same input leads back."""
    automaton = one_dimensional(0.0, 0.5, 1.0)
    first, second = automaton.modes
    noise = Noise((process,), (0.003,))
    automaton = replace(automaton, modes=(first, replace(second, input_matrix=((-1.0,),))), noise=noise)
    settings = PlannerSettings(samples_per_mode=40, max_step=(step,), max_knots=300, tightening_rounds=0)
    return Problem(automaton, Start((0.4,), (0.004,)), Goal(((0, 0.6, 0.05),)), settings)


def test_a_step_too_short_for_a_boundary_that_turns_is_named_and_a_longer_one_helps() -> None:
    short = turned(0.006)
    told = explain(short, solve(short))
    finding = next(one for one in told.findings if one.level == "optimisation")
    assert finding.sentence.code == "no_room_to_reverse"
    assert finding.sentence.values["modes"] == ("first", "second")
    assert finding.remedy.startswith("raise max_step")
    assert finding.room < finding.need
    assert solve(turned(0.02)).outcome == "solved"


def test_a_wide_corridor_is_not_reported_as_narrow() -> None:
    """The belief does not keep its distance from one boundary; the one that faces it is far away."""
    boundary = above(0, 0.0, 1, 1, name="c")
    shortfall = Shortfall(
        Row("first", 3, "'c >= 0'", "m", 0.0, np.inf, "boundary", boundary, 1.0, 0.95), 0.002, 0.004, 0.5
    )
    finding = finding_of(turned(0.02), ("first",), shortfall)
    assert finding.need == pytest.approx(1.645 * 0.004, rel=1e-3)
    assert finding.room == pytest.approx(finding.need - 0.002)
    assert "wide" not in finding.sentence


@pytest.mark.slow
def test_a_plan_that_could_localise_gets_the_remedy_of_revisits() -> None:
    walls = load_problem(Path(__file__).resolve().parents[2] / "problems" / "walled_domain.yaml")
    blunt = with_settings(walls, revisits=0, verification_trials=100, tightening_rounds=0)
    finding = explain(blunt, solve(blunt)).findings[0]
    assert "raise `revisits`" in finding.remedy
