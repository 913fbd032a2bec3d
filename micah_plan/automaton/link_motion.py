"""How a link moves: along its joints, one after another over one configuration.

A drawer that swings when it is out has a slide up to one configuration and an arc from there on (MICAH, section IV-A:
the segments of an edge share one coordinate). The configuration of a pose or an action then depends on the joint that
the part is on. Between two changes it is a single joint, and so are most motions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import EQUAL, Floats, Ints
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import ROTATION_LENGTH, forward, inverse, inverse_jacobian, jacobian
from micah_plan.automaton.memo import memoised

_TURN = 2.0 * np.pi
# Of a turn: what a run may lie beyond its range by noise, or because the range is shorter than what the part can do.
_BESIDE = 0.25


@dataclass(frozen=True)
class LinkMotion:
    """Joints traversed in sequence.

    Attributes:
        joints: in order of configuration.
        ends: (low, high) of each [rad or m]; the first has no lower end and the last no upper end.
        range: (low, high) of the configuration in all modes [rad or m]; infinite without an end.
    """

    joints: tuple[Joint, ...]
    ends: tuple[tuple[float, float], ...]
    range: tuple[float, float]

    def number(self, c: Floats) -> Ints:
        """(k,) which joint governs the configurations c (k,)."""
        return np.searchsorted([high for _, high in self.ends[:-1]], c, side="right")

    def poses(self, c: Floats) -> RigidTransform:
        """(k,) poses at the configurations c (k,)."""
        if len(self.joints) == 1:
            return forward(self.joints[0], c)
        number, translation, turn = self.number(c), np.zeros((len(c), 3)), np.zeros((len(c), 4))
        for k, joint in enumerate(self.joints):
            governed = number == k
            if governed.any():
                pose = forward(joint, c[governed])
                translation[governed], turn[governed] = pose.translation, pose.rotation.as_quat()
        return RigidTransform.from_components(translation, Rotation.from_quat(turn))

    def tangents(self, c: Floats) -> Floats:
        """(k, 6) derivatives [rotation, translation of the part's origin] of the pose at c (k,), base frame."""
        every = np.stack([jacobian(joint, c) for joint in self.joints])
        return np.asarray(every[self.number(c), np.arange(len(c))])

    def configurations(self, position: Floats, rotation: Rotation | None, near: Floats | None = None) -> Floats:
        """(k,) configurations closest to the measured poses of one run: positions (k, 3) [m] and orientations.

        Args:
            near: (k,) known configurations to choose whole turns by; None: by the range and the rows before.
        """
        if len(self.joints) == 1:
            return self._turned(self.joints[0], position, rotation, near)
        tried, misses = [], []
        for joint, (low, high) in zip(self.joints, self.ends, strict=True):
            c = np.clip(self._along_joint(joint, low, high, position, rotation), low, high)
            pose = forward(joint, c)
            missed = ((pose.translation - position) ** 2).sum(axis=1)
            if rotation is not None:
                missed = missed + ROTATION_LENGTH**2 * 2.0 * (
                    1.0 - np.cos((pose.rotation.inv() * rotation).magnitude())
                )
            tried.append(c)
            misses.append(missed)
        return np.asarray(np.stack(tried)[np.argmin(misses, axis=0), np.arange(len(position))])

    def commanded(self, c: Floats, action: Floats) -> Floats:
        """Displacements (k,) from c (k,) that actions (k, 3) [m] of the part's origin stand for.

        Of a turning part an action may be a chord f(c + u) - f(c) as well as a tangent J u: whichever fits each one
        better. Over a large step the two differ: the tangent of an angle's chord is its sine. Next to where one joint
        ends and another begins, an action may be of either.
        """
        return self._each(c, action, _commanded)

    def aimed(self, c: Floats, action: Floats) -> Floats:
        """Displacements (k,) from c (k,) to the path points closest to the targets of actions (k, 3)."""
        return self._each(c, action, _aimed)

    def _each(self, c: Floats, action: Floats, meant: Callable[[Joint, Floats, Floats], Floats]) -> Floats:
        """(k,) changes of configuration for actions (k, 3) at configurations (k,), each by its own joint."""
        configuration = np.zeros(len(c))
        number = self.number(c)
        for k, joint in enumerate(self.joints):
            rows = number == k
            if rows.any():
                configuration[rows] = meant(joint, c[rows], action[rows])
        return configuration if len(self.joints) == 1 else self._or_on_next_joint(c, action, configuration, number)

    def _or_on_next_joint(self, c: Floats, action: Floats, nearest: Floats, number: Ints) -> Floats:
        """Displacements of actions that lead onto the next joint of a path, where that fits better."""
        target = self.poses(c).translation + action
        best, missed = nearest.copy(), np.full(len(c), np.inf)
        for k, joint in enumerate(self.joints):
            rows = number == k
            if rows.any():
                ahead = forward(joint, c[rows] + nearest[rows]).translation
                missed[rows] = np.linalg.norm(ahead - target[rows], axis=1)
        for k, (joint, (low, high)) in enumerate(zip(self.joints, self.ends, strict=True)):
            there = np.clip(self._along_joint(joint, low, high, target, None), low, high)
            away = np.linalg.norm(forward(joint, there).translation - target, axis=1)
            # Only a neighbour that the motion gets to: a small action does not leave its joint.
            better = (number != k) & np.isfinite(there) & (away < missed - EQUAL)
            best, missed = np.where(better, there - c, best), np.where(better, away, missed)
        return best

    def _turned(self, joint: Joint, position: Floats, rotation: Rotation | None, near: Floats | None) -> Floats:
        """Configurations of a run along a single joint.

        A pose of a hinge belongs to many configurations, whole turns apart. In a range shorter than a turn, one of them
        is in it or nearest to it; in a longer one each row continues from the row before, in the turn closest to the
        first pose's that keeps the run in the range.
        """
        low, high = self.range
        if joint.kind != "revolute" or near is not None or not len(position):
            return inverse(joint, position, rotation, near=near)
        if high - low < _TURN:
            return self._along_joint(joint, low, high, position, rotation)
        configuration = np.unwrap(inverse(joint, position, rotation))
        least, most = (low - configuration.min()) / _TURN - _BESIDE, (high - configuration.max()) / _TURN + _BESIDE
        turns = np.clip(0.0, np.ceil(least), np.floor(most)) if least <= most else np.round(0.5 * (least + most))
        return np.asarray(configuration + _TURN * turns)

    def _along_joint(
        self, joint: Joint, low: float, high: float, position: Floats, rotation: Rotation | None
    ) -> Floats:
        """Configurations along one joint, unwrapped around the middle of its range."""
        finite_ends = [end for end in (low, high) if np.isfinite(end)]
        return inverse(
            joint, position, rotation, near=float(np.mean(finite_ends)) if joint.kind == "revolute" else None
        )


@memoised
def link_motions(automaton: HybridAutomaton) -> tuple[LinkMotion, ...]:
    """The motion of each link along its joints."""
    return tuple(_motion(automaton, number) for number in range(len(automaton.links)))


def _motion(automaton: HybridAutomaton, number: int) -> LinkMotion:
    coordinate = automaton.links[number].coordinate
    ranges: dict[Joint, tuple[float, float]] = {}
    intervals = [mode.interval(coordinate) for mode in automaton.modes]
    whole = min(low for low, _ in intervals), max(high for _, high in intervals)
    for mode, (low, high) in zip(automaton.modes, intervals, strict=True):
        joint = mode.joints[number]
        if joint.moves:
            before = ranges.get(joint, (low, high))
            ranges[joint] = min(before[0], low), max(before[1], high)
    order = sorted(ranges.items(), key=lambda item: item[1])
    follow = all(a[1][1] <= b[1][0] + EQUAL for a, b in pairwise(order))
    if len(order) < 2 or not follow:
        # Modes with joints of their own over the same range do not follow each other: the first that moves measures.
        return LinkMotion((automaton.moving_joint(number),), ((-np.inf, np.inf),), whole)
    ends = [-np.inf, *(0.5 * (a[1][1] + b[1][0]) for a, b in pairwise(order)), np.inf]
    return LinkMotion(tuple(joint for joint, _ in order), tuple(pairwise(ends)), whole)


def _commanded(joint: Joint, c: Floats, action: Floats) -> Floats:
    """(k,) changes of configuration whose handle follows actions (k, 3) along the joint."""
    if joint.kind == "revolute":
        return _around(jacobian(joint, c)[:, 3:], np.array(joint.axis), action)
    along = inverse_jacobian(joint, c, action)
    return _on_arc(joint, c, action, along) if joint.kind == "screw" else along


def _aimed(joint: Joint, c: Floats, action: Floats) -> Floats:
    """(k,) changes of configuration to the places that are closest to where actions (k, 3) lead."""
    place = inverse(joint, forward(joint, c).translation + action, near=c)
    lever = np.linalg.norm(jacobian(joint, c)[:, 3:], axis=1)
    return np.asarray(np.where(np.isfinite(place) & (lever > EQUAL), place - c, 0.0))


def _around(tangent: Floats, axis: Floats, action: Floats) -> Floats:
    """Angles (k,) of actions that start where J is `tangent` (k, 3)."""
    lever = np.linalg.norm(tangent, axis=1)
    safe = np.maximum(lever, EQUAL)
    along = (action * tangent).sum(axis=1) / safe
    outward = (action * np.cross(tangent, axis)).sum(axis=1) / safe
    is_chord = np.abs(np.hypot(lever + outward, along) - lever) < np.abs(outward)
    angle = np.where(is_chord, np.arctan2(along, lever + outward), along / safe)
    return np.asarray(np.where(lever > EQUAL, angle, 0.0))


def _on_arc(joint: Joint, c: Floats, action: Floats, along: Floats) -> Floats:
    """(k,) displacements of actions along a screw; `along` are their tangential ones."""
    start = forward(joint, c)
    arc = inverse(joint, start.translation + action, near=c) - c
    chord = forward(joint, c + arc).translation - start.translation
    tangent = jacobian(joint, c)[:, 3:] * along[:, None]
    fits = np.linalg.norm(chord - action, axis=1) < np.linalg.norm(tangent - action, axis=1)
    return np.asarray(np.where(fits & np.isfinite(arc), arc, along))
