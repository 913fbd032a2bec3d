"""Sub-pixel corners of a printed tag by alignment with its whole pattern, to hundredths of a pixel.

The known pattern is moved, blurred, brightened and shaded until it matches the picture (Gauss-Newton over the four
corners; Lucas and Kanade, 1981; Baker and Matthews, "Lucas-Kanade 20 years on", IJCV 2004). Every edge between two
cells counts, so the effect of blur and of a bright border on the outer edge alone hardly moves the corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from micah_plan.arrays import STDS_PER_MAD, Floats
from micah_plan.vision.opencv import opencv

# Samples per cell of the pattern, and cells of white around it that are looked at.
_FINE, _MARGIN = 10, 0.4
# Pixels of a tag that are looked at, and a sequence that fills the plane evenly (Roberts, 2018).
_EVEN = (0.7548776662, 0.5698402910)
_FEWEST_PIXELS, _MOST_PIXELS = 60, 1500
_LARGEST_CELL = 12.0  # px
_STEPS, _CONVERGED = 12, 5e-3  # px
_BLUR, _LEAST_BLUR, _MOST_BLUR = 0.25, 0.3, 4.0  # at first [cells]; bounds [px]
_RIDGE = 1e-9
# Residuals beyond so many stds are glare and fingers; a std is not less, since most of a large tag is flat, so that the
# median says nothing of what is left at its edges.
_FAR, _LEAST_STD = 2.5, 0.03
# What moves further has found something else [cells], and so has what leaves more than this share of the contrast.
_REACH, _UNEXPLAINED = 0.8, 0.3
_LEAST_CONTRAST = 0.02  # of 1 between black and white
_LEAST_SPREAD, _WIDEST = 0.1, 3 * _FINE  # of a blur [samples^2], and of its kernel [samples]
# Of the unit square, in the order of a tag's corners.
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Pattern:
    """A tag as it is printed: (n, n) cells of 0 and 1 with a margin of white, each of `_FINE` samples."""

    cells: int
    picture: Any

    @property
    def margin(self) -> float:
        """Width of the white margin [cells]."""
        return 0.5 * (float(self.picture.shape[0]) / _FINE - self.cells)


def pattern_of(markers: Any, number: int) -> Pattern:
    """The pattern of a tag of OpenCV's markers, with its black border."""
    cv2 = opencv()
    cells = int(markers.markerSize) + 2
    bits = cv2.aruco.generateImageMarker(markers, number, cells).astype(np.float32) / 255.0
    framed = np.pad(bits, 2, constant_values=1.0)
    return Pattern(cells, np.kron(framed, np.ones((_FINE, _FINE), dtype=np.float32)))


def aligned_corners(grey: Any, corners: Floats, pattern: Pattern) -> Floats | None:
    """The corners (4, 2) [px] aligned from nearby ones; None if the pattern does not match."""
    smaller = int(np.ceil(_cell(corners, pattern) / _LARGEST_CELL))
    if smaller <= 1:
        return _aligned_from(grey, corners, pattern)
    # Of a tag with many pixels most are flat: it is looked at from further away.
    low = np.maximum(np.floor(corners.min(axis=0) - 2.0 * _cell(corners, pattern)).astype(int), 0)
    high = np.ceil(corners.max(axis=0) + 2.0 * _cell(corners, pattern)).astype(int)
    crop = grey[low[1] : high[1], low[0] : high[0]]
    height, width = (length // smaller * smaller for length in crop.shape[:2])
    if min(height, width) < smaller:
        return None
    cv2 = opencv()
    shrunk = cv2.resize(crop[:height, :width], (width // smaller, height // smaller), interpolation=cv2.INTER_AREA)
    found = _aligned_from(shrunk, (corners - low + 0.5) / smaller - 0.5, pattern)
    return None if found is None else (found + 0.5) * smaller - 0.5 + low


def _cell(corners: Floats, pattern: Pattern) -> float:
    """Mean width of a cell [px]."""
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean()) / pattern.cells


def _aligned_from(grey: Any, corners: Floats, pattern: Pattern) -> Floats | None:
    cell = _cell(corners, pattern)
    pixels, values = _pixels(grey, corners, pattern)
    if len(pixels) < _FEWEST_PIXELS:
        return None
    found, blur, weight = corners.copy(), _BLUR * cell, np.ones(len(pixels))
    for _ in range(_STEPS):
        slopes, left = _linearized(found, blur, pixels, values, pattern, weight)
        weighted = slopes * weight[:, None]
        step = np.linalg.solve(weighted.T @ slopes + _RIDGE * np.eye(slopes.shape[1]), weighted.T @ left)
        found = found + np.clip(step[:8], -1.0, 1.0).reshape(4, 2)
        blur = float(np.clip(blur + np.clip(step[8], -0.5, 0.5), _LEAST_BLUR, _MOST_BLUR))
        rest = np.abs(left - slopes @ step)
        weight = 1.0 / (1.0 + (rest / (_FAR * max(STDS_PER_MAD * float(np.median(rest)), _LEAST_STD))) ** 2)
        is_lost = not np.abs(found - corners).max() < _REACH * max(cell, 1.0)
        if is_lost or np.abs(step[:8]).max() < _CONVERGED:
            break
    contrast = float(values.std())
    is_pattern = contrast > _LEAST_CONTRAST and float(np.median(rest)) < _UNEXPLAINED * contrast
    return found if is_pattern and not is_lost else None


def _pixels(grey: Any, corners: Floats, pattern: Pattern) -> tuple[Floats, Floats]:
    """(k, 2) pixels that show the tag or its margin, evenly thinned, and their values from 0 to 1."""
    height, width = grey.shape[:2]
    shared = _MARGIN / pattern.cells
    outer = _mapped(_homography(corners), _CORNERS + shared * (2.0 * _CORNERS - 1.0))
    low = np.maximum(np.floor(outer.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(outer.max(axis=0)).astype(int) + 1, (width, height))
    if (high <= low).any():
        return np.zeros((0, 2)), np.zeros(0)
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    # Evenly thinned, without a grid: that would see all edges of a tag at the same place between two pixels.
    is_taken = (_EVEN[0] * x + _EVEN[1] * y) % 1.0 < _MOST_PIXELS / float(np.prod(high - low))
    x, y = x[is_taken], y[is_taken]
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    at = _mapped(_inverse(_homography(corners)), pixels.astype(float))
    is_inside = ((at > -shared) & (at < 1.0 + shared)).all(axis=1)
    pixels = pixels[is_inside]
    return pixels.astype(float), grey[pixels[:, 1], pixels[:, 0]].astype(float) / 255.0


def _linearized(
    corners: Floats, blur: float, pixels: Floats, values: Floats, pattern: Pattern, weight: Floats
) -> tuple[Floats, Floats]:
    """(k, 9 + 6) derivatives of the image by corners, blur and illumination, and the residuals (k,).

    Light is the brightness of black and of white, each with a slope across and down.
    """
    matrix = _homography(corners)
    at = _mapped(_inverse(matrix), pixels)
    # A round blur in the picture is an ellipse on a tag that is seen from the side.
    (middle,) = np.linalg.inv(_slopes_of_map(matrix, np.full((1, 2), 0.5)))
    round_blur = pattern.cells**2 * middle @ middle.T  # cells^2 per px^2
    smooth = _Smooth(pattern, at, blur**2 * round_blur)
    shown, steep = smooth.value(), smooth.slopes()
    plane = np.stack([np.ones(len(at)), at[:, 0] - 0.5, at[:, 1] - 0.5], axis=1)
    light = np.concatenate([shown[:, None] * plane, plane], axis=1)
    weighted = light * weight[:, None]
    gains = np.linalg.solve(weighted.T @ light + _RIDGE * np.eye(6), weighted.T @ values)
    contrast = plane @ gains[:3]
    # The slope in the picture is the one on the tag times the inverse of the map's.
    (a, b), (c, d) = _slopes_of_map(matrix, at).transpose(1, 2, 0)
    turned = np.stack([d * steep[0] - c * steep[1], a * steep[1] - b * steep[0]]) / (a * d - b * c)
    moved = -contrast[:, None] * np.einsum("jk,kjc->kc", turned, _by_corners(matrix, at))
    spread = contrast * (_Smooth(pattern, at, (1.1 * blur) ** 2 * round_blur).value() - shown) / (0.1 * blur)
    return np.concatenate([moved, spread[:, None], light], axis=1), values - light @ gains


class _Smooth:
    """A blurred pattern sampled at places (k, 2) of the unit square; the blur is a covariance (2, 2) [cells^2]."""

    def __init__(self, pattern: Pattern, at: Floats, blur: Floats) -> None:
        cv2 = opencv()
        kernel = _kernel(blur * _FINE**2)
        self._picture = cv2.filter2D(pattern.picture, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE)
        place = ((at * pattern.cells + pattern.margin) * _FINE - 0.5).astype(np.float32)
        self._x, self._y, self._samples = place[:, 0].copy(), place[:, 1].copy(), pattern.cells * _FINE

    def value(self, dx: float = 0.0, dy: float = 0.0) -> Floats:
        """(k,) brightness from 0 to 1, at places shifted by (dx, dy) samples."""
        cv2 = opencv()
        taken = cv2.remap(self._picture, self._x + dx, self._y + dy, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(taken, dtype=np.float64).ravel()

    def slopes(self) -> tuple[Floats, Floats]:
        """Derivatives (k,) across and down, by the unit square."""
        half = 0.5 * self._samples
        return (self.value(1) - self.value(-1)) * half, (self.value(dy=1) - self.value(dy=-1)) * half


def _kernel(covariance: Floats) -> Any:
    """A sampled Gaussian kernel."""
    spread = covariance + _LEAST_SPREAD * np.eye(2)
    reach = int(np.clip(np.ceil(3.0 * np.sqrt(np.diag(spread).max())), 1, _WIDEST))
    x = np.arange(-reach, reach + 1)
    (a, b), (_, d) = np.linalg.inv(spread)
    density = np.exp(-0.5 * (a * x[None, :] ** 2 + 2.0 * b * x[None, :] * x[:, None] + d * x[:, None] ** 2))
    return (density / density.sum()).astype(np.float32)


def _homography(corners: Floats) -> Floats:
    """(3, 3) from the unit square, x across and y down, to the picture."""
    rows = np.zeros((8, 8))
    x, y = _CORNERS[:, 0], _CORNERS[:, 1]
    rows[:4, 0], rows[:4, 1], rows[:4, 2] = x, y, 1.0
    rows[4:, 3], rows[4:, 4], rows[4:, 5] = x, y, 1.0
    for k in range(2):
        rows[4 * k : 4 * k + 4, 6:] = -_CORNERS * corners[:, k : k + 1]
    numbers = np.linalg.solve(rows, corners.T.ravel())
    return np.append(numbers, 1.0).reshape(3, 3)


def _inverse(matrix: Floats) -> Floats:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _mapped(matrix: Floats, points: Floats) -> Floats:
    """(k, 2) points under a homography (3, 3)."""
    moved = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(moved[:, :2] / moved[:, 2:])


def _slopes_of_map(matrix: Floats, at: Floats) -> Floats:
    """(k, 2, 2) derivative of the pixel by the place on the tag."""
    depth = at @ matrix[2, :2] + 1.0
    pixel = _mapped(matrix, at)
    return np.asarray((matrix[None, :2, :2] - pixel[:, :, None] * matrix[2, :2]) / depth[:, None, None])


def _by_corners(matrix: Floats, at: Floats) -> Floats:
    """(k, 2, 8) derivative of the pixel of a place on the tag by the corners (x, y of each)."""

    def by_numbers(places: Floats) -> Floats:
        depth, pixel = places @ matrix[2, :2] + 1.0, _mapped(matrix, places)
        rows = np.zeros((len(places), 2, 8))
        full = np.concatenate([places, np.ones((len(places), 1))], axis=1) / depth[:, None]
        rows[:, 0, :3] = rows[:, 1, 3:6] = full
        rows[:, :, 6:] = -pixel[:, :, None] * (places / depth[:, None])[:, None, :]
        return rows

    at_corners = by_numbers(_CORNERS).reshape(8, 8)
    return np.asarray(by_numbers(at) @ np.linalg.inv(at_corners))
