"""What a page shows of an object that a hand holds: which points of it leave paths and carry the belief."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.scene.body import corners
from micah_plan.task.contact_poses import settled_poses
from micah_plan.task.problem import Problem
from micah_plan.view.motion import Keyframes, Moved
from micah_plan.view.scene import transforms


def settled_over_time(problem: Problem, keys: Keyframes) -> Moved:
    """(k,) poses of every part, as contacts leave them."""
    single = [settled_poses(problem, mode, x) for mode, x in zip(keys.modes, keys.states, strict=True)]
    return {name: transforms([poses[name] for poses in single]) for name in single[0]}


def with_shown_points(problem: Problem) -> Problem:
    """The problem with handles for a held object: the hand's point on the held part, the moving part's far end.

    The belief of the joint is seen at the far end, that of the hand at the hand. Other problems come back as they are.
    """
    if problem.hold is None:
        return problem
    grip = problem.hold.grip
    points = np.concatenate([corners(shape) for shape in grip.moving.shapes])
    lower, upper = points.min(axis=0), points.max(axis=0)
    end = (float(upper[0]), float(lower[1] + upper[1]) / 2, float(lower[2] + upper[2]) / 2)
    handles = {grip.held.name: grip.point, grip.moving.name: end}
    parts = tuple(replace(part, handle=handles.get(part.name, part.handle)) for part in problem.automaton.parts)
    return replace(problem, automaton=replace(problem.automaton, parts=parts))
