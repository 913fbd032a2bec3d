"""Clearances of an arm, its load and the object's other parts: `ClearanceModel`.

Distances come from Coal (GJK), and where solids overlap minus the depth of penetration (EPA): how far they would
have to move apart. Source: Montaut et al., "Collision detection accelerated: an optimization perspective", RSS 2022.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Part
from micah_plan.errors import InputError
from micah_plan.robot.arm import Arm
from micah_plan.robot.load_arm import link_name
from micah_plan.robot.solids import solid
from micah_plan.task.body import Body, Shape

Pair = tuple[str, str]
PartPoses = Mapping[str, RigidTransform]

_POSTURES = 200
_TOLERANCE = 1e-8
_DEPTH_TOLERANCE = 1e-6
_ITERATIONS = 256


class Clearance(NamedTuple):
    """The smallest distance at one configuration, with its pair.

    Attributes:
        distance: [m]; negative: depth of penetration. Infinite without a pair.
        pair: names of the two: links of the arm, parts of the object, bodies of the scene.
    """

    distance: float
    pair: Pair


@dataclass(frozen=True, eq=False)
class ClearanceModel:
    """Everything that must not meet; made by `clearance_model`.

    Attributes:
        arm: the arm.
        geometry: Pinocchio geometry of arm, scene and parts, with the pairs that are checked.
        names: (P, 2) names of each pair.
        parts: numbers of geometries by part, and their poses in the part's frame.
        carried: parts that move with the tool.
        first, second: (P,) numbers of the geometries of each pair.
    """

    arm: Arm
    geometry: Any
    names: tuple[Pair, ...]
    parts: Mapping[str, tuple[tuple[int, Any], ...]]
    carried: frozenset[str]
    first: NDArray[np.int64]
    second: NDArray[np.int64]

    @cached_property
    def _room(self) -> Any:
        """Reused buffers for Coal's results."""
        return _room(self.geometry)

    @cached_property
    def _results(self) -> tuple[Any, ...]:
        return tuple(self._room.distanceResults[i] for i in range(len(self.names)))

    def fresh(self) -> ClearanceModel:
        """A copy without cache: Coal's warm starts affect the last digits (1e-8 m)."""
        return replace(self)

    def distances(self, q: Floats, parts: PartPoses) -> Floats:
        """(P,) distance of every pair [m] at q (n,), with the pose (single) of each part in the base frame."""
        if missing := [name for name in self.parts if name not in parts]:
            raise InputError(f"clearances need the poses of all parts, missing {', '.join(missing)}")
        return self.placed_distances(q, {name: pin.SE3(parts[name].as_matrix()) for name in self.parts})

    def placed_distances(self, q: Floats, parts: Mapping[str, Any], pairs: Sequence[int] | None = None) -> Floats:
        """As `distances`, with Pinocchio poses of the parts, for some pairs in their order."""
        pin.updateGeometryPlacements(self.arm.model, self.arm.data, self.geometry, self._room, q)
        for name, items in self.parts.items():
            for number, placement in items:
                self._room.oMg[number] = parts[name] * placement
        if pairs is None:
            pin.computeDistances(self.geometry, self._room)
            distances = np.array([result.min_distance for result in self._results])
        else:
            distances = np.array([pin.computeDistance(self.geometry, self._room, k).min_distance for k in pairs])
        # Where the depth cannot be computed the solids do overlap.
        return np.where(np.isfinite(distances), distances, -_DEPTH_TOLERANCE)

    def at(self, q: Floats, parts: PartPoses | None = None, ignored: frozenset[Pair] = frozenset()) -> Clearance:
        """The smallest distance at q (n,).

        Args:
            parts: pose (single) of each part in the base frame.
            ignored: pairs, as `names` has them, that may meet now.
        """
        index, distance = self._closest(q, parts or {}, ignored)
        return Clearance(distance, ("", "") if index is None else self.names[index])

    def counted(self, ignored: frozenset[Pair]) -> NDArray[np.int64]:
        """Indices of the pairs that must not touch."""
        return np.array([k for k, pair in enumerate(self.names) if pair not in ignored], dtype=np.int64)

    def _closest(self, q: Floats, parts: PartPoses, ignored: frozenset[Pair]) -> tuple[int | None, float]:
        """Number of the pair with the smallest distance, and that distance [m]."""
        distances, counted = self.distances(q, parts), self.counted(ignored)
        if not len(counted):
            return None, np.inf
        index = int(counted[np.argmin(distances[counted])])
        return index, float(distances[index])

    def gradient(self, q: Floats, parts: PartPoses, ignored: frozenset[Pair]) -> tuple[Clearance, Floats]:
        """The smallest distance and its derivative by q (n,); carried parts move with the tool, others are static."""
        index, distance = self._closest(q, parts, ignored)
        if index is None:
            return Clearance(distance, ("", "")), np.zeros(self.arm.n)
        result = self._results[index]
        pin.computeJointJacobians(self.arm.model, self.arm.data, q)
        ends = (self.first[index], result.getNearestPoint1()), (self.second[index], result.getNearestPoint2())
        velocities = [self._point_jacobian(int(number), np.asarray(point)) for number, point in ends]
        return Clearance(distance, self.names[index]), np.asarray(
            np.asarray(result.normal) @ (velocities[1] - velocities[0])
        )

    def overlap(self, pair: Pair) -> tuple[tuple[Floats, float], ...]:
        """Half-spaces (direction (3,), bound [m]) of tool positions at which the pair overlaps.

        For the last evaluated configuration. Directions are the sides of the bounding boxes of both solids: where the
        tool, with its current orientation, is further along any of them, a plane separates the two. Empty unless one of
        the pair is a link that moves with the tool and the other stands still: otherwise the posture counts too.
        """
        of_pair = [k for k, name in enumerate(self.names) if name == pair]
        return self._overlap(min(of_pair, key=lambda k: float(self._results[k].min_distance)))

    def overlaps_near(self, pair: Pair, within: float) -> tuple[tuple[tuple[Floats, float], ...], ...]:
        """`overlap` of a pair, and of further pairs with the same static solid within a distance [m]."""
        if not (overlap := self.overlap(pair)):
            return ()
        first = int(self.first[self.names.index(pair)])
        still = pair[0] if self._joint_of(first) == 0 else pair[1]
        others = [k for k, neighbour in enumerate(self.names) if neighbour != pair and still in neighbour]
        near = [self._overlap(k) for k in others if self._results[k].min_distance < within]
        return (overlap, *(pair_near for pair_near in near if pair_near))

    def _overlap(self, index: int) -> tuple[tuple[Floats, float], ...]:
        """(side, largest projection) pairs of a collision, see `overlap`."""
        pair = self.names[index]
        numbers = int(self.first[index]), int(self.second[index])
        moves = [self._joint_of(number) for number in numbers]
        if sorted(moves) != [0, self.arm.tool_joint] or not self.carried.isdisjoint(pair):
            return ()
        link, still = (self._box_around(number) for number in (numbers if moves[0] else numbers[::-1]))
        tool = self.arm.data.oMi[self.arm.tool_joint].act(self.arm.model.frames[self.arm.tool].placement.translation)
        sides = np.concatenate([edges for edges, _ in (link, still)])
        sides = np.unique(np.round(np.concatenate([sides, -sides]), 9) + 0.0, axis=0)
        return tuple((side, float((still[1] @ side).max() - ((link[1] - tool) @ side).min())) for side in sides)

    def _box_around(self, geometry: int) -> tuple[Floats, Floats]:
        """(3, 3) directions of the edges and (8, 3) corners of the box around a solid, as it lies in its frame."""
        item, at = self.geometry.geometryObjects[geometry].geometry, self._room.oMg[geometry]
        ends = np.array([item.aabb_local.min_, item.aabb_local.max_]).T
        return np.array(at.rotation).T, np.array([at.act(np.array(corner)) for corner in product(*ends)])

    def tool_distances(self, pair: Pair, tools: RigidTransform) -> Floats:
        """(k, s) distance [m] between the solids of a pair with the tool at poses (k,), for any posture.

        Args:
            pair: something that moves with the tool and something that stands still, as in `overlap`.
        """
        numbers = [k for k, name in enumerate(self.names) if name == pair]
        frame = self.arm.model.frames[self.arm.tool]
        distances = np.empty((len(tools), len(numbers)))
        for row, matrix in zip(distances, tools.as_matrix(), strict=True):
            joint = pin.SE3(matrix) * frame.placement.inverse()
            for geometry in {int(i) for k in numbers for i in (self.first[k], self.second[k])}:
                item = self.geometry.geometryObjects[geometry]
                moves = item.parentJoint == self.arm.tool_joint
                self._room.oMg[geometry] = joint * item.placement if moves else item.placement
            row[:] = [pin.computeDistance(self.geometry, self._room, k).min_distance for k in numbers]
        return distances

    def _joint_of(self, geometry: int) -> int:
        """Number of the joint that a solid moves with; 0: of none."""
        if any(geometry == number for name in self.carried for number, _ in self.parts[name]):
            return self.arm.tool_joint
        return int(self.geometry.geometryObjects[geometry].parentJoint)

    def _point_jacobian(self, geometry: int, point: Floats) -> Floats:
        """(3, n) derivative of a point of a solid by q, the point in the base frame."""
        joint = self._joint_of(geometry)
        if joint == 0:
            return np.zeros((3, self.arm.n))
        columns = pin.getJointJacobian(self.arm.model, self.arm.data, joint, pin.WORLD)
        return np.asarray(columns[:3] + np.cross(columns[3:].T, point).T)


def clearance_model(
    arm: Arm, scene: Sequence[Body] = (), parts: Sequence[Part] = (), carried: Sequence[str] = ()
) -> ClearanceModel:
    """Arm, scene and the object's parts, with the pairs that must not meet.

    Checked are: links of the arm against each other, the scene and the parts; parts against the scene. Not checked are
    links that share a joint or do not move, pairs that an SRDF excludes, that touch in every posture or, two joints
    apart, in none, the hand against the first of the held parts, and parts against each other.

    Args:
        scene: bodies that do not move.
        parts: of the object, with their shapes; their poses are given in every call. The one called `base` stands
            still.
        carried: names of the parts that move with the tool; the first is the grasped one.

    Raises:
        InputError: for names that occur twice.
    """
    geometry = pin.GeometryModel(arm.geometry)
    links = list(range(geometry.ngeoms))
    labels = [link_name(item) for item in geometry.geometryObjects]
    taken = [*dict.fromkeys(labels), *(body.name for body in scene), *(part.name for part in parts)]
    twice = next((name for name in taken if taken.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"two things are called '{twice}' among the robot's links, the scene and the parts")
    still = [_added(geometry, labels, body.name, body.shapes, pin.SE3(body.pose.as_matrix())) for body in scene]
    moved = {part.name: _added(geometry, labels, part.name, part.shapes, pin.SE3.Identity()) for part in parts}
    scene_numbers = [number for group in still for number, _ in group]
    part_numbers = [(name, number) for name, group in moved.items() for number, _ in group]
    pairs = _arm_pairs(arm, geometry, links)
    pairs += [(a, b) for a, b in product(links, scene_numbers) if geometry.geometryObjects[a].parentJoint > 0]
    grasped = carried[0] if carried else None
    pairs += [
        (a, b)
        for a, (name, b) in product(links, part_numbers)
        if not (name == grasped and geometry.geometryObjects[a].parentJoint == arm.tool_joint)
    ]
    pairs += [(a, b) for (name, a), b in product(part_numbers, scene_numbers) if name != BASE]
    _set_pairs(geometry, pairs)
    return ClearanceModel(
        arm=arm,
        geometry=geometry,
        names=tuple((labels[a], labels[b]) for a, b in pairs),
        parts={name: tuple(group) for name, group in moved.items()},
        carried=frozenset(carried),
        first=np.array([a for a, _ in pairs], dtype=np.int64),
        second=np.array([b for _, b in pairs], dtype=np.int64),
    )


def _set_pairs(geometry: Any, pairs: Sequence[tuple[int, int]]) -> None:
    geometry.removeAllCollisionPairs()
    for a, b in pairs:
        geometry.addCollisionPair(pin.CollisionPair(a, b))


def _room(geometry: Any) -> Any:
    """Buffers for results, with penetration depth enabled."""
    for item in geometry.geometryObjects:
        item.geometry.computeLocalAABB()
    data = geometry.createData()
    for request in data.distanceRequests:
        request.enable_signed_distance = True
        # Starting from the solids' boxes takes half the time of the default.
        request.gjk_initial_guess = coal.GJKInitialGuess.BoundingVolumeGuess
        request.gjk_tolerance, request.epa_tolerance = _TOLERANCE, _DEPTH_TOLERANCE
        request.gjk_max_iterations = request.epa_max_iterations = _ITERATIONS
    return data


def _added(geometry: Any, labels: list[str], name: str, shapes: Sequence[Shape], pose: Any) -> list[tuple[int, Any]]:
    """(number, pose in its owner's frame) of each solid of a body or part, added to the geometry."""
    overlaps = []
    for i, shape in enumerate(shapes):
        form, placement = solid(shape)
        item = pin.GeometryObject(f"{name}/{i}", 0, pose * placement, form)
        overlaps.append((int(geometry.addGeometryObject(item)), placement))
        labels.append(name)
    return overlaps


def _arm_pairs(arm: Arm, geometry: Any, links: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs of the arm's solids that can meet."""
    objects = geometry.geometryObjects
    pairs = []
    for a, b in combinations(links, 2):
        first, second = sorted((int(objects[a].parentJoint), int(objects[b].parentJoint)))
        names = sorted((link_name(objects[a]), link_name(objects[b])))
        if first != second and arm.model.parents[second] != first and (names[0], names[1]) not in arm.separate:
            pairs.append((a, b))
    _set_pairs(geometry, pairs)
    data = _room(geometry)
    met = np.zeros(len(pairs), dtype=np.int64)
    for q in arm.sample(np.random.default_rng(0), _POSTURES):  # fixed: which pairs count is a property of the arm
        pin.computeDistances(arm.model, arm.data, geometry, data, q)
        met += np.array([result.min_distance < 0 for result in data.distanceResults], dtype=bool)
    # The joints that move two solids against each other.
    chains = [set(map(int, arm.model.supports[objects[number].parentJoint])) for number in links]
    near = np.array([len(chains[a] ^ chains[b]) <= 2 for a, b in pairs], dtype=bool)
    # Over the two joints between them, the postures are dense: links that never met there are kept apart by design.
    checked = (met < _POSTURES) & ~(near & (met == 0))
    return [pair for pair, counts in zip(pairs, checked, strict=True) if counts]
