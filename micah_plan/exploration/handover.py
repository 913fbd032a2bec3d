"""Conversion of an explored chain of joints to a hybrid automaton for planning.

Segments of the path become local models along one coordinate, as those of a demonstration do. A latch is a rigid model
where the handle was found, left by a pull. Dry friction is a dead zone of the commands: a hand that is a spring loses
the same amount of each.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan import __version__
from micah_plan.arrays import Floats
from micah_plan.automaton.build import SMALLEST_STD, build_automaton
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Part, Primitive
from micah_plan.automaton.joint import Joint, ParameterCovariance, axis_basis, prismatic, revolute, rigid
from micah_plan.automaton.kinematics import shifted
from micah_plan.exploration import messages
from micah_plan.exploration.chain import Chain
from micah_plan.exploration.explorer import Explorer

HANDLE = "handle"
_ORIGIN = ("rotation_1", "rotation_2", "rotation_3", "position_1", "position_2", "position_3")
_KNOB = Primitive("sphere", (0.015,), color="#e6b450")
_LATCHED = 2.5  # times the friction that held it in motion


def explored_model(explorer: Explorer, chain: Chain) -> HybridAutomaton:
    """The automaton of a chain of joints with its uncertainties."""
    ends = np.append(chain.begin, chain.way.max())
    ends[0] = min(0.0, chain.way.min())
    rates = [float(np.linalg.norm(rate)) or 1.0 for rate in chain.rate]
    starts = np.concatenate([[ends[0] * rates[0]], ends[0] * rates[0] + np.cumsum(np.diff(ends) * rates)])
    friction, spread = _friction(explorer, chain)
    compliance, count = explorer.record.hand.compliance, len(chain.way)
    process, segments = compliance * spread, []
    latch = _latch(explorer, chain)
    moves = int(np.argmax(chain.way > ends[0] + 0.005))
    latched = latch > _LATCHED * friction and starts[0] > -0.01
    if latched:
        turn = Rotation.from_matrix(chain.turn).as_quat()
        held = replace(rigid(chain.place, turn), covariance=_rigid_joint(chain))
        segments.append(_segment(held, chain, (0, moves), (0.0, 0.0), rates[0], process))
    rows = [moves, *(int(np.argmax(chain.way >= begin)) for begin in chain.begin[1:]), count - 1]
    for number, (first, last) in enumerate(pairwise(rows)):
        low, high = float(starts[number]), float(starts[number + 1])
        begin = 0.0 if number == 0 else low
        joint = shifted(_joint(chain, number), -begin)
        segments.append(_segment(joint, chain, (first, max(last, first)), (low, high), rates[number], process))
    graph = KinematicGraph((KinematicEdge(BASE, HANDLE, tuple(segments)),))
    provenance = {"method": "explore", "micah_plan": __version__, "hand_stiffness": f"{1.0 / compliance:.4g} N/m"}
    provenance |= {"friction": f"{friction:.2g} N", "latch": f"{latch:.3g} N"} if latch > 0 else {}
    automaton = build_automaton(
        graph,
        parts=(Part(HANDLE, (_KNOB,), (0.0, 0.0, 0.0)),),
        release=0.7 * compliance * latch * rates[0] if latched else 0.0,
        provenance=provenance,
    )
    automaton = replace(automaton, edges=tuple(_with_threshold_std(edge, chain.place_std) for edge in automaton.edges))
    width = compliance * friction * rates[0]
    lost = Effect("dead_zone", HANDLE, (("width", width), ("lost", 1.0)), (compliance * spread * rates[0], 0.1))
    return with_effect(automaton, replace(lost, note=messages.DRY_FRICTION))


def _with_threshold_std(edge: Edge, place_std: float) -> Edge:
    """An edge between two joints with the std of its threshold."""
    if edge.is_self_transition or not any(half.on_state for half in edge.guard.half_spaces):
        return edge
    return replace(edge, threshold_std=place_std)


def _segment(
    joint: Joint, chain: Chain, rows: tuple[int, int], reach: tuple[float, float], rate: float, process: float
) -> Segment:
    place_std = chain.place_std if rate == 1.0 else 1.0 / np.hypot(1.0 / (chain.place_std * rate), 1.0 / chain.turn_std)
    return Segment(
        joint=joint,
        run=0,
        start=rows[0],
        end=rows[1],
        configuration_start=reach[0],
        configuration_end=reach[1],
        configuration_range=reach,
        process_std=max(process * rate, SMALLEST_STD),
        observation_std=max(float(place_std), SMALLEST_STD),
        log_evidence=0.0,
        probability=1.0,
    )


def _friction(explorer: Explorer, chain: Chain) -> tuple[float, float]:
    """Mean and std of the friction against the handle's motion [N]."""
    tangents = chain.poses(chain.way)[2]
    moved = np.flatnonzero(np.diff(chain.way) > 0.004)
    held = np.einsum("ij,ij->i", np.array(explorer.record.forces)[moved], tangents[moved + 1])
    if not len(held):
        return explorer.friction, explorer.friction
    return max(float(np.median(held)), 0.0), float(np.std(held)) + 0.1


def _latch(explorer: Explorer, chain: Chain) -> float:
    """The largest pull along the path that did not move the handle from its first position [N]."""
    along = chain.direction[0]
    still = np.flatnonzero(np.abs(chain.way[1:]) < 0.003)
    still = still[still < int(np.argmax(chain.way > 0.005))]
    pulls = np.array(explorer.record.forces)[still] @ along if len(still) else np.zeros(1)
    return max(float(pulls.max()), 0.0)


def _axis_centre_pose(chain: Chain, number: int) -> Floats:
    """(axis, centre and position (..., 9), orientation (..., 9)) of a joint of the chain at its start."""
    direction, rate, begin = (a[..., number, :] for a in (chain.direction, chain.rate, chain.begin[..., None]))
    places, turns, _ = chain.poses(begin)
    place, turn = places[..., 0, :], turns[..., 0, :, :]
    size = np.linalg.norm(rate, axis=-1, keepdims=True)
    axis, centre = direction, np.zeros_like(place)
    if chain.hinges[number]:
        axis, centre = rate / size, place + np.cross(rate, direction) / size**2
    return np.concatenate([axis, centre, place, turn.reshape(*place.shape[:-1], 9)], axis=-1)


def _joint(chain: Chain, number: int) -> Joint:
    """A joint of the chain, counted from its beginning, with the covariance of its parameters."""
    here = _axis_centre_pose(chain, number)
    axis, centre, place, turn = here[:3], here[3:6], here[6:9], here[9:].reshape(3, 3)
    quaternion, turns = Rotation.from_matrix(turn).as_quat(), chain.hinges[number]
    joint = revolute(axis, centre, place, quaternion) if turns else prismatic(axis, place, quaternion)
    basis, small = axis_basis(axis), 1e-6
    change = (_axis_centre_pose(chain.changed(small * chain.numbers()[0]), number) - here) / small
    rotated = change[:, 9:].reshape(-1, 3, 3) @ turn.T
    rotation = np.stack([rotated[:, 2, 1], rotated[:, 0, 2], rotated[:, 1, 0]], axis=1)
    # Tilts are rotations of the axis about the basis: d axis = tilt x axis.
    tilt, shift = np.cross(axis, change[:, :3]) @ basis.T, change[:, 3:6] @ basis.T
    slope = np.concatenate([tilt, *([shift] if turns else []), rotation, change[:, 6:9]], axis=1)
    matrix = slope.T @ chain.covariance @ slope
    names = ("axis_1", "axis_2", *(("center_1", "center_2") if turns else ()), *_ORIGIN)
    matrix = 0.5 * (matrix + matrix.T) + 1e-14 * np.eye(len(names))
    return replace(joint, covariance=ParameterCovariance(names, tuple(map(tuple, matrix.tolist()))))


def _rigid_joint(chain: Chain) -> ParameterCovariance:
    """The rigid joint at the pose where the handle was found."""
    place, turn = np.full(3, chain.place_std**2 / 4), np.full(3, chain.turn_std**2 / 4)
    matrix = np.diag(np.concatenate([turn, place]))
    return ParameterCovariance(_ORIGIN, tuple(map(tuple, matrix.tolist())))
