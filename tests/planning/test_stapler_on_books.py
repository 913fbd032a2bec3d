"""The stapler on the books: what the planner finds by itself, and what it finds when the problem is another."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from micah_plan.automaton.transition import simulate
from micah_plan.documents.model import dump_model, load_model
from micah_plan.documents.plan import load_plan, write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.verification import verify
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem
from micah_plan.task.release import pre_release_problem

ROOT = Path(__file__).resolve().parents[2]
PROBLEM = ROOT / "problems" / "stapler_on_books.yaml"
CONTACTS = ("free", "line", "surface", "rigid")
IN_HAND = {"release": None, "goal.target.z.value": 0.288}
LOWER_BOOKS = {
    **IN_HAND,
    **{f"scene.book_{k + 1}.shapes": [{"kind": "box", "size": [0.35, 0.3, 0.02]}] for k in range(4)},
    **{f"scene.book_{k + 1}.position": [0.475, 0.0, 0.01 + 0.02 * k] for k in range(4)},
}
SURE = {"start.std": {"x": 0.002, "y": 0.002, "z": 0.002, "theta": 0.02}}
UNSURE = {"start.std": {"x": 0.02, "y": 0.02, "z": 0.02, "theta": 0.2}}


@cache
def solved(name: str) -> tuple[Problem, Plan]:
    problem = load_problem(PROBLEM, {"": {}, "lower books": LOWER_BOOKS, "sure": SURE, "unsure": UNSURE}[name])
    return problem, plan(problem, 0)


def dragged(problem: Problem, found: Plan) -> float:
    """How far [m] the stapler slides on the table if everything goes as expected."""
    trajectory = found.trajectory
    assert trajectory is not None
    run = simulate(
        problem.automaton, trajectory.modes[0], problem.start.mean, trajectory.inputs[~trajectory.is_transition]
    )
    lowest = run.states[:, 2].min()
    pairs = zip(run.modes, run.states[:, 2], strict=True)
    on_table = np.array([mode in ("line", "surface") or (mode == "rigid" and z < lowest + 1e-6) for mode, z in pairs])
    return float(np.abs(np.diff(run.states[:, 0]))[on_table[1:]].sum())


def test_the_goal_is_a_place_alone() -> None:
    problem, _ = solved("")
    assert [problem.automaton.coordinates[i].name for i, _, _ in problem.goal.target] == ["x", "y", "z"]
    assert problem.goal.modes == CONTACTS
    assert pre_release_problem(problem).goal.modes == ("rigid",)  # what is to stand must be shut
    assert problem.start.std == (0.01, 0.01, 0.01, 0.1)


def test_the_stapler_is_pressed_on_the_table_until_it_latches() -> None:
    problem, found = solved("")
    assert found.outcome == "solved"
    assert found.mode_sequence == CONTACTS
    # Nothing that the plan touches may come from chance: without noise the inputs alone do it.
    trajectory = found.trajectory
    assert trajectory is not None
    run = simulate(problem.automaton, "free", problem.start.mean, trajectory.inputs[~trajectory.is_transition])
    assert tuple(dict.fromkeys(run.modes)) == CONTACTS
    # The height becomes known where it latches on the table.
    stds = np.linalg.norm(trajectory.factors, axis=2)
    first = trajectory.modes.index("rigid")
    assert stds[first, 2] < 0.2 * stds[first, 1]


@pytest.mark.slow
def test_where_there_is_room_it_goes_straight_and_stays_open() -> None:
    _, found = solved("lower books")
    assert found.outcome == "solved"
    assert found.mode_sequence == ("free",)


def test_without_a_latch_there_is_no_plan_and_the_reason_names_what_is_in_the_way(tmp_path: Path) -> None:
    model = load_model(ROOT / "models" / "stapler.yaml")
    stops = tuple(edge for edge in model.edges if edge.is_self_transition)
    dump_model(replace(model, modes=model.modes[:1], edges=stops, learned=()), tmp_path / "stapler.yaml")
    latch = model.modes[1].pins[0].value
    problem = load_problem(PROBLEM, {"model": str(tmp_path / "stapler.yaml"), "hold.datum": latch, **IN_HAND})
    found = plan(problem, 0)
    assert found.outcome == "no_plan"
    assert "lower_arm at" in found.reason
    assert found.findings[0].remedy


@pytest.mark.slow
def test_a_sure_start_makes_it_drag_less() -> None:
    distances = [dragged(*solved(name)) for name in ("sure", "", "unsure")]
    assert distances[0] < 0.95 * min(distances[1:])


def test_the_plan_ends_above_the_books_from_where_it_is_put_down() -> None:
    problem, found = solved("")
    trajectory = found.trajectory
    assert trajectory is not None
    bottom = 0.0721  # of the pitched stapler, below the hand
    assert 0.2 + bottom < trajectory.means[-1][2] < 0.2 + bottom + 0.02
    assert problem.goal.target[2][1] == 0.26  # at rest it lies flat


def test_the_plan_file_holds_the_task(tmp_path: Path) -> None:
    problem, found = solved("")
    write_plan(found, problem, tmp_path / "plan.json")
    stored = load_plan(tmp_path / "plan.json")
    assert stored.problem.hold == problem.hold
    assert stored.automaton == problem.automaton


@pytest.mark.slow
def test_roll_outs_confirm_the_plan() -> None:
    problem, found = solved("")
    checked = verify(problem, found, 600)
    assert checked.success_probability is not None
    assert checked.outcome == "solved"


@pytest.mark.slow
def test_a_model_of_the_real_stapler_serves_as_well(tmp_path: Path) -> None:
    data = Path(os.environ.get("MICAH_DATA", ROOT.parent / "shared" / "data")) / "demonstrations" / "stapler.csv"
    if not data.is_file():
        pytest.skip(f"no recording at {data}")
    from micah_plan.api.learning import learn
    from micah_plan.recording.read import read_recording

    learned = learn(read_recording(data), seed=0)
    assert learned.automaton is not None
    dump_model(learned.automaton, tmp_path / "real.yaml")
    latch = next(pin.value for mode in learned.automaton.modes for pin in mode.pins)
    shut_by = 0.37
    changes = {"model": str(tmp_path / "real.yaml"), "hold.travel": latch, "start.mean.theta": latch - shut_by}
    found = plan(load_problem(PROBLEM, changes), 0)
    assert found.mode_sequence == CONTACTS
