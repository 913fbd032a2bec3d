"""Ways through random boxes, beside an exhaustive grid; and hands that move many things one after the other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import label

from micah_plan.documents.problem import load_problem
from micah_plan.execution.trials import run_trials
from micah_plan.planning.cuts import with_enlarged_obstacles
from micah_plan.planning.solver import solve
from micah_plan.task.problem import Problem

SLIDE = "{kind: prismatic, position: [0, 0, 0], axis: [1, 0, 0]}"
FIELD = f"""\
format: micah-plan/model/1
coordinates: {{x: m, y: m}}
inputs: {{x: m, y: m}}
links: [{{parent: base, child: p_x, coordinate: x}}, {{parent: base, child: p_y, coordinate: y}}]
noise: {{process_std: {{x: 0.001, y: 0.001}}, observation_std: {{x: 0.003, y: 0.003}}}}
modes:
  free:
    joints: &j {{p_x: {SLIDE}, p_y: {SLIDE}}}
    step: {{x: input x, y: input y}}
    invariant: [x >= 0, x <= 1, y >= 0, y <= 1]
  hit: {{joints: *j, step: {{}}, invariant: []}}
transitions:
"""
ACROSS = """\
format: micah-plan/problem/1
model: model.yaml
start: {mean: {x: 0.05, y: 0.05}, std: {x: 0.003, y: 0.003}, mode: free}
goal: {target: {x: {value: 0.95, tolerance: 0.02}, y: {value: 0.95, tolerance: 0.02}}, modes: [free]}
planner: {max_step: {x: 0.04, y: 0.04}, max_knots: 120}
"""
# A gap that a belief of this noise gets through surely: grown by this on all sides, boxes must leave a way [m].
SURE = 0.015


def _boxes(count: int, seed: int, largest: float = 0.035) -> np.ndarray:
    """(count, 4) x and y from and to, away from start and goal [m]."""
    rng, boxes = np.random.default_rng(seed), list[np.ndarray]()
    while len(boxes) < count:
        center, half = rng.uniform(0.05, 0.95, 2), rng.uniform(0.01, largest, 2)
        if min(np.abs(center - end).max() for end in (0.05, 0.95)) > 0.1:
            boxes.append(np.ravel([center - half, center + half], order="F"))
    return np.round(boxes, 4)


def _has_way(boxes: np.ndarray, grown: float) -> bool:
    """Whether a grid of 2 mm leads from start to goal between boxes that are larger by this on all sides."""
    at = np.linspace(0.0, 1.0, 501)
    free = np.ones((501, 501), dtype=bool)
    for x0, x1, y0, y1 in boxes:
        inside = [(at > low - grown) & (at < high + grown) for low, high in ((x0, x1), (y0, y1))]
        free &= ~np.outer(*inside)
    places = label(free)[0]
    return bool(places[25, 25] and places[25, 25] == places[475, 475])


def _field(folder: Path, boxes: np.ndarray) -> Problem:
    rows = (
        f"  - {{source: free, target: hit, guard: [x >= {a}, x <= {b}, y >= {c}, y <= {d}]}}\n" for a, b, c, d in boxes
    )
    (folder / "model.yaml").write_text(FIELD + "".join(rows))
    (folder / "problem.yaml").write_text(ACROSS)
    return load_problem(folder / "problem.yaml")


SEEDS = [1, 0, *(pytest.param(seed, marks=pytest.mark.evidence) for seed in range(2, 8))]


@pytest.mark.sweep
@pytest.mark.parametrize("seed", SEEDS)
def test_where_a_grid_finds_a_wide_way_through_64_boxes_a_plan_does(tmp_path, seed) -> None:
    boxes = _boxes(64, seed)
    assert _has_way(boxes, SURE)
    problem = _field(tmp_path, boxes)
    answer = solve(problem, seed=seed, advise=False)
    assert answer.outcome == "solved", answer.reason
    assert run_trials(problem, answer, trials=20, seed=3).successes >= 18


WALLS = {
    "a wall from side to side": np.array([[0.4, 0.45, 0.0, 0.6], [0.4, 0.45, 0.6, 1.0]]),
    "a wall with a hole of no width": np.array([[0.4, 0.45, 0.0, 0.5], [0.4, 0.45, 0.5001, 1.0]]),
    "a box around the goal": np.array(
        [[0.85, 0.88, 0.85, 1.0], [0.85, 1.0, 0.85, 0.88]],
    ),
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", WALLS)
def test_where_a_grid_finds_none_there_is_no_plan_that_is_taken_for_good(tmp_path, name) -> None:
    assert not _has_way(WALLS[name], 0.001)
    assert solve(_field(tmp_path, WALLS[name]), advise=False).outcome != "solved"


def test_a_trap_of_boxes_that_share_corners_is_gone_around(tmp_path) -> None:
    """The shortest path slips between two boxes that touch; the belief does not."""
    trap = np.array([[0.6, 0.65, 0.3, 0.7], [0.3, 0.65, 0.7, 0.75], [0.3, 0.65, 0.25, 0.3]])
    problem = _field(tmp_path, trap)
    text = ACROSS.replace("x: 0.05, y: 0.05", "x: 0.5, y: 0.5").replace("y: {value: 0.95", "y: {value: 0.5")
    (tmp_path / "problem.yaml").write_text(text)
    problem = load_problem(tmp_path / "problem.yaml")
    answer = solve(problem, advise=False)
    assert answer.outcome == "solved", answer.reason
    assert answer.trajectory is not None
    assert answer.trajectory.means[:, 0].min() < 0.3  # out of the open side


def test_room_is_added_to_what_ends_everything_but_never_around_the_start(tmp_path) -> None:
    boxes = np.array([[0.053, 0.2, 0.0, 0.3], [0.5, 0.6, 0.5, 0.6]])
    problem = _field(tmp_path, boxes)
    larger = with_enlarged_obstacles(problem).automaton
    near, far = (edge.guard for edge in larger.edges)
    given = problem.automaton.edges[1].guard
    assert near == problem.automaton.edges[0].guard  # grown, the start would lie in it
    grown = [h.c - before.c for h, before in zip(far.half_spaces, given.half_spaces, strict=True)]
    assert all(0.0 < -by < SURE for by in grown)


LIDS = 5


def _lids(folder: Path, count: int) -> Problem:
    names = "abcdefg"[:count]
    units = ", ".join(f"{name}: rad" for name in names)
    links = ", ".join(f"{{parent: base, child: p_{name}, coordinate: {name}}}" for name in ("h", *names))
    hinge = "{kind: revolute, position: [0, 0, 0], axis: [0, 0, 1], center: [0, 0, 0]}"
    joints = ", ".join([f"p_h: {SLIDE}", *(f"p_{name}: {hinge}" for name in names)])
    model = (
        f"format: micah-plan/model/1\ncoordinates: {{h: m, {units}}}\ninputs: {{h: m, t: rad, grip: m}}\n"
        f"links: [{links}]\n"
        f"noise: {{process_std: {{h: 0.002, {', '.join(f'{n}: 0.001' for n in names)}}},"
        f" observation_std: {{h: 0.005, {', '.join(f'{n}: 0.01' for n in names)}}}}}\n"
        f"modes:\n  free: {{joints: &j {{{joints}}}, step: {{h: input h}}, invariant: [h >= -0.1, h <= 1.1]}}\n"
        + "".join(f"  on_{n}: {{joints: *j, step: {{{n}: input t}}, invariant: [{n} >= 0, {n} <= 1]}}\n" for n in names)
        + "transitions:\n"
    )
    for name, at in zip(names, np.linspace(0.0, 1.0, count), strict=True):
        guard = f"input grip > 0.005, h >= {at - 0.04:.3f}, h <= {at + 0.04:.3f}"
        model += f"  - {{source: free, target: on_{name}, guard: [{guard}]}}\n"
        model += f"  - {{source: on_{name}, target: free, guard: [input grip < -0.005]}}\n"
    zeros, stds = ", ".join(f"{n}: 0" for n in names), ", ".join(f"{n}: 0.01" for n in names)
    target = ", ".join(f"{n}: {{value: 0.8, tolerance: 0.05}}" for n in names)
    (folder / "model.yaml").write_text(model)
    (folder / "problem.yaml").write_text(
        f"format: micah-plan/problem/1\nmodel: model.yaml\n"
        f"start: {{mean: {{h: 0.25, {zeros}}}, std: {{h: 0.01, {stds}}}, mode: free}}\n"
        f"goal: {{target: {{{target}}}, modes: [free]}}\n"
        f"planner: {{max_step: {{h: 0.1, t: 0.2, grip: 0.01}}, revisits: {count}, max_knots: 160}}\n"
    )
    return load_problem(folder / "problem.yaml")


@pytest.mark.slow
def test_one_hand_opens_five_lids_within_the_programmes_that_a_search_has(tmp_path) -> None:
    answer = solve(_lids(tmp_path, LIDS), advise=False)
    assert answer.outcome == "solved", answer.reason
    assert {mode for mode in answer.mode_sequence if mode != "free"} == {f"on_{name}" for name in "abcde"}
