"""From tracks of points to a recording: the bodies that they are on, their poses, and which point is on which.

**Files.** NPZ with one array of places (points, frames, 3) or (frames, points, 3), as CoTracker, TAPVid-3D and
SpatialTracker write them after lifting, and whether each is visible.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats, Ints
from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes
from micah_plan.quantities import count, quantity
from micah_plan.recording.conventions import LENGTHS
from micah_plan.recording.value import Recording
from micah_plan.vision.rigid_bodies import FEWEST_POINTS, RigidBody, rigid_bodies

Axes = Literal["points,frames", "frames,points"]
_VISIBLE = ("visib", "seen", "valid")
_HIDDEN = ("occlu", "hidden")
_MOST_NUMBERS = 60_000_000
# Points of a body from which on nothing is said of its number.
_ENOUGH_POINTS = 7
# A turn that is known no better than that is no measurement of one [rad].
_NO_TURN = 0.3
# A body moves by more than so many of its stds.
_MOVES = 5.0


@dataclass(frozen=True, eq=False)
class TrackedPoints:
    """What tracks of points show.

    Attributes:
        recording: poses of all bodies but the base, in its frame: that of the camera in the first frame.
        bodies: most points first; the first is the base. names: of each.
        body: (N,) number of the body that each point is on; -1: on none.
        noise: std of a measurement [m]. frames: how many.
        stds: (position [m], turn [rad]) of the poses of each body but the base, median.
        notes: what to know of it, one sentence each.
    """

    recording: Recording
    bodies: tuple[RigidBody, ...]
    names: tuple[str, ...]
    body: Ints
    noise: float
    frames: int
    stds: dict[str, tuple[float, float]]
    notes: tuple[str, ...]


def load_points(path: str | Path, *, axes: Axes | None = None, unit: str = "m") -> Floats:
    """Tracks (N, T, 3) [m] of an NPZ file, NaN where a point is not seen.

    Raises:
        InputError: if it holds no such array, several, or one of which it is not known what its axes are.
    """
    arrays = _arrays(path)
    places = {name: array for name, array in arrays.items() if array.ndim == 3 and array.shape[2] == 3}
    if len(places) != 1:
        found = f"found {', '.join(sorted(places)) or ', '.join(sorted(arrays)) or 'none'}"
        problem = f"expected one array (points, frames, 3) or (frames, points, 3), {found}"
        raise InputError(problem, source=path, remedy="store the tracks in space [x, y, z] alone, e.g. as 'tracks'")
    ((name, tracks),) = places.items()
    visible = _visible(arrays, tracks.shape[:2], path)
    if axes is None:
        first, second = tracks.shape[:2]
        if first == second:
            problem = f"the tracks '{name}' {tracks.shape} may be of points or frames first"
            raise InputError(problem, source=path, remedy="say --axes points,frames or --axes frames,points")
        axes = _axes_of(tracks)
    tracks = np.where(visible[..., None], tracks.astype(np.float64), np.nan) * LENGTHS[unit]
    return np.asarray(tracks if axes == "points,frames" else tracks.transpose(1, 0, 2))


def _arrays(path: str | Path) -> dict[str, Floats]:
    try:
        with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as file:
            sizes = [info.file_size for info in file.zip.infolist()] if hasattr(file, "zip") else [0]
            if sum(sizes) > 8 * _MOST_NUMBERS:
                raise InputError(
                    "expected at most 480 MB of arrays", source=path, remedy="store fewer points or frames"
                )
            return {name: np.asarray(file[name]) for name in file.files}
    except (ValueError, OSError, EOFError, AttributeError, zipfile.BadZipFile):
        remedy = "write it with numpy.savez(path, tracks=..., visibility=...)"
        raise InputError("expected an NPZ file of plain arrays", source=path, remedy=remedy) from None


def _visible(arrays: dict[str, Floats], shape: tuple[int, ...], path: str | Path) -> Floats:
    for name, array in arrays.items():
        is_hidden = any(word in name.lower() for word in _HIDDEN)
        if not is_hidden and not any(word in name.lower() for word in _VISIBLE):
            continue
        own = array[..., 0] if array.ndim == 3 and array.shape[2] == 1 else array
        if own.shape != tuple(shape):
            problem = f"expected '{name}' {tuple(shape)} as the tracks, found {own.shape}"
            raise InputError(problem, source=path, remedy="store both with the same axes")
        numbers = np.nan_to_num(own.astype(np.float64))
        return np.asarray(numbers < 0.5 if is_hidden else numbers > 0.5)
    return np.ones(shape, dtype=bool)


def _axes_of(tracks: Floats) -> Axes:
    """Along frames points move less than from one point to another."""
    steps = [float(np.nanmedian(np.linalg.norm(np.diff(tracks, axis=axis), axis=-1))) for axis in (0, 1)]
    return "frames,points" if steps[0] < steps[1] else "points,frames"


def track_points(tracks: Floats, rate: float) -> TrackedPoints:
    """The bodies that points (N, T, 3) [m] are on, and a recording of their poses.

    Args:
        rate: frames per second.

    Raises:
        InputError: if too few points are seen, no body is found, or only one.
    """
    tracks = np.where(np.isfinite(tracks), tracks, np.nan)
    points, frames = tracks.shape[:2]
    if points < 2 * FEWEST_POINTS or frames < 3:
        problem = f"expected {2 * FEWEST_POINTS} points and 3 frames at least, found {points} and {frames}"
        raise InputError(problem, remedy="track more points")
    bodies = rigid_bodies(tracks)
    if not bodies:
        raise InputError("no four points keep their distances", remedy="check the unit, --axes, and the tracks")
    base, others = bodies[0], bodies[1:]
    if not others:
        way = _largest_way(base)
        problem = f"one rigid body only: beside it nothing moves, it moves by {quantity(way, 'm', digits=2)}"
        raise InputError(problem, remedy="track points on what stands and on what moves, while it moves")
    names = ("base", *(f"body {number}" for number in range(1, len(bodies))))
    first = int(np.flatnonzero(base.is_seen)[0])
    poses = {name: _relative(base, body, first) for name, body in zip(names[1:], others, strict=True)}
    stds = {name: (float(np.median(own[3])), float(np.median(own[4]))) for name, own in poses.items() if len(own[0])}
    label = np.full(points, -1)
    for number, body in enumerate(bodies):
        label[body.points] = number
    notes = _notes(bodies, names, stds, label)
    recording = _recording(poses, rate, notes)
    return TrackedPoints(recording, bodies, names, label, base.noise, frames, stds, notes)


def _largest_way(body: RigidBody) -> float:
    at = body.positions[body.is_seen]
    return float(np.linalg.norm(np.ptp(at, axis=0))) if len(at) else 0.0


def _relative(base: RigidBody, body: RigidBody, first: int) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Frames, positions, turns and their stds of a body in the frame of the base as it stood in the first frame."""
    frames = np.flatnonzero(base.is_seen & body.is_seen)
    back = np.einsum("ij,tkj->tik", base.turns[first], base.turns[frames])  # to the camera of the first frame
    positions = np.einsum("tij,tj->ti", back, body.positions[frames] - base.positions[frames]) + base.positions[first]
    turns = back @ body.turns[frames]
    spread = np.array([np.diagonal(body.covariance(int(k)) + base.covariance(int(k))) for k in frames]).reshape(-1, 6)
    place, turn = (np.sqrt(spread[:, s].sum(axis=1) / 3.0) for s in (slice(0, 3), slice(3, 6)))
    kept = turn < _NO_TURN
    return frames[kept], positions[kept], turns[kept], place[kept], turn[kept]


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


def check_unit(unit: str) -> str:
    """The unit of a length, if it is known.

    Raises:
        InputError: if it is not.
    """
    if unit not in LENGTHS:
        raise InputError(f"unknown unit {shown(unit)}", source="--units", remedy=f"choose one of {', '.join(LENGTHS)}")
    return unit
