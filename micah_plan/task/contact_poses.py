"""Settled poses: poses of the parts at a belief's mean under contact.

A belief's mean may lie where no object can be: while contact of the lower arm is uncertain, the mean of the joint is
that of the free one although the hand is low; while latching is uncertain, the mean closes further than the latch. For
drawing and for an arm's clearances the hand's place counts, and the rest follows from contact: the joint from the
hand's height above the face, flat parts flat, a resting latched object rotated in the hand. Only where the joint is
closed does the object stop the hand.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.values import HINGE, Face, Grip
from micah_plan.automaton.hybrid import HybridAutomaton, Tie
from micah_plan.automaton.kinematics import part_poses
from micah_plan.task.body import corners
from micah_plan.task.problem import Problem
from micah_plan.task.surroundings import faces_of

Pair = tuple[str, str]

_MOST_TURN = 0.6
_TOUCHING = 0.004
_ANGLES = 1201


def settled_poses(problem: Problem, mode: str, x: Floats) -> dict[str, RigidTransform]:
    """Pose of every linked part in the base frame at the state x (n,), by name; without `hold` by the mode's joints."""
    automaton, hold = problem.automaton, problem.hold
    if hold is None:
        return part_poses(automaton, automaton.mode(mode), x)
    mode, x = _followed(automaton, mode, x)
    poses = part_poses(automaton, automaton.mode(mode), x)
    if hold.grip.pivots and automaton.mode(mode).pins:
        for face in faces_of(problem.scene, hold.contacts):
            poses = _rested(poses, hold.grip, face)
    return poses


def touching_pairs(problem: Problem, poses: dict[str, RigidTransform]) -> frozenset[Pair]:
    """(part, body) of the faces that the moving part touches, as the contacts of the problem intend it."""
    if problem.hold is None:
        return frozenset()
    grip, faces = problem.hold.grip, faces_of(problem.scene, problem.hold.contacts)
    part = grip.moving.name
    near = {face.solid for face in faces if _gap(poses, grip, face) < _TOUCHING}
    return frozenset((part, solid) for solid in near)


def _followed(automaton: HybridAutomaton, mode: str, x: Floats) -> tuple[str, Floats]:
    """(mode, state) of an object that is not latched, with ties applied where it touches."""
    if automaton.mode(mode).pins:
        return mode, x
    mode_reached, followed = mode, x
    for contact in automaton.modes:  # line before surface: pressing passes from one to the other
        for tie in contact.ties:
            low, high = contact.invariant.interval(tie.coordinate)
            closes = _closing(automaton, contact.name, tie)
            begin, end = (low, high) if closes > 0 else (high, low)
            asked, at = float(tie.value(x)), float(x[tie.coordinate])
            touches = bool(automaton.mode(mode).ties) or (at - end) * closes < 0 < (asked - at) * closes
            if touches and (asked - begin) * closes >= 0:
                mode_reached, followed = contact.name, x.copy()
                followed[tie.coordinate] = min(max(asked, low), high)
                # At the end of the last piece the object stops the hand.
                over, weights = followed[tie.coordinate] - asked, np.array(tie.weights)
                followed[: tie.coordinate] += (weights * over / float(weights @ weights))[: tie.coordinate]
    return mode_reached, followed


def _closing(automaton: HybridAutomaton, mode: str, tie: Tie) -> float:
    """+1 where the joint grows in a contact mode as its hand presses on, -1 where it falls."""
    rows = [h for edge in automaton.edges_from(mode) for h in edge.guard.half_spaces if h.on_input]  # withdrawing
    return -float(np.sign(sum(float(np.dot(tie.weights[: len(h.b)], h.b)) for h in rows)))


def _rested(poses: dict[str, RigidTransform], grip: Grip, face: Face) -> dict[str, RigidTransform]:
    """The object rotated in the hand about the hinge's direction, as far as needed to leave the face."""
    if _gap(poses, grip, face) >= 0:
        return poses
    hand = poses[grip.held.name].apply(grip.point)
    axis = poses[grip.held.name].rotation.apply(HINGE)
    angles = np.linspace(-_MOST_TURN, _MOST_TURN, _ANGLES)
    turned = Rotation.from_rotvec(angles[:, None] * axis).as_matrix() @ (_corners(poses, grip) - hand).T
    gaps = (face.sign * (turned[:, face.axis] + hand[face.axis] - face.position)).min(axis=1)
    free = angles[gaps >= 0]
    best = free[np.argmin(np.abs(free))] if free.size else angles[np.argmax(gaps)]
    turn = Rotation.from_rotvec(best * axis)
    about = RigidTransform.from_components(hand - turn.apply(hand), turn)
    return {**poses, **{name: about * poses[name] for name in (grip.held.name, grip.moving.name)}}


def _gap(poses: dict[str, RigidTransform], grip: Grip, face: Face) -> float:
    """Distance of the moving part from the plane of a face [m]; negative: below it."""
    return float((face.sign * (_corners(poses, grip)[:, face.axis] - face.position)).min())


def _corners(poses: dict[str, RigidTransform], grip: Grip) -> Floats:
    """(k, 3) corners of the moving part in the base frame [m]."""
    return np.asarray(poses[grip.moving.name].apply(np.concatenate([corners(shape) for shape in grip.moving.shapes])))
