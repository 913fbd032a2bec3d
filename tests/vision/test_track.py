"""From a rendered video with tags to a recording and a model; cameras, and what is refused."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from extras import module_requires
from typer.testing import CliRunner

pytestmark = module_requires("vision")

import cv2
import rendered_video as rendered

import micah_plan
from micah_plan.api.tracking import track
from micah_plan.automaton.joint import axis_std
from micah_plan.checking import check_file
from micah_plan.cli.application import app
from micah_plan.documents.tags import load_tags
from micah_plan.errors import InputError
from micah_plan.recording.read import write_recording
from micah_plan.recording.tag_layout import PlacedTag, TagLayout
from micah_plan.recording.value import Recording
from micah_plan.vision.camera import Camera, load_camera

CAMERA = Camera(rendered.MATRIX, np.zeros(0), (rendered.WIDTH, rendered.HEIGHT))
DOOR = TagLayout("tag36h11", {0: PlacedTag("base", 0.06), 1: PlacedTag("door", 0.06)})
SHUT_AT = 3.0


@pytest.fixture(scope="module")
def videos(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("videos")
    made = {name: folder / f"{name}.mp4" for name in ("standing", "hand_held", "drawer")}
    rendered.film(made["standing"], rendered.door(), rendered.shutting)
    rendered.film(
        made["hand_held"], rendered.door(more=True), rendered.shutting, rendered.hand_held, seed=1,
        covered=lambda t: (0, 0, rendered.WIDTH, rendered.HEIGHT) if 1.4 < t < 1.8 else None,
    )  # fmt: skip
    rendered.film(made["drawer"], rendered.drawer(), rendered.pulled, rendered.hand_held, seed=2)
    return made


def test_poses_of_a_door_have_their_stated_precision(videos) -> None:
    found = track(videos["standing"], DOOR, camera=CAMERA)
    off, turned = rendered.errors_of(found.recording, rendered.door(), rendered.shutting)
    place, turn = found.tracked.stds["door"]
    assert found.tracked.is_fixed
    assert len(found.recording) == found.tracked.frames == 60
    assert off < 2.0 * place
    assert turned < 2.0 * turn
    assert off < 0.0015


def test_a_model_of_the_door_is_learned_from_the_video(videos) -> None:
    recording = track(videos["standing"], DOOR, camera=CAMERA).recording
    learned = micah_plan.learn(recording)
    hinge, rest = (segment for edge in learned.graph.edges for segment in edge.segments)
    assert (hinge.joint.kind, rest.joint.kind) == ("revolute", "rigid")
    assert abs(hinge.joint.axis[1]) > np.cos(0.02)  # up, which is y of the base's tag
    assert recording.time[rest.start] == pytest.approx(SHUT_AT, abs=0.3)


def test_a_hand_held_video_with_a_gap_and_two_tags_on_the_door(videos) -> None:
    layout = TagLayout("tag36h11", {**DOOR.tags, 11: PlacedTag("door", 0.06)})
    found = track(videos["hand_held"], layout, camera=CAMERA)
    assert not found.tracked.is_fixed
    assert 48 <= len(found.recording) <= 56  # 6 of 60 frames show nothing
    off, _ = rendered.errors_of(found.recording, rendered.door(), rendered.shutting)
    assert off < 0.002
    kinds = [segment.joint.kind for edge in micah_plan.learn(found.recording).graph.edges for segment in edge.segments]
    assert kinds == ["revolute", "rigid"]


def test_a_drawer_and_no_camera_file(videos) -> None:
    layout = TagLayout("tag36h11", {0: PlacedTag("base", 0.06), 1: PlacedTag("drawer", 0.06)})
    found = track(videos["drawer"], layout)
    camera = found.tracked.camera
    assert camera.matrix[0, 0] == pytest.approx(rendered.FOCAL, rel=3.0 * camera.uncertainty)
    assert found.warnings[0].startswith("no camera file: f = ")
    kinds = [segment.joint.kind for edge in micah_plan.learn(found.recording).graph.edges for segment in edge.segments]
    assert kinds[0] == "prismatic"
    assert np.ptp(np.linalg.norm(found.recording.position - found.recording.position[0], axis=1)) == pytest.approx(
        0.3, rel=0.1
    )


def test_a_camera_file_of_a_pinhole_for_a_lens_with_distortion_is_reported(tmp_path) -> None:
    """The marker is near the edge of the picture, where a cheap lens bends most."""
    rendered.film(tmp_path / "bent.mp4", rendered.door(), rendered.shutting, seconds=2.0, bent=rendered.BENT)
    plain = track(tmp_path / "bent.mp4", DOOR, camera=CAMERA)
    (line,) = (note for note in plain.warnings if "without distortion" in note)
    assert "--camera-from" in line
    right = track(tmp_path / "bent.mp4", DOOR, camera=replace(CAMERA, distortion=rendered.BENT))
    assert not any("without distortion" in note for note in right.warnings)


def test_the_command_writes_what_learn_reads(videos, tmp_path) -> None:
    tags = tmp_path / "tags.yaml"
    tags.write_text("format: micah-plan/tags/1\ntags:\n  0: {part: base, size: 0.06}\n  1: {part: door, size: 0.06}\n")
    assert load_tags(tags) == DOOR
    output, page = tmp_path / "door.csv", tmp_path / "door.html"
    files = ("--tags", tags, "-o", output, "--html", page)
    result = CliRunner().invoke(app, ["track", str(videos["standing"]), *map(str, files), "--json"])
    assert result.exit_code == 0
    said = json.loads(result.stdout)
    assert said["parts"]["door"]["frames"] == 60
    assert said["camera_is_fixed"] is True
    assert micah_plan.load(output).parts == ("door",)
    assert page.stat().st_size > 10_000
    assert check_file(tags).faults == ()


def test_pictures_with_stamps_are_a_video(tmp_path) -> None:
    rendered.film(tmp_path, rendered.door(), rendered.shutting, seconds=0.4)
    with pytest.raises(InputError, match=r"add stamps\.txt or give --rate"):
        track(tmp_path, DOOR, camera=CAMERA)
    (tmp_path / "stamps.txt").write_text("\n".join(str(10.0 + 0.1 * k) for k in range(6)))
    found = track(tmp_path, DOOR, camera=CAMERA)
    assert found.recording.time.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert track(tmp_path, DOOR, camera=CAMERA, rate=15.0).recording.time[1] == pytest.approx(1 / 15)
    (tmp_path / "stamps.txt").write_text("0\n0.1\n")
    with pytest.raises(InputError, match="expected 6 increasing times"):
        track(tmp_path, DOOR, camera=CAMERA)


@pytest.mark.parametrize(
    ("layout", "base", "camera", "message"),
    [
        (TagLayout("tag36h11", {0: PlacedTag("base", 0.06)}), None, CAMERA, "expected tags on two parts"),
        (TagLayout("aruco_4x4", DOOR.tags), None, CAMERA, "in none of 60 frames is a tag of the family aruco_4x4"),
        (TagLayout("tag36h11", {7: PlacedTag("base", 0.06), 1: PlacedTag("door", 0.06)}), None, CAMERA, "is ever seen"),
        (DOOR, "lid", CAMERA, "choose one of base, door"),
        (DOOR, None, Camera(rendered.MATRIX, np.zeros(0), (640, 480)), "is for pictures of 640x480"),
    ],
    ids=["one part", "family", "base unseen", "base unknown", "size"],
)
def test_what_cannot_be_tracked_is_reported(videos, layout, base, camera, message) -> None:
    with pytest.raises(InputError, match=message):
        track(videos["standing"], layout, camera=camera, base=base)


def test_what_is_no_video_is_reported(tmp_path) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    for path in (tmp_path / "text.mp4", tmp_path / "none.mp4"):
        with pytest.raises(InputError, match=r"found no frame|does not exist"):
            track(path, DOOR)


def test_a_camera_for_a_smaller_picture_of_the_same_format_is_scaled(videos) -> None:
    half = rendered.MATRIX * np.array([[0.5], [0.5], [1.0]])
    half[:2, 2] = 0.5 * (rendered.MATRIX[:2, 2] + 0.5) - 0.5
    size = (rendered.WIDTH // 2, rendered.HEIGHT // 2)
    first = track(videos["standing"], DOOR, camera=Camera(half, np.zeros(0), size)).recording
    second = track(videos["standing"], DOOR, camera=CAMERA).recording
    np.testing.assert_allclose(first.position, second.position, atol=1e-7)


CAMERA_FILES = {
    "ros.yaml": "image_width: 960\nimage_height: 540\ncamera_name: head\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    "  data: [760.0, 0, 482.0, 0, 760.0, 268.0, 0, 0, 1]\ndistortion_model: plumb_bob\n"
    "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, -0.2, 0.001, 0.002, 0.03]\n",
    "topic.yaml": "width: 960\nheight: 540\ndistortion_model: plumb_bob\nd: [0.1, -0.2, 0.001, 0.002, 0.03]\n"
    "k: [760.0, 0, 482.0, 0, 760.0, 268.0, 0, 0, 1]\n",
    "kalibr.yaml": "cam0:\n  camera_model: pinhole\n  intrinsics: [760.0, 760.0, 482.0, 268.0]\n"
    "  distortion_model: radtan\n  distortion_coeffs: [0.1, -0.2, 0.001, 0.002]\n  resolution: [960, 540]\n",
    "opencv.yaml": "%YAML:1.0\n---\nimage_width: 960\nimage_height: 540\ncamera_matrix: !!opencv-matrix\n   rows: 3\n"
    "   cols: 3\n   dt: d\n   data: [ 760., 0., 482., 0., 760., 268., 0., 0., 1. ]\n"
    "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
    "   data: [ 0.1, -0.2, 0.001, 0.002, 0.03 ]\n",
    "realsense.json": '{"width": 960, "height": 540, "fx": 760.0, "fy": 760.0, "ppx": 482.0, "ppy": 268.0,'
    ' "model": "Brown Conrady", "coeffs": [0.1, -0.2, 0.001, 0.002, 0.03]}',
}


@pytest.mark.parametrize("name", CAMERA_FILES)
def test_files_of_cameras(name, tmp_path) -> None:
    (tmp_path / name).write_text(CAMERA_FILES[name])
    camera = load_camera(tmp_path / name)
    np.testing.assert_allclose(camera.matrix, rendered.MATRIX)
    np.testing.assert_allclose(camera.distortion[:4], [0.1, -0.2, 0.001, 0.002])
    assert camera.size == (960, 540)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\n", "expected intrinsics of a camera, found none"),
        ("K: [1, 2]\n", "key 'K': expected 9 numbers"),
        ("K: [760, 0, 482, 0, 760, 268, 0, 0, 1]\ndistortion_model: equidistant\n", "undistort the video first"),
        ("K: [0.5, 0, 482, 0, 0.5, 268, 0, 0, 1]\n", "expected focal lengths and a centre in px"),
        ("- 1\n", "expected"),
    ],
)
def test_files_that_are_no_cameras(text, message, tmp_path) -> None:
    (tmp_path / "camera.yaml").write_text(text)
    with pytest.raises(InputError, match=message):
        load_camera(tmp_path / "camera.yaml")


def test_the_base_is_turned_so_that_its_z_points_up(videos) -> None:
    plain = track(videos["standing"], DOOR, camera=CAMERA).recording
    for up, axis in (
        ("y", (0.0, 1.0, 0.0)),
        ("x", (1.0, 0.0, 0.0)),
        ("-y", (0.0, -1.0, 0.0)),
        ("-z", (0.0, 0.0, -1.0)),
    ):
        turned = track(videos["standing"], replace(DOOR, up=up), camera=CAMERA).recording
        assert turned.position[:, 2] == pytest.approx(plain.position @ axis)
        assert np.linalg.norm(turned.position, axis=1) == pytest.approx(np.linalg.norm(plain.position, axis=1))
    # The door's hinge stands upright where y is up.
    learned = micah_plan.learn(track(videos["standing"], replace(DOOR, up="y"), camera=CAMERA).recording)
    assert abs(learned.graph.edges[0].segments[0].joint.axis[2]) > np.cos(0.02)


ROS_1 = """standalone_tags:
  [
    {id: 0, size: 0.06, name: base},
  ]
tag_bundles:
  [
    {name: 'door', layout: [{id: 1, size: 0.06, x: 0.0, y: 0.0, z: 0.0, qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0},
                            {id: 2, size: 0.04, x: 0.1, y: 0.0, z: 0.0, qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0}]}
  ]
"""
ROS_2 = """apriltag:
  ros__parameters:
    family: 36h11
    size: 0.06
    tag:
      ids: [0, 1]
      frames: [base, door]
"""


def test_tags_of_apriltag_ros_are_read_as_they_are(tmp_path) -> None:
    first, second = tmp_path / "tags.yaml", tmp_path / "apriltag.yaml"
    first.write_text(ROS_1)
    second.write_text(ROS_2)
    assert load_tags(second) == DOOR
    layout = load_tags(first)
    assert layout.parts == ("base", "door")
    assert layout.tags[2] == PlacedTag("door", 0.04, (0.1, 0.0, 0.0))
    second.write_text(ROS_2.replace("[base, door]", "[base]"))
    with pytest.raises(InputError, match="expected as many frames and sizes as ids"):
        load_tags(second)
    for wrong, message in (
        (ROS_2.replace("[0, 1]", "3"), "key 'tag.ids': expected a list"),
        (ROS_2.replace("[0, 1]", "[]"), "tags"),
        (ROS_2.replace("[0, 1]", "[1, 1]"), "tag 1 is there twice"),
        (ROS_2.replace("36h11", "Standard41h12"), "found 'Standard41h12'"),
        (ROS_1.replace("id: 2", "id: 0"), "tag 0 is there twice"),
        ("standalone_tags: 5\n", "expected a list of tags"),
    ):
        second.write_text(wrong)
        with pytest.raises(InputError, match=message):
            load_tags(second)
    first.write_text(ROS_1.replace("size: 0.06, name", "name"))
    with pytest.raises(InputError, match="missing key 'size'"):
        load_tags(first)


def test_the_page_shows_the_video_with_what_was_found(videos) -> None:
    found = track(videos["hand_held"], DOOR, camera=CAMERA)
    page = found.page("Door")
    data = json.loads(re.search(r'id="page-data">(.*?)</script>', page, re.DOTALL)[1])
    assert 40 <= len(data["pictures"]) <= 60
    assert [time for time, _ in data["pictures"]] == sorted(time for time, _ in data["pictures"])
    jpeg = base64.b64decode(data["pictures"][0][1].removeprefix("data:image/jpeg;base64,"))
    shown = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).astype(int)
    assert shown.shape[1] == 640
    # The video is grey; what was found is drawn in colour, about the tags and along the door's hinge.
    coloured = np.argwhere(np.ptp(shown, axis=2) > 60)
    assert len(coloured) > 200
    near = found.tracked.footage.corners[0][1].mean(axis=0) * 640 / rendered.WIDTH
    assert np.linalg.norm(coloured - near[::-1], axis=1).min() < 30.0


def test_a_page_without_its_video_is_one_line(videos, tmp_path) -> None:
    copy = tmp_path / "copy.mp4"
    copy.write_bytes(videos["standing"].read_bytes())
    found = track(copy, DOOR, camera=CAMERA)
    copy.unlink()
    with pytest.raises(InputError, match="does not exist"):
        found.page()


def test_commands_of_a_robot_are_joined_by_its_own_clock(videos, tmp_path) -> None:
    time = np.arange(-2.0, 6.0, 0.01)
    hand = np.array([[0.3 * np.cos(rendered.shutting(t)), 0.3 * np.sin(rendered.shutting(t)), 0.0] for t in time])
    action = np.vstack([np.diff(hand, axis=0), np.full((1, 3), np.nan)])
    robot, tags, output = tmp_path / "robot.csv", tmp_path / "tags.yaml", tmp_path / "door.csv"
    write_recording(Recording(time + 100.0, hand, action=action), robot)
    tags.write_text("format: micah-plan/tags/1\ntags:\n  0: {part: base, size: 0.06}\n  1: {part: door, size: 0.06}\n")
    line = ["track", str(videos["standing"]), "--tags", str(tags), "-o", str(output), "--json"]
    result = CliRunner().invoke(app, [*line, "--actions", str(robot)])
    assert result.exit_code == 0
    clock = json.loads(result.stdout)["clock_offset"]
    assert clock["seconds"] == pytest.approx(100.0, abs=0.04)
    joined = micah_plan.load(output)
    assert joined.has_actions
    learned = micah_plan.learn(output)
    assert learned.graph.edges[0].segments[0].joint.kind == "revolute"
    assert learned.graph.edges[0].certainty.channel is not None
    for wrong, message in (
        (["--offset", "3"], "there are no actions to shift"),
        (["--actions", str(robot), "--offset", "-900"], "at this offset the commands are from"),
        (["--actions", str(tmp_path / "none.csv")], "does not exist"),
    ):
        refused = CliRunner().invoke(app, [*line, *wrong])
        assert isinstance(refused.exception, InputError)
        assert message in str(refused.exception)


@pytest.mark.parametrize(("factor", "is_doubted"), [(1.0, False), (1.03, False), (1.25, True), (0.8, True)])
def test_a_camera_file_of_another_zoom_is_doubted(videos, factor: float, is_doubted: bool) -> None:
    matrix = rendered.MATRIX * [[factor], [factor], [1.0]]
    matrix[:2, 2] = rendered.MATRIX[:2, 2]
    found = track(videos["hand_held"], DOOR, camera=Camera(matrix, np.zeros(0), (rendered.WIDTH, rendered.HEIGHT)))
    assert any(note.startswith("the camera file has f = ") for note in found.warnings) == is_doubted


def test_without_a_camera_file_a_lens_with_distortion_is_within_the_stated_uncertainty(tmp_path) -> None:
    video = tmp_path / "bent.mp4"
    rendered.film(video, rendered.door(), rendered.shutting, rendered.hand_held, bent=np.array([-0.06, 0.0, 0.0, 0.0]))
    errors, stds = [], []
    for camera in (None, CAMERA):
        joint = micah_plan.learn(track(video, DOOR, camera=camera).recording).graph.edges[0].segments[0].joint
        assert joint.kind == "revolute"
        errors.append(float(np.arccos(abs(joint.axis[1]))))
        stds.append(axis_std(joint))
    assert errors[0] < 2.0 * stds[0]
    assert stds[0] > 2.0 * stds[1]  # a file is believed
