"""Stops against drift, which are part of the step that a plan is based on.

A latch with a return spring rests on its stop when nobody turns it. The flow of its mode alone would take it further
with every step, and no input could hold it, so the plan would be infeasible. So the mean of a coordinate that drifts
beyond a stop is kept at it, smoothly, since an optimiser needs a slope. The information from the stop is left to the
filter: the covariance is that of the flow.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from micah_plan.automaton.effects.motion import displaced
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.memo import memoised
from micah_plan.symbolic.compiled import compiled_mode

# How far from a stop its hold begins, as a share of a step's drift.
_SOFT = 0.02


class Stop(NamedTuple):
    """An end that a coordinate drifts against.

    Attributes:
        coordinate, value: which, and where [rad or m].
        drift: of a step without input, at the stop [rad or m]; negative at a lower end.
    """

    coordinate: int
    value: float
    drift: float


def stops_of(automaton: HybridAutomaton, mode: str) -> tuple[Stop, ...]:
    """The ends of a mode that a step without input exceeds and a self-transition restores."""
    found, own = dict[tuple[int, float], Stop](), automaton.mode(mode)
    for edge in automaton.edges_from(mode):
        if (end := _end(automaton, edge)) is None:
            continue
        coordinate, value, is_upper = end
        at = np.zeros((1, automaton.n))
        at[0, coordinate] = value
        drift = float(displaced(automaton, own, at, np.zeros((1, automaton.m)))[0][0, coordinate])
        if drift > 0.0 if is_upper else drift < 0.0:
            found[coordinate, value] = Stop(coordinate, value, drift)
    return tuple(found.values())


def _end(automaton: HybridAutomaton, edge: Edge) -> tuple[int, float, bool] | None:
    """(coordinate, value, is upper) of an end to which a self-transition resets the state; None for other edges."""
    rows = edge.guard.half_spaces
    if not edge.is_self_transition or len(rows) != 1 or (bound := rows[0].bound) is None:
        return None
    A, B, c = edge.reset.matrices(automaton.n, automaton.m)
    i, others = bound.coordinate, np.arange(automaton.n) != bound.coordinate
    is_put = not A[i].any() and not B.any() and c[i] == bound.value
    is_alone = np.array_equal(A[others], np.eye(automaton.n)[others]) and not c[others].any()
    return (i, bound.value, bound.is_lower) if is_put and is_alone else None


@memoised
def planned_step(automaton: HybridAutomaton, mode: str) -> ca.Function:
    """(mean, factor, u) -> (mean, factor): `CompiledMode.belief_step` with the stops of the mode."""
    step, stops = compiled_mode(automaton, mode).belief_step, stops_of(automaton, mode)
    if not stops:
        return step
    n = automaton.n
    mean, u = ca.SX.sym("x", n), ca.SX.sym("u", automaton.m)
    factor = ca.SX.sym("L", ca.Sparsity.lower(n))
    after, spread = step.call([mean, factor, u])
    for stop in stops:
        beyond = after[stop.coordinate] - stop.value
        kept = 0.5 * ca.sqrt(beyond**2 + (_SOFT * stop.drift) ** 2)
        after[stop.coordinate] = stop.value + 0.5 * beyond + (kept if stop.drift < 0.0 else -kept)
    return ca.Function("planned_step", [mean, factor, u], [after, spread])
