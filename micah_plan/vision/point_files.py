"""Tracks of points from files of trackers and of motion capture.

NPZ: one array of places (points, frames, 3) or (frames, points, 3), as TAPVid-3D, SpatialTracker and CoTracker (after
lifting) write them, and whether each is visible; or of pixels (points, frames, 2) with the depth of each, or with maps
of depth (frames, height, width), and the camera. A leading axis of one clip is taken off.
Markers: TRC (OpenSim, Motion Analysis), C3D (by ezc3d, where it is installed) and tables with a column for each of
``NAME_x``, ``NAME_y``, ``NAME_z``.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.errors import InputError, MissingDependencyError, located_in, shown
from micah_plan.files import read_bytes
from micah_plan.recording.conventions import LENGTHS
from micah_plan.recording.csv_file import csv_columns
from micah_plan.recording.text import read_lines
from micah_plan.vision.camera import Camera

Axes = Literal["points,frames", "frames,points"]
POINT_FILES = (".npz", ".trc", ".c3d", ".csv")
"""Endings of files that may hold tracks of points."""
_VISIBLE = ("visib", "seen", "valid")
_HIDDEN = ("occlu", "hidden")
_DEPTH, _INTRINSICS = ("depth", "disp_z"), ("intrinsics", "K", "camera_matrix", "fx_fy_cx_cy")
_MOST_NUMBERS = 60_000_000
_MARKER = re.compile(r"(?P<name>.+?)[ _.:]?(?P<axis>[xyzXYZ])")
_FEWEST_MARKERS = 4


@dataclass(frozen=True, eq=False)
class PointTracks:
    """Points over time.

    Attributes:
        places: (N, T, 3) [m], NaN where a point is not seen.
        rate: frames per second; None: not stated in the file.
        names: of markers; () where points have none.
    """

    places: Floats
    rate: float | None = None
    names: tuple[str, ...] = ()

    def rate_or(self, length: float | None) -> float:
        """Frames per second, as given or else from the file.

        Raises:
            InputError: if neither does.
        """
        rate = length or self.rate
        if rate is None:
            raise InputError("how many frames a second there are is not known", remedy="e.g. --rate 30")
        return rate


def holds_points(path: str | Path) -> bool:
    """Whether a file holds tracks of points rather than poses; tables of markers need the command `track`."""
    suffix = Path(path).suffix.lower()
    if suffix != ".npz":
        return suffix in (".trc", ".c3d")
    try:
        with zipfile.ZipFile(path) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
    except (OSError, zipfile.BadZipFile):
        return False
    return "position" not in names and "time" not in names


def load_points(
    path: str | Path, *, axes: Axes | None = None, unit: str | None = None, camera: Camera | None = None
) -> PointTracks:
    """The tracks that a file holds.

    Args:
        axes: order of the first two axes of an array; None: the one along which points move less is of frames.
        unit: of lengths; None: from the file, else m.
        camera: of pixels with depths; None: the one in the file.

    Raises:
        InputError: if it cannot be used; one line with the expected and the found content.
        MissingDependencyError: for C3D without ezc3d.
    """
    suffix = Path(path).suffix.lower()
    with located_in(path):
        if suffix == ".trc":
            return _of_trc(path, unit)
        if suffix == ".c3d":
            return _of_c3d(path, unit)
        if suffix == ".csv":
            return _of_table(csv_columns(path), unit)
        return _of_npz(path, axes, unit, camera)


def check_unit(unit: str) -> str:
    """The unit of a length, if it is known.

    Raises:
        InputError: if it is not.
    """
    if unit not in LENGTHS:
        raise InputError(f"unknown unit {shown(unit)}", source="--units", remedy=f"choose one of {', '.join(LENGTHS)}")
    return unit


def _of_npz(path: str | Path, axes: Axes | None, unit: str | None, camera: Camera | None) -> PointTracks:
    arrays = {name: array[0] if array.ndim > 3 and len(array) == 1 else array for name, array in _arrays(path).items()}
    in_space = [name for name, array in arrays.items() if array.ndim == 3 and array.shape[2] == 3]
    in_picture = [name for name, array in arrays.items() if array.ndim == 3 and array.shape[2] == 2]
    named = in_space or in_picture
    if len(named) != 1:
        found = f"found {', '.join(sorted(named)) or ', '.join(sorted(arrays)) or 'none'}"
        problem = f"expected one array (points, frames, 3) or (frames, points, 3), {found}"
        raise InputError(problem, remedy="store the tracks in space [x, y, z] alone, e.g. as 'tracks'")
    tracks = arrays[named[0]].astype(np.float64)
    visible = _visible(arrays, tracks.shape[:2])
    if axes is None:
        first, second = tracks.shape[:2]
        if first == second:
            problem = f"the tracks '{named[0]}' {tracks.shape} may be of points or frames first"
            raise InputError(problem, remedy="add --axes points,frames or --axes frames,points")
        axes = _axes_of(tracks)
    points_first = axes == "points,frames"
    if not points_first:
        tracks, visible = tracks.transpose(1, 0, 2), visible.T
    if not in_space:
        tracks = _lifted(tracks, arrays, points_first, camera or _camera(arrays))
    scale = LENGTHS[unit or "m"]
    return PointTracks(np.where(visible[..., None], tracks, np.nan) * scale)


def _arrays(path: str | Path) -> dict[str, Any]:
    try:
        with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as file:
            sizes = [info.file_size for info in file.zip.infolist()] if hasattr(file, "zip") else [0]
            if sum(sizes) > 8 * _MOST_NUMBERS:
                raise InputError("expected at most 480 MB of arrays", remedy="store fewer points or frames")
            arrays = {name: np.asarray(file[name]) for name in file.files}
            return {name: array for name, array in arrays.items() if array.dtype.kind in "fiub"}
    except (ValueError, OSError, EOFError, AttributeError, zipfile.BadZipFile):
        remedy = "write it with numpy.savez(path, tracks=..., visibility=...)"
        raise InputError("expected an NPZ file of plain arrays", remedy=remedy) from None


def _visible(arrays: Mapping[str, Any], shape: tuple[int, ...]) -> Booleans:
    """(N, T) whether points are visible, from an array of that name; all if there is none."""
    for name, array in arrays.items():
        is_hidden = any(word in name.lower() for word in _HIDDEN)
        if not is_hidden and not any(word in name.lower() for word in _VISIBLE):
            continue
        own = array[..., 0] if array.ndim == 3 and array.shape[2] == 1 else array
        if own.shape != tuple(shape):
            problem = f"expected '{name}' {tuple(shape)} as the tracks, found {own.shape}"
            raise InputError(problem, remedy="store both with the same axes")
        numbers = np.nan_to_num(own.astype(np.float64))
        return np.asarray(numbers < 0.5 if is_hidden else numbers > 0.5)
    return np.ones(shape, dtype=bool)


def _axes_of(tracks: Floats) -> Axes:
    """The order of axes, from the observation that points move less between frames than they differ."""
    steps = [float(np.nanmedian(np.linalg.norm(np.diff(tracks, axis=axis), axis=-1))) for axis in (0, 1)]
    return "frames,points" if steps[0] < steps[1] else "points,frames"


def _camera(arrays: Mapping[str, Any]) -> Camera:
    for name in _INTRINSICS:
        if name not in arrays:
            continue
        numbers = np.asarray(arrays[name], dtype=np.float64)
        numbers = numbers[0] if numbers.ndim == 3 else numbers
        if numbers.shape == (3, 3):
            return Camera(numbers, np.zeros(0))
        if numbers.shape == (4,):
            fx, fy, cx, cy = numbers.tolist()
            return Camera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), np.zeros(0))
    problem = "tracks in pixels need the camera's intrinsics"
    raise InputError(problem, remedy="add --camera CAMERA.yaml, or store 'intrinsics' (3, 3) with them")


def _lifted(tracks: Floats, arrays: Mapping[str, Any], points_first: bool, camera: Camera) -> Floats:
    """(N, T, 3) points in the camera from pixels (N, T, 2) and depths; NaN where unknown."""
    depth = next((array for name, array in arrays.items() if any(word in name.lower() for word in _DEPTH)), None)
    if depth is None:
        problem = "tracks in pixels need the depth of each point"
        raise InputError(problem, remedy="store 'depth' with the same axes, or maps (frames, height, width)")
    depth = np.asarray(depth, dtype=np.float64)
    expected = tracks.shape[:2] if points_first else tracks.shape[1::-1]
    if depth.ndim == 3 and depth.shape[2] == 1:
        depth = depth[..., 0]
    if depth.shape == expected:
        along = depth if points_first else depth.T
    elif depth.ndim == 3 and len(depth) == tracks.shape[1]:
        along = _at_pixels(depth, tracks)
    else:
        problem = f"expected depths {tuple(expected)} or maps ({tracks.shape[1]}, height, width), found {depth.shape}"
        raise InputError(problem, remedy="store one depth for each point and frame")
    rays = _rays(tracks, camera)
    return np.asarray(rays * np.where(along > 0.0, along, np.nan)[..., None])


def _at_pixels(maps: Floats, tracks: Floats) -> Floats:
    """(N, T) of the maps (T, height, width) at the nearest pixels; 0 outside."""
    frames, height, width = maps.shape
    at = np.round(np.nan_to_num(tracks, nan=-1e6)).astype(int)
    x, y = at[..., 0], at[..., 1]
    is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    values = maps[np.arange(frames)[None], np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    return np.where(is_inside, values, 0.0)


def _rays(tracks: Floats, camera: Camera) -> Floats:
    """(N, T, 3) directions with depth 1."""
    pixels = tracks.reshape(-1, 2)
    if camera.distortion.any():
        from micah_plan.vision.opencv import opencv

        seen = np.nan_to_num(pixels)[:, None]
        straight = opencv().undistortPoints(seen, camera.matrix, camera.distortion)[:, 0]
        straight = np.where(np.isfinite(pixels), straight, np.nan)
    else:
        straight = (pixels - camera.matrix[:2, 2]) / np.diag(camera.matrix)[:2]
    return np.concatenate([straight, np.ones((len(straight), 1))], axis=1).reshape(*tracks.shape[:2], 3)


def _of_trc(path: str | Path, unit: str | None) -> PointTracks:
    """Tracks of a TRC file: a header of keys and values, marker names, axis names, then a line per frame."""
    lines = [line.rstrip("\r\n") for line in read_lines(path)]
    keys = next((k for k, line in enumerate(lines) if line.startswith("DataRate")), None)
    remedy = "give a TRC file as OpenSim and Motion Analysis write it"
    if keys is None or len(lines) < keys + 5:
        raise InputError("expected a header with DataRate and the names of markers", remedy=remedy)
    header = dict(zip(lines[keys].split(), lines[keys + 1].split(), strict=False))
    names = tuple(name.strip() for name in lines[keys + 2].split("\t")[2:] if name.strip())
    rows = []
    for number, line in enumerate(lines[keys + 4 :], start=keys + 5):
        fields = line.split("\t")
        if not line.strip():
            continue
        values = (fields[2:] + [""] * (3 * len(names)))[: 3 * len(names)]
        try:
            rows.append([float(text) if text.strip() else np.nan for text in values])
        except ValueError:
            raise InputError("expected numbers", where=f"line {number}", remedy=remedy) from None
    rate, length = header.get("DataRate", ""), unit or header.get("Units", "m")
    if not re.fullmatch(r"\d+(\.\d*)?", rate) or float(rate) <= 0.0 or length not in LENGTHS or not names:
        problem = f"expected a rate, a unit and markers, found DataRate {shown(rate)} and Units {shown(length)}"
        raise InputError(problem, remedy=remedy)
    places = np.array(rows).reshape(len(rows), len(names), 3).transpose(1, 0, 2)
    return PointTracks(places * LENGTHS[length], float(rate), names)


def _of_c3d(path: str | Path, unit: str | None) -> PointTracks:
    try:
        import ezc3d
    except ImportError:
        raise MissingDependencyError("C3D files need ezc3d: pip install ezc3d") from None
    read_bytes(path)  # that it does not exist or is a directory is the better message
    try:
        file = ezc3d.c3d(str(path))
        points, group = np.asarray(file["data"]["points"], dtype=np.float64), file["parameters"]["POINT"]
        rate, names = float(group["RATE"]["value"][0]), tuple(group["LABELS"]["value"])
        length = unit or next(iter(group.get("UNITS", {}).get("value", [])), "mm")
    except Exception as error:  # anything that a damaged file makes the library raise
        raise InputError(f"expected a C3D file ({shown(str(error))})", remedy="export it again") from None
    if length not in LENGTHS or not rate > 0.0:
        raise InputError(f"expected lengths in m or mm and a rate, found {shown(length)}", remedy="add --units mm")
    places = points[:3].transpose(1, 2, 0)
    places = np.where((np.abs(places) > 0.0).any(axis=2, keepdims=True), places, np.nan)  # zeros: not seen
    return PointTracks(places * LENGTHS[length], rate, names)


def _of_table(columns: Mapping[str, Any], unit: str | None) -> PointTracks:
    """Tracks of a table with columns ``NAME_x``, ``NAME_y`` and ``NAME_z``, and times in ``t`` or ``time``."""
    axes: dict[str, dict[str, Floats]] = {}
    for column, values in columns.items():
        match = _MARKER.fullmatch(column)
        if match is not None and np.asarray(values).dtype.kind in "fi":
            axes.setdefault(match["name"], {})[match["axis"].lower()] = np.asarray(values, dtype=np.float64)
    markers = {name: own for name, own in axes.items() if len(own) == 3}
    if len(markers) < _FEWEST_MARKERS:
        problem = f"expected columns of markers such as m1_x,m1_y,m1_z, found {shown(','.join(columns))}"
        raise InputError(problem, remedy="name them like that, or give poses to learn")
    places = np.array([np.stack([own[axis] for axis in "xyz"], axis=1) for own in markers.values()])
    return PointTracks(places * LENGTHS[unit or "m"], _rate(columns), tuple(markers))


def _rate(columns: Mapping[str, Any]) -> float | None:
    """Frames per second of a column of times; None without one."""
    time: Sequence[float] | None = next((columns[name] for name in ("t", "time", "Time") if name in columns), None)
    if time is None or len(time) < 2:
        return None
    step = float(np.median(np.diff(np.asarray(time, dtype=np.float64))))
    return 1.0 / step if step > 0.0 else None
