"""The intrinsics of a camera from pictures of a ChArUco board, rendered with a camera that is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from extras import module_requires
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

pytestmark = module_requires("vision")

import cv2
from rendered_video import HEIGHT, MATRIX, WIDTH

from micah_plan.cli.application import app
from micah_plan.errors import InputError
from micah_plan.vision.board import Board, board_of, camera_of_board
from micah_plan.vision.camera import load_camera

BOARD = Board(9, 6, 0.03, 0.022)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> Path:
    folder, rng = tmp_path_factory.mktemp("board"), np.random.default_rng(0)
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    texture = cv2.aruco.CharucoBoard((9, 6), 0.03, 0.022, markers).generateImage((1800, 1200))
    for k in range(16):
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.3, 3)).as_matrix()
        at = np.array([rng.uniform(-0.08, 0.08), rng.uniform(-0.05, 0.05), rng.uniform(0.25, 0.45)])
        at -= turn @ np.array([0.135, 0.09, 0.0])
        plane = np.diag([0.27 / 1800, 0.18 / 1200, 1.0])
        view = MATRIX @ np.column_stack([turn[:, 0], turn[:, 1], at]) @ plane
        picture = cv2.warpPerspective(texture, view, (WIDTH, HEIGHT), flags=cv2.INTER_AREA, borderValue=120)
        noisy = cv2.GaussianBlur(picture, (0, 0), 0.7) + rng.normal(0.0, 3.0, picture.shape)
        cv2.imwrite(str(folder / f"{k:02d}.png"), np.clip(noisy, 0, 255).astype(np.uint8))
    return folder


def test_the_camera_of_a_board(pictures) -> None:
    camera, rms, views = camera_of_board(pictures, BOARD)
    assert camera.matrix[0, 0] == pytest.approx(MATRIX[0, 0], rel=0.005)
    assert camera.matrix[0, 2] == pytest.approx(MATRIX[0, 2], abs=4.0)
    assert abs(camera.matrix[0, 0] / MATRIX[0, 0] - 1.0) < 4.0 * camera.uncertainty
    assert rms < 0.5
    assert views >= 10


def test_the_command_writes_a_camera_that_track_reads(pictures, tmp_path) -> None:
    output = tmp_path / "camera.yaml"
    result = CliRunner().invoke(app, ["track", str(pictures), "--board", "9x6,30mm,22mm", "-o", str(output)])
    assert result.exit_code == 0
    assert "focal length" in result.stdout
    assert load_camera(output).size == (WIDTH, HEIGHT)
    other = CliRunner().invoke(app, ["track", str(pictures), "--board", "9x6,30mm,22mm", "-o", str(tmp_path / "c.csv")])
    assert other.exit_code != 0


@pytest.mark.parametrize("text", ["9x6", "9x6,30mm", "2x6,30mm,22mm", "9x6,22mm,30mm", "9x6,1..2mm,1mm", ""])
def test_what_is_no_board_is_reported(text) -> None:
    with pytest.raises(InputError, match=r"e\.g\. --board 9x6,30mm,22mm"):
        board_of(text)


def test_another_board_is_not_seen(pictures) -> None:
    assert board_of("9x6, 3cm, 22mm") == BOARD
    with pytest.raises(InputError, match=r"the board is seen in 0 of 16 frames|is seen in [0-4] of 16 frames"):
        camera_of_board(pictures, Board(4, 3, 0.03, 0.022))
