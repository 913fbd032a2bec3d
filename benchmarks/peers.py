"""Boxes in the way, beside the planners that people know: CPU, length, and success under the same noise.

    OMP_NUM_THREADS=1 python -m benchmarks peers [--seeds K] [--executions N]

A point moves between boxes that it must not touch, in two and three dimensions. Every peer gets the same boxes, grown
by three stds of what its own tracking leaves (`margin`), and its path is executed like ours, in the model's own step
and noise: a Kalman filter, and inputs towards the next point of the path, cut at the largest step.

- RRT-Connect of OMPL, shortened by its `PathSimplifier`.
- GCS of Drake (Marcucci, Petersen, von Wrangel and Tedrake, "Motion planning around obstacles with convex
  optimization", Science Robotics 2023), where `pydrake` is installed: regions are the free boxes between the faces of
  obstacles; shortest path by Clarabel, the best of ten roundings.
- The programme that a person writes with CasADi who has a path already (RRT-Connect's): smallest inputs, each box is
  passed on the side where the path passes it.

They know that the world is boxes and that nothing happens but touching. Ours is told a hybrid automaton, says what
success it expects, and pays for that in its seconds (`verify`: share of them spent on roll-outs).
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import process_time

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests" / "planning")]

import test_executed_inputs as people  # noqa: E402
import test_fields_of_boxes as fields  # noqa: E402

from micah_plan.automaton.drawn_thresholds import threshold_stds  # noqa: E402
from micah_plan.automaton.transition import TransitionBatch  # noqa: E402
from micah_plan.execution.trials import run_trials  # noqa: E402
from micah_plan.planning.solver import solve  # noqa: E402
from micah_plan.task.problem import Problem  # noqa: E402

Floats = NDArray[np.float64]
_RRT_SECONDS = 60.0
# Steps after which a filter's variance is what it stays.
_STEADY = 500
# Points at which a segment of a path is checked, per unit of length.
_RESOLUTION = 0.002


@dataclass(frozen=True)
class Scene:
    """A problem in a unit square or cube, with its (N, 2, d) boxes: lowest and highest corners [m]."""

    problem: Problem
    boxes: Floats

    @property
    def start(self) -> Floats:
        return np.array(self.problem.start.mean)

    @property
    def goal(self) -> Floats:
        return np.array([value for _, value, _ in self.problem.goal.target])

    @property
    def largest(self) -> Floats:
        return np.array(self.problem.settings.max_step)

    def grown(self) -> Floats:
        """(N, 2, d) boxes with the margin around them, but for the start and the goal."""
        by = margin(self.problem)
        grown = self.boxes + np.array([-by, by])
        for end in (self.start, self.goal):
            inside = ((grown[:, 0] < end) & (end < grown[:, 1])).all(axis=1)
            grown[inside] = self.boxes[inside]
        return grown


def scene_of(problem: Problem) -> Scene:
    """The boxes are the guards into the mode in which all has ended; what a guard leaves open ends with the world."""
    boxes = []
    for edge in problem.automaton.edges:
        box = np.repeat([[0.0], [1.0]], problem.automaton.n, axis=1)
        for half in edge.guard.half_spaces:
            (axis,) = np.flatnonzero(half.a)
            box[int(half.a[axis] < 0), axis] = half.c / half.a[axis]
        boxes.append(box)
    return Scene(problem, np.array(boxes))


def _variances(problem: Problem) -> tuple[Floats, Floats, Floats]:
    """(d,) of the start, of a step's noise and of a measurement."""
    noise = problem.automaton.noise
    start, process, seen = (np.array(std) ** 2 for std in (problem.start.std, noise.process_std, noise.observation_std))
    return start, process, seen


def margin(problem: Problem) -> Floats:
    """(d,) three stds of where a tracked point is: of the estimate after many steps, and of what the last one adds."""
    variance, process, seen = _variances(problem)
    for _ in range(_STEADY):
        variance = 1.0 / (1.0 / (variance + process) + 1.0 / seen)
    return np.asarray(3.0 * np.sqrt(variance + process))


def by_rrt_connect(scene: Scene, seed: int) -> Floats | None:
    """(K, d) corners of a path, shortened."""
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(seed + 1)
    boxes, d = scene.grown(), len(scene.start)
    space = ob.RealVectorStateSpace(d)
    bounds = ob.RealVectorBounds(d)
    bounds.setLow(0.0)
    bounds.setHigh(1.0)
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)

    def is_free(state: ob.State) -> bool:
        x = np.array([state[i] for i in range(d)])
        return not ((boxes[:, 0] < x) & (x < boxes[:, 1])).all(axis=1).any()

    setup.setStateValidityChecker(is_free)
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(_RESOLUTION)
    states = []
    for point in (scene.start, scene.goal):
        state = space.allocState()
        for i, value in enumerate(point):
            state[i] = float(value)
        states.append(state)
    setup.setStartAndGoalStates(*states)
    setup.setPlanner(og.RRTConnect(information))
    setup.solve(_RRT_SECONDS)
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution()
    path = setup.getSolutionPath()
    return np.array([[path.getState(k)[i] for i in range(d)] for k in range(path.getStateCount())])


def free_boxes(boxes: Floats) -> list[tuple[Floats, Floats]]:
    """Boxes that what is free divides into: cells between the faces of obstacles, joined with the free ones beside.

    Boxes that overlap as far as they can are fewer, but the graph of them takes GCS several times as long.
    """
    d = boxes.shape[2]
    edges = [np.unique(np.clip([0.0, 1.0, *boxes[:, :, i].ravel()], 0.0, 1.0)) for i in range(d)]
    middles = np.stack(np.meshgrid(*(0.5 * (e[1:] + e[:-1]) for e in edges), indexing="ij"), axis=-1)
    taken = np.zeros(middles.shape[:-1], dtype=bool)
    for low, high in boxes:
        taken |= ((middles > low) & (middles < high)).all(axis=-1)
    found = list[tuple[Floats, Floats]]()
    while not taken.all():
        low = np.array(np.unravel_index(int(np.argmin(taken)), taken.shape))
        high = low + 1
        for i in range(d):
            while high[i] < taken.shape[i]:
                beside = (slice(high[i], high[i] + 1) if j == i else slice(low[j], high[j]) for j in range(d))
                if taken[tuple(beside)].any():
                    break
                high[i] += 1
        taken[tuple(map(slice, low, high))] = True
        ends = [np.array([edges[i][side[i]] for i in range(d)]) for side in (low, high)]
        found.append((ends[0], ends[1]))
    return found


def by_gcs(scene: Scene, seed: int) -> Floats | None:
    """(K, d) points of the shortest path through a graph of convex sets."""
    logging.getLogger("drake").setLevel(logging.WARNING)
    from pydrake.geometry.optimization import GraphOfConvexSetsOptions, HPolyhedron, Point
    from pydrake.planning import GcsTrajectoryOptimization

    d = len(scene.start)
    gcs = GcsTrajectoryOptimization(d)
    regions = [HPolyhedron.MakeBox(low, high) for low, high in free_boxes(scene.grown())]
    main = gcs.AddRegions(regions, order=1)
    start, goal = (gcs.AddRegions([Point(point)], order=0) for point in (scene.start, scene.goal))
    gcs.AddEdges(start, main)
    gcs.AddEdges(main, goal)
    gcs.AddPathLengthCost()
    options = GraphOfConvexSetsOptions()
    options.convex_relaxation, options.max_rounded_paths, options.rounding_seed = True, 10, seed
    trajectory, result = gcs.SolvePath(start, goal, options)
    if not result.is_success():
        return None
    ends = [trajectory.segment(k) for k in range(trajectory.get_number_of_segments())]
    return np.array([*(piece.value(piece.start_time())[:, 0] for piece in ends), scene.goal])


def by_programme(scene: Scene, path: Floats) -> Floats | None:
    """(K, d) points with the smallest inputs, past each box on the side where a path passes it."""
    way, boxes = in_steps(path, scene.largest), scene.grown()
    opti = ca.Opti()
    x = opti.variable(len(scene.start), len(way))
    opti.set_initial(x, way.T)
    opti.subject_to(x[:, 0] == scene.start)
    opti.subject_to(x[:, -1] == scene.goal)
    u = x[:, 1:] - x[:, :-1]
    opti.subject_to(opti.bounded(-np.tile(scene.largest[:, None], len(way) - 1), u, scene.largest[:, None]))
    opti.minimize(ca.sumsqr(u))
    outside = np.concatenate([boxes[:, None, 0] - way[None], way[None] - boxes[:, None, 1]], axis=2)
    near = np.argwhere((outside < 2.0 * scene.largest.max()).all(axis=2))
    d = len(scene.start)
    for box, k in near:
        # Between two points, both are outside by the same face.
        ends = [k, k + 1] if k + 1 < len(way) else [k]
        face = int(np.argmax(np.min([outside[box, e] for e in ends], axis=0)))
        for end in ends:
            if face < d:
                opti.subject_to(x[face, end] <= boxes[box, 0, face])
            else:
                opti.subject_to(x[face - d, end] >= boxes[box, 1, face - d])
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"})
    try:
        return np.array(opti.solve().value(x)).T
    except RuntimeError:
        return None


def in_steps(path: Floats, largest: Floats) -> Floats:
    """(K, d) a path in steps of nine tenths of the largest: the rest corrects."""
    points = [path[0]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.max(np.abs(b - a) / (0.9 * largest)))))
        points += [a + (k + 1) / count * (b - a) for k in range(count)]
    return np.array(points)


def tracked(problem: Problem, way: Floats, trials: int, seed: int) -> float:
    """The share of trials in which a filter that goes from point to point ends in the goal."""
    automaton, rng = problem.automaton, np.random.default_rng(seed)
    variance, process, seen = _variances(problem)
    objects = TransitionBatch(automaton, np.zeros((trials, threshold_stds(automaton).size)))
    modes = np.full(trials, automaton.mode_index(problem.start.mode or automaton.mode_names[0]))
    estimate = np.tile(problem.start.mean, (trials, 1))
    x = estimate + np.array(problem.start.std) * rng.standard_normal(estimate.shape)
    largest = np.array(problem.settings.max_step)
    for target in [*way[1:], *[way[-1]] * 3]:
        u = np.clip(target - estimate, -largest, largest)
        modes, x = objects.step(modes, x, u, np.sqrt(process) * rng.standard_normal(x.shape))
        gain = (variance + process) / (variance + process + seen)
        variance = gain * seen
        estimate = estimate + u
        estimate += gain * (x + np.sqrt(seen) * rng.standard_normal(x.shape) - estimate)
    admitted = problem.goal.admitted(automaton.mode_names)[modes]
    return float((admitted & problem.goal.holds(x)).mean())


def length(path: Floats) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


Peer = Callable[[Scene, int], Floats | None]


def _peers() -> dict[str, Peer]:
    def programme(scene: Scene, seed: int) -> Floats | None:
        path = by_rrt_connect(scene, seed)
        return None if path is None else by_programme(scene, path)

    found: dict[str, Peer] = {"RRT-Connect": by_rrt_connect, "CasADi from it": programme}
    try:
        import pydrake.planning  # noqa: F401
    except ImportError:
        print("pydrake is not installed: without GCS")
        return found
    return {"GCS": by_gcs, **found}


WALL = np.array([[[0.45, 0.0], [0.5, 0.58]], [[0.45, 0.62], [0.5, 1.0]]])
OPEN = np.array([[[0.45, 0.0], [0.5, 0.4]]])


def _scenes(folder: Path, count: int) -> dict[str, list[Scene]]:
    def plane(boxes: Floats) -> Scene:
        return scene_of(fields._field(folder, np.stack([boxes[:, :, 0], boxes[:, :, 1]], axis=1).reshape(-1, 4)))

    scenes = {"one wall": [plane(OPEN)] * count, "gap of 40 mm": [plane(WALL)] * count}
    scenes["two plates, 3-D"] = [scene_of(people._problem(folder, people.PLATES))] * count
    for boxes in (16, 64):
        drawn = (fields._boxes(boxes, seed) for seed in range(8 * count))
        having = [own for own in drawn if fields._has_way(own, fields.SURE)][:count]
        scenes[f"{boxes} boxes"] = [scene_of(fields._field(folder, own)) for own in having]
    return scenes


@dataclass
class _Row:
    solved: int = 0
    seconds: float = 0.0
    verify: float = 0.0
    length: float = 0.0
    steps: float = 0.0
    share: float = 0.0

    def text(self, scene: str, who: str, count: int) -> str:
        n = max(self.solved, 1)
        verify = f"{self.verify / max(self.seconds, 1e-9):8.0%}" if self.verify else " " * 8
        return (
            f"{scene:<17}{who:<16}{self.solved:>3} of {count:<4}{self.seconds / count:>9.2f}{verify}"
            f"{self.length / n:>8.2f}{self.steps / n:>7.0f}{self.share / n:>10.3f}"
        )


def ours(scenes: list[Scene], executions: int) -> _Row:
    row = _Row()
    for seed, scene in enumerate(scenes):
        begin = process_time()
        plan = solve(scene.problem, seed=seed, advise=False)
        row.seconds += process_time() - begin
        if plan.outcome == "solved" and plan.trajectory is not None:
            row.solved += 1
            row.verify += plan.timings.get("verify", 0.0)
            row.length += length(np.array(plan.trajectory.means))
            row.steps += len(plan.trajectory.inputs)
            row.share += run_trials(scene.problem, plan, trials=executions, seed=7).successes / executions
    return row


def theirs(peer: Peer, scenes: list[Scene], executions: int) -> _Row:
    row = _Row()
    for seed, scene in enumerate(scenes):
        begin = process_time()
        path = peer(scene, seed)
        row.seconds += process_time() - begin
        if path is not None:
            way = in_steps(path, scene.largest)
            row.solved += 1
            row.length += length(path)
            row.steps += len(way) - 1
            row.share += tracked(scene.problem, way, executions, seed)
    return row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--executions", type=int, default=200)
    asked = parser.parse_args()
    peers = _peers()
    print(
        f"{'scene':<17}{'planner':<16}{'found':>10}{'seconds':>9}{'verify':>8}{'length':>8}{'steps':>7}{'success':>10}"
    )
    with tempfile.TemporaryDirectory() as folder:
        for name, scenes in _scenes(Path(folder), asked.seeds).items():
            print(ours(scenes, asked.executions).text(name, "micah_plan", len(scenes)), flush=True)
            for who, peer in peers.items():
                print(theirs(peer, scenes, asked.executions).text("", who, len(scenes)), flush=True)


if __name__ == "__main__":
    main()
