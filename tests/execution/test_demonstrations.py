"""The shipped demonstrations: made by their script, and carrying what the true objects can teach."""

import sys
from pathlib import Path

import numpy as np
import pytest
from extras import requires

from micah_plan.automaton.tracks import tracks
from micah_plan.recording.csv_file import read_csv

pytestmark = requires("sim")

EXAMPLES = Path(__file__).parents[2] / "examples"
FOLDER = EXAMPLES / "demonstrations"


@pytest.fixture(scope="module")
def scripts():
    sys.path.insert(0, str(EXAMPLES))
    try:
        import objects
        import record_demonstrations

        yield objects, record_demonstrations
    finally:
        sys.path.remove(str(EXAMPLES))


@pytest.mark.parametrize(
    ("name", "script"), [("microwave", "shut_microwave"), ("drawer", "pull_drawer"), ("cabinet", "use_cabinet")]
)
def test_the_script_makes_the_shipped_files(scripts, name, script):
    made = getattr(scripts[1], script)()
    shipped = read_csv(FOLDER / f"{name}.csv")
    # Other releases of the simulator may round differently.
    for column in ("time", "position", "quaternion", "action", "force"):
        np.testing.assert_allclose(getattr(made, column), getattr(shipped, column), atol=1e-6)
    assert made.part == shipped.part


def test_the_script_makes_the_log_of_the_laboratory(scripts):
    made = scripts[1].as_a_lab_logs(read_csv(FOLDER / "microwave.csv"))
    assert made == (EXAMPLES / "logs" / "laboratory.csv").read_text(encoding="utf-8")


def test_the_door_is_shut_and_then_pressed(scripts):
    (track,) = tracks(scripts[0].microwave(), read_csv(FOLDER / "microwave.csv"))
    moved, asked = np.diff(track.x[:, 0]), track.u[:, 0]
    shut = int(np.argmax(track.x[:, 0] > 1.19))
    assert 70 < shut < 90
    assert np.sum(moved[:shut]) == pytest.approx(1.2, abs=0.02)
    # While it moves the actions say how far; once it is shut they go on and nothing moves.
    assert np.sum(asked[:shut]) == pytest.approx(1.2, rel=0.1)
    assert np.mean(asked[shut + 3 :]) > 0.02
    assert abs(np.mean(moved[shut + 3 :])) < 1e-3


def test_the_drawer_follows_the_hand(scripts):
    (track,) = tracks(scripts[0].drawer(), read_csv(FOLDER / "drawer.csv"))
    assert track.x[-1, 0] - track.x[0, 0] == pytest.approx(0.28, abs=0.01)
    assert np.sum(track.u) == pytest.approx(0.28, rel=0.15)
    assert np.std(np.diff(track.x[:, 0]) - track.u[:, 0]) < 0.004


def test_the_cabinet_is_used_one_part_after_the_other(scripts):
    (track,) = tracks(scripts[0].cabinet(), read_csv(FOLDER / "cabinet.csv"))
    out = int(np.argmax(track.x[:, 1] > 0.24))
    assert 35 < out < 50
    assert track.x[:out, 0] == pytest.approx(0.0, abs=0.06)
    assert track.x[out + 5 :, 1] == pytest.approx(0.25, abs=0.01)
    assert track.x[-10:, 0] == pytest.approx(1.2, abs=0.06)
    # Shut it is pressed on; the handle goes with it and is asked for nothing of its own.
    assert np.mean(track.u[-10:, 0]) > 0.01
    handle = track.position[:, 2]
    assert np.std(handle, axis=0).max() < 0.005


def test_the_shapes_fit_the_true_objects(scripts):
    objects = scripts[0]
    for automaton in (objects.microwave(), objects.drawer(), objects.cabinet()):
        assert {part.name for part in automaton.parts} == {"base", *(link.child for link in automaton.links)}
        assert all(part.shapes for part in automaton.parts)
        assert automaton.part(automaton.coordinates[0].name).handle is not None
