"""Joint trajectories that carry the tool along a path: `follow`.

From several start postures (chosen by the seed) the path is followed in small steps: damped least squares onto the next
pose, and within the null space downhill in `posture_cost` (Liégeois, "Automatic supervisory control of the
configuration and behavior of multibody mechanisms", IEEE T-SMC 1977). Each step between knots is then checked as
executed, straight in the joints: limits, jumps, singularities, and clearance all along the way.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from micah_plan.arrays import Floats
from micah_plan.errors import InputError
from micah_plan.robot import messages
from micah_plan.robot.arm import Arm
from micah_plan.robot.clearance import Clearance, ClearanceModel, Pair
from micah_plan.robot.inverse_kinematics import Reached, next_pose, pose_error, reach_pose
from micah_plan.robot.posture import PostureWeights, posture_cost, posture_gradient
from micah_plan.robot.sweep import MotionBound, sweep_between
from micah_plan.task.deadline import NEVER, Deadline, TimeLimitError
from micah_plan.task.plan import ArmTrajectory

FailureKind = Literal["unreachable", "joint limit", "singularity", "collision", "jump"]

_SUBSTEP_M, _SUBSTEP_RAD = 0.02, 0.08
_NULL_RATE = 0.5
_LONGEST_NULL_STEP = 0.06
_SAME_START = 0.2
# What moves with the tool this close to what another link meets is likely to meet it next [m].
_NEAR_M = 0.05


@dataclass(frozen=True)
class PathSettings:
    """Limits of a joint trajectory, and the effort of the search.

    Attributes:
        margin: smallest distance between things that must not meet [m].
        limit_margin: distance kept from joint limits [rad or m], for the feedback to move in.
        least_manipulability: smallest manipulability, as a share of that of the rest posture.
        longest_step: largest motion of a joint from knot to knot [rad or m], beyond which it counts as a jump.
        starts: random configurations that start postures are sought from.
        followed: how many of the best start postures are followed at most, from each end of the path.
        enough: how many complete trajectories the best is chosen among.
    """

    margin: float = 0.003
    limit_margin: float = 0.02
    least_manipulability: float = 0.05
    longest_step: float = 0.6
    starts: int = 60
    followed: int = 6
    enough: int = 2
    weights: PostureWeights = field(default_factory=PostureWeights)


@dataclass(frozen=True)
class ArmFailure:
    """The failure of the try that came furthest along the path.

    Attributes:
        knot: where it ends.
        kind: of the failure.
        names: the joint at its limit, or the pair that meets; empty for others.
        amount: distance of the tool from its pose, depth of the collision, or jump of a joint [m or rad].
        sentence, remedy: the same in words.
        overlaps: of a collision that no posture changes, where the tool is while it lasts (`ClearanceModel.overlap`),
            and while others that move with the tool meet the same.
        short: of an unreachable place, the missing displacement of the tool (base frame) [m]; else None.
    """

    knot: int
    kind: FailureKind
    names: tuple[str, ...]
    amount: float
    sentence: str
    remedy: str
    overlaps: tuple[tuple[tuple[Floats, float], ...], ...] = ()
    short: Floats | None = None


@dataclass(frozen=True, eq=False)
class ToolPath:
    """The path of the tool, at K knots.

    Attributes:
        tool: (K,) poses of the tool in the base frame.
        parts: (K,) poses of the object's parts in the base frame, by part.
        touching: (K,) pairs that may meet at each knot, and on the way to and from it; None: none.
    """

    tool: RigidTransform
    parts: Mapping[str, RigidTransform] = field(default_factory=dict)
    touching: Sequence[frozenset[Pair]] | None = None

    def __post_init__(self) -> None:
        lengths = {len(self.tool), *map(len, self.parts.values())}
        lengths |= set() if self.touching is None else {len(self.touching)}
        if len(lengths) != 1 or not len(self.tool):
            raise InputError(f"a tool path needs the same number of knots of all, at least one. Got {sorted(lengths)}")

    def backwards(self) -> ToolPath:
        """The same knots from the last to the first."""
        parts = {name: poses[::-1] for name, poses in self.parts.items()}
        return ToolPath(self.tool[::-1], parts, None if self.touching is None else self.touching[::-1])

    def at(self, knot: int) -> dict[str, RigidTransform]:
        """Pose of each part at a knot."""
        return {name: poses[knot] for name, poses in self.parts.items()}

    def allowed(self, *knots: int) -> frozenset[Pair]:
        """Pairs that may touch at any knot."""
        return frozenset() if self.touching is None else frozenset().union(*(self.touching[knot] for knot in knots))


def follow(
    model: ClearanceModel,
    path: ToolPath,
    seed: int = 0,
    settings: PathSettings | None = None,
    deadline: Deadline = NEVER,
    start: Floats | None = None,
) -> ArmTrajectory | ArmFailure:
    """A joint trajectory through the tool poses of a path, or its failure.

    Args:
        model: of the arm with its surroundings, for the parts that the path gives.
        path: K knots.
        seed: of the start postures; the same seed gives the same trajectory.
        settings: None: the defaults.
        deadline: when it passes, the best of the complete trajectories so far is returned.
        start: (n,) posture that the arm is in near the first knot; None: one is sought.

    Raises:
        TimeLimitError: if there is none by then.
    """
    follower = _Follower(model.fresh(), settings or PathSettings(), seed, deadline)
    if start is not None:
        rows = follower.onwards(path, start)
        return rows if isinstance(rows, ArmFailure) else follower.summary(path, rows)
    postures: list[tuple[float, Floats]] = []
    failures: list[ArmFailure] = []
    try:
        for way in (path, path.backwards())[: len(path.tool)]:  # a single knot has no other end
            for tried in follower.tries(way):
                if not isinstance(tried, ArmFailure):
                    rows = tried if way is path else tried[::-1]
                    postures.append((follower.cost(path, rows), rows))
                elif tried.overlaps and way is path:  # so of every posture
                    return tried
                elif way is path:  # its knots are what a reader counts
                    failures.append(tried)
                if len(postures) >= follower.settings.enough:
                    break
            if postures:
                break
    except TimeLimitError:
        if not postures:
            raise
    if postures:
        return follower.summary(path, min(postures, key=lambda pair: pair[0])[1])
    return max(failures, key=lambda failure: failure.knot)


class _Follower:
    """The search, with data shared by all tries."""

    def __init__(self, model: ClearanceModel, settings: PathSettings, seed: int, deadline: Deadline) -> None:
        self.model, self.arm, self.settings, self.deadline = model, model.arm, settings, deadline
        self._generator = np.random.default_rng(seed)
        self._bound = MotionBound(model)
        lower, upper = self.arm.lower + settings.limit_margin, self.arm.upper - settings.limit_margin
        middle = np.clip(self.arm.rest, self.arm.lower, self.arm.upper)
        self._limits = np.minimum(lower, middle), np.maximum(upper, middle)
        self._least = settings.least_manipulability * float(self.arm.manipulability(self.arm.rest)[0])

    def tries(self, path: ToolPath) -> Iterator[Floats | ArmFailure]:
        """(K, n) configurations along the path from each of the best starts, or the failure."""
        starts = self._starts(path)
        if isinstance(starts, ArmFailure):
            yield starts
        else:
            yield from (self._followed(path, start) for start in starts)

    def _starts(self, path: ToolPath) -> list[Floats] | ArmFailure:
        """Configurations at the first knot, best first."""
        target = path.tool[0].as_matrix()
        seeds = np.vstack([self.arm.rest, self.arm.sample(self._generator, self.settings.starts)])
        postures: list[tuple[float, Floats]] = []
        missed: list[Reached] = []
        blocked: list[ArmFailure] = []
        for number, seed in enumerate(seeds):
            self.deadline.check("arm's motion", f"{number} of {len(seeds)} start postures were sought")
            reached = reach_pose(self.arm, target, np.clip(seed, *self._limits), self._limits)
            if not reached.done:
                missed.append(reached)
            elif all(np.abs(reached.q - q).max() >= _SAME_START for _, q in postures):
                failure = self._standing(path, 0, reached.q)
                if failure is None:
                    postures.append((self._posture_cost(path, 0, reached.q), reached.q))
                else:
                    blocked.append(failure)
        if postures:
            return [q for _, q in sorted(postures, key=lambda pair: pair[0])[: self.settings.followed]]
        if blocked:
            return min(blocked, key=lambda failure: abs(failure.amount))
        return self._out_of_reach(0, min(missed, key=lambda reached: float(np.linalg.norm(reached.error))))

    def onwards(self, path: ToolPath, near: Floats) -> Floats | ArmFailure:
        """(K, n) configurations along the path, starting near a posture."""
        reached = reach_pose(self.arm, path.tool[0].as_matrix(), np.clip(near, *self._limits), self._limits)
        failure = self._standing(path, 0, reached.q) if reached.done else self._out_of_reach(0, reached)
        return failure or self._followed(path, reached.q)

    def _followed(self, path: ToolPath, start: Floats) -> Floats | ArmFailure:
        """(K, n) configurations along the path from a start at its first knot."""
        rows = [start]
        for knot in range(1, len(path.tool)):
            self.deadline.check("arm's motion", f"{knot} of {len(path.tool)} knots were reached")
            reached = self._step(path, knot, rows[-1])
            failure = self._out_of_reach(knot, reached) if not reached.done else self._standing(path, knot, reached.q)
            failure = failure or self._on_the_way(path, knot, rows[-1], reached.q)
            if failure is not None:
                return failure
            rows.append(reached.q)
        return np.stack(rows)

    def cost(self, path: ToolPath, rows: Floats) -> float:
        """Cost of a whole trajectory: the worst posture, and the motion of the joints."""
        costs = [self._posture_cost(path, k, q) for k, q in enumerate(rows)]
        return float(np.max(costs) + np.mean(costs) + 0.1 * np.abs(np.diff(rows, axis=0)).sum())

    def _posture_cost(self, path: ToolPath, knot: int, q: Floats) -> float:
        return posture_cost(self.model, q, path.at(knot), path.allowed(knot), self.settings.weights)

    def summary(self, path: ToolPath, rows: Floats) -> ArmTrajectory:
        """The trajectory with its clearances and margins."""
        clearances, swept = [], []
        for k, q in enumerate(rows):
            clearances.append(self.model.at(q, path.at(k), path.allowed(k)))
            swept.append((clearances[-1], k))
            if k + 1 < len(rows):
                swept.append((self._sweep(path, k, q, rows[k + 1], None), k))
        closest, knot = min(swept, key=lambda pair: pair[0].distance)
        met = np.isfinite(closest.distance)
        margins = np.minimum(rows - self.arm.lower, self.arm.upper - rows).min(axis=0)
        nearest = int(np.argmin(margins))
        return ArmTrajectory(
            joints=self.arm.joints,
            positions=rows,
            manipulability=self.arm.manipulability(rows),
            clearance=tuple(c.distance if np.isfinite(c.distance) else None for c in clearances),
            least_clearance=closest.distance if met else None,
            closest_pair=closest.pair if met else (),
            closest_knot=knot,
            deviation=_deviation(self.arm, rows),
            limit_margin=float(margins[nearest]) if np.isfinite(margins[nearest]) else None,
            limit_joint=self.arm.joints[nearest] if np.isfinite(margins[nearest]) else "",
            limit_unit=self.arm.units[nearest],
        )

    def _step(self, path: ToolPath, knot: int, q: Floats) -> Reached:
        """The configuration at a knot from the previous one, in steps small enough to stay on one branch."""
        before, after = path.tool[knot - 1], path.tool[knot]
        way = pose_error(after.as_matrix(), before.as_matrix())
        count = int(np.ceil(max(np.linalg.norm(way[:3]) / _SUBSTEP_RAD, np.linalg.norm(way[3:]) / _SUBSTEP_M)))
        if not count:  # a transition takes no time: the arm stands still
            return reach_pose(self.arm, after.as_matrix(), q, self._limits)
        shares = np.linspace(0.0, 1.0, count + 1)[1:]
        turns = Slerp([0.0, 1.0], Rotation.concatenate([before.rotation, after.rotation]))(shares)
        places = before.translation + shares[:, None] * (after.translation - before.translation)
        reached = Reached(q, np.zeros(6), np.zeros(self.arm.n, dtype=bool))
        for target in RigidTransform.from_components(places, turns).as_matrix():
            reached = next_pose(self.arm, target, q, self._downhill(path, knot, q), self._limits)
            if not reached.done:
                return reached
            q = reached.q
        return reached

    def _downhill(self, path: ToolPath, knot: int, q: Floats) -> Floats:
        """(n,) step of the posture down the gradient of its cost [rad or m]."""
        gradient = posture_gradient(self.model, q, path.at(knot), path.allowed(knot - 1, knot), self.settings.weights)
        wish = -_NULL_RATE * gradient
        return np.asarray(wish * min(1.0, _LONGEST_NULL_STEP / max(float(np.abs(wish).max()), 1e-12)))

    def _standing(self, path: ToolPath, knot: int, q: Floats) -> ArmFailure | None:
        """The failure of a configuration at a knot; None if valid."""
        measure = float(self.arm.manipulability(q)[0])
        if measure < self._least:
            sentence = messages.singularity(knot, measure)
            return ArmFailure(knot, "singularity", (), measure, sentence, messages.MOVE_ROOT_OR_GRASP)
        clearance = self.model.at(q, path.at(knot), path.allowed(knot))
        return self._collision(knot, clearance) if clearance.distance < self.settings.margin else None

    def _on_the_way(self, path: ToolPath, knot: int, before: Floats, after: Floats) -> ArmFailure | None:
        """The failure of the motion from the previous knot, linear in the joints; None if valid."""
        moved = np.abs(after - before)
        if moved.max() > self.settings.longest_step:
            name = self.arm.joints[int(np.argmax(moved))]
            sentence = messages.jump(name, float(moved.max()), knot)
            return ArmFailure(knot, "jump", (name,), float(moved.max()), sentence, messages.SMALLER_STEPS)
        closest = self._sweep(path, knot - 1, before, after, self.settings.margin)
        return self._collision(knot, closest) if closest.distance < self.settings.margin else None

    def _sweep(self, path: ToolPath, knot: int, before: Floats, after: Floats, margin: float | None) -> Clearance:
        ends = (before, path.at(knot)), (after, path.at(knot + 1))
        allowed = path.allowed(knot, knot + 1)
        return sweep_between(self.model, self._bound, *ends, margin, allowed).clearance

    def _collision(self, knot: int, clearance: Clearance) -> ArmFailure:
        sentence = messages.collision(clearance.pair, clearance.distance, knot)
        remedy = messages.MOVE_ROOT_GRASP_OR_SCENE
        overlaps = self.model.overlaps_near(clearance.pair, _NEAR_M)
        return ArmFailure(knot, "collision", clearance.pair, clearance.distance, sentence, remedy, overlaps)

    def _out_of_reach(self, knot: int, reached: Reached) -> ArmFailure:
        away = float(np.linalg.norm(reached.error[3:]))
        turned = float(np.linalg.norm(reached.error[:3]))
        stopped = np.flatnonzero(reached.stopped)
        if len(stopped):
            lower = reached.q[stopped] - self._limits[0][stopped] < self._limits[1][stopped] - reached.q[stopped]
            names = tuple(self.arm.joints[i] for i in stopped)
            ends = [(name, "lower" if low else "upper") for name, low in zip(names, lower, strict=True)]
            sentence, remedy = messages.joint_limit(knot, away, turned, ends), messages.MOVE_GRASP_OR_ROOT
            return ArmFailure(knot, "joint limit", names, max(away, turned), sentence, remedy, short=reached.error[3:])
        sentence, remedy = messages.unreachable(knot, away, turned), messages.MOVE_ROOT
        return ArmFailure(knot, "unreachable", (), max(away, turned), sentence, remedy, short=reached.error[3:])


def _deviation(arm: Arm, rows: Floats) -> float:
    """Deviation of the tool halfway between knots [m]."""
    places = arm.poses(rows).translation
    if len(rows) < 2:
        return 0.0
    halfway = arm.poses((rows[:-1] + rows[1:]) / 2).translation
    return float(np.linalg.norm(halfway - (places[:-1] + places[1:]) / 2, axis=1).max())
