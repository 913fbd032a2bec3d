"""From tracks of points to a recording: the bodies that they are on, their poses, and which point is on which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from micah_plan.arrays import Floats, Ints
from micah_plan.errors import InputError
from micah_plan.quantities import count, quantity
from micah_plan.recording.shared_error import SharedError, with_shared_errors
from micah_plan.recording.value import Recording
from micah_plan.vision.point_files import PointTracks
from micah_plan.vision.rigid_bodies import FEWEST_POINTS, RigidBody, rigid_bodies

# Points of a body from which on their number is not mentioned.
_ENOUGH_POINTS = 7
# A turn that is known no better than that is no measurement of one [rad].
_NO_TURN = 0.3
# A body moves by more than so many of its stds.
_MOVES = 5.0
# Parts of a video whose means are compared, and how rarely a camera that stands is taken for one that moves.
_PARTS, _RARELY = 4, 1e-3


@dataclass(frozen=True, eq=False)
class TrackedPoints:
    """Bodies and poses from tracks of points.

    Attributes:
        recording: poses of all bodies but the base, in its frame: that of the camera in the first frame.
        bodies: most points first; the first is the base. names: of each.
        body: (N,) number of the body that each point is on; -1: on none.
        noise: std of a measurement [m]. frames: how many.
        stds: (position [m], turn [rad]) of the poses of each body but the base, median.
        notes: remarks, one sentence each.
    """

    recording: Recording
    bodies: tuple[RigidBody, ...]
    names: tuple[str, ...]
    body: Ints
    noise: float
    frames: int
    stds: dict[str, tuple[float, float]]
    notes: tuple[str, ...]

    def places(self) -> dict[str, Floats]:
        """(n, 3) positions of each body's points [m] in its frame; for the base, in the recording's frame."""
        base, first = self.bodies[0], int(np.flatnonzero(self.bodies[0].is_seen)[0])
        standing = base.shape @ base.turns[first].T + base.positions[first]
        return {self.names[0]: standing} | {
            name: body.shape for name, body in zip(self.names[1:], self.bodies[1:], strict=True)
        }


def track_points(tracks: PointTracks, rate: float) -> TrackedPoints:
    """The bodies that points are on, and a recording of their poses.

    Args:
        rate: frames per second.

    Raises:
        InputError: if too few points are seen, no body is found, or only one.
    """
    places = np.where(np.isfinite(tracks.places), tracks.places, np.nan)
    points, frames = places.shape[:2]
    if points < 2 * FEWEST_POINTS or frames < 3:
        problem = f"expected {2 * FEWEST_POINTS} points and 3 frames at least, found {points} and {frames}"
        raise InputError(problem, remedy="track more points")
    bodies = rigid_bodies(places)
    if not bodies:
        raise InputError("no four points keep their distances", remedy="check the unit, --axes, and the tracks")
    standing = [_is_static(body) for body in bodies]
    # What stands before a camera that stands is the base, however many points are on what moves.
    bodies = tuple(bodies[k] for k in sorted(range(len(bodies)), key=lambda k: not standing[k]))
    base, others = bodies[0], bodies[1:]
    if not others:
        way = _largest_way(base)
        problem = f"one rigid body only: no other one moves, it moves by {quantity(way, 'm', digits=2)}"
        raise InputError(problem, remedy="track points on what stands and on what moves, while it moves")
    names = ("base", *_names(others, tracks.names))
    first = None if any(standing) else int(np.flatnonzero(base.is_seen)[0])
    poses = {name: _relative(base, body, first) for name, body in zip(names[1:], others, strict=True)}
    stds = {name: (float(np.median(own[3])), float(np.median(own[4]))) for name, own in poses.items() if len(own[0])}
    label = np.full(points, -1)
    for number, body in enumerate(bodies):
        label[body.points] = number
    notes = _notes(bodies, names, stds, label)
    of_name = dict(zip(names[1:], others, strict=True))
    errors = {name: _shared_error(base, of_name[name], poses[name][0], first) for name in stds}
    recording = with_shared_errors(_recording(poses, rate, notes), errors)
    return TrackedPoints(recording, bodies, names, label, base.noise, frames, stds, notes)


def _names(bodies: Sequence[RigidBody], markers: Sequence[str]) -> list[str]:
    """Names of bodies: the common prefix of their markers if it is unique, else a number."""
    names = []
    for number, body in enumerate(bodies, start=1):
        own = [markers[k] for k in body.points] if markers else [""]
        is_common = [len(set(letters)) == 1 for letters in zip(*own, strict=False)]
        common = own[0][: (*is_common, False).index(False)]
        name = common.rpartition(":")[2].strip(" _-.0123456789")
        names.append(name if name and name != "base" and name not in names else f"body {number}")
    return names


def _largest_way(body: RigidBody) -> float:
    """Diagonal of the box around a body's positions [m]."""
    at = body.positions[body.is_seen]
    return float(np.linalg.norm(np.ptp(at, axis=0))) if len(at) else 0.0


def _is_static(base: RigidBody) -> bool:
    """Whether a body is static before the camera: its pose is constant within noise.

    Means over parts of the frames differ by no more than noise, the noise of one divided by their number; poses by the
    same points share their errors, as large as the noise of all frames together.
    """
    frames = np.flatnonzero(base.is_seen)
    if len(frames) < 2 * _PARTS:
        return False
    middle = Rotation.from_matrix(base.turns[frames]).mean()
    away = (middle.inv() * Rotation.from_matrix(base.turns[frames])).as_rotvec()
    away = np.hstack([base.positions[frames] - base.positions[frames].mean(axis=0), middle.apply(away)])
    total, parts = 0.0, np.array_split(np.arange(len(frames)), _PARTS)
    for part in parts:
        covariance = np.mean([base.covariance(int(frames[k])) for k in part], axis=0)
        mean = away[part].mean(axis=0)
        total += float(mean @ np.linalg.pinv(covariance) @ mean) / (1.0 / len(part) + 1.0 / len(frames))
    return total < float(chdtri(6 * (len(parts) - 1), _RARELY))


def _relative(base: RigidBody, body: RigidBody, first: int | None) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Frames, positions, rotations and stds of a body in the camera's frame, or in that of the first frame.

    Args:
        first: the frame that poses are brought to by the base; None: the camera stands, and no base is needed.
    """
    if first is None:
        frames = np.flatnonzero(body.is_seen)
        positions, turns = body.positions[frames], body.turns[frames]
        spread = np.array([np.diagonal(body.covariance(int(k))) for k in frames]).reshape(-1, 6)
    else:
        frames = np.flatnonzero(base.is_seen & body.is_seen)
        back = np.einsum("ij,tkj->tik", base.turns[first], base.turns[frames])
        positions = np.einsum("tij,tj->ti", back, body.positions[frames] - base.positions[frames])
        positions += base.positions[first]
        turns = back @ body.turns[frames]
        both = [np.diagonal(body.covariance(int(k)) + base.covariance(int(k))) for k in frames]
        spread = np.array(both).reshape(-1, 6)
    place, turn = (np.sqrt(spread[:, s].sum(axis=1) / 3.0) for s in (slice(0, 3), slice(3, 6)))
    kept = turn < _NO_TURN
    return frames[kept], positions[kept], turns[kept], place[kept], turn[kept]


def _shared_error(base: RigidBody, body: RigidBody, frames: Ints, first: int | None) -> SharedError:
    """Errors that averaging over frames does not reduce.

    With a moving camera all poses are transformed to that of the first frame, whose place is known from that frame
    alone. And each point's place in a body is estimated from all frames in which it is seen, so poses by nearly the
    same points share their errors.
    """
    if first is None:
        of_body = np.mean([body.covariance(int(k)) for k in frames], axis=0)
        return SharedError(np.zeros((6, 6)), of_body / len(frames))
    x, y, z = base.positions[first]
    # A turn w about the base's origin b moves the camera's by -w x b.
    at_camera = np.eye(6)
    at_camera[:3, 3:] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    of_poses = np.mean([base.covariance(int(k)) + body.covariance(int(k)) for k in frames], axis=0)
    return SharedError(at_camera @ base.covariance(first) @ at_camera.T, of_poses / len(frames))


def _recording(
    poses: dict[str, tuple[Ints, Floats, Floats, Floats, Floats]], rate: float, notes: tuple[str, ...]
) -> Recording:
    rows = sorted(
        (int(frame), name, position, turn)
        for name, (frames, positions, turns, _, _) in poses.items()
        for frame, position, turn in zip(frames, positions.tolist(), turns.tolist(), strict=True)
    )
    if not rows:
        raise InputError("no body is seen together with the base", remedy="track points that are seen for longer")
    return Recording(
        time=np.array([frame for frame, _, _, _ in rows]) / rate,
        position=np.array([position for _, _, position, _ in rows]),
        quaternion=Rotation.from_matrix(np.array([turn for _, _, _, turn in rows])).as_quat(canonical=True),
        part=tuple(name for _, name, _, _ in rows),
        has_part=True,
        notes=notes,
    )


def _notes(
    bodies: Sequence[RigidBody], names: Sequence[str], stds: dict[str, tuple[float, float]], label: Ints
) -> tuple[str, ...]:
    notes = []
    for name, body in zip(names, bodies, strict=True):
        if len(body.points) < _ENOUGH_POINTS and name in stds:
            turn = quantity(stds[name][1], "rad", digits=2, degrees=False)
            notes.append(f"{name} has {count(len(body.points), 'point')}: its turns are known to {turn} only")
    for name, (place, _) in stds.items():
        number = names.index(name)
        if _largest_way(bodies[number]) < _MOVES * place and _largest_way(bodies[0]) < _MOVES * place:
            notes.append(f"{name} does not move")
    lost = int((label < 0).sum())
    if lost:
        notes.append(f"{count(lost, 'point')} of {len(label)} moved with no body and were left out")
    return tuple(notes)


def points_table(found: TrackedPoints) -> bytes:
    """A CSV file: number of each point, and the body that it is on (empty: none)."""
    rows = (f"{number},{found.names[body] if body >= 0 else ''}" for number, body in enumerate(found.body.tolist()))
    return ("\n".join(("point,body", *rows)) + "\n").encode()
