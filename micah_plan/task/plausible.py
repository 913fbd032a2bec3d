"""Plausibility of usable problems, scenes and experiments: nothing is refused, each suspicion is one line.

Every number is compared with the scale that the rest of the file gives it (`automaton.plausible`). A tolerance, a
spread or a step that is wider than the range of a coordinate is meaningless: every place is in the goal, and nothing is
known of any. For a coordinate without an end, the hand's reach or many of the planner's largest steps are used as its
range.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from micah_plan.automaton.hybrid import Primitive
from micah_plan.automaton.plausible import (
    FARTHEST_SOLID_M,
    Amount,
    implausible,
    length,
    part_amounts,
    solid_amounts,
    whole_range,
)
from micah_plan.quantities import FARTHEST_M
from micah_plan.task.body import Body, volume
from micah_plan.task.experiment import Experiment
from micah_plan.task.exploration_scene import Scene
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Hold, Problem, Release

_MOST_STEPS = 10_000
"""Of a plan: more than a planner is ever given, and hours of a control loop."""
_MANY_STEPS = 1000
"""As far as a coordinate without an end is looked at."""
_DENSEST, _LIGHTEST = 25_000.0, 1.0
"""Osmium and air [kg/m^3]."""
_WHOLE_TURN = 2.0 * math.pi


def suspicions_of_problem(problem: Problem) -> tuple[str, ...]:
    """Suspicious values of a problem without its model, one line each, with their keys."""
    amounts = [*_along_coordinates(problem), *_places(problem), *_of_scene(problem.scene)]
    amounts += [] if problem.hold is None else _of_hold(problem.hold)
    amounts += [] if problem.release is None else _of_release(problem.release)
    return tuple(implausible(amounts))


def suspicions_of_plan(plan: Plan, problem: Problem) -> tuple[str, ...]:
    """Suspicious belief and feedback of a plan, one line each, with key and worst knot."""
    if plan.trajectory is None:
        return ()
    coordinates = problem.automaton.coordinates
    stds = np.linalg.norm(plan.trajectory.factors, axis=2)
    # What one std of the belief corrects, all coordinates together.
    corrections = np.linalg.norm(plan.trajectory.gains @ plan.trajectory.factors[:-1], axis=2)
    # Memories of effects come behind the coordinates and the inputs that the problem names.
    places = {name.name: i for i, name in enumerate(coordinates)}
    of_inputs = [(k, places[name.name]) for k, name in enumerate(problem.automaton.inputs) if name.name in places]
    worst = [("factors", i, stds[:, i]) for i in range(len(coordinates))]
    worst += [("gains", i, corrections[:, k]) for k, i in of_inputs]
    amounts = []
    for key, i, sizes in worst:
        if len(sizes):
            place, scale = f"trajectory.{key}.{int(np.argmax(sizes))}", _scale(problem, i)
            amounts.append(Amount(f"{place}: {coordinates[i].name}", float(sizes.max()), coordinates[i].unit, *scale))
    return tuple(implausible(amounts))


def suspicions_of_scene(scene: Scene) -> tuple[str, ...]:
    """Suspicious values of an exploration scene, one line each, with their keys."""
    lengths = {"largest_step": scene.largest_step, "opening": scene.opening}
    return tuple(implausible(Amount(key, length, "m", FARTHEST_M) for key, length in lengths.items()))


def suspicions_of_experiment(experiment: Experiment) -> tuple[str, ...]:
    """Suspicious starts of an experiment, one line each, with their keys."""
    automaton = experiment.automaton
    return tuple(
        implausible(
            Amount(f"motions.{k}.start.std.{coordinate.name}", motion.start.std[i], coordinate.unit, whole, than)
            for i, coordinate in enumerate(automaton.coordinates)
            for whole, than in [(whole_range(automaton, i), f"the whole range of {coordinate.name}")]
            for k, motion in enumerate(experiment.motions)
        )
    )


def _along_coordinates(problem: Problem) -> Iterator[Amount]:
    """Start, goal, noise and steps of each coordinate, compared with its range."""
    automaton, start = problem.automaton, problem.start
    targets = {index: (value, tolerance) for index, value, tolerance in problem.goal.target}
    true = dict(start.true)
    steps = _steps(problem)
    for i, coordinate in enumerate(automaton.coordinates):
        name, unit, step = coordinate.name, coordinate.unit, steps.get(coordinate.name, 0.0)
        value, tolerance = targets.get(i, (start.mean[i], 0.0))
        whole, than = _scale(problem, i)
        sizes = {
            "goal.target": tolerance,
            "start.std": start.std[i],
            "start.true": true.get(i, start.mean[i]) - start.mean[i],
            "noise.observation_std": automaton.noise.observation_std[i],
            "noise.process_std": automaton.noise.process_std[i],
            "planner.max_step": step,
        }
        for key, size in sizes.items():
            yield Amount(f"{key}.{name}", size, unit, whole, than)
        place = f"goal.target.{name}: the way from the start"
        yield Amount(place, value - start.mean[i], unit, step * _MOST_STEPS, f"{_MOST_STEPS:,} steps of max_step")


def _scale(problem: Problem, i: int) -> tuple[float, str]:
    """(range of a coordinate [rad or m], its name)."""
    name, whole = problem.automaton.coordinates[i].name, whole_range(problem.automaton, i)
    if math.isfinite(whole):
        return whole, f"the whole range of {name}"
    hold = problem.hold
    if hold is not None and name in ("x", "y", "z"):
        axis = "xyz".index(name)
        return hold.upper[axis] - hold.lower[axis], f"the whole reach of the hand along {name}"
    if hold is not None and name == hold.grip.coordinate:
        return hold.grip.travel, f"the whole travel of {name}"
    return _MANY_STEPS * _steps(problem).get(name, 0.0), f"{_MANY_STEPS:,} steps of max_step"


def _steps(problem: Problem) -> dict[str, float]:
    """The largest step of each input coordinate stated by the problem [rad or m], by name."""
    return dict(
        zip((coordinate.name for coordinate in problem.automaton.inputs), problem.settings.max_step or (), strict=False)
    )


def _places(problem: Problem) -> Iterator[Amount]:
    places = {} if problem.robot is None else {"robot.position": problem.robot.position}
    places |= {} if problem.grasp is None else {"grasp.position": problem.grasp.position}
    for key, place in places.items():
        yield Amount(key, length(place), "m", FARTHEST_M)


def _of_scene(bodies: Sequence[Body]) -> Iterator[Amount]:
    for body in bodies:
        key = f"scene.{body.name}"
        yield Amount(f"{key}.position", length(body.position), "m", FARTHEST_SOLID_M)
        yield from solid_amounts(key, [shape for shape in body.shapes if isinstance(shape, Primitive)])
        if body.mass is not None:
            size = sum(map(volume, body.shapes))
            dense, light = _DENSEST * size, _LIGHTEST * size
            yield Amount(f"{key}.mass", body.mass, "kg", dense, "the densest metal of its size weighs", light)


def _of_hold(hold: Hold) -> Iterator[Amount]:
    yield from part_amounts((hold.grip.held, hold.grip.moving))
    for key, place in {"point": hold.grip.point, "reach.lower": hold.lower, "reach.upper": hold.upper}.items():
        yield Amount(f"hold.{key}", length(place), "m", FARTHEST_M)
    yield Amount("hold.rotation", length(hold.grip.rotation), "rad", _WHOLE_TURN, "a whole turn")


def _of_release(release: Release) -> Iterator[Amount]:
    lengths = {name: getattr(release, name) for name in ("support_std", "step", "shift_std", "withdraw")}
    for key, size in lengths.items():
        yield Amount(f"release.{key}", size, "m", 1.0, "a hand can feel or move away")
    for joint, position in release.fingers:  # only its file shows whether it slides or rotates
        yield Amount(f"release.fingers.{joint}", position, "", _WHOLE_TURN, "any joint of a gripper opens")
