"""From tracks of points to bodies and a model: planted bodies, files, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from point_tracks import SCENES, share_right, simulated
from typer.testing import CliRunner

import micah_plan
from micah_plan.api.tracking import track_bodies
from micah_plan.cli.application import app
from micah_plan.documents.tags import load_tags
from micah_plan.errors import InputError
from micah_plan.vision.track_points import load_points


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


def test_positions_are_as_precise_as_said() -> None:
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
    np.testing.assert_allclose(load_points(tmp_path / "a.npz"), tracks)
    np.testing.assert_allclose(load_points(tmp_path / "b.npz", unit="mm"), tracks)


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


def test_what_cannot_be_tracked_is_said(tmp_path) -> None:
    tracks, _ = planted("door")
    square = tracks[:100]
    np.savez(tmp_path / "square.npz", tracks=square)
    np.savez(tmp_path / "flat.npz", tracks=tracks[..., 0])
    np.savez(tmp_path / "two.npz", a=tracks, b=tracks)
    (tmp_path / "text.npz").write_text("no arrays")
    np.savez(tmp_path / "visible.npz", tracks=tracks, visibility=np.ones(7))
    for name, message in (
        ("square.npz", "say --axes points,frames"),
        ("flat.npz", "expected one array"),
        ("two.npz", "found a, b"),
        ("text.npz", "expected an NPZ file of plain arrays"),
        ("visible.npz", "store both with the same axes"),
    ):
        with pytest.raises(InputError, match=message):
            load_points(tmp_path / name)
    assert load_points(tmp_path / "square.npz", axes="points,frames").shape == square.shape
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
