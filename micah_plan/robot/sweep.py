"""Continuous collision check of a motion between two configurations: `sweep_between`.

The joints move in a straight line. Around a configuration no point of a solid moves further than its speed there times
the time, plus a bound on what its acceleration adds; a distance greater than that proves the stretch free, elsewhere it
is halved. Source: Schwarzer, Saha and Latombe, "Exact collision checking of robot paths", WAFR 2002; the second order
makes up for joints that move against each other while the hand hardly moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from micah_plan.arrays import Floats
from micah_plan.robot.arm import Arm
from micah_plan.robot.clearance import Clearance, ClearanceModel, Pair, PartPoses

_RESOLUTION_M = 1e-3
_RELATIVE_RESOLUTION = 0.2


class Swept(NamedTuple):
    """Result of a continuous collision check.

    Attributes:
        clearance: the smallest distance found. Where it is above the margin, the whole motion keeps the margin within 1
            mm; without a margin, nothing is nearer than this less 1 mm or a fifth of it.
        share: where it was met, 0 to 1.
    """

    clearance: Clearance
    share: float


class MotionBound:
    """How far points of solids move, for an arm and its surroundings, at all configurations within the limits.

    Attributes:
        levers: (g, n) largest distance of a geometry's points from each joint's axis that moves it, else 0 [m]; 1 for a
            joint that slides. Those of carried parts count to the tool's frame.
        radii: (g,) radius of the sphere around each geometry [m].
        centers: (g, 3) its centre, in the frame of the joint or of the part [m].
        joints: (g,) number of the joint that moves it; 0 for none.
        turning: (n,) 1 for joints that rotate, 0 for those that slide.
    """

    def __init__(self, model: ClearanceModel) -> None:
        arm, items = model.arm, model.geometry.geometryObjects
        count = len(items)
        self.levers, self.radii, self.centers = np.zeros((count, arm.n)), np.zeros(count), np.zeros((count, 3))
        self.joints = np.zeros(count, dtype=np.int64)
        self.turning = np.any(arm.twists()[:, 3:] != 0, axis=1).astype(float)
        of_part = {number: (name, placement) for name, group in model.parts.items() for number, placement in group}
        tool = float(np.linalg.norm(arm.model.frames[arm.tool].placement.translation))
        for number, item in enumerate(items):
            item.geometry.computeLocalAABB()
            name, placement = of_part.get(number, ("", item.placement))
            self.centers[number] = placement.act(item.geometry.aabb_center)
            self.radii[number] = item.geometry.aabb_radius
            if name in model.carried:
                joint, distance = arm.tool_joint, tool
            elif not name:
                distance = float(np.linalg.norm(self.centers[number])) + self.radii[number]
                joint = int(item.parentJoint)
            else:  # a part that stands on its own
                continue
            self.joints[number], self.levers[number] = joint, _levers(arm, joint, distance)


def sweep_between(
    model: ClearanceModel,
    bound: MotionBound,
    start: tuple[Floats, PartPoses],
    end: tuple[Floats, PartPoses],
    margin: float | None = 0.0,
    ignored: frozenset[Pair] = frozenset(),
) -> Swept:
    """The smallest distance while arm and parts move from one configuration to another.

    Parts that are carried move relative to the tool, others relative to the base frame, by one screw motion.

    Args:
        bound: of the model.
        start, end: configuration (n,) and pose (single) of each part in the base frame.
        margin: distance that is wanted [m]; the sweep ends early where it is not kept. None: the smallest
            distance itself is found.
        ignored: pairs that may meet.
    """
    path = _Path(model, bound, start, end)
    swept = Swept(Clearance(np.inf, ("", "")), 0.0)
    waiting = [(0.5, 0.5, model.counted(ignored))]
    while waiting and (margin is None or swept.clearance.distance >= margin):
        share, half, pairs = waiting.pop(0)
        if not len(pairs):
            break
        q, parts = path.at(share)
        # All at once in one call, or few of them one by one.
        few = len(pairs) < len(model.names) // 3
        distances = model.placed_distances(q, parts, pairs.tolist() if few else None)
        distances = distances if few else distances[pairs]
        index = int(np.argmin(distances))
        if distances[index] < swept.clearance.distance:
            swept = Swept(Clearance(float(distances[index]), model.names[pairs[index]]), share)
        least = swept.clearance.distance
        room = _RESOLUTION_M if margin is not None else max(_RESOLUTION_M, _RELATIVE_RESOLUTION * least)
        moves = path.moves(q, parts, half, pairs)
        unproven = (moves > room) & (distances - (least - room if margin is None else margin) < moves)
        if unproven.any():
            remaining = pairs[unproven]
            waiting += [(share - half / 2, half / 2, remaining), (share + half / 2, half / 2, remaining)]
    return swept


class _Path:
    """The motion between the two ends; time runs from 0 to 1.

    A part moves by its own screw, in the tool's or the base frame: a point p under the twist (w, v) has the speed
    |w x p + v|, and on the way stays within its first distance from the frame's origin plus what it has slid.
    """

    def __init__(
        self, model: ClearanceModel, bound: MotionBound, start: tuple[Floats, PartPoses], end: tuple[Floats, PartPoses]
    ) -> None:
        self._model, self._bound = model, bound
        self._q, self._step = start[0], end[0] - start[0]
        tools = [pin.SE3(model.arm.matrix(q)) for q in (start[0], end[0])]
        self._relative: dict[str, tuple[Any, Any]] = {}
        spin, slide, reach, is_carried = (np.zeros(len(bound.radii)) for _ in range(4))
        for name, group in model.parts.items():
            first, last = (pin.SE3(parts[name].as_matrix()) for parts in (start[1], end[1]))
            if name in model.carried:
                first, last = tools[0].actInv(first), tools[1].actInv(last)
            screw = pin.log6(last * first.inverse())
            self._relative[name] = first, screw
            for number, _ in group:
                spin[number], slide[number] = np.linalg.norm(screw.angular), np.linalg.norm(screw.linear)
                reach[number] = np.linalg.norm(first.act(bound.centers[number])) + bound.radii[number] + slide[number]
                is_carried[number] = name in model.carried
        # (g,) bound on the speed of a part's points by its own screw, and by the joints about its distance.
        self._own = spin * reach + slide
        steps = np.abs(self._step)
        turned = float(steps @ bound.turning)
        carried = turned * reach * is_carried
        # (P,) how far the solids of each pair move against each other at most: a joint that moves both does not count.
        first_levers, second_levers = bound.levers[model.first], bound.levers[model.second]
        both = (first_levers > 0) & (second_levers > 0)
        between = np.where(both, 0.0, first_levers + second_levers) @ steps
        self._travel = between + (carried + self._own)[model.first] + (carried + self._own)[model.second]
        # (g,) half the acceleration: the second derivative of a point by joints i and j is at most its lever about the
        # outer one of them, so all joints give at most the sum of all turns times the sum of turns times levers.
        coriolis = 2 * np.where(bound.joints > 0, turned, 0.0) * self._own
        self._bend = (turned * (bound.levers @ steps + carried) + coriolis + spin * self._own) / 2

    def at(self, share: float) -> tuple[Floats, dict[str, Any]]:
        """(configuration, poses of the parts) at a fraction of the motion."""
        q = self._q + share * self._step
        tool = pin.SE3(self._model.arm.matrix(q)) if self._model.carried else pin.SE3.Identity()
        parts = {name: pin.exp6(share * screw) * first for name, (first, screw) in self._relative.items()}
        return q, {name: tool * pose if name in self._model.carried else pose for name, pose in parts.items()}

    def moves(self, q: Floats, parts: Mapping[str, Any], half: float, pairs: NDArray[np.int64]) -> Floats:
        """(p,) bound on the relative displacement of each pair's solids within the time `half`."""
        reached = self._speeds(q, parts) * half + self._bend * half**2
        first, second = self._model.first[pairs], self._model.second[pairs]
        return np.asarray(np.minimum(half * self._travel[pairs], reached[first] + reached[second]))

    def _speeds(self, q: Floats, parts: Mapping[str, Any]) -> Floats:
        """(g,) bound on the speed of each geometry's points at q, during the motion."""
        arm, bound = self._model.arm, self._bound
        pin.forwardKinematics(arm.model, arm.data, q, self._step)
        centers = bound.centers.copy()
        for name, group in self._model.parts.items():
            into = arm.data.oMi[arm.tool_joint].actInv(parts[name]) if name in self._model.carried else parts[name]
            for number, _ in group:
                centers[number] = into.act(bound.centers[number])
        velocity = np.array([velocity.vector for velocity in arm.data.v])[bound.joints]
        at_center = velocity[:, :3] + np.cross(velocity[:, 3:], centers)
        turned = np.linalg.norm(velocity[:, 3:], axis=1) * bound.radii
        return np.asarray(np.linalg.norm(at_center, axis=1) + turned + self._own)


def _levers(arm: Arm, joint: int, distance: float) -> Floats:
    """(n,) bound on the distance of a point from each joint's axis, the point at `distance` from the frame of `joint`.

    1 for joints that slide, which move every point by their own displacement.
    """
    margins = np.zeros(arm.n)
    twists = arm.twists()
    for number in range(joint, 0, -1):
        slides = not twists[number - 1, 3:].any()
        margins[number - 1] = 1.0 if slides else distance
        distance += float(np.linalg.norm(arm.model.jointPlacements[number].translation))
        if slides:
            distance += max(abs(float(arm.lower[number - 1])), abs(float(arm.upper[number - 1])))
    return margins
