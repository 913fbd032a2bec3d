"""A user's constraint or cost on the path: one function, planned with, rolled out, explained."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from planning_examples import DOOR_SHUT, door_problem, drawer_problem, planar_problem, with_settings
from scipy.stats import norm

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.form import Operations
from micah_plan.automaton.effects.value import Effect
from micah_plan.belief.filter import initial_belief
from micah_plan.errors import InputError
from micah_plan.planning import messages
from micah_plan.planning.feedback import time_knots
from micah_plan.planning.findings import explain
from micah_plan.planning.limits import limits_of
from micah_plan.planning.plan_cost import cost_of
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.receding_horizon import RecedingHorizon
from micah_plan.planning.roll_outs import are_in_goal, draw_chances, roll_out
from micah_plan.planning.search.mode_search import search_modes
from micah_plan.planning.solver import solve
from micah_plan.planning.transcription.corridor import path_rows, path_terms_of
from micah_plan.planning.transcription.guess import guess
from micah_plan.planning.transcription.packed_belief import pack
from micah_plan.planning.verification import verify
from micah_plan.quantities import quantity
from micah_plan.task.path import (
    PathConstraint,
    PathStep,
    Pay,
    Require,
    Terms,
    check_constraint,
    path_function,
    path_terms,
    remove_path_function,
)
from micah_plan.task.problem import Problem

ROOM = norm.ppf(0.95)


def slow_near_frame(ops: Operations, step: PathStep, *, largest: float) -> Terms:
    room = ops.maximum(0.0, 0.8 - step.x["door"])
    return [Require("slow near the frame", largest + 0.3 * room - ops.abs(step.u["door"]), step.unit["door"])]


def creep(ops: Operations, step: PathStep, *, largest: float) -> Terms:
    return [Require("creep", largest - ops.abs(step.u["door"]), step.unit["door"])]


def well_known(_ops: Operations, step: PathStep, *, most: float) -> Terms:
    return [Require("well known", most - step.std["door"], "rad")]


def pay_for_place(_ops: Operations, step: PathStep, *, weight: float) -> Terms:
    return [Pay(weight * (step.x["drawer"] - 0.3) ** 2 + weight * step.std["drawer"] ** 2)]


def curved(ops: Operations, step: PathStep) -> Terms:
    x, y, u = step.x["x"], step.x["y"], step.u["x"]
    bend = Require("bend", ops.sin(3.0 * x) + y**2 - 0.5 * ops.exp(u) * y)
    return [bend, Require("fixed", 1.0), Require("std", 1.0 - step.std["y"]), Pay(x * y + step.std["x"])]


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    functions = (slow_near_frame, creep, well_known, pay_for_place, curved)
    for function in functions:
        path_function(function)
    yield
    for function in functions:
        remove_path_function(function.__name__)


def asking(problem: Problem, name: str, modes: tuple[str, ...] = (), **arguments: float | str) -> Problem:
    return replace(problem, constraints=(*problem.constraints, PathConstraint(name, tuple(arguments.items()), modes)))


def away_from_the_path(distance: float = 0.25) -> Problem:
    return asking(
        planar_problem(trap=False),
        "keep_away",
        first="x",
        second="y",
        at_first=-0.4,
        at_second=0.4,
        distance=distance,
    )


def distances(means: np.ndarray) -> np.ndarray:
    return np.hypot(means[:, 0] + 0.4, means[:, 1] - 0.4)


def test_numbers_and_expressions_are_one_formula_with_the_slopes_of_its_differences() -> None:
    problem = asking(planar_problem(), "curved")
    pattern, rng = ca.Sparsity.lower(2), np.random.default_rng(0)
    terms = path_terms_of(problem, limits_of(problem), "left", pattern)
    assert [name for name, _ in terms.requirements] == ["bend", "fixed", "std"]
    assert terms.uncertain == [0]
    x, u = rng.normal(size=(7, 2)), rng.normal(size=(7, 2))
    factors = np.tril(rng.normal(size=(7, 2, 2)))
    root = rng.normal(size=(7, 4, 4))
    covariances = root @ np.swapaxes(root, 1, 2)
    columns = covariances.reshape(7, -1).T
    margins, stds, _, cost = (np.array(v) for v in terms.function.map(7)(pack(x, factors, pattern), u.T, columns))

    def numbers(x: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
        std = np.linalg.norm(factors, axis=-1).T
        said = path_terms(problem.constraints[0], np, problem.automaton, x.T, u.T, std)
        return [np.broadcast_to(t.margin if isinstance(t, Require) else t.amount, 7) for t in said]

    np.testing.assert_allclose([*margins, *cost], numbers(x, u), rtol=1e-12, atol=1e-12)
    small = 1e-6
    steps = [(small * np.eye(4)[i, :2], small * np.eye(4)[i, 2:]) for i in range(4)]
    slopes = np.array([(numbers(x + a, u + b)[0] - numbers(x - a, u - b)[0]) / (2 * small) for a, b in steps]).T
    whole = covariances.copy()
    whole[:, :2, :2] += factors @ np.swapaxes(factors, 1, 2)
    np.testing.assert_allclose(stds[0], np.sqrt(np.einsum("ki,kij,kj->k", slopes, whole, slopes)), rtol=1e-6)


def test_a_constraint_changes_the_plan_which_keeps_k_sigma_from_it_and_roll_outs_hold_it() -> None:
    problem = away_from_the_path()
    free, asked = plan(planar_problem(trap=False)), plan(problem).trajectory
    assert free.trajectory is not None
    assert asked is not None
    assert distances(free.trajectory.means).min() < 0.15
    # Noise is alike in x and y, so the std is that of any direction.
    assert (distances(asked.means)[1:] - ROOM * asked.factors[1:, 0, 0]).min() > 0.25
    assert verify(problem, free, trials=50).success_probability == 0.0
    found = solve(with_settings(problem, verification_trials=300))
    assert found.outcome == "solved"


def test_the_room_of_a_constraint_is_that_of_simulated_filters_and_feedback() -> None:
    """Input and place together against 20,000 simulated loops, in which the feedback makes both move together."""
    path_function(place_and_input)
    try:
        problem = asking(with_settings(drawer_problem(0.05, 0.3), max_knots=30), "place_and_input")
        limits = limits_of(problem)
        (sequence,) = search_modes(problem, limits, "slides").sequences
        (phase,) = guess(problem, limits, sequence)
        (rows,) = path_rows(problem, limits, (phase,), ca.Sparsity.lower(1))
    finally:
        remove_path_function("place_and_input")
    assert rows is not None
    states = pack(phase.means[rows.knots], phase.factors[rows.knots], ca.Sparsity.lower(1))
    planned = np.array(rows.terms.function.map(len(rows.knots))(states, phase.inputs.T, rows.covariances)[1]).ravel()
    rng, trials = np.random.default_rng(0), 20_000
    process, observation = problem.automaton.noise.process_std[0], problem.automaton.noise.observation_std[0]
    variance, estimate = problem.start.std[0] ** 2, np.full(trials, 0.05)
    x = estimate + problem.start.std[0] * rng.standard_normal(trials)
    for k in range(phase.steps):
        u = phase.inputs[k, 0] + phase.gains[k, 0, 0] * (estimate - phase.means[k, 0])
        x = x + u + process * rng.standard_normal(trials)
        gain = (variance + process**2) / (variance + process**2 + observation**2)
        estimate = estimate + u
        estimate = estimate + gain * (x + observation * rng.standard_normal(trials) - estimate)
        variance = (1 - gain) * (variance + process**2)
        assert np.std(x - 4.0 * u) == pytest.approx(planned[k], rel=0.03)


def place_and_input(_ops: Operations, step: PathStep) -> Terms:
    return [Require("both", step.x["drawer"] - 4.0 * step.u["drawer"] + 1.0)]


def test_a_constraint_on_the_input_leaves_room_for_the_feedback() -> None:
    problem = asking(door_problem(0.2, 1.0), "slow_near_frame", largest=0.03)
    found = solve(with_settings(problem, verification_trials=300))
    assert found.outcome == "solved"
    assert found.trajectory is not None
    door, inputs = found.trajectory.means[1:, 0], found.trajectory.inputs[:, 0]
    assert inputs[door < 0.6].max() > 0.035
    assert inputs[door > 0.8].max() < 0.029


def test_a_constraint_that_leaves_too_few_steps_is_named_and_relaxing_it_by_the_amount_helps() -> None:
    problem = door_problem(0.2, 1.0)
    refused = plan(asking(problem, "creep", largest=0.012))
    assert refused.outcome == "no_plan"
    finding = explain(problem, refused).findings[0]
    assert (finding.level, finding.constraint, finding.unit) == ("optimisation", "'creep'", "rad")
    # 0.75 rad in 58 steps.
    assert finding.amount == pytest.approx(0.75 / 58 - 0.012, rel=1e-2)
    assert finding.remedy.startswith("relax it by 0.0009")
    assert "'creep' is missed by" in refused.reason
    assert finding.amount is not None
    assert plan(asking(problem, "creep", largest=0.012 + 1.02 * finding.amount)).outcome == "solved"


@pytest.mark.parametrize("problem", [away_from_the_path(0.95), door_problem(0.2, 1.0)])
def test_a_constraint_that_blocks_the_way_is_named_by_the_search(problem: Problem) -> None:
    if not problem.constraints:
        problem = asking(problem, "stay_below", coordinate="door", value=0.9)
    refused = plan(problem)
    assert refused.outcome == "no_plan"
    (finding,) = explain(problem, refused).findings
    assert finding.level == "search"
    assert f"only without '{problem.constraints[0].name}'" in finding.sentence
    assert finding.remedy == "relax it"


def test_a_belief_that_is_too_wide_is_reported_with_the_missing_room() -> None:
    problem = asking(door_problem(0.2, 1.0), "well_known", most=0.001)
    (finding,) = plan(problem).findings
    # Σ after one step: process 0.002, measurement 0.01 from a start of 0.02.
    prior = 0.02**2 + 0.002**2
    assert finding.amount == pytest.approx(np.sqrt(prior * 0.01**2 / (prior + 0.01**2)) - 0.001, abs=1e-5)
    assert plan(asking(door_problem(0.2, 1.0), "well_known", most=0.0095)).outcome == "solved"


def test_roll_outs_that_break_a_constraint_fail_and_say_which() -> None:
    problem = door_problem(0.2, 1.0)
    found = plan(problem)
    assert found.trajectory is not None
    asked = asking(asking(problem, "creep", largest=0.03), "stay_above", coordinate="door", value=0.0)
    for sequential in (False, True):
        failed = verify(asked, found, trials=200, sequential=sequential)
        assert (failed.outcome, failed.success_probability) == ("not_verified", 0.0)
        (finding,) = explain(asked, failed).findings
        assert (finding.level, finding.constraint) == ("verification", "'creep'")
        assert finding.amount is not None
        assert finding.sentence == messages.breaks_constraint(1.0, "creep", finding.amount, "rad")
        assert finding.amount > 0.0047  # the planned input, 0.0347, and what feedback adds
    chances = draw_chances(asked, found.trajectory, 200, seed=1)
    ends = roll_out(asked, found.trajectory, chances)
    assert not are_in_goal(asked, ends).any()
    assert are_in_goal(problem, replace(ends, path=roll_out(problem, found.trajectory, chances).path)).all()


@pytest.mark.slow
def test_room_too_narrow_for_the_belief_is_not_verified_and_named() -> None:
    problem = with_settings(door_problem(0.2, 1.0, tolerance=0.012), tightening_rounds=0, verification_trials=300)
    problem = asking(problem, "stay_below", coordinate="door", value=0.995)
    found = solve(problem)
    assert found.outcome == "not_verified"
    by_level = {finding.level: finding for finding in explain(problem, found).findings}
    assert by_level["verification"].constraint == "'door stays below 0.995'"
    planned = by_level["optimisation"]
    assert (planned.constraint, planned.unit) == ("'door stays below 0.995' at 95 %", "rad")
    assert planned.code == "too_little_room"
    assert planned.sentence.code == "margin_too_small"
    assert planned.need is not None
    assert planned.room is not None
    assert planned.need - planned.room == pytest.approx(planned.amount)
    assert f"relax 'door stays below 0.995' by {quantity(planned.amount or 0.0, 'rad')}" in planned.remedy


@pytest.mark.slow
def test_a_constraint_counts_in_its_modes_only_and_behind_the_guard_that_a_step_crosses() -> None:
    latched = with_settings(door_problem(0.9, DOOR_SHUT, goal_modes=("shut",)), confidence=0.999)
    free, most = plan(latched).trajectory, DOOR_SHUT + 0.0155
    assert free is not None
    assert free.means.max() > most
    # The mean goes behind the latch to be sure of it; the door itself stays there.
    below = asking(latched, "stay_below", coordinate="door", value=most)
    found = plan(below)
    assert found.trajectory is not None
    assert found.trajectory.means.max() > most
    assert not found.findings
    assert (
        verify(below, found, trials=300).success_probability == verify(latched, found, trials=300).success_probability
    )
    slow = plan(asking(latched, "creep", ("shut",), largest=-1.0))
    assert slow.outcome == "no_plan"
    assert plan(asking(latched, "creep", ("swings",), largest=0.05)).outcome == "solved"
    with pytest.raises(InputError, match="unknown mode 'ajar'"):
        plan(asking(latched, "creep", ("ajar",), largest=0.05))


def test_what_a_path_costs_is_in_the_programme_and_in_the_cost_of_its_trajectory() -> None:
    problem = drawer_problem(0.05, 0.3)
    paying = asking(problem, "pay_for_place", weight=30.0)
    plain, found = plan(problem), plan(paying)
    assert plain.trajectory is not None
    assert found.trajectory is not None
    limits = limits_of(problem)
    assert cost_of(paying, limits, found.trajectory) == pytest.approx(found.cost, abs=1e-4)
    assert cost_of(paying, limits, found.trajectory) < cost_of(paying, limits, plain.trajectory) - 0.01
    means, stds = found.trajectory.means[1:, 0], found.trajectory.factors[1:, 0, 0]
    extra = 30.0 * float(np.sum((means - 0.3) ** 2 + stds**2))
    assert cost_of(paying, limits, found.trajectory) - cost_of(problem, limits, found.trajectory) == pytest.approx(
        extra
    )


def test_what_is_left_of_a_plan_is_optimised_again_within_the_constraint() -> None:
    problem = away_from_the_path()
    trajectory = plan(problem).trajectory
    assert trajectory is not None
    horizon, knot = RecedingHorizon(problem, trajectory), 3
    std = np.linalg.norm(trajectory.factors[knot], axis=1)
    belief = initial_belief(problem.automaton, trajectory.means[knot] + 0.3 * std, std, "left")
    onward = horizon(belief, trajectory, knot)
    assert onward is not None
    assert (horizon.reused, horizon.built) == (1, 0)
    assert distances(onward.means).min() > 0.25


@pytest.mark.slow
def test_constraints_hold_where_the_model_has_a_memory_of_inputs() -> None:
    problem = door_problem(0.2, 1.0)
    delayed = with_effect(problem.automaton, Effect("delay", "door", (("steps", 2.0),)))
    problem = asking(replace(problem, automaton=delayed), "creep", largest=0.03)
    found = solve(with_settings(problem, verification_trials=300))
    assert found.outcome == "solved"
    assert found.trajectory is not None
    assert np.abs(found.trajectory.inputs[time_knots(found.trajectory)]).max() < 0.03


def branching(_ops: Operations, step: PathStep) -> Terms:
    return [Require("far", 1.0 if step.x["door"] > 0.5 else -1.0)]


def misspelt(_ops: Operations, step: PathStep) -> Terms:
    return [Require("far", step.x["dor"])]


def wrong_shape(_ops: Operations, _step: PathStep) -> Terms:
    return [Require("far", np.zeros(3))]


def twice(_ops: Operations, step: PathStep) -> Terms:
    return [Require("far", step.x["door"]), Require("far", step.x["door"])]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (branching, "path constraint 'branching' cannot be evaluated: .*; use the functions of `ops`"),
        (misspelt, "path constraint 'misspelt': there is no 'dor'; choose one of door"),
        (wrong_shape, "must give one number per state. Got the shape \\(3,\\) for 2 states"),
        (twice, "each Require with a name of its own"),
    ],
)
def test_mistakes_in_a_function_are_reported_before_anything_is_planned(function, message: str) -> None:  # type: ignore[no-untyped-def]
    path_function(function)
    try:
        with pytest.raises(InputError, match=message):
            plan(asking(door_problem(0.2, 1.0), function.__name__))
    finally:
        remove_path_function(function.__name__)


def test_names_and_arguments_must_fit() -> None:
    automaton = door_problem(0.2, 1.0).automaton
    for constraint, message in (
        (PathConstraint("never_heard_of"), "unknown path constraint 'never_heard_of'; choose one of stay_above"),
        (PathConstraint("creep"), "path constraint 'creep' takes largest. Got none"),
        (PathConstraint("creep", (("largest", 0.1), ("other", 0.1))), "takes largest. Got largest, other"),
        (PathConstraint("creep", (("largest", float("nan")),)), "arguments must be finite"),
    ):
        with pytest.raises(InputError, match=message):
            check_constraint(constraint, automaton)
    with pytest.raises(InputError, match="a path function 'creep' exists already"):
        path_function(creep)
    with pytest.raises(InputError, match="expected \\(ops, step, \\*, keywords\\)"):
        path_function(lambda ops, step, more: [])  # noqa: ARG005
    remove_path_function("stay_above")  # the library's own stay
    check_constraint(PathConstraint("stay_above", (("coordinate", "door"), ("value", 0.1))), automaton)
