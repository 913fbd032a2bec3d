"""Collision avoidance for objects without a robot: their parts keep clear of the bodies of the scene.

For a part that only slides, independently of the other parts, the states in which its bounding box meets the box around
a body are an intersection of half-spaces, like any guard: p(c) = p₀ + J c is affine, and two boxes along the axes of
one of them meet where they overlap along each of these. So search, programme and roll-outs treat a body like a guard to
a final mode. Parts that rotate are not kept clear of anything here; `unchecked_parts_warning` names them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.kinematics import poses_of_states
from micah_plan.automaton.region import Region
from micah_plan.planning import messages
from micah_plan.planning.cuts import Cut, half_space, with_cuts_as_bodies
from micah_plan.task.body import Body, Shape, corners, transform
from micah_plan.task.problem import Problem
from micah_plan.task.start import is_final

# As near as this at the start, a part touches a body: they are joined, or it rests on it, and the two may meet [m].
_TOUCHING = 1e-3


def with_scene(problem: Problem) -> Problem:
    """The problem with the bodies of its scene as guards; unchanged if a hand holds the object.

    There, contacts define what may be touched (`automaton.contacts`).
    """
    if not problem.scene or problem.hold is not None:
        return problem
    cuts = [cut for mode in _moving(problem.automaton) for cut in _collision_cuts(problem, mode)]
    bare = replace(problem, scene=())
    return with_cuts_as_bodies(bare, cuts) if cuts else bare


def unchecked_parts_warning(problem: Problem) -> tuple[str, ...]:
    """A warning on rotating parts, for which plans do not avoid the scene."""
    if not problem.scene or problem.hold is not None or problem.robot is not None:
        return ()
    cuts = {
        name
        for mode in _moving(problem.automaton)
        for name, (_, slides) in _parts(problem.automaton, mode).items()
        if slides is None
    }
    if not cuts:
        return ()
    return (messages.rotating_parts_unchecked(sorted(cuts)),)


def slides_of(automaton: HybridAutomaton, mode: str) -> dict[str, Floats]:
    """(3, n) Jacobian of each part that only slides in a mode, by name."""
    n = automaton.n
    poses = poses_of_states(automaton, automaton.mode(mode), np.vstack([np.zeros(n), np.eye(n)]))
    return {name: _slides(pose) for name, pose in poses.items() if not _turns(pose)}


def _slides(poses: RigidTransform) -> Floats:
    """(3, n) translation per coordinate, from poses at 0 and at each unit vector."""
    return np.asarray((poses.translation[1:] - poses.translation[0]).T)


def _turns(poses: RigidTransform) -> bool:
    return bool((poses[0].rotation.inv() * poses.rotation).magnitude().max() > ROUND_OFF)


def _moving(automaton: HybridAutomaton) -> list[Mode]:
    return [mode for mode in automaton.modes if not is_final(automaton, mode)]


def _parts(automaton: HybridAutomaton, mode: Mode) -> dict[str, tuple[Floats, Floats | None]]:
    """Corners (k, 3) at x = 0 in the base frame and J (3, n) of each part with shapes; J is None for rotating ones."""
    n, bounds = automaton.n, dict[str, tuple[Floats, Floats | None]]()
    poses = poses_of_states(automaton, mode, np.vstack([np.zeros(n), np.eye(n)]))
    for part in automaton.parts:
        if not part.shapes or part.name not in poses:
            continue
        pose = poses[part.name]
        points = np.concatenate([pose[0].apply(corners(shape)) for shape in part.shapes])
        bounds[part.name] = points, None if _turns(pose) else _slides(pose)
    return bounds


def _collision_cuts(problem: Problem, mode: Mode) -> Iterator[Cut]:
    """The regions of a mode in which a part overlaps a body, except for overlaps at the start."""
    start = np.array(problem.start.mean)[: problem.automaton.n]
    for name, (points, slides) in _parts(problem.automaton, mode).items():
        if slides is None or not slides.any():
            continue
        for body in problem.scene:
            for shape in body.shapes:
                rows = _overlap(points, slides, _box(body, shape))
                if rows is None or all(a @ start > least - _TOUCHING for a, least in rows if a.any()):
                    continue
                sizes, text = (problem.automaton.n, problem.automaton.m), f"{name} at {body.name}"
                yield mode.name, Region(tuple(half_space(sizes, a, least, text) for a, least in rows))


def _overlap(points: Floats, slides: Floats, box: tuple[Floats, Floats, Floats]) -> list[tuple[Floats, float]] | None:
    """Half-spaces a'x >= c of the states in which a part's box overlaps another; None if there are none.

    Args:
        points: (k, 3) corners of the part at x = 0 [m]; slides: (3, n).
        box: axes (3, 3), as rows, and the extent (3,), (3,) along them [m].
    """
    axes, low, high = box
    along = points @ axes.T
    rows = []
    for axis, least, most, nearest, farthest in zip(axes, along.min(axis=0), along.max(axis=0), low, high, strict=True):
        a = axis @ slides
        if np.abs(a).max() <= ROUND_OFF:
            if most <= nearest or least >= farthest:
                return None
            continue
        rows += [(a, float(nearest - most)), (-a, float(least - farthest))]
    return rows


def _box(body: Body, shape: Shape) -> tuple[Floats, Floats, Floats]:
    """Axes (3, 3), as rows, and extent (3,), (3,) along them, of the box around a shape of a body."""
    axes = (body.pose * transform(shape.position, shape.quaternion)).rotation.as_matrix().T
    along = body.pose.apply(corners(shape)) @ axes.T
    return axes, along.min(axis=0), along.max(axis=0)
