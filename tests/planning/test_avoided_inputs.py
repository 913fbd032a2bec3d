"""Inputs that take a transition which nobody planned: feedback is cut off there, and plans take steps enough."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_executed_inputs import GLASS, _problem, _succeeds

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.belief.filter import initial_belief
from micah_plan.documents.model import load_model
from micah_plan.execution.pilot import PlanFollower
from micah_plan.planning.avoided_inputs import cut_off, input_bounds, needs_margin
from micah_plan.planning.solver import solve
from micah_plan.task.plan import Trajectory

LONG = ("max_knots: 80", "max_knots: 400")
LARGEST = 0.05


def _slower(limit: float) -> tuple[tuple[str, str], ...]:
    return ("input x >= 0.025", f"input x >= {limit}"), ("input x <= -0.025", f"input x <= -{limit}"), LONG


def _sent(
    automaton: HybridAutomaton,
    wanted: list[float],
    planned: list[float],
    weights: tuple[float, ...] = (1.0, 0.0),
) -> np.ndarray:
    """(m,) what is sent for a belief with these weights."""
    largest = np.full(automaton.m, LARGEST)
    return cut_off(automaton, np.array([weights]), np.array([wanted]), largest, np.array(planned))[0]


@pytest.mark.parametrize(("wanted", "sent"), [(0.04, 0.025), (0.02, 0.02), (-0.04, -0.025)])
def test_feedback_is_cut_off_before_what_the_planned_input_keeps_out_of(tmp_path, wanted, sent) -> None:
    cut = _sent(_problem(tmp_path, GLASS).automaton, [wanted], [0.01])
    assert cut == pytest.approx([sent], abs=1e-4)
    assert abs(cut[0]) < 0.025  # the guards are closed: they hold on their boundary


def test_what_the_plan_wants_to_take_is_taken(tmp_path) -> None:
    automaton = _problem(tmp_path, GLASS).automaton
    assert _sent(automaton, [0.04], [0.03]) == pytest.approx([0.04])
    assert _sent(automaton, [-0.04], [0.03]) == pytest.approx([-0.025], abs=1e-4)


@pytest.mark.parametrize(("weight", "sent"), [(1.0, 0.025), (0.2, 0.025), (0.002, 0.025), (1e-5, 0.04), (0.0, 0.04)])
def test_a_mode_that_is_hardly_believed_may_still_be_the_true_one(tmp_path, weight, sent) -> None:
    automaton = _problem(tmp_path, GLASS).automaton
    assert _sent(automaton, [0.04], [0.01], (weight, 1.0 - weight)) == pytest.approx([sent], abs=1e-4)


def test_where_a_transition_leads_back_feedback_may_take_it(tmp_path) -> None:
    back = "  - {source: spilled, target: carries, guard: [input x >= 0.04]}\n"
    automaton = _problem(tmp_path, (GLASS[0] + back, GLASS[1])).automaton
    assert _sent(automaton, [0.04], [0.0]) == pytest.approx([0.04])
    # The plan itself keeps out of it, so it still counts with slower steps.
    bounds = input_bounds(automaton, automaton.mode("carries"), np.array([LARGEST]))
    assert np.ravel(bounds) == pytest.approx([-0.025, 0.025])


def test_of_commands_that_are_places_feedback_is_not_cut_off(tmp_path) -> None:
    """How far a place is depends on where the part is, which nobody knows: plans keep their margin there."""
    values = "share: 0.5, offset: 0, gain: 1, delay: 0, momentum: 0, width: 0"
    places = f"{GLASS[0]}effects:\n  - {{name: follow, coordinate: x, parameters: {{{values}}}}}\n"
    automaton = _problem(tmp_path, (places, GLASS[1])).automaton
    assert _sent(automaton, [0.04], [0.0]) == pytest.approx([0.04])
    assert all(needs_margin(automaton, edge) for edge in automaton.edges)


PLANE = """\
format: micah-plan/model/1
coordinates: {x: m, y: m}
inputs: {x: m, y: m}
links: [{parent: base, child: p_x, coordinate: x}, {parent: base, child: p_y, coordinate: y}]
noise: {process_std: {x: 0.001, y: 0.001}, observation_std: {x: 0.003, y: 0.003}}
modes:
  whole:
    joints: &j
      p_x: {kind: prismatic, position: [0, 0, 0], axis: [1, 0, 0]}
      p_y: {kind: prismatic, position: [0, 0, 0], axis: [0, 1, 0]}
    step: {x: input x, y: input y}
    invariant: [x >= 0, x <= 1, y >= 0, y <= 1]
    inputs: [input y >= -0.01]
  torn: {joints: *j, step: {}, invariant: []}
transitions:
"""


@pytest.mark.parametrize(
    ("guard", "planned", "wanted", "sent"),
    [
        ("input x + input y >= 0.05", [0.0, 0.0], [0.05, 0.05], [0.025, 0.025]),
        ("input x >= 0.02, input y >= 0.02", [0.01, 0.018], [0.05, 0.05], [0.02, 0.05]),  # misses x by most
        ("input x >= 0.02, input y >= 0.02", [0.018, 0.01], [0.05, 0.05], [0.05, 0.02]),
        ("x >= 0.5, input x >= 0.02", [0.0, 0.0], [0.05, 0.05], [0.05, 0.05]),  # planned with a margin
        ("x + input x >= 0.5", [0.0, 0.0], [0.05, 0.05], [0.05, 0.05]),
        ("x >= 0.5", [0.0, 0.0], [0.05, 0.05], [0.05, 0.05]),
    ],
)
def test_guards_on_several_inputs_and_on_places(tmp_path: Path, guard, planned, wanted, sent) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(PLANE + f"  - {{source: whole, target: torn, guard: [{guard}]}}\n")
    assert _sent(load_model(file), wanted, planned) == pytest.approx(sent, abs=2e-4)


def test_bounds_are_of_admissible_inputs_and_of_guards_on_one_input(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(
        PLANE
        + "  - {source: whole, target: torn, guard: [input x >= 0.02]}\n"
        + "  - {source: whole, target: torn, guard: [input x <= 0.04, input y >= 0.03]}\n"
        + "  - {source: whole, target: torn, guard: [input y >= -0.005]}\n"  # holds at rest: no way to keep out of it
    )
    automaton = load_model(file)
    lowest, highest = input_bounds(automaton, automaton.mode("whole"), np.full(2, 0.05))
    assert lowest == pytest.approx([-0.05, -0.01])
    assert highest == pytest.approx([0.02, 0.05])


@pytest.mark.parametrize(
    "limit",
    [0.01, 0.005, pytest.param(0.0025, marks=pytest.mark.evidence), pytest.param(0.015, marks=pytest.mark.evidence)],
)
def test_a_glass_is_carried_as_slowly_as_it_must_be(tmp_path, limit) -> None:
    """A person who cuts what he sends at the limit gets there always; a margin for feedback left nothing to send."""
    problem = _problem(tmp_path, GLASS, *_slower(limit))
    answer = solve(problem, advise=False)
    assert answer.outcome == "solved", answer.reason
    assert (answer.success_probability or 0.0) > 0.98
    assert _succeeds(problem, answer) > 0.95
    assert answer.trajectory is not None
    assert np.abs(answer.trajectory.inputs).max() < limit


def test_a_plan_without_steps_is_held(tmp_path) -> None:
    problem = _problem(tmp_path, GLASS)
    whole = solve(problem, advise=False).trajectory
    assert whole is not None
    ended = Trajectory(
        whole.modes[:1], whole.means[:1], whole.factors[:1], whole.inputs[:0], whole.gains[:0], whole.is_transition[:0]
    )
    believed = initial_belief(problem.automaton, (0.1,), (0.01,), "carries")
    advice = PlanFollower(problem, ended).advise(believed)
    assert advice.fit == "finished"
    assert advice.u == pytest.approx([-0.025], abs=1e-4)  # back, but not so fast that it spills


def test_slower_than_the_noise_is_not_carried(tmp_path) -> None:
    problem = _problem(tmp_path, GLASS, *_slower(0.0012))
    assert solve(problem, advise=False).outcome != "solved"


def test_admissible_inputs_ask_for_as_many_steps(tmp_path) -> None:
    """The same limit as half-spaces of admissible inputs."""
    model = GLASS[0].replace(
        "step: {x: input x}, invariant: [x >= -1, x <= 1]}",
        "step: {x: input x}, invariant: [x >= -1, x <= 1], inputs: [input x >= -0.005, input x <= 0.005]}",
    )
    assert model != GLASS[0]
    answer = solve(_problem(tmp_path, (model, GLASS[1]), LONG), advise=False)
    assert answer.outcome == "solved", answer.reason
    assert answer.trajectory is not None
    assert len(answer.trajectory.inputs) > 100
