"""Learning on measured recordings, with one configuration: the structure that is known of each."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from mechanisms import DEMONSTRATIONS, TRACKS

from micah_plan.automaton.graph import KinematicEdge
from micah_plan.automaton.joint import radius
from micah_plan.learning.learn import METHODS, learn_graph
from micah_plan.recording.read import read_recording

DATA = Path(os.environ.get("MICAH_DATA", Path(__file__).parents[3] / "shared" / "data"))
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="measured recordings are not here (set MICAH_DATA)")

RADII = {"cabinet_one": 0.38, "drawer_one": 0.0, "iros_2010/drawer": 0.0, "iros_2010/left_door": 0.34}


def edge(path: Path, method: str) -> KinematicEdge:
    return learn_graph(read_recording(path), method=method).edges[0]  # type: ignore[arg-type]


def assert_as_known(name: str, method: str) -> None:
    kinds, rows = DEMONSTRATIONS[name]
    found = edge(DATA / "demonstrations" / f"{name}.csv", method)
    assert tuple(segment.joint.kind for segment in found.segments) == kinds
    if rows is not None:
        assert found.changepoints[0] in rows
    assert all(
        segment.certainty is not None and segment.certainty.no_single_joint is None for segment in found.segments
    )


@pytest.mark.sweep
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", DEMONSTRATIONS)
def test_a_demonstration_has_its_structure_where_the_motion_ends(name: str, method: str) -> None:
    assert_as_known(name, method)


@pytest.mark.slow
@pytest.mark.parametrize("name", RADII)
def test_tracks_of_one_object_have_one_joint_of_its_kind_and_radius(name: str) -> None:
    kind, expected = TRACKS[name], RADII[name]
    radii = []
    for path in sorted((DATA / "tracks" / name).glob("*.csv")):
        moving = [segment.joint for segment in edge(path, "champ").segments if segment.joint.kind != "rigid"]
        assert [joint.kind for joint in moving] == [kind], path.name
        radii.append(radius(moving[0]))
    assert np.mean(radii) == pytest.approx(expected, abs=0.02)
    assert np.std(radii) < 0.03


@pytest.mark.slow
def test_every_kitchen_track_has_one_moving_joint_and_rests() -> None:
    for path in sorted((DATA / "tracks" / "kitchen").glob("*.csv")):
        segments = edge(path, "champ").segments
        assert sum(segment.joint.kind != "rigid" for segment in segments) == 1, path.name
        assert all(segment.certainty is not None and segment.certainty.no_single_joint is None for segment in segments)
