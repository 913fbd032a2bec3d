"""Cuts: states excluded from the next search as if a body stood there.

A search finds the shortest path through each sequence of modes. Where the belief is too wide for a narrow place on it,
or an arm cannot take the hand there, that place is cut out, and the search finds the next path, around it. All paths
compete: a detour is taken where it costs less than the expected failures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.memo import sharing_motion
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.solve import BeliefPath
from micah_plan.task.problem import Problem
from micah_plan.task.start import is_final

Cut = tuple[str | None, Region]
"""The mode in which states are cut out, None: all modes that do not end everything; and the states."""


def with_cuts_as_bodies(problem: Problem, cuts: Sequence[Cut]) -> Problem:
    """The problem with a body in the place of each cut; its first edges are those of the original."""
    automaton = problem.automaton
    modes = automaton.modes
    if COLLIDED not in automaton.mode_names:
        modes = (*modes, Mode(COLLIDED, modes[0].joints, tuple((0.0,) * automaton.m for _ in range(automaton.n))))
    moving = [mode.name for mode in automaton.modes if not is_final(automaton, mode)]
    edges = [Edge(name, COLLIDED, cut) for name in moving for where, cut in cuts if where is None or where == name]
    changed = replace(automaton, modes=modes, edges=(*automaton.edges, *edges))
    return replace(problem, automaton=sharing_motion(changed, automaton))


def half_space(automaton_sizes: tuple[int, int], a: Floats, least: float, name: str) -> HalfSpace:
    """a'x >= least over n states and m inputs, where a may cover only the first states."""
    n, m = automaton_sizes
    weights = np.zeros(n)
    weights[: len(a)] = a
    return HalfSpace(tuple(weights.tolist()), (0.0,) * m, float(least), name=name)


def tight_places(problem: Problem, limits: Limits, path: BeliefPath, size_of_state: int) -> list[Cut]:
    """Regions, each with its mode, in which a path is closer to an obstacle than the planned confidence allows.

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


def with_enlarged_obstacles(problem: Problem) -> Problem:
    """The problem with obstacles enlarged on all sides by the space that a belief needs, for another search.

    A shortest path touches faces and corners as if the state were known. Guards to final modes are enlarged by k stds
    of a converged belief, but not so far that the start lies inside.
    """
    automaton, start = problem.automaton, np.array(problem.start.mean)[None]
    traps = {mode.name for mode in automaton.modes if is_final(automaton, mode)}
    if problem.goal.modes:
        traps -= set(problem.goal.modes)
    reach = problem.settings.sigmas * np.sqrt(2.0) * _steady_state_std(automaton)
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


def _steady_state_std(automaton: HybridAutomaton) -> Floats:
    """(n,) steady-state std of each coordinate under its Kalman filter."""
    process, observed = (
        np.array(stds, dtype=float) for stds in (automaton.noise.process_std, _measurement_std(automaton))
    )
    return np.asarray(np.sqrt(0.5 * process * (process + np.sqrt(process**2 + 4.0 * observed**2))))


def _measurement_std(automaton: HybridAutomaton) -> Floats:
    """(n,) std of a measurement; 0 where not measured, since a margin cannot help there."""
    stds = np.array(automaton.noise.observation_std, dtype=float)
    return np.where(np.isfinite(stds), stds, 0.0)
