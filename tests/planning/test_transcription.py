"""The low level: names, truth against closed forms, k-sigma at guards, failures in words."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from planning_examples import DOOR_SHUT, door_problem, drawer_problem, planar_problem, with_settings
from scipy.stats import norm

from micah_plan.automaton.hybrid import Edge, Noise, Reset
from micah_plan.automaton.region import Region, above, below
from micah_plan.planning import messages
from micah_plan.planning.feedback import belief_lqr
from micah_plan.planning.findings import sentence_of
from micah_plan.planning.limits import limits_of
from micah_plan.planning.no_way import NoWayError
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.search.mode_search import search_modes
from micah_plan.planning.transcription.guess import guess
from micah_plan.planning.transcription.packed_belief import factor_pattern, pack, unpack
from micah_plan.planning.transcription.programme import Transcription, transcribe
from micah_plan.planning.transcription.rows import ConstraintRows, Row, Shortfall
from micah_plan.planning.transcription.solve import BeliefPath, solve_transcription, violated_constraints
from micah_plan.task.problem import Problem

LIMIT_S = 20.0
GUARD_MESSAGE = (
    r"the guard 'y [<>]= 0.81?' of 'left -> right' at 95 % is missed by ([0-9.]+) mm at knot \d+ in mode 'left'"
)


def transcription(problem: Problem, start_mode: str, modes: tuple[str, ...]) -> Transcription:
    limits = limits_of(problem)
    found = search_modes(problem, limits, start_mode).sequences
    sequence = next(s for s in found if s.modes == modes)
    return transcribe(problem, limits, guess(problem, limits, sequence))


def optimised(problem: Problem, start_mode: str, modes: tuple[str, ...]) -> BeliefPath:
    return solve_transcription(transcription(problem, start_mode, modes), LIMIT_S)


def rows_at_start(nlp: Transcription) -> np.ndarray:
    values = ca.Function("g", [ca.vertcat(*nlp.w)], [ca.vertcat(*nlp.g)])
    return np.array(values(np.concatenate(nlp.w_start))).ravel()


def test_pack_and_unpack_are_inverse() -> None:
    rng = np.random.default_rng(0)
    means, factors = rng.normal(size=(5, 3)), np.tril(rng.normal(size=(5, 3, 3)))
    pattern = ca.Sparsity.lower(3)
    again = unpack(pack(means, factors, pattern), pattern)
    np.testing.assert_array_equal(again[0], means)
    np.testing.assert_array_equal(again[1], factors)


def test_packed_order_is_casadis() -> None:
    lower = np.tril(np.arange(1.0, 10.0).reshape(3, 3))
    np.testing.assert_array_equal(
        pack(np.zeros((1, 3)), lower[None], ca.Sparsity.lower(3))[3:, 0],
        np.array(ca.project(ca.DM(lower), ca.Sparsity.lower(3)).nonzeros()),
    )


def test_factors_have_the_entries_that_resets_fill_and_no_others() -> None:
    automaton = planar_problem().automaton
    mixing = replace(automaton.edges[0], reset=Reset(A=((1.0, 0.0), (0.5, 1.0))))
    for edges, entries in ((automaton.edges, 2), ((mixing, *automaton.edges[1:]), 3)):
        changed = replace(automaton, edges=edges)
        assert factor_pattern(changed, np.eye(2), ["left", "right"], [0]).nnz() == entries
        assert factor_pattern(changed, np.eye(2), ["left"], []).nnz() == 2
        assert factor_pattern(changed, np.tril(np.ones((2, 2))), ["left"], []).nnz() == 3


@pytest.mark.parametrize(
    ("problem", "start_mode", "modes"),
    [
        (door_problem(0.2, DOOR_SHUT), "swings", ("swings", "shut")),
        (door_problem(DOOR_SHUT, 0.3, mode="shut"), "shut", ("shut", "swings")),
        (drawer_problem(0.05, 0.3), "slides", ("slides",)),
        (planar_problem(), "left", ("left", "right")),
    ],
)
def test_every_row_is_named_and_the_warm_start_satisfies_the_dynamics(
    problem: Problem, start_mode: str, modes: tuple[str, ...]
) -> None:
    nlp = transcription(problem, start_mode, modes)
    g = rows_at_start(nlp)
    assert len(g) == len(nlp.rows)
    last_knot = nlp.guess[-1].first_knot + nlp.guess[-1].steps
    assert all(row.name and row.mode in modes and 0 <= row.knot <= last_knot for row in nlp.rows)
    exact = [row.violation(v) for row, v in zip(nlp.rows, g, strict=True) if row.lower == row.upper]
    assert max(exact) < 1e-8


def test_variance_follows_the_scalar_kalman_filter() -> None:
    problem = drawer_problem(0.05, 0.3)
    path = optimised(problem, "slides", ("slides",))
    assert path.feasible
    q, r = problem.automaton.noise.process_std[0] ** 2, problem.automaton.noise.observation_std[0] ** 2
    variance = [problem.start.std[0] ** 2]
    for _ in path.inputs:
        prior = variance[-1] + q
        variance.append(prior * r / (prior + r))
    np.testing.assert_allclose(path.factors[:, 0, 0] ** 2, variance, rtol=1e-5)
    np.testing.assert_allclose(np.diff(path.means, axis=0), path.inputs, atol=1e-7)


def test_the_optimum_of_effort_and_goal_error_in_closed_form() -> None:
    """The minimum of N w_e (u/s)² + w_g ((D - N u)/tol)² is at u = D/(N + λ) with λ = (w_e/s²)/(w_g/tol²)."""
    problem = drawer_problem(0.05, 0.3)
    path = optimised(problem, "slides", ("slides",))
    settings, step = problem.settings, limits_of(problem).max_step[0]
    ratio = (settings.weight_effort / step**2) / (settings.weight_goal / problem.goal.target[0][2] ** 2)
    np.testing.assert_allclose(path.inputs, 0.25 / (len(path.inputs) + ratio), rtol=1e-4)


@pytest.mark.parametrize("confidence", [0.6, 0.95, 0.999])
def test_the_guard_is_passed_by_k_sigma_and_the_pin_takes_the_overshoot(confidence: float) -> None:
    problem = with_settings(door_problem(0.2, DOOR_SHUT), confidence=confidence)
    path = optimised(problem, "swings", ("swings", "shut"))
    at = int(np.flatnonzero(path.is_transition)[0])
    overshoot = path.means[at, 0] - DOOR_SHUT
    assert overshoot >= norm.ppf(confidence) * path.factors[at, 0, 0] - 1e-6
    assert path.means[at + 1, 0] == pytest.approx(DOOR_SHUT, abs=0.2 * overshoot + 1e-9)
    assert path.factors[at + 1, 0, 0] <= 0.005 + 1e-9
    np.testing.assert_array_equal(path.inputs[at], 0.0)
    assert path.modes[at : at + 2] == ("swings", "shut")


def test_a_door_that_shall_stay_off_its_latch_keeps_k_sigma_from_it() -> None:
    problem = door_problem(0.2, 1.19, goal_modes=("swings",))
    path = optimised(problem, "swings", ("swings",))
    k = norm.ppf(problem.settings.confidence)
    assert (DOOR_SHUT - path.means[1:, 0] - k * path.factors[1:, 0, 0]).min() >= -1e-6
    assert path.message == "locally optimal"


def test_without_room_the_boundary_is_kept_in_part_and_reported() -> None:
    problem = door_problem(0.2, 1.199, goal_modes=("swings",), tolerance=0.003)
    path = optimised(problem, "swings", ("swings",))
    assert path.feasible
    assert "'door <= 1.2' holds with less than 95 % around knot" in path.message
    assert path.means[:, 0].max() <= DOOR_SHUT + 1e-6


def test_the_clamped_end_bounds_the_mean_only() -> None:
    path = optimised(drawer_problem(0.0, 0.0), "slides", ("slides",))
    assert path.message == "locally optimal"
    assert path.means.min() >= -1e-6


def test_inputs_stay_within_the_largest_step() -> None:
    problem = with_settings(door_problem(0.2, DOOR_SHUT), max_step=(0.03,), max_knots=50)
    path = optimised(problem, "swings", ("swings", "shut"))
    assert path.feasible
    assert np.abs(path.inputs).max() <= 0.03 + 1e-7


def test_the_path_around_the_trap_keeps_k_sigma_at_the_knots_and_stays_out_between() -> None:
    problem = planar_problem()
    path = optimised(problem, "left", ("left", "right"))
    assert path.feasible
    left = path.means[: path.modes.index("right")]
    along = np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(left)])
    block = problem.automaton.edges[2].guard
    assert not np.any(np.all(block.margins(along, np.zeros((len(along), 2))) > 1e-5, axis=1))


def test_a_gate_too_narrow_for_the_belief_is_named_with_the_amount() -> None:
    problem = planar_problem(trap=False)
    first, second = problem.automaton.edges
    half_spaces = (above(0, 0.0, 2, 2, name="x"), above(1, 0.8, 2, 2, name="y"), below(1, 0.81, 2, 2, name="y"))
    automaton = replace(
        problem.automaton,
        edges=(replace(first, guard=Region(half_spaces)), second),
        noise=Noise((0.01, 0.01), (0.05, 0.05)),
    )
    problem = replace(problem, automaton=automaton)
    nlp = transcription(problem, "left", ("left", "right"))
    assert not solve_transcription(nlp, LIMIT_S).feasible
    # Both boundaries ask for k-sigma, together they leave 0.01 m: the sum of what is missed is known.
    k, phase = norm.ppf(0.95), nlp.guess[0]
    std = np.sqrt((phase.factors[-1] @ phase.factors[-1].T + phase.spreads[-1])[1, 1])
    missed = [
        re.fullmatch(GUARD_MESSAGE, sentence) for sentence in map(sentence_of, violated_constraints(nlp, LIMIT_S))
    ]
    assert all(missed)
    assert sum(float(m.group(1)) for m in missed if m) == pytest.approx(1e3 * (2 * k * std - 0.01), rel=2e-2)


def test_a_start_point_that_is_not_a_number_is_found_before_the_solver_runs() -> None:
    problem = drawer_problem(0.05, 0.3)
    nlp = transcription(problem, "slides", ("slides",))
    nlp.w_start[0] = nlp.w_start[0] * np.nan
    path = solve_transcription(nlp, LIMIT_S)
    assert not path.feasible
    assert path.message.startswith(f"{messages.UNUSABLE_GUESS}: the dynamics of 'drawer' is not a number")


def test_knots_of_phases_follow_one_another() -> None:
    problem = planar_problem()
    limits = limits_of(problem)
    found = search_modes(problem, limits, "left").sequences
    sequence = next(s for s in found if s.modes == ("left", "right"))
    first, second = guess(problem, limits, sequence)
    assert (first.first_knot, second.first_knot) == (0, len(first.means))
    for phase in (first, second):
        assert len(phase.inputs) == len(phase.means) - 1 == len(phase.gains) == len(phase.closed) > 0


def test_too_few_knots_say_how_many_are_needed() -> None:
    problem = with_settings(door_problem(0.2, 0.9), max_knots=10)
    limits = limits_of(problem)
    (sequence, *_) = search_modes(problem, limits, "swings").sequences
    # 0.7 rad at 0.06 rad per step: 12 steps, 13 knots.
    with pytest.raises(NoWayError, match="needs at least 13 knots at the largest step, more than max_knots = 10"):
        guess(problem, limits, sequence)


def test_more_measurements_are_planned_where_the_goal_is_tight() -> None:
    wide = optimised(door_problem(0.5, 0.5, tolerance=0.1), "swings", ("swings",))
    tight = optimised(door_problem(0.5, 0.5, tolerance=0.008), "swings", ("swings",))
    assert len(tight.modes) > len(wide.modes)
    assert norm.ppf(0.95) * tight.factors[-1, 0, 0] <= 0.008


def test_an_input_guard_of_another_transition_is_not_triggered() -> None:
    """A door that would slam if moved by more than 0.02 backwards in one step: the plan goes slower."""
    problem = with_settings(door_problem(0.9, 0.5), max_knots=100)
    slam = Edge("swings", "shut", Region((replace(problem.automaton.edges[1].guard.half_spaces[0], c=0.02),)))
    automaton = replace(problem.automaton, edges=(*problem.automaton.edges, slam))
    found = plan(replace(problem, automaton=automaton))
    assert found.trajectory is not None
    assert found.mode_sequence == ("swings",)
    assert found.trajectory.inputs.min() >= -0.02 - 1e-7


def test_the_spread_of_the_true_state_is_that_of_simulated_filters() -> None:
    """Belief and closed-loop spread together against 20,000 simulated loops of filter and feedback."""
    problem = with_settings(drawer_problem(0.05, 0.3), max_knots=30)
    limits = limits_of(problem)
    (phase,) = transcription(problem, "slides", ("slides",)).guess
    gains = belief_lqr(problem, limits, ("slides",) * (phase.steps + 1), np.zeros(phase.steps, dtype=bool))
    rng, trials = np.random.default_rng(0), 20_000
    process, observation = problem.automaton.noise.process_std[0], problem.automaton.noise.observation_std[0]
    variance = problem.start.std[0] ** 2
    estimate = np.full(trials, 0.05)
    x = estimate + problem.start.std[0] * rng.standard_normal(trials)
    for k in range(phase.steps):
        u = phase.inputs[k, 0] + gains[k, 0, 0] * (estimate - phase.means[k, 0])
        x = x + u + process * rng.standard_normal(trials)
        prior = variance + process**2
        gain = prior / (prior + observation**2)
        estimate = estimate + u
        estimate = estimate + gain * (x + observation * rng.standard_normal(trials) - estimate)
        variance = (1 - gain) * prior
        planned = np.sqrt(phase.factors[k + 1, 0, 0] ** 2 + phase.spreads[k + 1, 0, 0])
        assert np.std(x) == pytest.approx(planned, rel=0.03)


def test_a_reset_that_depends_on_the_input_gets_the_input_that_opens_the_guard() -> None:
    """A latch that springs: leaving it throws the door as far again as it is pulled."""
    problem = door_problem(DOOR_SHUT, 0.3, mode="shut")
    first, release, clamp = problem.automaton.edges
    springing = replace(release, reset=Reset(B=((1.0,),)))
    automaton = replace(problem.automaton, edges=(first, springing, clamp))
    path = optimised(replace(problem, automaton=automaton), "shut", ("shut", "swings"))
    assert path.feasible
    at = int(np.flatnonzero(path.is_transition)[0])
    assert path.inputs[at + 1, 0] < 0
    assert path.means[at + 1, 0] == pytest.approx(path.means[at, 0] + path.inputs[at + 1, 0], abs=1e-6)


def test_rows_say_what_is_wrong_worst_first() -> None:
    rows = ConstraintRows(
        [Row("q", 3, "the guard 'x >= 1'", "m", 0.0, np.inf), Row("q", 1, "the goal", "rad", -0.1, 0.1)]
    )
    g = np.array([-0.25, 0.4])
    assert [sentence_of(Shortfall(rows[i], rows[i].violation(g[i]))) for i in rows.worst(g)] == [
        "the goal is missed by 0.3 rad (17.2°) at knot 1 in mode 'q'",
        "the guard 'x >= 1' is missed by 250 mm at knot 3 in mode 'q'",
    ]
    assert rows.worst(np.array([0.0, 0.1])) == []
    assert rows.worst(np.array([0.0, np.nan])) == [1]
    assert rows[1].violation(np.nan) == np.inf
