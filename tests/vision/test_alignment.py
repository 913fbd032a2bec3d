"""Corners of tags from their whole picture, against pictures that are made by integration over each pixel."""

from __future__ import annotations

import numpy as np
import pytest
from extras import module_requires

pytestmark = module_requires("vision")

import cv2

from micah_plan.vision.alignment import aligned_corners, pattern_of
from micah_plan.vision.corners import detector, dictionary

FINER = 8
MARKERS = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def corners_of(rng: np.random.Generator, width: float) -> np.ndarray:
    """A square that is seen from somewhere: turned, tilted and near."""
    half = 0.5 * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]) * [1.0, -1.0]
    turn = cv2.Rodrigues(np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(-3.1, 3.1)]))[0]
    points = np.column_stack([half, np.zeros(4)]) @ turn.T + [0.0, 0.0, rng.uniform(4.0, 12.0)]
    pixels = points[:, :2] / points[:, 2:]
    size = np.mean(np.linalg.norm(np.roll(pixels, -1, axis=0) - pixels, axis=1))
    return pixels * width / size + 100.0 + rng.uniform(-0.5, 0.5, 2)


def picture_of(corners: np.ndarray, blur: float, noise: float, rng: np.random.Generator, number: int = 5) -> np.ndarray:
    cell = 40
    tag = cv2.aruco.generateImageMarker(MARKERS, number, 8 * cell)
    tag = np.clip(cv2.copyMakeBorder(tag, cell, cell, cell, cell, cv2.BORDER_CONSTANT, value=255), 25, 230)
    own = np.array([[1, 1], [9, 1], [9, 9], [1, 9]]) * cell - 0.5
    fine = (corners + 0.5) * FINER - 0.5
    matrix = cv2.getPerspectiveTransform(own.astype(np.float32), fine.astype(np.float32))
    large = np.full((200 * FINER, 200 * FINER), 120, np.uint8)
    cv2.warpPerspective(tag, matrix, large.shape[::-1], dst=large, borderMode=cv2.BORDER_TRANSPARENT)
    small = cv2.GaussianBlur(cv2.resize(large, (200, 200), interpolation=cv2.INTER_AREA).astype(float), (0, 0), blur)
    shade = np.linspace(0.8, 1.1, 200)[None]
    return np.clip(small * shade + rng.normal(0.0, noise, small.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("width", [25.0, 45.0, 90.0, 150.0])
@pytest.mark.parametrize("blur", [0.4, 1.0])
def test_corners_are_known_to_hundredths_of_a_pixel(width: float, blur: float) -> None:
    rng = np.random.default_rng([3, int(width), int(10 * blur)])
    pattern, errors = pattern_of(MARKERS, 5), []
    for _ in range(20):
        truth = corners_of(rng, width)
        rough = truth + rng.uniform(-0.8, 0.8, (4, 2)) * min(1.0, width / 40.0)
        found = aligned_corners(picture_of(truth, blur, 2.0, rng), rough, pattern)
        assert found is not None
        errors.append(found - truth)
    assert np.sqrt(np.mean(np.square(errors))) < (0.03 if width < 100.0 else 0.05)
    assert np.abs(np.mean(errors, axis=0)).max() < 0.03


def test_what_is_not_the_tag_is_not_seen() -> None:
    rng = np.random.default_rng(4)
    corners = corners_of(rng, 50.0)
    picture = picture_of(corners, 0.7, 2.0, rng)
    assert aligned_corners(picture, corners, pattern_of(MARKERS, 5)) is not None
    assert aligned_corners(picture, corners, pattern_of(MARKERS, 6)) is None
    assert aligned_corners(rng.integers(0, 255, (160, 160)).astype(np.uint8), corners, pattern_of(MARKERS, 5)) is None
    assert aligned_corners(np.full((160, 160), 90, np.uint8), corners, pattern_of(MARKERS, 5)) is None
    assert aligned_corners(picture, corners + 500.0, pattern_of(MARKERS, 5)) is None


def test_a_finger_before_it_hardly_moves_the_corners() -> None:
    rng = np.random.default_rng(6)
    corners = corners_of(rng, 70.0)
    picture = picture_of(corners, 0.7, 2.0, rng)
    middle = corners.mean(axis=0).astype(int)
    cv2.circle(picture, (int(middle[0]) + 12, int(middle[1])), 7, 150, -1)
    found = aligned_corners(picture, corners + 0.4, pattern_of(MARKERS, 5))
    assert found is not None
    assert np.abs(found - corners).max() < 0.15


def test_every_family_is_found() -> None:
    for family, number in (("tag25h9", 3), ("tag16h5", 2), ("aruco_4x4", 7), ("aruco_5x5", 8), ("aruco_6x6", 9)):
        markers, picture = dictionary(family), np.full((240, 240), 255, np.uint8)
        side = 14 * (markers.markerSize + 2)
        picture[70 : 70 + side, 60 : 60 + side] = cv2.aruco.generateImageMarker(markers, number, side)
        found = detector(family)(cv2.GaussianBlur(picture, (0, 0), 0.8))[number]
        assert np.abs(found - (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * side + [59.5, 69.5])).max() < 0.05
