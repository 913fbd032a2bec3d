"""Clearance all along a motion between two configurations, not only at its ends: `sweep`.

The joints move in a straight line. Between two configurations no point of a solid moves further than a bound that
follows from how far it is from each joint, so a distance greater than this bound proves the stretch free; elsewhere it
is halved. Source: Schwarzer, Saha and Latombe, "Exact collision checking of robot paths", WAFR 2002.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from micah_plan.robot.arm import Arm
from micah_plan.robot.clearance import Clearance, ClearanceModel, Pair, PartPoses
from micah_plan.robot.solids import reach

Floats = NDArray[np.float64]

_RESOLUTION_M = 1e-3


class Swept(NamedTuple):
    """What a sweep found.

    Attributes:
        clearance: the smallest distance that was met. Where it is above the margin, the whole motion keeps the margin;
            nothing is nearer than the margin less the resolution.
        share: where it was met, 0 to 1.
        evaluations: how many configurations were looked at.
    """

    clearance: Clearance
    share: float
    evaluations: int


@dataclass(frozen=True, eq=False)
class MotionBound:
    """How far points of solids move.

    Attributes:
        levers: (g, n) largest distance of a geometry's points from each joint's axis that moves it, else 0 [m]; 1 for a
            joint that slides. Those of held parts count to the tool's frame.
        radii: (g,) largest distance of a part's points from the origin of its frame [m]; 0 for others.
    """

    levers: Floats
    radii: Floats


def motion_bound(model: ClearanceModel) -> MotionBound:
    """The bound for an arm and its surroundings; it holds at all configurations within the limits."""
    arm, items = model.arm, model.geometry.geometryObjects
    levers, radii = np.zeros((len(items), arm.n)), np.zeros(len(items))
    of_part = {number: name for name, group in model.parts.items() for number, _ in group}
    placements = {number: placement for group in model.parts.values() for number, placement in group}
    tool = float(np.linalg.norm(arm.model.frames[arm.tool].placement.translation))
    for number, item in enumerate(items):
        size = reach(item.geometry)
        if number in of_part:
            radii[number] = size + float(np.linalg.norm(placements[number].translation))
            if of_part[number] in model.held:
                levers[number] = _levers(arm, arm.tool_joint, tool)
        elif item.parentJoint > 0:
            distance = float(np.linalg.norm(item.placement.translation)) + size
            levers[number] = _levers(arm, int(item.parentJoint), distance)
    return MotionBound(levers, radii)


def sweep(
    model: ClearanceModel,
    bound: MotionBound,
    start: tuple[Floats, PartPoses],
    end: tuple[Floats, PartPoses],
    margin: float | None = 0.0,
    ignored: frozenset[Pair] = frozenset(),
) -> Swept:
    """The smallest distance while arm and parts move from one configuration to another.

    Parts that are held move relative to the tool, others relative to the base frame, by one screw motion.

    Args:
        bound: `motion_bound` of the model.
        start, end: configuration (n,) and pose (single) of each part in the base frame.
        margin: distance that is wanted [m]; the sweep ends early where it is not kept. None: the smallest
            distance itself is found, to the resolution.
        ignored: pairs that may meet.
    """
    path = _Path(model, bound, start, end)
    travel, counted = path.travel(), model.counted(ignored)
    evaluations = 0
    best, best_share = Clearance(np.inf, ("", "")), 0.0
    waiting = [(0.0, 0.0), (1.0, 0.0), (0.5, 0.5)]
    while waiting and (margin is None or best.distance >= margin):
        share, half = waiting.pop(0)
        q, parts = path.at(share)
        distances = model.placed_distances(q, parts)
        evaluations += 1
        closest = model.smallest(distances, ignored)
        if closest.distance < best.distance:
            best, best_share = closest, share
        moves = half * travel
        wanted = best.distance if margin is None else margin
        unproven = counted & (distances - wanted < moves) & (moves > _RESOLUTION_M)
        if unproven.any():
            waiting += [(share - half / 2, half / 2), (share + half / 2, half / 2)]
    return Swept(best, best_share, evaluations)


class _Path:
    """The motion between the two ends."""

    def __init__(
        self, model: ClearanceModel, bound: MotionBound, start: tuple[Floats, PartPoses], end: tuple[Floats, PartPoses]
    ) -> None:
        self._model, self._bound = model, bound
        self._q, self._step = start[0], end[0] - start[0]
        tools = [pin.SE3(model.arm.matrix(q)) for q in (start[0], end[0])]
        self._relative: dict[str, tuple[Any, Any]] = {}
        for name in model.parts:
            first, last = (pin.SE3(parts[name].as_matrix()) for parts in (start[1], end[1]))
            if name in model.held:
                first, last = tools[0].actInv(first), tools[1].actInv(last)
            self._relative[name] = first, pin.log6(last * first.inverse())

    def at(self, share: float) -> tuple[Floats, dict[str, Any]]:
        """Configuration and poses of the parts at a share of the way."""
        q = self._q + share * self._step
        tool = pin.SE3(self._model.arm.matrix(q)) if self._model.held else pin.SE3.Identity()
        parts = {name: pin.exp6(share * screw) * first for name, (first, screw) in self._relative.items()}
        return q, {name: tool * pose if name in self._model.held else pose for name, pose in parts.items()}

    def travel(self) -> Floats:
        """(P,) bound on how far the two solids of each pair move against each other over the whole way [m]."""
        first, second = self._model.first, self._model.second
        levers = [self._bound.levers[numbers] for numbers in (first, second)]
        # A joint that moves both does not move them against each other.
        between = np.where((levers[0] > 0) & (levers[1] > 0), 0.0, levers[0] + levers[1])
        own = self._own_motion()
        return np.asarray(between @ np.abs(self._step) + own[first] + own[second])

    def _own_motion(self) -> Floats:
        """(g,) bound on how far points of parts move beyond what the tool's origin does [m]; 0 for others."""
        moved = np.zeros(len(self._bound.radii))
        turned = np.abs(self._step) @ self._turning()
        for name, group in self._model.parts.items():
            first, screw = self._relative[name]
            angle, slide = float(np.linalg.norm(screw.angular)), float(np.linalg.norm(screw.linear))
            offset = float(np.linalg.norm(first.translation))
            for number, _ in group:
                # A point p under the twist (w, v) has the speed |w x p + v|; on the way p stays within its first
                # distance from the frame's origin plus what it has slid.
                radius = self._bound.radii[number] + offset + slide
                moved[number] = angle * radius + slide
                if name in self._model.held:
                    moved[number] += turned * radius
        return moved

    def _turning(self) -> Any:
        """(n,) 1 for joints that turn, 0 for those that slide."""
        return np.any(self._model.arm.twists()[:, 3:] != 0, axis=1).astype(float)


def _levers(arm: Arm, joint: int, distance: float) -> Floats:
    """(n,) bound on the distance of a point from each joint's axis, the point at `distance` from the frame of `joint`.

    1 for joints that slide, which move every point by their own displacement.
    """
    found = np.zeros(arm.n)
    twists = arm.twists()
    for number in range(joint, 0, -1):
        slides = not twists[number - 1, 3:].any()
        found[number - 1] = 1.0 if slides else distance
        distance += float(np.linalg.norm(arm.model.jointPlacements[number].translation))
        if slides:
            distance += max(abs(float(arm.lower[number - 1])), abs(float(arm.upper[number - 1])))
    return found
