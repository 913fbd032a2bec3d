"""Camera models: the projection of directions to pixels, and their files."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.documents.yaml_lines import read_yaml
from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes
from micah_plan.vision.opencv import opencv

_KINDS = (
    "a ROS camera_info (YAML), OpenCV's calibration (YAML), Kalibr's camchain (YAML) or RealSense intrinsics (JSON)"
)
# Distortion models that are OpenCV's own five or eight numbers.
_BROWN = ("plumb_bob", "rational_polynomial", "radtan", "brown-conrady", "none", "")


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with the distortion of Brown and Conrady, as OpenCV has it.

    Attributes:
        matrix: (3, 3) intrinsic matrix [px].
        distortion: (k,) k1, k2, p1, p2, k3 and so on; k may be 0.
        size: width and height of its pictures [px]; None: not stated.
        uncertainty: std of the focal length as a share of it; 0 for a calibrated one.
    """

    matrix: Floats
    distortion: Floats
    size: tuple[int, int] | None = None
    uncertainty: float = 0.0

    def with_focal_length(self, focal: float) -> Camera:
        """The camera with another focal length [px]."""
        matrix = self.matrix.copy()
        matrix[0, 0] = matrix[1, 1] = focal
        return Camera(matrix, self.distortion, self.size, self.uncertainty)


def guessed_camera(width: int, height: int) -> Camera:
    """A camera with the given image size, a central axis and a usual field of view."""
    focal = 1.2 * max(width, height) * 0.6
    matrix = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    return Camera(matrix, np.zeros(0), (width, height))


def load_camera(path: str | Path) -> Camera:
    """The camera that a file describes.

    Raises:
        InputError: if it is of an unknown kind, or cannot be used.
    """
    content = read_bytes(path)
    if content.lstrip().startswith(b"%YAML:1.0"):
        return _checked(_of_opencv(path), path)
    if Path(path).suffix.lower() == ".json":
        try:
            data: Any = json.loads(content)
        except (ValueError, RecursionError):
            raise InputError("expected JSON", source=path, remedy=f"give {_KINDS}") from None
    else:
        data = read_yaml(content, str(path)).data
    if not isinstance(data, Mapping):
        raise InputError("expected keys", source=path, remedy=f"give {_KINDS}")
    for reader in (_of_camera_info, _of_kalibr, _of_realsense):
        found = reader(data, path)
        if found is not None:
            return _checked(found, path)
    raise InputError("expected intrinsics of a camera, found none", source=path, remedy=f"give {_KINDS}")


def _numbers(entry: Any, counts: Sequence[int], path: str | Path, key: str) -> Floats:
    """(k,) finite numbers of an entry, with one of the allowed lengths."""
    values = entry.get("data") if isinstance(entry, Mapping) else entry
    try:
        numbers = np.array(values, dtype=float).ravel()
    except (TypeError, ValueError):
        numbers = np.full(1, np.nan)
    if len(numbers) not in counts or not np.isfinite(numbers).all():
        expected = " or ".join(map(str, counts))
        raise InputError(f"expected {expected} numbers", source=path, where=f"key '{key}'", remedy=f"give {_KINDS}")
    return numbers


def _size(data: Mapping[str, Any], names: tuple[str, str]) -> tuple[int, int] | None:
    sides = [data.get(name) for name in names]
    return (int(sides[0]), int(sides[1])) if all(isinstance(side, int) for side in sides) else None  # type: ignore[arg-type]


def _check_distortion_model(name: Any, path: str | Path) -> None:
    """Refuse distortion models that are not OpenCV's polynomial."""
    text = (
        str(name or "").lower().replace(" ", "-").removeprefix("distortion.").replace("brown_conrady", "brown-conrady")
    )
    if text not in _BROWN:
        problem = f"expected a camera with the distortion plumb_bob (radtan), found {shown(str(name))}"
        raise InputError(
            problem, source=path, remedy="undistort the video first, and give the camera without distortion"
        )


def _of_camera_info(data: Mapping[str, Any], path: str | Path) -> Camera | None:
    """ROS: a file of camera_calibration, or a CameraInfo message as text (ROS 1 and 2)."""
    key = next((name for name in ("camera_matrix", "K", "k") if name in data), None)
    if key is None:
        return None
    _check_distortion_model(data.get("distortion_model", "plumb_bob"), path)
    matrix = _numbers(data[key], (9,), path, key).reshape(3, 3)
    name = next((name for name in ("distortion_coefficients", "D", "d") if name in data), None)
    distortion = _numbers(data[name], (0, 4, 5, 8, 12), path, name) if name else np.zeros(0)
    return Camera(matrix, distortion, _size(data, ("image_width", "image_height")) or _size(data, ("width", "height")))


def _of_kalibr(data: Mapping[str, Any], path: str | Path) -> Camera | None:
    first = data.get("cam0", data)
    if not isinstance(first, Mapping) or "intrinsics" not in first or isinstance(first["intrinsics"], Mapping):
        return None
    if first.get("camera_model", "pinhole") != "pinhole":
        problem = f"expected camera_model pinhole, found {shown(str(first['camera_model']))}"
        raise InputError(problem, source=path, remedy="calibrate it as a pinhole camera")
    _check_distortion_model(first.get("distortion_model", "radtan"), path)
    fx, fy, cx, cy = _numbers(first["intrinsics"], (4,), path, "intrinsics")
    distortion = _numbers(first.get("distortion_coeffs", []), (0, 4, 5), path, "distortion_coeffs")
    sides = first.get("resolution")
    size = tuple(_numbers(sides, (2,), path, "resolution").astype(int).tolist()) if sides is not None else None
    return Camera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), distortion, size)


def _of_realsense(data: Mapping[str, Any], path: str | Path) -> Camera | None:
    if not {"fx", "fy"} <= set(data) or not ({"ppx", "ppy"} <= set(data) or {"cx", "cy"} <= set(data)):
        return None
    centre = ("ppx", "ppy") if "ppx" in data else ("cx", "cy")
    fx, fy, cx, cy = _numbers([data["fx"], data["fy"], *(data[name] for name in centre)], (4,), path, "fx")
    distortion = _numbers(data.get("coeffs", []), (0, 4, 5), path, "coeffs")
    if distortion.any():
        _check_distortion_model(data.get("model", ""), path)
    return Camera(
        np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), distortion, _size(data, ("width", "height"))
    )


def _of_opencv(path: str | Path) -> Camera:
    cv2 = opencv()
    try:
        file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        nodes = {name: file.getNode(name).mat() for name in ("camera_matrix", "distortion_coefficients")}
        sides = [file.getNode(name) for name in ("image_width", "image_height")]
        size = None if any(side.empty() for side in sides) else tuple(int(side.real()) for side in sides)
    except cv2.error:
        raise InputError("expected OpenCV's calibration (YAML)", source=path, remedy=f"give {_KINDS}") from None
    if nodes["camera_matrix"] is None:
        raise InputError("missing key 'camera_matrix'", source=path, remedy=f"give {_KINDS}")
    distortion = nodes["distortion_coefficients"]
    return Camera(
        _numbers(nodes["camera_matrix"], (9,), path, "camera_matrix").reshape(3, 3),
        np.zeros(0) if distortion is None else np.asarray(distortion, dtype=float).ravel(),
        size,  # type: ignore[arg-type]
    )


def _checked(camera: Camera, path: str | Path) -> Camera:
    fx, fy, cx, cy = camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2]
    width, height = camera.size or (math.inf, math.inf)
    if not (fx > 1.0 and fy > 1.0 and 0.0 <= cx <= width and 0.0 <= cy <= height):
        problem = f"expected focal lengths and a centre in px, found {fx:g}, {fy:g} and ({cx:g}, {cy:g})"
        raise InputError(problem, source=path, remedy="give the intrinsics in px, of pictures of this size")
    return camera
