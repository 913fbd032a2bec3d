"""Numbers in remedies are tried before they are named; limits, bodies and confidences are told as what they are."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from planning_examples import DOOR_SHUT, door_automaton, door_problem, drawer_problem, planar_problem, with_settings

from micah_plan.automaton.hybrid import Edge
from micah_plan.automaton.region import box, input_box
from micah_plan.documents.problem import load_problem
from micah_plan.planning import messages
from micah_plan.planning.offers import (
    LARGER_STEPS,
    LESS_NOISE,
    LONGER_SEARCH,
    MORE_CONFIDENCE,
    MORE_KNOTS,
    MORE_STATES,
    SURER_START,
    changed,
    lower_confidence,
    more_knots,
    more_revisits,
)
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.remedies import with_tested_remedies
from micah_plan.planning.solver import solve
from micah_plan.planning.tightening import verified_plan
from micah_plan.planning.verification import verify
from micah_plan.task.acceptance import least_trials
from micah_plan.task.deadline import Deadline
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Finding, Plan
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Offer, one_of
from micah_plan.task.start import start_mode

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
NUMBER = r"(\d[\d.e-]*)"


def of_file(name: str) -> Problem:
    return load_problem(PROBLEMS / f"{name}.yaml")


def with_tolerances(problem: Problem, share: float) -> Problem:
    target = tuple((i, value, share * tolerance) for i, value, tolerance in problem.goal.target)
    return replace(problem, goal=replace(problem.goal, target=target))


def with_root(problem: Problem, position: tuple[float, float, float]) -> Problem:
    assert problem.robot is not None
    return replace(problem, robot=replace(problem.robot, position=position))


FAILING = {
    "a tight door": lambda: replace(of_file("microwave_close"), goal=Goal(((0, 1.2, 0.012),))),
    "a tight goal in the plane": lambda: with_tolerances(planar_problem(), 0.1),
    "far from a light": lambda: with_tolerances(of_file("light_dark"), 0.3),
    "behind a door": lambda: with_tolerances(of_file("drawer_behind_door"), 0.15),
    "beyond the end of a drawer": lambda: drawer_problem(0.1, 0.3595),
    "far beyond the end of a drawer": lambda: drawer_problem(0.1, 0.5),
    "a start that is too open": lambda: door_problem(1.6, 0.4),
    "an arm that stands too far away": lambda: with_root(of_file("microwave_close_by_arm"), (0.15, 1.2, -0.15)),
}
QUICK = ("a tight door", "far from a light", "far beyond the end of a drawer")
# What numbers are found for: a remedy without one is true too, but helps less.
NUMBERED = {
    "a tight door": ("move its target to", "widen the tolerance of 'door' to", "lower `confidence` to"),
    "far from a light": ("lower `confidence` to", "widen the tolerance of 'x' to"),
    "far beyond the end of a drawer": ("move its target to",),
    "an arm that stands too far away": (r"or move the robot's root to \[-?",),
}


def taken(problem: Problem, finding: Finding) -> list[Problem]:
    """The problem with each number that a remedy names, read from its words as a user reads them."""
    names, found = problem.automaton.coordinate_names, list[Problem]()
    for text in re.findall(rf"`confidence` to {NUMBER}", finding.remedy):
        found.append(with_settings(problem, confidence=float(text)))
    tolerances = dict(re.findall(rf"(?:tolerance|that) of '(\w+)' to {NUMBER}", finding.remedy))
    if tolerances:
        target = tuple((i, v, float(tolerances.get(names[i], tol))) for i, v, tol in problem.goal.target)
        found.append(replace(problem, goal=replace(problem.goal, target=target)))
    for text in re.findall(rf"move its target to {NUMBER}", finding.remedy):
        (name,) = [name for name in names if re.search(rf"goal (for '{name}'|{name} =)", finding.sentence)]
        target = tuple((i, float(text) if names[i] == name else v, tol) for i, v, tol in problem.goal.target)
        found.append(replace(problem, goal=replace(problem.goal, target=target)))
    for text in re.findall(r"the robot's root to \[(.*?)\] m", finding.remedy):
        x, y, z = map(float, text.split(", "))
        found.append(with_root(problem, (x, y, z)))
    for name, text in re.findall(rf"start (\w+) at {NUMBER}", finding.remedy):
        mean = tuple(float(text) if names[i] == name else value for i, value in enumerate(problem.start.mean))
        found.append(replace(problem, start=replace(problem.start, mean=mean)))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [one if one in QUICK else pytest.param(one, marks=pytest.mark.evidence) for one in FAILING]
)
def test_every_number_in_a_remedy_works_when_it_is_followed(name: str) -> None:
    problem = FAILING[name]()
    failed = solve(problem)
    assert failed.outcome != "solved"
    followed = [other for finding in failed.findings for other in taken(problem, finding)]
    remedies = "; ".join(finding.remedy for finding in failed.findings)
    assert followed, remedies
    for words in NUMBERED.get(name, ()):
        assert re.search(rf"{words} ?{NUMBER}", remedies), (words, remedies)
    for other in followed:
        assert solve(other, advise=False).outcome == "solved"


@pytest.mark.sweep
@pytest.mark.parametrize(
    "name", [one if one in QUICK else pytest.param(one, marks=pytest.mark.slow) for one in FAILING]
)
def test_without_advice_no_number_is_named(name: str) -> None:
    problem = FAILING[name]()
    for finding in solve(problem, advise=False).findings:
        assert not taken(problem, finding)


def _refused(*ways: str | Offer) -> Plan:
    words = one_of(ways)
    finding = Finding("search", "not_connected", "it is too far", words, ways=ways)
    return Plan("no_plan", "").refused_for(finding, outcome="no_plan")


def test_what_was_added_behind_a_remedy_stays() -> None:
    plan = _refused(MORE_KNOTS)
    longer = replace(plan, reason=f"{plan.reason}; planned again once")
    answer = with_tested_remedies(door_problem(0.2, 0.6), longer, _solver(lambda p: p.settings.max_knots >= 100, []))
    assert answer.findings[0].remedy == "raise max_knots to 120"
    assert answer.reason == longer.reason


def _solver(helps: Callable[[Problem], bool], asked: list[Problem]) -> Callable[..., Plan]:
    def solver(problem: Problem, *, seed: int) -> Plan:
        asked.append(problem)
        return Plan("solved" if helps(problem) else "no_plan", "", seed=seed)

    return solver


def _after(plan: Plan, helps: Callable[[Problem], bool]) -> tuple[str, list[Problem]]:
    asked: list[Problem] = []
    answer = with_tested_remedies(door_problem(0.2, 0.6), plan, _solver(helps, asked))
    assert answer.reason == f"it is too far; {answer.findings[0].remedy}"
    return answer.findings[0].remedy, asked


def test_what_helps_is_named_with_its_number_and_what_does_not_is_left_out() -> None:
    plan = _refused(MORE_KNOTS, LARGER_STEPS, "move the goal")
    assert _after(plan, lambda p: p.settings.max_knots >= 100)[0] == "raise max_knots to 120, or move the goal"
    assert _after(plan, lambda p: p.settings.max_knots >= 130)[0] == "raise max_knots to 480, or move the goal"
    assert _after(plan, lambda p: p.settings.max_knots >= 500)[0] == "move the goal"


def test_noise_and_steps_are_reported_with_their_size() -> None:
    quiet = door_problem(0.2, 0.6).automaton.noise.process_std[0]
    plan = _refused(LESS_NOISE, SURER_START, LARGER_STEPS)
    remedy, _ = _after(plan, lambda p: p.automaton.noise.process_std[0] < 0.3 * quiet)
    assert remedy == "lower the noise (an eighth of it suffices)"
    remedy, _ = _after(plan, lambda p: p.automaton.noise.process_std[0] == quiet)
    assert remedy == "lower the start's std (half of it suffices), or raise max_step (twice as much suffices)"


def test_a_failure_without_remedy_lists_the_trials() -> None:
    remedy, asked = _after(_refused(MORE_KNOTS, LESS_NOISE), lambda _: False)
    assert remedy == messages.none_helped(["raise max_knots", "lower the noise"])
    assert len(asked) == 4  # two numbers each, and no second seed where the first fails


def test_untested_remedies_are_marked() -> None:
    ways = [MORE_KNOTS, LARGER_STEPS, LESS_NOISE, SURER_START, MORE_CONFIDENCE, lower_confidence(0.9)]
    remedy, asked = _after(_refused(*ways), lambda _: False)
    assert len(asked) == 14
    assert remedy == messages.none_helped([way.words for way in ways])  # the last one just was
    more = more_revisits(1)
    assert _after(_refused(*ways, more), lambda _: False) == (messages.untested("raise revisits"), asked)


def test_progress_reports_the_remedy_that_is_tried(capsys) -> None:
    told: list[tuple[str, float]] = []
    with_tested_remedies(
        door_problem(0.2, 0.6), _refused(MORE_KNOTS), _solver(lambda _: False, []), progress=lambda *a: told.append(a)
    )
    assert [text for text, _ in told] == [messages.trying("raise max_knots")] * 2
    assert [share for _, share in told] == sorted(share for _, share in told)
    assert capsys.readouterr().out == ""


def test_what_helps_only_with_one_seed_does_not_help() -> None:
    def lucky(_: Problem, *, seed: int) -> Plan:
        return Plan("solved" if seed == 0 else "no_plan", "")

    answer = with_tested_remedies(door_problem(0.2, 0.6), _refused(MORE_KNOTS), lucky)
    assert answer.findings[0].remedy == messages.none_helped(["raise max_knots"])


def test_an_offer_changes_its_value_alone() -> None:
    problem = planar_problem()
    (first, second), settings = problem.goal.target, problem.settings
    assert changed(problem, Offer("", "", "tolerance", ((1, 0.3),))).goal.target == (first, (1, second[1], 0.3))
    assert changed(problem, Offer("", "", "target", ((0, 0.7),))).goal.target == ((0, 0.7, first[2]), second)
    assert changed(problem, Offer("", "", "start", ((1, 0.1),))).start.mean == (problem.start.mean[0], 0.1)
    assert changed(problem, Offer("", "", "confidence", ((0, 0.6),))).settings == replace(settings, confidence=0.6)

    more = [changed(problem, offer).settings for offer in (more_knots(11 / 60), MORE_STATES, LONGER_SEARCH)]
    states, limit = 2 * settings.samples_per_mode, 2 * settings.search_limit
    assert [more[0].max_knots, more[1].samples_per_mode, more[2].search_limit] == [11, states, limit]


@pytest.mark.parametrize("knots", [3, 7, 17])
def test_knots_that_a_path_needs_at_least_are_counted(knots: int) -> None:
    """A door that needs 18 knots gets these, and not four times twice what it has."""
    problem = with_settings(door_problem(0.2, 1.2), max_knots=knots)
    refused = solve(problem)
    assert refused.reason.endswith("raise max_knots to 18")
    assert solve(with_settings(problem, max_knots=18)).outcome == "solved"


def test_plans_that_would_take_minutes_are_not_tried() -> None:
    """Steps of 0.2 mrad take 4,756 knots to swing the door by 0.96 rad; of 2 nrad, more than there may be."""
    for step, expected in ((2e-4, "at least 4756 knots"), (2e-9, "; raise max_step (15,847,1")):
        refused = solve(with_settings(door_problem(0.2, 1.2), max_step=(step,)))
        assert refused.outcome == "no_plan"
        assert expected in refused.reason
        assert "raise max_knots" not in refused.reason


def latched(step: float | None, admitted: float) -> Problem:
    """A door that is shut until it is pulled by more than 0.1 rad, by steps and inputs up to these."""
    automaton = door_automaton(release=0.1)
    modes = tuple(replace(mode, inputs=input_box([-admitted], [admitted], 1, ["door"])) for mode in automaton.modes)
    problem = door_problem(DOOR_SHUT, 0.3, mode="shut", automaton=replace(automaton, modes=modes))
    return with_settings(problem, max_step=None if step is None else (step,))


@pytest.mark.parametrize(
    ("step", "suffices"), [(0.08, "twice as much"), (0.03, "4 times as much"), (0.0005, "256 times as much")]
)
def test_steps_that_are_too_small_for_a_guard_are_counted(step: float, suffices: str) -> None:
    problem = latched(step, 1.0)
    refused = solve(problem)
    assert "holds nowhere in mode 'shut' with inputs up to max_step" in refused.reason
    assert refused.reason.endswith(f"; raise max_step ({suffices} suffices)")


def test_steps_are_not_blamed_where_inputs_are_too_small() -> None:
    """The mode admits 0.06 of the 0.1 that its latch needs; of 0.2 the same problem is solved."""
    for step in (None, 0.05, 0.2):
        refused = solve(latched(step, 0.06))
        assert [finding.code for finding in refused.findings] == ["guard_empty"]
        assert refused.reason.endswith(f"; {messages.CORRECT_GUARD}")
    assert solve(latched(None, 0.2), advise=False).outcome == "solved"


def test_an_offer_of_a_root_moves_the_robot_alone() -> None:
    problem = of_file("microwave_close_by_arm")
    moved = changed(problem, Offer("", "", "root", ((0, 0.1), (1, 0.9), (2, -0.2))))
    assert moved == with_root(problem, (0.1, 0.9, -0.2)) != problem


def test_a_confidence_takes_as_many_roll_outs_as_show_it() -> None:
    """All of n succeed with probability c^n: with the confidence 0.999, 1,000 do by luck in 37 of 100 cases."""
    assert [least_trials(c) for c in (0.9, 0.95, 0.999, 0.9999)] == [29, 59, 2995, 29956]
    problem = with_settings(door_problem(0.2, 0.5), confidence=0.999, verification_trials=200)
    found = verify(problem, plan(problem))
    assert found.verification_trials == 2995
    surer = with_settings(problem, confidence=0.999999)
    refused = verify(surer, plan(surer))
    assert refused.outcome == "not_verified"
    assert refused.findings[0].sentence == messages.too_many_trials(2_995_731, 0.999999, 100_000)


def test_a_limit_that_ends_the_tightening_is_reported_as_one() -> None:
    """The time is over after the first verification: not the noise, but the limit is to be changed first."""
    problem = with_tolerances(planar_problem(), 0.1)
    now = [0.0]
    deadline = Deadline(10.0, clock=lambda: now[0])

    def planner(task: Problem, *, deadline: Deadline) -> Plan:
        assert not deadline.is_over()
        return plan(task)

    def slow(task: Problem, found: Plan, *, seed: int, deadline: Deadline) -> Plan:
        answer = verify(task, found, seed=seed, deadline=deadline)
        now[0] = 1000.0
        return answer

    found = verified_plan(problem, planner, 0, 3, deadline, verifier=slow)
    assert found.outcome == "not_verified"
    assert found.reason.endswith("raise solve_time_limit_s")
    assert found.findings[0].remedy == "raise solve_time_limit_s"


def held(**mean: float) -> Problem:
    problem = replace(of_file("stapler_on_books"), robot=None, grasp=None)
    start = tuple(
        mean.get(name, value) for name, value in zip(["x", "y", "z", "theta"], problem.start.mean, strict=True)
    )
    return replace(problem, start=replace(problem.start, mean=start))


@pytest.mark.slow
@pytest.mark.parametrize(
    "mean",
    [{"theta": 0.001}, *(pytest.param(one, marks=pytest.mark.evidence) for one in ({"theta": -0.03}, {"z": 0.605}))],
)
def test_a_start_a_hair_outside_of_its_range_is_not_a_collision(mean: dict[str, float]) -> None:
    problem = held(**mean)
    assert start_mode(problem.automaton, problem.start) == ("free", None)
    assert solve(problem, advise=False).outcome == "solved"


def test_a_start_far_outside_reports_how_far() -> None:
    (finding,) = solve(held(theta=-0.5), advise=False).findings
    assert finding.level == "start"
    low = float(finding.constraint.split("[")[1].split(",")[0])
    assert 0 <= low < 0.01
    assert finding.amount == pytest.approx(low + 0.5)
    assert f"it misses mode 'free' by {finding.amount:.3f} rad" in finding.sentence


@pytest.mark.slow
def test_a_start_or_a_goal_inside_a_body_is_named() -> None:
    within = solve(held(x=0.45, z=0.15), advise=False)
    assert within.findings[0].code == "start_in_obstacle"
    assert "'lower_arm at book_1, book_2, book_3, book_4'" in within.reason
    problem = held()
    goal = tuple((i, 0.15 if i == 2 else value, tol) for i, value, tol in problem.goal.target)
    placed = solve(replace(problem, goal=replace(problem.goal, target=goal), release=None), advise=False)
    assert placed.findings[0].code == "goal_in_obstacle"
    assert "'lower_arm at book_1, book_2, book_3, book_4'" in placed.reason


def test_a_goal_inside_two_bodies_together_is_named() -> None:
    """Neither block holds all of the goal."""
    problem = planar_problem(trap=False)
    names, edges = ["x", "y"], problem.automaton.edges
    for low, high in ((0.6, 0.8), (0.79, 1.0)):
        edges = (*edges, Edge("right", "lost", box([low, -1.0], [high, -0.6], 2, names)))
    told = solve(replace(problem, automaton=replace(problem.automaton, edges=edges)), advise=False)
    assert told.outcome == "no_plan"
    assert told.findings[0].code == "goal_in_obstacle"
