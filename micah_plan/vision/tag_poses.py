"""Poses of parts in the camera and in the frame of the base, from the corners of their tags.

A square seen nearly head-on has two poses with nearly the same picture (Schweighofer and Pinz, "Robust pose estimation
from a planar target", PAMI 2006). Both are kept, and one of each frame is chosen by the likeliest sequence: with the
corners' precision, and parts that rotate as fast as hands move them (Viterbi). A pose's uncertainty follows from its
corners.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.recording.tag_layout import PlacedTag, TagLayout
from micah_plan.vision.camera import Camera
from micah_plan.vision.corners import Corners
from micah_plan.vision.opencv import opencv

# Turns from frame to frame: of a part at rest [rad], and how fast parts turn [rad/s]; the most that one jump costs.
_JITTER, _TURNS, _MOST_COST = 0.02, 2.0, 400.0
_REFINEMENTS = 20  # steps of a pose, at most
# Corners are never more precise than that [px], and those of a tag that stands are wrong alike in all frames by that.
_FINEST, _LASTING = 0.02, 0.02
# Of normal noise, the median of a square over its mean.
_MEDIAN_OF_SQUARES = 0.455
_MEDIAN_OF_TWO = 1.386  # of the sum of two
# A camera is fixed if one pose of the base misses corners by so many times what a pose in each frame does.
_FIXED = 1.5


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose of a part in the camera or in the base frame.

    Attributes:
        turn: (3, 3) part to frame. position: (3,) of its origin [m].
        covariance: (6, 6) of position [m] and a small turn in the frame [rad].
        misfit: sum of squares of its corners' errors [px^2].
    """

    turn: Floats
    position: Floats
    covariance: Floats
    misfit: float = 0.0

    def seen_from(self, base: Pose) -> Pose:
        """The pose relative to another pose of the same camera."""
        turn, lever = base.turn.T, self.position - base.position
        of_base = np.block([[-np.eye(3), _cross(lever)], [np.zeros((3, 3)), -np.eye(3)]])
        back = np.kron(np.eye(2), turn)
        covariance = back @ (self.covariance + of_base @ base.covariance @ of_base.T) @ back.T
        return Pose(turn @ self.turn, turn @ lever, covariance, self.misfit)


@dataclass(frozen=True, eq=False)
class Sighting:
    """A part in one frame: its corners in the part (n, 3) [m] and in the image (n, 2) [px], with candidate poses."""

    points: Floats
    pixels: Floats
    poses: tuple[Pose, ...]

    @property
    def misfit(self) -> float:
        """Misfit of the best pose [px^2]."""
        return min(pose.misfit for pose in self.poses)


def corners_of(tag: PlacedTag, pose: Pose | None = None) -> Floats:
    """(4, 3) corners of a tag in the frame of its part [m], from its top left on, clockwise as printed."""
    half = 0.5 * tag.size
    square = half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    if pose is not None:
        return np.asarray(square @ pose.turn.T + pose.position)
    at = (0.0, 0.0, 0.0) if tag.position is None else tag.position
    return np.asarray(Rotation.from_quat(tag.quaternion).apply(square) + at)


def placed_corners(layout: TagLayout, frames: Sequence[Corners], camera: Camera) -> dict[str, dict[int, Floats]]:
    """(4, 3) corners in the frame of each part, by part and tag.

    The first tag of a part without given places defines the part's frame; others without one are placed by the median
    over frames that show both. Tags that are never seen together with a placed one are left out.
    """
    placed = {}
    for part in layout.parts:
        tags = layout.of(part)
        corners = {number: corners_of(tag) for number, tag in tags.items() if tag.position is not None}
        if not corners:
            first = next(iter(tags))
            corners[first] = corners_of(tags[first])
        for _ in tags:
            for number, tag in tags.items():
                if number not in corners:
                    pose = _relative_tag_pose(corners, number, tag, frames, camera)
                    if pose is not None:
                        corners[number] = corners_of(tag, pose)
        placed[part] = corners
    return placed


def _relative_tag_pose(
    placed: Mapping[int, Floats], number: int, tag: PlacedTag, frames: Sequence[Corners], camera: Camera
) -> Pose | None:
    """The pose of a tag relative to placed ones; None if no frame shows both."""
    alone, turns, places = PlacedTag(tag.part, tag.size), [], []
    for frame in frames:
        first, second = sighting(placed, frame, camera), sighting({number: corners_of(alone)}, frame, camera)
        if first is None or second is None:
            continue
        base = min(first.poses, key=lambda pose: pose.misfit)
        beside = min(second.poses, key=lambda pose: pose.misfit).seen_from(base)
        turns.append(Rotation.from_matrix(beside.turn).as_quat())
        places.append(beside.position)
    if not turns:
        return None
    every = Rotation.from_quat(np.array(turns))
    middle = every.mean()
    for _ in range(3):  # flipped ones count for nothing
        near = (middle.inv() * every).magnitude()
        middle = every[near <= max(2.0 * float(np.median(near)), 0.02)].mean()
    is_near = (middle.inv() * every).magnitude() <= max(2.0 * float(np.median(near)), 0.02)
    return Pose(middle.as_matrix(), np.median(np.array(places)[is_near], axis=0), np.zeros((6, 6)))


def sighting(tags: Mapping[int, Floats], frame: Corners, camera: Camera) -> Sighting | None:
    """The sighting of a part with tags (4, 3 each) in a frame; None if no tag is seen."""
    numbers = [number for number in tags if number in frame]
    if not numbers:
        return None
    points = np.concatenate([tags[number] for number in numbers])
    pixels = np.concatenate([frame[number] for number in numbers])
    poses = _poses(points, pixels, camera)
    return Sighting(points, pixels, poses) if poses else None


def _poses(points: Floats, pixels: Floats, camera: Camera) -> tuple[Pose, ...]:
    """Candidate poses of corners, refined: two for coplanar tags."""
    cv2 = opencv()
    middle = points.mean(axis=0)
    _, spread, axes = np.linalg.svd(points - middle)
    is_flat = spread[2] < 1e-6 * max(spread[0], 1e-9)
    # A solver for planes wants them at z = 0.
    frame = axes if np.linalg.det(axes) > 0 else axes * np.array([[1.0], [1.0], [-1.0]])
    in_plane = (points - middle) @ frame.T if is_flat else points
    way = cv2.SOLVEPNP_IPPE if is_flat else cv2.SOLVEPNP_SQPNP
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(in_plane, pixels, camera.matrix, camera.distortion, flags=way)
    except cv2.error:
        return ()
    poses = []
    for turn, shift in zip(turns, shifts, strict=True):
        matrix, position = _refined(in_plane, pixels, np.asarray(cv2.Rodrigues(turn)[0]), np.ravel(shift), camera)
        if is_flat:
            matrix = matrix @ frame
            position = position - matrix @ middle
        misfit = float((_missed(points, pixels, matrix, position, camera) ** 2).sum())
        if (points @ matrix.T + position)[:, 2].min() > 0.0 and np.isfinite(misfit):
            poses.append(Pose(matrix, position, np.zeros((6, 6)), misfit))
    return tuple(poses)


def _refined(points: Floats, pixels: Floats, turn: Floats, position: Floats, camera: Camera) -> tuple[Floats, Floats]:
    """Pose (3, 3), (3,) with least reprojection error, refined by Levenberg-Marquardt."""
    cv2 = opencv()
    at = np.concatenate([np.ravel(cv2.Rodrigues(turn)[0]), position])

    def look(at: Floats) -> tuple[float, Floats, Floats]:
        projected, slopes = cv2.projectPoints(points, at[:3], at[3:], camera.matrix, camera.distortion)
        missed = (pixels - projected[:, 0]).ravel()
        return float(missed @ missed), slopes[:, :6].T @ slopes[:, :6], slopes[:, :6].T @ missed

    cost, information, pull = look(at)
    damped = 1e-4
    for _ in range(_REFINEMENTS):
        step = np.linalg.solve(information + damped * np.diag(np.diag(information) + 1e-9), pull)
        tried = look(at + step)
        if not tried[0] <= cost:
            damped *= 10.0
            continue
        is_there = cost - tried[0] < 1e-7 * max(cost, 1e-12)
        at, damped = at + step, 0.1 * damped
        cost, information, pull = tried
        if is_there:
            break
    return np.asarray(cv2.Rodrigues(at[:3])[0]), at[3:]


def _missed(points: Floats, pixels: Floats, turn: Floats, position: Floats, camera: Camera) -> Floats:
    """(k, 2) errors of projected points [px]."""
    cv2 = opencv()
    rotated = cv2.Rodrigues(turn)[0]
    projected = cv2.projectPoints(points, rotated, position, camera.matrix, camera.distortion)[0]
    return np.asarray(projected[:, 0] - pixels)


def corner_noise(sightings: Sequence[Sighting]) -> float:
    """Std of a corner [px], from the residuals of the best poses."""
    shares = [sighting.misfit / max(2 * len(sighting.points) - 6, 1) for sighting in sightings]
    return max(float(np.sqrt(np.median(shares) / _MEDIAN_OF_SQUARES)), _FINEST) if shares else _FINEST


def chosen_poses(
    sightings: Sequence[Sighting | None], times: Floats, noise: float, camera: Camera
) -> list[Pose | None]:
    """The pose of a part in each frame, by the likeliest sequence, with its covariance; None where it is not seen."""
    at = [(k, now) for k, now in enumerate(sightings) if now is not None]
    chosen: list[Pose | None] = [None] * len(sightings)
    cost, back, before = np.zeros(0), list[Floats](), at[:1]
    for k, now in at:
        costs = np.array([pose.misfit for pose in now.poses]) / (2.0 * noise**2)
        if len(cost):
            (earlier, last), reach = before[0], _JITTER
            reach += _TURNS * float(times[k] - times[earlier])
            turned = np.array([[_angle(a.turn, b.turn) / reach for a in last.poses] for b in now.poses])
            total = np.minimum(0.5 * turned**2, _MOST_COST) + cost
            back.append(total.argmin(axis=1))
            costs = costs + total.min(axis=1)
        cost, before = costs, [(k, now)]
    number = int(cost.argmin()) if len(cost) else 0
    for j in range(len(at) - 1, -1, -1):
        k, now = at[j]
        chosen[k] = _with_covariance(now.poses[number], now.points, noise, camera)
        number = int(back[j - 1][number]) if j else number
    return chosen


def _with_covariance(pose: Pose, points: Floats, noise: float, camera: Camera) -> Pose:
    """The pose with its covariance (inverse Fisher information of the projection)."""
    arms = points @ pose.turn.T
    corners = arms + pose.position
    rows = np.zeros((2 * len(points), 6))
    for k, ((x, y, z), arm) in enumerate(zip(corners, arms, strict=True)):
        fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
        project = np.array([[fx / z, 0.0, -fx * x / z**2], [0.0, fy / z, -fy * y / z**2]])
        rows[2 * k : 2 * k + 2] = project @ np.hstack([np.eye(3), -_cross(arm)])
    covariance: Floats = np.asarray(noise**2 * np.linalg.pinv(rows.T @ rows), dtype=np.float64)
    return Pose(pose.turn, pose.position, covariance, pose.misfit)


def pooled(poses: Sequence[Pose | None], sightings: Sequence[Sighting | None], camera: Camera) -> Pose | None:
    """One pose of a part that is static before a static camera; None otherwise."""
    able = [
        (pose, sighting)
        for pose, sighting in zip(poses, sightings, strict=True)
        if pose is not None and sighting is not None
    ]
    if len(able) < 2:
        return None
    points = np.concatenate([sighting.points for _, sighting in able])
    pixels = np.concatenate([sighting.pixels for _, sighting in able])
    start, _ = min(able, key=lambda pair: pair[0].misfit)
    matrix, position = _refined(points, pixels, start.turn, start.position, camera)
    missed = _missed(points, pixels, matrix, position, camera)
    noise = corner_noise([sighting for _, sighting in able])
    if float(np.sqrt(np.median(np.sum(missed**2, axis=1)) / _MEDIAN_OF_TWO)) > _FIXED * noise:
        return None
    alone = Pose(matrix, position, np.zeros((6, 6)))
    # What lens and compression do to a picture that stands still is the same in every frame.
    lasting = _with_covariance(alone, able[0][1].points, _LASTING, camera).covariance
    together = _with_covariance(alone, points, noise, camera).covariance
    return Pose(matrix, position, lasting + together)


def _angle(first: Floats, second: Floats) -> float:
    """Angle between two rotation matrices [rad]."""
    return float(np.arccos(np.clip(0.5 * (np.trace(first.T @ second) - 1.0), -1.0, 1.0)))


def _cross(v: Floats) -> Floats:
    """(3, 3) matrix of the cross product with v."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
