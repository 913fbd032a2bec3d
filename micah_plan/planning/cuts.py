"""States that plans are to keep out of: cut out of a problem as if a body stood there, for the next search.

A search finds the shortest path through each sequence of modes. Where the belief is too wide for a narrow place on it,
or an arm cannot take the hand there, that place is cut out, and a search finds the next path, around it. All paths
compete: a detour is taken where it costs less than what may fail.

**Scenes.** What stands around an object that nobody's hand carries: its parts keep clear of the bodies of the scene.

Of a part that only slides, whatever the others do, the states in which the box around it meets the box around a body
are an intersection of half-spaces, like any guard: p(c) = p₀ + J c is affine, and two boxes along the axes of one of
them meet where they overlap along each of these. So search, programme and roll-outs see a body as they see a guard
that ends everything. Parts that turn are not kept clear of anything here; `unchecked` names them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.kinematics import poses_of_states
from micah_plan.automaton.memo import sharing_motion
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.solve import BeliefPath
from micah_plan.task.body import Body, Shape, corners, transform
from micah_plan.task.problem import Problem
from micah_plan.task.start import is_final

Cut = tuple[str | None, Region]
"""The mode in which states are cut out, None: all modes that do not end everything; and the states."""


def without(problem: Problem, cuts: Sequence[Cut]) -> Problem:
    """The problem with a body wherever a state is cut out. Its first transitions are those of the problem."""
    automaton = problem.automaton
    modes = automaton.modes
    if COLLIDED not in automaton.mode_names:
        modes = (*modes, Mode(COLLIDED, modes[0].joints, tuple((0.0,) * automaton.m for _ in range(automaton.n))))
    moving = [mode.name for mode in automaton.modes if not is_final(automaton, mode)]
    edges = [Edge(name, COLLIDED, cut) for name in moving for where, cut in cuts if where is None or where == name]
    changed = replace(automaton, modes=modes, edges=(*automaton.edges, *edges))
    return replace(problem, automaton=sharing_motion(changed, automaton))


def half_space(automaton_sizes: tuple[int, int], a: Floats, least: float, name: str) -> HalfSpace:
    """a'x >= least over n states and m inputs, of which a may name the first ones only."""
    n, m = automaton_sizes
    weights = np.zeros(n)
    weights[: len(a)] = a
    return HalfSpace(tuple(weights.tolist()), (0.0,) * m, float(least), name=name)


def tight_places(problem: Problem, limits: Limits, path: BeliefPath, size_of_state: int) -> list[Cut]:
    """Where a path keeps clear of what it must not enter with less than the planned confidence, each with its mode.

    A step to either side, and as wide as the corridor there. None where the path begins or ends: no other path could
    keep clear of that.
    """
    sizes, cuts = (problem.automaton.n, problem.automaton.m), list[Cut]()
    for shortfall in path.in_part:
        row = shortfall.row
        if row.kind != "boundary" or row.sign > 0 or row.half_space is None:
            continue
        x, normal = path.means[row.knot][:size_of_state], np.abs(np.array(row.half_space.a))[:size_of_state]
        # Only what is too narrow for the belief is cut out from side to side.
        narrow = 2.0 * problem.settings.sigmas * (shortfall.std or 0.0)
        width = max(shortfall.width or 0.0, 0.0) if (shortfall.width or 0.0) < narrow else 0.0
        width /= float(np.linalg.norm(normal))
        reach = np.maximum(limits.speed, width * normal / float(np.linalg.norm(normal)))
        sides = [(i, sign) for i in np.flatnonzero(problem.automaton.mode(row.mode).driven) for sign in (1.0, -1.0)]
        rows = [
            half_space(sizes, sign * np.eye(len(x))[i], float(sign * x[i] - reach[i]), f"too narrow: {row.name}")
            for i, sign in sides
        ]
        region = Region(tuple(rows))
        ends = path.means[[0, -1], :size_of_state]
        if rows and not region.contains(ends, np.zeros((2, problem.automaton.m))).any():
            cuts.append((row.mode, region))
    return cuts


def with_room(problem: Problem) -> Problem:
    """The problem with what must not be entered larger on all sides by what a belief needs, for one more search.

    A shortest path goes along faces and around corners as if the state were known. What ends everything is enlarged by
    k stds of a belief that has settled, but not so far that the start lies in it.
    """
    automaton, start = problem.automaton, np.array(problem.start.mean)[None]
    traps = {mode.name for mode in automaton.modes if is_final(automaton, mode)}
    if problem.goal.modes:
        traps -= set(problem.goal.modes)
    reach = problem.settings.sigmas * np.sqrt(2.0) * _settled(automaton)
    nothing = np.zeros((1, automaton.m))

    def wider(edge: Edge) -> Edge:
        guard = edge.guard
        if edge.target not in traps or guard.on_input or not guard.half_spaces:
            return edge
        rows = tuple(replace(h, c=h.c - float(np.linalg.norm(np.array(h.a) * reach))) for h in guard.half_spaces)
        larger = Region(rows)
        return edge if larger.contains(start, nothing).any() else replace(edge, guard=larger)

    changed = replace(automaton, edges=tuple(map(wider, automaton.edges)))
    return replace(problem, automaton=sharing_motion(changed, automaton))


def _settled(automaton: HybridAutomaton) -> Floats:
    """(n,) std of a coordinate that is moved and measured for long: the steady state of its Kalman filter."""
    process, observed = (np.array(stds, dtype=float) for stds in (automaton.noise.process_std, _seen(automaton)))
    return np.asarray(np.sqrt(0.5 * process * (process + np.sqrt(process**2 + 4.0 * observed**2))))


def _seen(automaton: HybridAutomaton) -> Floats:
    """(n,) std of a measurement; 0 for what is not measured: no room helps there."""
    stds = np.array(automaton.noise.observation_std, dtype=float)
    return np.where(np.isfinite(stds), stds, 0.0)


# As near as this at the start, a part touches a body: they are joined, or it rests on it, and the two may meet [m].
_TOUCHING = 1e-3


def with_scene(problem: Problem) -> Problem:
    """The problem with the bodies of its scene as guards, and without the scene; itself where a hand holds the object.

    There contacts say what may be touched (`automaton.contacts`).
    """
    if not problem.scene or problem.hold is not None:
        return problem
    cuts = [cut for mode in _moving(problem.automaton) for cut in _cuts(problem, mode)]
    bare = replace(problem, scene=())
    return without(bare, cuts) if cuts else bare


def unchecked(problem: Problem) -> tuple[str, ...]:
    """A line on the parts that turn, which plans do not keep clear of the scene; an arm that carries them does."""
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
    turning = ", ".join(map(repr, sorted(cuts)))
    return (f"what turns is not kept clear of the scene: {turning}; look at the page",)


def slides_of(automaton: HybridAutomaton, mode: str) -> dict[str, Floats]:
    """(3, n) how each part that only slides in a mode moves with the state, by name."""
    n = automaton.n
    poses = poses_of_states(automaton, automaton.mode(mode), np.vstack([np.zeros(n), np.eye(n)]))
    return {name: _slides(pose) for name, pose in poses.items() if not _turns(pose)}


def _slides(poses: RigidTransform) -> Floats:
    return np.asarray((poses.translation[1:] - poses.translation[0]).T)


def _turns(poses: RigidTransform) -> bool:
    return bool((poses[0].rotation.inv() * poses.rotation).magnitude().max() > ROUND_OFF)


def _moving(automaton: HybridAutomaton) -> list[Mode]:
    return [mode for mode in automaton.modes if not is_final(automaton, mode)]


def _parts(automaton: HybridAutomaton, mode: Mode) -> dict[str, tuple[Floats, Floats | None]]:
    """Of each part with shapes: corners (k, 3) at x = 0 in the base frame, and J (3, n); None if it turns."""
    n, bounds = automaton.n, dict[str, tuple[Floats, Floats | None]]()
    poses = poses_of_states(automaton, mode, np.vstack([np.zeros(n), np.eye(n)]))
    for part in automaton.parts:
        if not part.shapes or part.name not in poses:
            continue
        pose = poses[part.name]
        points = np.concatenate([pose[0].apply(corners(shape)) for shape in part.shapes])
        bounds[part.name] = points, None if _turns(pose) else _slides(pose)
    return bounds


def _cuts(problem: Problem, mode: Mode) -> Iterator[Cut]:
    """The states of a mode in which a part meets a body, except for those that meet at the start."""
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
    """Half-spaces a'x >= c of the states in which a part's box meets another; None where it never does.

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
