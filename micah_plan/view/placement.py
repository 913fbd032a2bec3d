"""Placement of an automaton's parts at a state, their paths and ranges, and the uncertainty of a belief."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import DIFFERENCE, Floats
from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward, poses_of_states

_RANGE_IF_UNSTATED = {"rad": 1.0, "m": 0.2}
CURVE_POINTS = 49
"""Points of an arc or a circle that is drawn."""


@dataclass(frozen=True)
class Threshold:
    """A configurational changepoint: the value of a coordinate at which the mode changes [rad or m]."""

    source: str
    target: str
    coordinate: int
    value: float


def handle_in_part(automaton: HybridAutomaton, part: str) -> Floats:
    """(3,) the point of a part whose motion is shown: its handle or else its origin [m, part frame]."""
    handle = automaton.part(part).handle
    return np.zeros(3) if handle is None else np.array(handle)


def handle_jacobian(automaton: HybridAutomaton, mode: Mode, x: Floats, part: str) -> Floats:
    """(3, n) derivative of the handle's position by the state, by central differences along the chain of links."""
    steps = DIFFERENCE * np.eye(automaton.n)
    states = np.concatenate([x + steps, x - steps])
    handles = poses_of_states(automaton, mode, states)[part].apply(handle_in_part(automaton, part))
    return np.asarray((handles[: automaton.n] - handles[automaton.n :]).T / (2 * DIFFERENCE))


def chain_coordinates(automaton: HybridAutomaton, part: str) -> tuple[int, ...]:
    """The coordinates on the chain of links from the base to a part."""
    by_child = {link.child: link for link in automaton.links}
    numbers: list[int] = []
    while part in by_child:
        numbers.append(by_child[part].coordinate)
        part = by_child[part].parent
    return tuple(sorted(set(numbers)))


def joint_curve(joint: Joint, lower: float, upper: float, point: Floats | None = None) -> Floats:
    """(k, 3) path of a point of the part [part frame, m; None: its origin] from one configuration to another.

    An arc for revolute, a helix for screw, a line for prismatic, one point for rigid.
    """
    count = CURVE_POINTS if joint.turns or joint.knots else 2 if joint.moves else 1
    poses = forward(joint, np.linspace(lower, upper, count))
    return np.asarray(poses.apply(np.zeros(3) if point is None else point))


def joint_axis(joint: Joint, length: float) -> Floats | None:
    """(2, 3) ends of a joint's axis for drawing, centred at the part's origin; None without an axis."""
    if not joint.has_axis:
        return None
    axis = np.array(joint.axis)
    middle = np.array(joint.position if joint.slides else joint.center)
    return np.stack([middle - axis * length / 2, middle + axis * length / 2])


def coordinate_range(automaton: HybridAutomaton, mode: Mode, coordinate: int) -> tuple[float, float, bool]:
    """Lower and upper end of a coordinate in a mode, and whether the automaton states both.

    Taken from the mode's invariant, then its clamps (self transitions), then its guards; a missing end is put 1 rad or
    0.2 m away from the other end, or from 0.
    """
    lower, upper = mode.invariant.interval(coordinate)
    for is_first in (True, False):
        for edge in automaton.edges_from(mode.name):
            if edge.is_self_transition == is_first:
                above, below = edge.guard.interval(coordinate)
                # A guard that holds above a value ends the mode there.
                upper = above if np.isinf(upper) and np.isfinite(above) else upper
                lower = below if np.isinf(lower) and np.isfinite(below) else lower
    stated = bool(np.isfinite(lower) and np.isfinite(upper))
    length = _RANGE_IF_UNSTATED.get(automaton.coordinates[coordinate].unit, 1.0)
    if np.isinf(lower):
        lower = upper - length if np.isfinite(upper) else min(0.0, -length / 2)
    if np.isinf(upper):
        upper = lower + length
    return float(lower), float(upper), stated


def representative_state(automaton: HybridAutomaton, mode: Mode) -> Floats:
    """(n,) a state inside the mode for drawing: pinned values, else the value closest to 0."""
    x = np.zeros(automaton.n)
    for i in range(automaton.n):
        lower, upper = mode.invariant.interval(i)
        x[i] = min(max(0.0, lower), upper)
    for pin in mode.pins:
        x[pin.coordinate] = pin.value
    return x


def thresholds(automaton: HybridAutomaton) -> tuple[Threshold, ...]:
    """The guards between different modes that are a limit on one coordinate; one per coordinate, value and modes."""
    thresholds: dict[tuple[int, float, frozenset[str]], Threshold] = {}
    for edge in automaton.edges:
        for half_space in edge.guard.half_spaces:
            limit = half_space.bound
            if limit is not None and not edge.is_self_transition:
                coordinate, value, _ = limit
                key = (coordinate, round(value, 9), frozenset((edge.source, edge.target)))
                thresholds.setdefault(key, Threshold(edge.source, edge.target, coordinate, value))
    return tuple(thresholds.values())


def guards_of(automaton: HybridAutomaton, coordinate: int) -> list[float]:
    """Thresholds on a single coordinate that change the mode."""
    return [mark.value for mark in thresholds(automaton) if mark.coordinate == coordinate and mark.target != COLLIDED]


def ellipsoid(covariance: Floats, factor: float, floor: float) -> tuple[Floats, Floats]:
    """Axes (3, 3, columns, right-handed) and radii (3,) of {p: p' C⁻¹ p <= factor²}, each radius at least `floor`."""
    values, axes = np.linalg.eigh(covariance)
    if np.linalg.det(axes) < 0:
        axes = axes * np.array([1.0, 1.0, -1.0])
    return axes, np.maximum(factor * np.sqrt(np.maximum(values, 0.0)), floor)
