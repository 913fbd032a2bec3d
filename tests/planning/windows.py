"""A point that goes through plates with a window each, at alternating sides, all of it turned."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from scipy.linalg import expm
from scipy.sparse.csgraph import connected_components

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import HalfSpace, Region, box
from micah_plan.planning.limits import limits_of
from micah_plan.planning.search.leaves import leaves_of
from micah_plan.planning.search.polytope import mode_states
from micah_plan.planning.search.roadmap import motions_of, obstacles_on_state, roadmap_of
from micah_plan.planning.search.samples import inside_any, sample_modes
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

ROOM, THICKNESS, ASIDE, TURN = 0.5, 0.08, 0.2, 0.35


def corridor(n: int, plates: int, width: float) -> Problem:
    """A way through plates with windows, from one side of a room to the other."""
    turn = _turn(n)
    moves = tuple(tuple(float(i == j) for j in range(n)) for i in range(n))
    names, still = [f"x{i}" for i in range(n)], Joint("rigid", (0.0, 0.0, 0.0))
    free = Mode("free", (still,), moves, box([-ROOM] * n, [ROOM] * n, n, names))
    stuck = Mode("stuck", (still,), ((0.0,) * n,) * n, Region())
    begin, edges = -0.3, []
    for k in range(plates):
        centre = np.array([(ASIDE if (k + i) % 2 else -ASIDE) + 0.03 * k for i in range(n - 1)])
        edges += [Edge("free", "stuck", Region(rows)) for rows in _plate(turn, begin, centre, width)]
        begin += THICKNESS + width
    coordinates = tuple(Coordinate(name, "m") for name in names)
    noise = Noise((0.001,) * n, (0.005,) * n)
    links = (Link("base", "point", 0),)
    automaton = HybridAutomaton(coordinates, coordinates, links, (Part("point"),), (free, stuck), tuple(edges), noise)
    start, goal = (turn @ np.array([end, *[side] * (n - 1)]) for end, side in ((-0.4, -0.1), (0.42, 0.1)))
    target = tuple((i, float(value), 0.02) for i, value in enumerate(goal))
    settings = PlannerSettings(max_step=(0.05,) * n)
    return Problem(automaton, Start(tuple(map(float, start)), (0.001,) * n), Goal(target, ("free",)), settings)


def _turn(n: int) -> Floats:
    """(n, n) a rotation by TURN about no axis of the room."""
    square = np.random.default_rng(1).normal(size=(n, n))
    skew = square - square.T
    return np.asarray(expm(TURN * skew / np.linalg.norm(skew, 2)))


def _plate(turn: Floats, begin: float, centre: Floats, width: float) -> list[tuple[HalfSpace, ...]]:
    """The convex pieces of a plate around a square window."""
    n = len(turn)

    def half_space(axis: int, sign: float, c: float) -> HalfSpace:
        return HalfSpace(tuple(map(float, sign * turn[:, axis])), (0.0,) * n, sign * c, name="plate")

    kept = [half_space(0, 1.0, begin), half_space(0, -1.0, begin + THICKNESS)]
    pieces = []
    for axis, middle in enumerate(centre.tolist(), start=1):
        low, high = middle - width / 2, middle + width / 2
        pieces += [(*kept, half_space(axis, -1.0, low)), (*kept, half_space(axis, 1.0, high))]
        kept += [half_space(axis, 1.0, low), half_space(axis, -1.0, high)]
    return pieces


def joined(problem: Problem, samples: int, seeds: int) -> Counter[str]:
    """How often the planner's states on faces of plates join start and goal, and how often as many uniform ones do."""
    problem = replace(problem, settings=replace(problem.settings, samples_per_mode=samples))
    limits, found = limits_of(problem), Counter[str]()
    motion, leaves = motions_of(problem, limits)["free"], leaves_of(problem.automaton.mode("free"), limits)
    ends = np.array([problem.start.mean, [value for _, value, _ in problem.goal.target]])
    for seed in range(seeds):
        faces = sample_modes(problem, limits, "free", np.random.default_rng(seed)).points["free"]
        rng, states = np.random.default_rng(seed), mode_states(problem.automaton.mode("free"), limits)
        uniform = states.sample(rng, 4 * len(faces))
        uniform = uniform[~inside_any(obstacles_on_state(problem.automaton, "free"), uniform)][: len(faces)]
        for kind, points in (("uniform", uniform), ("faces", faces)):
            parts = connected_components(roadmap_of(np.vstack([ends, points]), leaves, motion))[1]
            found[kind] += int(parts[0] == parts[1])
    return found
