"""Time as an input of the search: by waiting, a plan reaches any state along a drift.

A rising gate, a falling lid or a belt that carries a box moves without any input. In a search over inputs they would
stand still, and an obstacle would stay where it is. Here waiting is one more input, which moves them in one of its
steps as far as they drift in one time step, forwards only. It costs as much as other steps, but nothing during other
motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.automaton.hybrid import Coordinate, Edge
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.planning.limits import drift_of, drifts
from micah_plan.task.problem import Problem

_TIME = "passing time"  # no input of a model has a blank in its name


def with_passing_time(problem: Problem) -> Problem:
    """The problem with time as an additional input; unchanged if no coordinate drifts without an input."""
    if not drifts(problem):
        return problem
    automaton, start = problem.automaton, np.array(problem.start.mean)
    forwards = HalfSpace((0.0,) * automaton.n, (0.0,) * automaton.m + (1.0,), 0.0, name=f"input {_TIME} >= 0")
    modes = tuple(
        replace(
            mode,
            input_matrix=tuple(map(tuple, np.column_stack([mode.B, drift_of(automaton, mode, start)]).tolist())),
            invariant=_longer(mode.invariant),
            inputs=Region((*_longer(mode.inputs).half_spaces, forwards)),
        )
        for mode in automaton.modes
    )
    whole = replace(
        automaton,
        inputs=(*automaton.inputs, Coordinate(_TIME, "m")),
        modes=modes,
        edges=tuple(_edge(edge) for edge in automaton.edges),
        init=tuple((name, _longer(region)) for name, region in automaton.init),
    )
    settings = problem.settings
    if settings.max_step is not None:
        settings = replace(settings, max_step=(*settings.max_step, 1.0))
    return replace(problem, automaton=whole, settings=settings)


def _longer(region: Region) -> Region:
    return Region(tuple(replace(h, b=(*h.b, 0.0)) for h in region.half_spaces))


def _edge(edge: Edge) -> Edge:
    B = edge.reset.B
    reset = edge.reset if B is None else replace(edge.reset, B=tuple((*row, 0.0) for row in B))
    return replace(edge, guard=_longer(edge.guard), reset=reset)
