"""From tracks of points to bodies and a model: planted bodies, files, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from point_tracks import SCENES, share_right, simulated, tilt_held
from typer.testing import CliRunner

import micah_plan
from micah_plan.api.tracking import track_bodies
from micah_plan.cli.application import app
from micah_plan.documents.tags import load_tags
from micah_plan.errors import InputError
from micah_plan.recording.conventions import Conventions
from micah_plan.view.recording_page import recording_page
from micah_plan.vision.camera import Camera
from micah_plan.vision.point_files import load_points


def planted(name: str, seed: int = 0, **how):
    rng = np.random.default_rng([seed, sum(map(ord, name))])
    return simulated(SCENES[name], rng, **how)


@pytest.mark.sweep
@pytest.mark.parametrize("name", SCENES)
def test_bodies_and_their_points(name) -> None:
    tracks, label = planted(name)
    found = track_bodies(tracks, rate=30.0).tracked
    assert len(found.bodies) == len(SCENES[name])
    assert share_right([body.points for body in found.bodies], label) > 0.95
    assert found.noise == pytest.approx(0.003, rel=0.2)
    wandering = found.body[label < 0]
    assert np.mean(wandering >= 0) < 0.2


@pytest.mark.parametrize(("name", "kind"), [("door", "revolute"), ("drawer", "prismatic")])
def test_a_model_is_learned_from_points_before_a_moving_camera(name, kind) -> None:
    recording = track_bodies(planted(name, seed=1)[0], rate=30.0).recording
    segments = [segment for edge in micah_plan.learn(recording).graph.edges for segment in edge.segments]
    assert segments[0].joint.kind in (kind, "rigid")
    assert kind in [segment.joint.kind for segment in segments]


@pytest.mark.evidence
def test_axes_are_as_well_known_as_the_camera_of_the_first_frame() -> None:
    """All poses are told in that frame, so its error is that of every axis, however many frames there are."""
    found = [tilt_held(name, seed, 0.003) for name in ("door", "drawer") for seed in range(8)]
    held = [one for one, _ in filter(None, found)]
    assert len(held) >= 14
    assert np.mean(held) > 0.7  # 0.4 without what the poses share


@pytest.mark.parametrize("is_moving", [False, True])
def test_what_stands_before_a_camera_that_stands_is_the_base(is_moving) -> None:
    """Though most points are on the drawer; before a camera that moves nothing else tells which body the base is."""
    tracks, label = planted("drawer", is_moving=is_moving)
    tracks = np.delete(tracks, np.flatnonzero(label == 0)[::2], axis=0)
    hidden = track_bodies(tracks, rate=30.0).tracked
    way = np.linalg.norm(hidden.recording.position - hidden.recording.position[0], axis=1).max()
    assert way == pytest.approx(0.3, abs=0.02)
    assert (len(hidden.bodies[0].points) < len(hidden.bodies[1].points)) == (not is_moving)
    # Poses are those of the camera, so none is lost where the base is not seen.
    tracks[np.flatnonzero(np.delete(label, np.flatnonzero(label == 0)[::2]) == 0), 40:50] = np.nan
    found = track_bodies(tracks, rate=30.0).tracked
    lost = 0 if not is_moving else 10
    assert len(hidden.recording) - len(found.recording) == lost


@pytest.mark.parametrize("frames", [12, 25])
def test_few_frames_are_enough_for_poses(frames) -> None:
    tracks = planted("door", is_moving=False)[0]
    tracks = tracks[:, np.linspace(0, tracks.shape[1] - 1, frames).astype(int)]
    assert len(track_bodies(tracks, rate=30.0).tracked.bodies) >= 2


def test_positions_have_their_stated_precision() -> None:
    result = track_bodies(planted("drawer", is_moving=False)[0], rate=30.0)
    recording, (place, _) = result.recording, result.tracked.stds["body 1"]
    way = recording.position - recording.position[0]
    across = way[:, [0, 2]]  # the drawer moves along -y alone
    assert float(np.sqrt(np.mean((across - across.mean(axis=0)) ** 2))) < 2.0 * place
    assert np.linalg.norm(way, axis=1).max() == pytest.approx(0.3, abs=0.01)


def test_files_with_both_orders_units_and_visibility(tmp_path) -> None:
    tracks, _ = planted("door")
    visible = np.isfinite(tracks).all(axis=2)
    filled = np.nan_to_num(tracks)
    np.savez(tmp_path / "a.npz", tracks=filled, visibility=visible)
    np.savez(tmp_path / "b.npz", tracks_XYZ=1000.0 * filled.transpose(1, 0, 2), occluded=~visible.T)
    np.testing.assert_allclose(load_points(tmp_path / "a.npz").places, tracks)
    np.testing.assert_allclose(load_points(tmp_path / "b.npz", unit="mm").places, tracks)


def test_the_command_writes_bodies_and_points(tmp_path) -> None:
    tracks, label = planted("door")
    np.savez(tmp_path / "tracks.npz", tracks=tracks)
    output, points, page = tmp_path / "door.csv", tmp_path / "points.csv", tmp_path / "page.html"
    files = ("-o", output, "--points", points, "--html", page)
    line = ["track", str(tmp_path / "tracks.npz"), "--rate", "30", "--json", *map(str, files)]
    result = CliRunner().invoke(app, line)
    assert result.exit_code == 0
    said = json.loads(result.stdout)
    assert list(said["bodies"]) == ["base", "body 1"]
    assert micah_plan.load(output).parts == ("body 1",)
    rows = points.read_text().splitlines()
    assert rows[0] == "point,body"
    assert len(rows) == 1 + len(label)
    assert page.stat().st_size > 10_000


def test_what_cannot_be_tracked_is_reported(tmp_path) -> None:
    tracks, _ = planted("door")
    square = tracks[:100]
    np.savez(tmp_path / "square.npz", tracks=square)
    np.savez(tmp_path / "flat.npz", tracks=tracks[..., 0])
    np.savez(tmp_path / "two.npz", a=tracks, b=tracks)
    (tmp_path / "text.npz").write_text("no arrays")
    np.savez(tmp_path / "visible.npz", tracks=tracks, visibility=np.ones(7))
    for name, message in (
        ("square.npz", "add --axes points,frames"),
        ("flat.npz", "expected one array"),
        ("two.npz", "found a, b"),
        ("text.npz", "expected an NPZ file of plain arrays"),
        ("visible.npz", "store both with the same axes"),
    ):
        with pytest.raises(InputError, match=message):
            load_points(tmp_path / name)
    assert load_points(tmp_path / "square.npz", axes="points,frames").places.shape == square.shape
    with pytest.raises(InputError, match="one rigid body only"):
        track_bodies(tracks[:40], rate=30.0)
    with pytest.raises(InputError, match="expected 8 points"):
        track_bodies(tracks[:3], rate=30.0)
    with pytest.raises(InputError, match="no four points keep their distances"):
        track_bodies(np.random.default_rng(0).uniform(0.0, 1.0, (20, 50, 3)), rate=30.0)
    with pytest.raises(InputError, match="--rate 30"):
        track_bodies(tracks, rate=None)


def test_infinite_places_are_not_seen_and_one_point_many_times_is_no_body() -> None:
    tracks, _ = planted("door")
    tracks[3, 4] = np.inf
    assert len(track_bodies(tracks, rate=30.0).tracked.bodies) == 2
    with pytest.raises(InputError):
        track_bodies(np.repeat(tracks[:1], 20, axis=0), rate=30.0)


def test_sizes_of_tags_in_mm_are_refused(tmp_path) -> None:
    path = tmp_path / "tags.yaml"
    path.write_text("format: micah-plan/tags/1\ntags:\n  0: {part: base, size: 2.5}\n")
    assert load_tags(path).tags[0].size == 2.5
    path.write_text("format: micah-plan/tags/1\ntags:\n  0: {part: base, size: 60.0}\n")
    with pytest.raises(InputError, match=r"tags\.0\.size.*in mm it would be 0\.06"):
        load_tags(path)


def test_options_of_the_other_source_are_refused(tmp_path) -> None:
    np.savez(tmp_path / "tracks.npz", tracks=planted("door")[0])
    line = ["track", str(tmp_path / "tracks.npz"), "-o", str(tmp_path / "x.csv"), "--base", "door"]
    result = CliRunner().invoke(app, line)
    assert isinstance(result.exception, InputError)
    assert "--base" in str(result.exception)
    assert not (tmp_path / "x.csv").exists()


FOCAL = np.array([[600.0, 0.0, 320.0], [0.0, 590.0, 240.0], [0.0, 0.0, 1.0]])


def ahead(name: str) -> np.ndarray:
    """Planted tracks, wholly before the camera."""
    tracks, _ = planted(name)
    return tracks - [0.0, 0.0, min(0.0, float(np.nanmin(tracks[..., 2])) - 0.5)]


def test_tracks_in_pixels_are_lifted_by_their_depths(tmp_path) -> None:
    tracks = ahead("door")
    depth = tracks[..., 2]
    pixels = (tracks / depth[..., None]) @ FOCAL.T
    np.savez(tmp_path / "a.npz", pred_tracks=pixels[None, ..., :2], depth=depth, intrinsics=FOCAL)
    np.testing.assert_allclose(load_points(tmp_path / "a.npz").places, tracks, atol=1e-9)
    turned = pixels[..., :2].transpose(1, 0, 2)
    np.savez(tmp_path / "b.npz", tracks=turned, depths=1000.0 * depth.T, fx_fy_cx_cy=[600.0, 590.0, 320.0, 240.0])
    np.testing.assert_allclose(load_points(tmp_path / "b.npz", unit="mm").places, tracks, atol=1e-9)
    np.savez(tmp_path / "c.npz", tracks=turned, depth=depth.T)
    with pytest.raises(InputError, match=r"need the camera's intrinsics; add --camera"):
        load_points(tmp_path / "c.npz")
    np.testing.assert_allclose(
        load_points(tmp_path / "c.npz", camera=Camera(FOCAL, np.zeros(0))).places, tracks, atol=1e-9
    )
    np.savez(tmp_path / "d.npz", tracks=turned, intrinsics=FOCAL)
    with pytest.raises(InputError, match="need the depth of each point"):
        load_points(tmp_path / "d.npz")
    np.savez(tmp_path / "e.npz", tracks=turned, intrinsics=FOCAL, depth=depth[:5])
    with pytest.raises(InputError, match="expected depths"):
        load_points(tmp_path / "e.npz")


def test_maps_of_depth_are_read_at_the_pixels(tmp_path) -> None:
    pixels = np.array([[[3.0, 2.0], [4.2, 2.0]], [[0.0, 0.0], [50.0, 2.0]]])  # the last one is outside
    maps = np.arange(2 * 5 * 6, dtype=float).reshape(2, 5, 6)
    np.savez(tmp_path / "a.npz", tracks=pixels, depth_maps=maps, K=FOCAL)
    places = load_points(tmp_path / "a.npz", axes="points,frames").places
    assert places[0, :, 2].tolist() == [maps[0, 2, 3], maps[1, 2, 4]]
    assert np.isnan(places[1]).all()  # 0: no depth


def trc_of(tracks: np.ndarray, names: list[str], rate: float) -> str:
    lines = ["PathFileType\t4\t(X/Y/Z)\tdoor.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits"]
    lines += [f"{rate}\t{rate}\t{tracks.shape[1]}\t{len(names)}\tmm", "Frame#\tTime\t" + "\t\t\t".join(names)]
    lines += ["\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)), ""]
    for k in range(tracks.shape[1]):
        numbers = ["" if np.isnan(v) else f"{1000.0 * v:.6f}" for v in tracks[:, k].ravel()]
        lines.append("\t".join([str(k + 1), f"{k / rate:.4f}", *numbers]))
    return "\n".join(lines) + "\n"


def marker_names(label: np.ndarray) -> list[str]:
    return [f"{('frame', 'leaf', 'other')[int(own)]}_{k}" for k, own in enumerate(label)]


@pytest.fixture(scope="module")
def markers() -> tuple[np.ndarray, list[str]]:
    tracks, label = planted("door", is_moving=False)
    kept = np.concatenate([np.flatnonzero(label == body)[:12] for body in (0, 1)])
    return tracks[kept], marker_names(label[kept])


def test_markers_of_trc_files_and_tables(tmp_path, markers) -> None:
    tracks, names = markers
    (tmp_path / "door.trc").write_text(trc_of(tracks, names, 25.0))
    found = load_points(tmp_path / "door.trc")
    np.testing.assert_allclose(found.places, tracks, atol=1e-8)
    assert (found.rate, list(found.names)) == (25.0, names)
    header = ",".join(["t", *(f"{name}_{axis}" for name in names for axis in "xyz")])
    rows = [",".join(["%.3f" % (0.04 * k), *("" if np.isnan(v) else repr(float(v)) for v in tracks[:, k].ravel())])
            for k in range(tracks.shape[1])]  # fmt: skip
    (tmp_path / "door.csv").write_text("\n".join([header, *rows]) + "\n")
    table = load_points(tmp_path / "door.csv")
    np.testing.assert_allclose(table.places, tracks)
    assert table.rate == pytest.approx(25.0)
    bodies = track_bodies(tmp_path / "door.csv")
    assert bodies.recording.parts == ("leaf",)  # what its markers are called
    for text, message in (
        ("nothing\n", "expected a header with DataRate"),
        (trc_of(tracks, names, 25.0).replace("mm", "furlong"), "Units 'furlong'"),
        (trc_of(tracks, names, 25.0) + "7\t0.1\ta\n", "expected numbers"),
    ):
        (tmp_path / "bad.trc").write_text(text)
        with pytest.raises(InputError, match=message):
            load_points(tmp_path / "bad.trc")
    (tmp_path / "poses.csv").write_text("t,x,y,z\n0,1,2,3\n")
    with pytest.raises(InputError, match="expected columns of markers"):
        load_points(tmp_path / "poses.csv")


def test_markers_of_c3d_files(tmp_path, markers) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    tracks, names = markers
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [25.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = names
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    points = np.ones((4, *tracks.shape[:2]))
    points[:3] = 1000.0 * np.nan_to_num(tracks).transpose(2, 0, 1)
    file["data"]["points"] = points
    file.write(str(tmp_path / "door.c3d"))
    found = load_points(tmp_path / "door.c3d")
    np.testing.assert_allclose(found.places, tracks, atol=1e-5)
    assert (found.rate, list(found.names)) == (25.0, names)
    (tmp_path / "bad.c3d").write_bytes(b"no c3d")
    with pytest.raises(InputError, match="expected a C3D file"):
        load_points(tmp_path / "bad.c3d")


def test_learn_takes_tracks_as_they_are(tmp_path, markers) -> None:
    tracks, names = markers
    (tmp_path / "door.trc").write_text(trc_of(tracks, names, 25.0))
    np.savez(tmp_path / "door.npz", tracks=1000.0 * tracks, visibility=np.isfinite(tracks).all(axis=2))
    of_markers = micah_plan.learn(tmp_path / "door.trc")
    of_arrays = micah_plan.learn(tmp_path / "door.npz", conventions=Conventions(rate=25.0, length="mm"))
    for learned in (of_markers, of_arrays):
        assert "revolute" in [s.joint.kind for edge in learned.graph.edges for s in edge.segments]
    model = tmp_path / "door.yaml"
    line = ["learn", str(tmp_path / "door.npz"), "--units", "mm", "-o", str(model)]
    refused = CliRunner().invoke(app, line)
    assert isinstance(refused.exception, InputError)
    assert "e.g. --rate 30" in str(refused.exception)
    assert CliRunner().invoke(app, [*line, "--rate", "25"]).exit_code == 0
    assert model.exists()


def test_points_move_with_their_bodies() -> None:
    """Places in a body's frame, taken along by its poses, are where the points were seen, in the frame of the base."""
    tracks, _ = planted("door", is_moving=False)
    result = track_bodies(tracks, rate=30.0)
    found, places = result.tracked, result.tracked.places()
    assert list(places) == list(found.names)
    (standing, moving), noise = found.bodies, found.noise
    seen = np.nanmedian(tracks[standing.points], axis=1)
    assert np.nanmedian(np.linalg.norm(places["base"] - seen, axis=1)) < 2.0 * noise
    recording = result.recording
    poses = recording.poses()
    for row in (0, len(recording) // 2, len(recording) - 1):
        frame = round(recording.time[row] * 30.0)
        carried = poses[row].apply(places["body 1"])
        assert np.nanmedian(np.linalg.norm(carried - tracks[moving.points, frame], axis=1)) < 3.0 * noise


def test_the_page_shows_points_in_the_colour_of_their_body() -> None:
    result = track_bodies(planted("door")[0], rate=30.0)
    page = result.page()
    assert f"{len(result.tracked.bodies[0].points)} points on base" in page
    assert f"{len(result.tracked.bodies[1].points)} points on body 1" in page
    assert "points on" not in recording_page(result.recording)
