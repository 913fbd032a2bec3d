"""Which random states lead a roadmap through narrow corridors between bodies: uniform ones, bridges, or on the faces.

    python -m benchmarks corridors [--seeds 6] [--samples 16 32 64 128]

A point in two or three dimensions goes through plates with a window each, at alternating sides, all of it turned; to
touch a plate is a mode change, as the collisions of held objects are. `faces` is what the planner does: its states of
the mode, those on the faces of guards among them. The others get as many states: uniform outside of the plates, or half
of them by the bridge test (Hsu et al., ICRA 2003): free middles between two states inside of plates. Counted is how
often the planner's roadmap over them joins start and goal.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.sparse.csgraph import connected_components

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

Floats = NDArray[np.float64]

# (dimensions, plates, width of the windows and distance of the plates [m])
SCENES = ((2, 2, 0.03), (2, 2, 0.01), (2, 4, 0.01), (3, 1, 0.05), (3, 2, 0.03), (3, 4, 0.03))
ROOM, THICKNESS, ASIDE, TURN = 0.5, 0.08, 0.2, 0.35
# Bridges are as long as these powers of ten times the room's width, and so many are tried for each state wanted.
LENGTHS, TRIED = (-3.0, -0.5), 200


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


def counts(problem: Problem, samples: int, seeds: int) -> tuple[int, Counter[str]]:
    """How many states the planner's roadmap has, and how often as many of each kind join start and goal."""
    problem = replace(problem, settings=replace(problem.settings, samples_per_mode=samples))
    limits, found = limits_of(problem), Counter[str]()
    motion, leaves = motions_of(problem, limits)["free"], leaves_of(problem.automaton.mode("free"), limits)
    for seed in range(seeds):
        faces = sample_modes(problem, limits, "free", np.random.default_rng(seed)).points["free"]
        rng, states = np.random.default_rng(seed), mode_states(problem.automaton.mode("free"), limits)
        ends = np.array([problem.start.mean, [value for _, value, _ in problem.goal.target]])
        uniform = states.sample(rng, 4 * len(faces))
        uniform = uniform[~inside_any(obstacles_on_state(problem.automaton, "free"), uniform)][: len(faces)]
        bridges = bridge_states(problem, rng, len(faces) // 2)
        mixed = np.vstack([bridges, uniform[len(bridges) :]])
        for kind, points in (("uniform", uniform), ("bridges", mixed), ("faces", faces)):
            parts = connected_components(roadmap_of(np.vstack([ends, points]), leaves, motion))[1]
            found[kind] += int(parts[0] == parts[1])
    return len(faces), found


def bridge_states(problem: Problem, rng: np.random.Generator, count: int) -> Floats:
    """(at most count, n) free middles of bridges between two states inside of plates or out of the room."""
    plates, n = obstacles_on_state(problem.automaton, "free"), problem.automaton.n
    ends = rng.uniform(-ROOM, ROOM, (TRIED * count, n))
    ends = ends[inside_any(plates, ends)]
    others = ends + 2 * ROOM * 10.0 ** rng.uniform(*LENGTHS, (len(ends), 1)) * rng.standard_normal(ends.shape)
    middles = (ends + others) / 2
    blocked = inside_any(plates, others) | (np.abs(others) > ROOM).any(axis=1)
    free = ~inside_any(plates, middles) & (np.abs(middles) <= ROOM).all(axis=1)
    return np.asarray(middles[blocked & free][:count])


def main() -> None:
    parser = argparse.ArgumentParser(description="States that lead through narrow corridors.")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--samples", type=int, nargs="*", default=[16, 32, 64, 128], help="samples_per_mode")
    options = parser.parse_args()
    print(f"{'scene':36} {'samples_per_mode':>16} {'states':>6} {'uniform':>8} {'bridges':>8} {'faces':>6}")
    for n, plates, width in SCENES:
        for samples in options.samples:
            states, found = counts(corridor(n, plates, width), samples, options.seeds)
            scene = f"{n} dimensions, {plates} plates, {1e3 * width:.0f} mm"
            columns = " ".join(f"{found[kind]:{size}}" for kind, size in (("uniform", 8), ("bridges", 8), ("faces", 6)))
            print(f"{scene:36} {samples:16} {states:6} {columns}", flush=True)


if __name__ == "__main__":
    main()
