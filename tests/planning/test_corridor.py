"""A narrow corridor with bends, where uniform states do not fall: those on the faces of guards line it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning_examples import planar_problem, with_settings
from scipy.sparse.csgraph import connected_components
from windows import corridor, joined

from micah_plan.automaton.hybrid import Edge
from micah_plan.automaton.region import HalfSpace, Region, box
from micah_plan.planning.limits import limits_of
from micah_plan.planning.search.leaves import leaves_of
from micah_plan.planning.search.mode_search import search_modes
from micah_plan.planning.search.polytope import mode_states
from micah_plan.planning.search.roadmap import motions_of, roadmap_of
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

WIDTH, LENGTH, RISE = 0.03, 0.1, 0.12
MIDDLE, TURN = np.array([-0.5, 0.1]), 0.3
ALONG = np.array([np.cos(TURN), np.sin(TURN)])
ACROSS = np.array([-ALONG[1], ALONG[0]])


def half_space(a: np.ndarray, c: float, name: str) -> HalfSpace:
    return HalfSpace((float(a[0]), float(a[1])), (0.0, 0.0), float(c), name=name)


def zigzag(segments: int = 3) -> Problem:
    """A wall between start and gate with a slit of many bends; touching the wall loses the point."""
    problem = planar_problem(trap=False)
    at, blocks = MIDDLE - ALONG * LENGTH * segments / 2, []
    for k in range(segments):
        to = at + ALONG * LENGTH + ACROSS * RISE * (1 if k % 2 else -1)
        n = np.array([at[1] - to[1], to[0] - at[0]]) / np.linalg.norm(to - at)
        band = half_space(ALONG, ALONG @ at, "begins"), half_space(-ALONG, -ALONG @ to, "ends")
        for side in (1.0, -1.0):
            wall = half_space(side * n, side * float(n @ at) + WIDTH / 2, "wall")
            blocks.append(Edge("left", "lost", Region((*band, wall))))
        at = to
    automaton = replace(problem.automaton, edges=(*problem.automaton.edges, *blocks))
    start = Start((-0.95, -0.2), (0.001, 0.001), "left")
    return replace(problem, automaton=automaton, start=start)


def is_connected(problem: Problem, points: np.ndarray) -> bool:
    """Whether a roadmap over the start, a state behind the wall and these points joins the two."""
    limits = limits_of(problem)
    ends = np.array([[-0.95, -0.2], [-0.05, 0.6]])
    motion = motions_of(problem, limits)["left"]
    graph = roadmap_of(np.vstack([ends, points]), leaves_of(problem.automaton.mode("left"), limits), motion)
    labels = connected_components(graph)[1]
    return bool(labels[0] == labels[1])


def test_uniform_states_do_not_connect_it() -> None:
    problem, limits = zigzag(), limits_of(zigzag())
    states = mode_states(problem.automaton.mode("left"), limits)
    drawn = [states.sample(np.random.default_rng(seed), 200) for seed in range(8)]
    assert sum(is_connected(problem, points) for points in drawn) <= 2


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(4))
def test_the_search_goes_through_the_bends_on_half_as_many(seed: int) -> None:
    problem = with_settings(zigzag(), samples_per_mode=100)
    (first, *_) = search_modes(problem, limits_of(problem), "left", seed).sequences
    assert first.modes == ("left", "right")
    path = first.waypoints[0]
    inside = np.abs((path - MIDDLE) @ ALONG) < 1.5 * LENGTH
    assert inside.sum() >= 2


def test_faces_lead_through_windows_of_bodies_where_uniform_states_do_not() -> None:
    windows = corridor(3, 2, 0.03)
    free, stuck = windows.automaton.modes
    nowhere = replace(stuck, invariant=box([5.0] * 3, [6.0] * 3, 3, ["x0", "x1", "x2"]))
    leads_nowhere = replace(windows, automaton=replace(windows.automaton, modes=(free, nowhere)))
    for problem in (windows, leads_nowhere):
        assert joined(problem, samples=32, seeds=3) == {"faces": 3, "uniform": 0}
