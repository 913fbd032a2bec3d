"""From a video with printed tags to a recording of the parts' poses in the frame of the base.

If no file states it, the focal length is the one that makes the squares square: it is estimated from the tags
themselves, and its uncertainty is reported, since all lengths share it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, shown
from micah_plan.quantities import count, percent, quantity
from micah_plan.recording.shared_error import SharedError, with_shared_errors
from micah_plan.recording.tag_layout import TagLayout, Up
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress
from micah_plan.vision.camera import Camera, guessed_camera
from micah_plan.vision.corners import Corners, detector
from micah_plan.vision.tag_poses import (
    Pose,
    Sighting,
    chosen_poses,
    corner_noise,
    corners_of,
    placed_corners,
    pooled,
    sighting,
)
from micah_plan.vision.video import grey_frames

# A tag of fewer pixels has an ambiguous tilt (measured: 19 px seen head-on put an axis off by 59 mrad).
_ENOUGH_PX = 25.0
# Frames that the focal length is found from, and the range in which it is sought, over the larger side of a picture.
_FOCAL_FRAMES, _FOCAL_RANGE = 25, (0.35, 6.0)
# Stds between a camera's file and the estimate from tags from which on the file is doubted.
_DOUBTED = 3.0
# Distortion k1 of an uncalibrated lens, one std.
_BENT = 0.06
# Times the std of one rotation from which on the effect of such a lens on directions is reported.
_MATTERS = 2.0
# What a lens moves one pose by beyond all others is a flip of its tag [m, rad].
_FLIPPED = 0.01
# Std of a focal length, as a share of it, where the camera's axis need not meet the middle of the picture.
_OF_AXIS = 0.02
# Of the variance of a pose, what its neighbours share (`benchmarks video_intervals`: 95 % intervals of joints hold).
_SHARED = 0.15
# An axis that turns by less than so many times its noise, or a part that moves by less, does not move.
_MOVES = 5.0


@dataclass(frozen=True, eq=False)
class Footage:
    """The detections of a video, frame by frame.

    Attributes:
        video, rate: the file, and the frames per second that replace its own.
        layout: which tags are on which part.
        camera: that was used, with its focal length if that was found from the tags.
        times: (n,) of all frames [s], from 0. corners: of the tags that each frame shows.
        poses: of each part in the camera, by frame; None where it is not seen.
        base_poses: of the base in the camera, by frame; one for all where the camera stood still.
    """

    video: str | Path
    rate: float | None
    layout: TagLayout
    camera: Camera
    times: Floats
    corners: Sequence[Corners]
    poses: Mapping[str, Sequence[Pose | None]]
    base_poses: Sequence[Pose | None]


@dataclass(frozen=True, eq=False)
class Tracked:
    """Poses of the parts in a video.

    Attributes:
        recording: poses of the parts in the frame of the base's tags; frames that do not show a part are left out.
        footage: its source.
        noise: std of a corner [px].
        is_fixed: whether the camera stood still, so that the base is known in all frames.
        base: part in whose frame the poses are. stds: (position [m], turn [rad]) of the poses of each part, median.
        notes: remarks, one sentence each.
    """

    recording: Recording
    footage: Footage
    noise: float
    is_fixed: bool
    base: str
    stds: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...]

    @property
    def camera(self) -> Camera:
        """The camera that was used."""
        return self.footage.camera

    @property
    def frames(self) -> int:
        """How many frames the video has."""
        return len(self.footage.times)

    def rows_of(self, part: str) -> int:
        """Number of frames with both the part and the base."""
        return sum(name == part for name in self.recording.part)


def track_tags(
    video: str | Path,
    layout: TagLayout,
    camera: Camera | None = None,
    *,
    base: str | None = None,
    rate: float | None = None,
    progress: Progress | None = None,
) -> Tracked:
    """The poses of tagged parts in a video.

    Args:
        camera: that made it; None: its focal length is found from the tags.
        base: part whose frame the poses are in; default: the part called base, else the first.
        rate: frames per second, in place of the video's own.

    Raises:
        InputError: if a file cannot be used, or the base or all parts are never seen.
        MissingDependencyError: without OpenCV.
    """
    base = _base(layout, base)
    times, frames, size = _detected(video, layout, rate, progress)
    _check_seen(video, layout, frames, base)
    used, notes_on_camera = _camera(camera, size, layout, frames)
    placed = placed_corners(layout, frames, used)
    sightings = {part: [sighting(placed[part], frame, used) for frame in frames] for part in layout.parts}
    noise = corner_noise([each for of_part in sightings.values() for each in of_part if each is not None])
    poses = {part: chosen_poses(of_part, times, noise, used) for part, of_part in sightings.items()}
    still = pooled(poses[base], sightings[base], used)
    as_seen: list[Pose | None] = list(poses[base]) if still is None else [still] * len(frames)
    of_base = poses[base] = [None if pose is None else _upright(pose, layout.up) for pose in as_seen]
    relative = {part: _pose_relative_to_base(poses[part], of_base) for part in layout.parts if part != base}
    together = {part: sum(pose is not None for pose in of_part) for part, of_part in relative.items()}
    if not any(together.values()):
        remedy = f"keep the tags of {shown(base)} and of the part in the picture, or name another --base"
        raise InputError(f"no part is seen together with {shown(base)}", source=video, remedy=remedy)
    stds = {part: _stds(of_part) for part, of_part in relative.items() if together[part]}
    notes = (
        *notes_on_camera,
        *_notes_on_tags(layout, frames, placed, sightings),
        *_notes_on_parts(base, together, len(frames), relative, stds),
        *_notes_on_base(base, of_base if still is None else of_base[:1]),
    )
    errors = {part: _shared_error(relative[part], of_base, poses[part], still is not None, used) for part in stds}
    if camera is None or not np.any(used.distortion):
        both = used, replace(used, distortion=np.array([_BENT, 0.0, 0.0, 0.0]))
        with_lens = {part: _with_lens(errors[part], part, base, placed, frames, both, layout.up) for part in stds}
        notes = (*notes, *(_notes_on_lens(errors, with_lens, stds) if camera is not None else ()))
        errors = with_lens if camera is None else errors
    recording = with_shared_errors(_recording(times, relative, notes), errors)
    footage = Footage(video, rate, layout, used, times - times[0], frames, poses, of_base)
    return Tracked(recording, footage, noise, still is not None, base, stds, notes)


def _upright(pose: Pose, up: Up) -> Pose:
    """A base pose rotated so that z points up, where an axis of its tags is vertical."""
    turns = {"z": (0, 0), "-z": (0, 180), "y": (0, -90), "-y": (0, 90), "x": (1, 90), "-x": (1, -90)}
    axis, angle = turns[up]
    turn = np.round(Rotation.from_euler("xy"[axis], angle, degrees=True).as_matrix())
    return replace(pose, turn=pose.turn @ turn)


def _pose_relative_to_base(poses: Sequence[Pose | None], base: Sequence[Pose | None]) -> list[Pose | None]:
    return [
        None if pose is None or beside is None else pose.seen_from(beside)
        for pose, beside in zip(poses, base, strict=True)
    ]


def _base(layout: TagLayout, base: str | None) -> str:
    if len(layout.parts) < 2:
        raise InputError("expected tags on two parts or more", remedy="put one on what the part is joined to as well")
    if base is None:
        return "base" if "base" in layout.parts else layout.parts[0]
    if base not in layout.parts:
        remedy = f"choose one of {', '.join(layout.parts)}"
        raise InputError(f"no tag is on a part called {shown(base)}", source="--base", remedy=remedy)
    return base


def _detected(
    video: str | Path, layout: TagLayout, rate: float | None, progress: Progress | None
) -> tuple[Floats, list[Corners], tuple[int, int]]:
    """(times (F,), corners of each frame, size of the pictures)."""
    find, times, frames, size = detector(layout.family), list[float](), list[Corners](), (0, 0)
    for time, grey in grey_frames(video, rate):
        shape = (int(grey.shape[1]), int(grey.shape[0]))
        if frames and shape != size:
            problem = f"expected pictures of {size[0]}x{size[1]}, found one of {shape[0]}x{shape[1]}"
            raise InputError(problem, source=video, remedy="put pictures of one camera into a folder")
        size = shape
        times.append(time)
        frames.append(find(grey))
        if progress is not None and len(frames) % 30 == 0:
            progress(f"{count(len(frames), 'frame')}", min(0.9, len(frames) / 3000.0))
    of_layout = [{number: frame[number] for number in frame if number in layout.tags} for frame in frames]
    return np.array(times), of_layout, size


def _of_size(camera: Camera, size: tuple[int, int]) -> Camera:
    if camera.size is None or camera.size == size:
        return camera
    width, height = camera.size
    if width * size[1] != height * size[0]:
        problem = f"the camera is for pictures of {width}x{height}, those of the video have {size[0]}x{size[1]}"
        raise InputError(
            problem, source="--camera", remedy="give the camera of this format: part of its view is cut off"
        )
    scale = size[0] / width
    matrix = camera.matrix * np.array([[scale], [scale], [1.0]])
    matrix[:2, 2] = scale * (camera.matrix[:2, 2] + 0.5) - 0.5  # the middle of the first pixel is at 0
    return replace(camera, matrix=matrix, size=size)


def _check_seen(video: str | Path, layout: TagLayout, frames: Sequence[Corners], base: str) -> None:
    numbers = {number for frame in frames for number in frame}
    if not numbers:
        remedy = "check the family, more light, larger tags with a white border, less blur"
        problem = f"in none of {count(len(frames), 'frame')} is a tag of the family {layout.family} with a given number"
        raise InputError(problem, source=video, remedy=remedy)
    if not numbers & set(layout.of(base)):
        remedy = f"choose another --base, or check the numbers: seen were {', '.join(map(str, sorted(numbers)))}"
        raise InputError(f"no tag of the base {shown(base)} is ever seen", source=video, remedy=remedy)


def _camera(
    camera: Camera | None, size: tuple[int, int], layout: TagLayout, frames: Sequence[Corners]
) -> tuple[Camera, list[str]]:
    """(camera to use, notes)."""
    of_file = guessed_camera(*size) if camera is None else _of_size(camera, size)
    of_tags = _focal_length(of_file, layout, frames)
    focal, off = of_tags.matrix[0, 0], 2.0 * of_tags.uncertainty
    if camera is None:
        return of_tags, [
            f"no camera file: f = {focal:.0f} px from the tags; lengths may be off by {percent(min(off, 1.0), 0)}, "
            "and more where the lens bends straight lines"
        ]
    if abs(float(np.log(focal / of_file.matrix[0, 0]))) < _DOUBTED * of_tags.uncertainty:
        return of_file, []
    return of_file, [
        f"the camera file has f = {of_file.matrix[0, 0]:.0f} px, but squares are square at {focal:.0f} ± "
        f"{focal * off:.0f} px: is it of this camera, its zoom and this size of pictures?"
    ]


def _focal_length(camera: Camera, layout: TagLayout, frames: Sequence[Corners]) -> Camera:
    """The camera with the focal length under which tags are square, and its uncertainty."""
    able = [frame for frame in frames if frame]
    chosen = [able[k] for k in np.unique(np.linspace(0, len(able) - 1, _FOCAL_FRAMES).astype(int))]
    largest = max(camera.size or (1, 1))
    alone = [(number, {number: frame[number]}) for frame in chosen for number in sorted(frame)]

    def misfit(log_focal: float) -> float:
        tried = camera.with_focal_length(float(np.exp(log_focal)))
        squares = ({number: corners_of(layout.tags[number])} for number, _ in alone)
        sightings = (sighting(square, frame, tried) for square, (_, frame) in zip(squares, alone, strict=True))
        misfits = np.array([each.misfit for each in sightings if each is not None])
        scale = max(float(np.median(misfits)), 1e-6)
        return float((scale * np.log1p(misfits / scale)).sum()) if len(misfits) else np.inf

    low, high = (float(np.log(share * largest)) for share in _FOCAL_RANGE)
    grid = np.linspace(low, high, 25)
    values = [misfit(at) for at in grid]
    k = int(np.argmin(values))
    bounds = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    best = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-3})
    step, freedom = 0.05, max(2 * len(alone), 1)
    curvature = (misfit(best.x + step) - 2.0 * best.fun + misfit(best.x - step)) / step**2
    noise = best.fun / freedom
    of_corners = float(np.sqrt(2.0 * noise / curvature)) if curvature > 0.0 else 1.0
    uncertainty = float(np.hypot(of_corners, _OF_AXIS))
    return replace(camera.with_focal_length(float(np.exp(best.x))), uncertainty=min(uncertainty, 1.0))


def _stds(poses: Sequence[Pose | None]) -> tuple[float, float]:
    """Medians of the stds of a position [m] and of a turn [rad], in any direction."""
    every = np.array([pose.covariance for pose in poses if pose is not None])
    return tuple(
        float(np.median(np.sqrt(np.trace(every[:, s, s], axis1=1, axis2=2) / 3.0))) for s in (slice(0, 3), slice(3, 6))
    )  # type: ignore[return-value]


def _shared_error(
    poses: Sequence[Pose | None],
    of_base: Sequence[Pose | None],
    of_part: Sequence[Pose | None],
    is_fixed: bool,
    camera: Camera,
) -> SharedError:
    """Errors that averaging over frames does not reduce.

    Args:
        poses: of the part in the frame of the base. of_base, of_part: both in the camera.
    """
    if not is_fixed:
        every = [pose.covariance for pose in poses if pose is not None]
        return SharedError(np.zeros((6, 6)), _SHARED * np.mean(every, axis=0), camera.uncertainty)
    base = next(pose for pose in of_base if pose is not None)
    along = np.kron(np.eye(2), base.turn.T)
    mean = np.mean([pose.covariance for pose in of_part if pose is not None], axis=0)
    return SharedError(along @ base.covariance @ along.T, _SHARED * along @ mean @ along.T, camera.uncertainty)


def _notes_on_lens(
    errors: Mapping[str, SharedError], with_lens: Mapping[str, SharedError], stds: Mapping[str, tuple[float, float]]
) -> list[str]:
    """Notes on possible distortion where the camera file states none: unrectified images look like a pinhole's."""
    turned = {part: float(np.sqrt(np.trace((with_lens[part].frame - errors[part].frame)[3:, 3:]))) for part in stds}
    worst = max(turned, key=lambda part: turned[part])
    if turned[worst] < _MATTERS * stds[worst][1]:
        return []
    return [
        "the camera file has a lens without distortion: if these pictures were not rectified, directions may be "
        f"off by {quantity(turned[worst], 'rad', digits=2, degrees=False)}; calibrate it with --camera-from"
    ]


def _with_lens(
    error: SharedError,
    part: str,
    base: str,
    placed: Mapping[str, Mapping[int, Floats]],
    frames: Sequence[Corners],
    cameras: tuple[Camera, Camera],
    up: Up,
) -> SharedError:
    """The error including that of a typical lens distortion, where none is stated."""
    frame_moved, places = [], []
    both = [frame for frame in frames if not placed[part].keys().isdisjoint(frame)]
    both = [frame for frame in both if not placed[base].keys().isdisjoint(frame)]
    for k in np.unique(np.linspace(0, len(both) - 1, _FOCAL_FRAMES).astype(int)) if both else ():
        plain, bent = (_relative_pose(placed[part], placed[base], both[k], camera, up) for camera in cameras)
        if plain is None or bent is None:
            continue
        turn = Rotation.from_matrix(bent.turn @ plain.turn.T).as_rotvec()
        # As a move of the frame: a point p is moved by v + w x p.
        frame_moved.append(np.concatenate([bent.position - plain.position - np.cross(turn, plain.position), turn]))
        places.append(plain.position)
    if not frame_moved:
        return error
    every = np.array(frame_moved)
    middle = np.median(every, axis=0)  # flipped ones count for nothing
    away = np.clip(every - middle, -np.abs(middle) - _FLIPPED, np.abs(middle) + _FLIPPED)
    left = np.concatenate([away[:, :3] + np.cross(away[:, 3:], np.array(places)), away[:, 3:]], axis=1)
    return replace(error, frame=error.frame + np.outer(middle, middle), pose=error.pose + left.T @ left / len(left))


def _relative_pose(
    tags: Mapping[int, Floats], of_base: Mapping[int, Floats], frame: Corners, camera: Camera, up: Up
) -> Pose | None:
    """The likeliest pose of a part in the base frame from one image."""
    both = sighting(tags, frame, camera), sighting(of_base, frame, camera)
    if both[0] is None or both[1] is None:
        return None
    part, base = (min(each.poses, key=lambda pose: pose.misfit) for each in both if each is not None)
    return part.seen_from(_upright(base, up))


def _recording(times: Floats, relative: Mapping[str, Sequence[Pose | None]], notes: tuple[str, ...]) -> Recording:
    rows = [
        (times[k], part, pose)
        for k in range(len(times))
        for part, poses in relative.items()
        if (pose := poses[k]) is not None
    ]
    return Recording(
        time=np.array([time for time, _, _ in rows]) - times[0],
        position=np.array([pose.position for _, _, pose in rows]),
        quaternion=Rotation.from_matrix(np.array([pose.turn for _, _, pose in rows])).as_quat(canonical=True),
        part=tuple(part for _, part, _ in rows),
        has_part=True,
        notes=notes,
    )


def _notes_on_tags(
    layout: TagLayout,
    frames: Sequence[Corners],
    placed: Mapping[str, Mapping[int, Floats]],
    sightings: Mapping[str, Sequence[Sighting | None]],
) -> list[str]:
    notes = []
    for number, tag in layout.tags.items():
        sizes = [
            float(np.linalg.norm(f[number] - np.roll(f[number], 1, axis=0), axis=1).mean())
            for f in frames
            if number in f
        ]
        if not sizes:
            notes.append(f"tag {number} ({tag.part}) is never seen")
        elif number not in placed[tag.part]:
            notes.append(
                f"tag {number} ({tag.part}) is never seen together with another of its part, so it was left out"
            )
        elif np.median(sizes) < _ENOUGH_PX and max(len(s.points) for s in sightings[tag.part] if s is not None) == 4:
            notes.append(
                f"tag {number} ({tag.part}) is {np.median(sizes):.0f} px wide; below {_ENOUGH_PX:.0f} px its tilt is "
                "ambiguous: come closer, print it larger or add a second tag"
            )
    return notes


def _notes_on_base(base: str, poses: Sequence[Pose | None]) -> list[str]:
    """Notes on the accuracy of the base frame of a static camera, which more frames do not improve."""
    place, turn = _stds(poses)
    known = f"{quantity(place, 'm', digits=2)} and {quantity(turn, 'rad', digits=2, degrees=False)}"
    return [f"the frame of {base} is known to {known}; axes of joints are no better"] if len(poses) == 1 else []


def _notes_on_parts(
    base: str,
    together: Mapping[str, int],
    frames: int,
    relative: Mapping[str, Sequence[Pose | None]],
    stds: Mapping[str, tuple[float, float]],
) -> list[str]:
    notes = []
    for part, number in together.items():
        if number < 0.5 * frames:
            notes.append(f"{part} and {base} are seen together in {number} of {frames} frames")
        if part not in stds:
            continue
        places = np.array([pose.position for pose in relative[part] if pose is not None])
        turns = Rotation.from_matrix(np.array([pose.turn for pose in relative[part] if pose is not None]))
        way = float(np.linalg.norm(np.ptp(places, axis=0)))
        turned = float((turns[0].inv() * turns).magnitude().max())
        if way < _MOVES * stds[part][0] and turned < _MOVES * stds[part][1]:
            notes.append(f"{part} moves by less than {quantity(max(way, 1e-6), 'm')} relative to {base}")
    return notes
