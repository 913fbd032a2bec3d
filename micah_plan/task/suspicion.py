"""What looks like a mistake in a problem that can be used. Nothing is refused: each suspicion is one line.

- **Wider than the world.** A tolerance, a spread of measurements or motion, or a step that is wider than all that a
  coordinate can do makes what it states empty: every place is in the goal, and nothing is known of any.
- **Millimetres.** A robot, a grasp or a tracker's error farther than `FARTHEST_M` was probably given in millimetres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from micah_plan.automaton.suspicion import FARTHEST_M
from micah_plan.quantities import quantity
from micah_plan.task.exploration import Scene
from micah_plan.task.problem import Problem


def suspicions(problem: Problem) -> tuple[str, ...]:
    """What looks wrong in a problem beside its model, one line each, with its key."""
    return (*_wide(problem), *_far(problem))


def _wide(problem: Problem) -> Iterator[str]:
    automaton, noise = problem.automaton, problem.automaton.noise
    tolerances = {index: tolerance for index, _, tolerance in problem.goal.target}
    for i, coordinate in enumerate(automaton.coordinates):
        ranges = automaton.ranges(i)
        width = ranges[-1][1] - ranges[0][0] if ranges else math.inf
        steps = problem.settings.max_step if automaton.m == automaton.n else None
        given = {
            "goal.target": tolerances.get(i, 0.0),
            "start.std": problem.start.std[i],
            "noise.observation_std": noise.observation_std[i],
            "noise.process_std": noise.process_std[i],
            "planner.max_step": 0.0 if steps is None else steps[i],
        }
        for key, size in given.items():
            if 0.0 < width < size:
                found, whole = quantity(size, coordinate.unit), quantity(width, coordinate.unit)
                yield f"{key}.{coordinate.name}: {found} is more than its whole range, {whole}; correct either"


def _far(problem: Problem) -> Iterator[str]:
    places = {} if problem.robot is None else {"robot.position": problem.robot.position}
    places |= {} if problem.grasp is None else {"grasp.position": problem.grasp.position}
    distances = {key: float(np.linalg.norm(place)) for key, place in places.items()}
    distances |= {f"plant.{key}": problem.plant.get(key, 0.0) for key in ("position_noise", "position_wander")}
    yield from _in_millimetres(distances)


def suspicions_of_scene(scene: Scene) -> tuple[str, ...]:
    """What looks wrong in what `explore` is given, one line each, with its key."""
    return tuple(_in_millimetres({"largest_step": scene.largest_step, "opening": scene.opening}))


def _in_millimetres(distances: Mapping[str, float]) -> Iterator[str]:
    for key, distance in distances.items():
        if distance > FARTHEST_M:
            yield f"{key}: {quantity(distance, 'm')}; lengths are in m: are these millimetres? then divide by 1000"
