"""What `learn` reports of how sure it is: JSON, table, warnings, and the exit code where no joint fits."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from micah_plan import cli
from micah_plan.api.learning import LearningResult, segment_row
from micah_plan.automaton.certainty import ActionChannel, EdgeCertainty, NoSingleJoint, RowPosterior, SegmentCertainty
from micah_plan.automaton.graph import KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import ParameterCovariance, axis_std, radius_std, revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.cli import learning as report
from micah_plan.cli.console import table
from micah_plan.documents.model import load_model
from micah_plan.errors import InputError
from micah_plan.learning import learn as learning
from micah_plan.learning.settings import LearnSettings
from micah_plan.recording.read import read_recording, write_recording
from micah_plan.view.learned_words import action_words

DEMONSTRATION = "examples/demonstrations/microwave.csv"
STDS = (0.1, 0.1, 0.05, 0.02, 0.03)
CHANNEL = ActionChannel((0.0, 0.0, 0.2), 0.94, 0.11, tuple(map(tuple, np.diag(np.square(STDS)).tolist())), 0.87)
NO_SINGLE_JOINT = NoSingleJoint(0.023, 0.3, 0.002, 0.012, 120.0)


def sure_graph() -> KinematicGraph:
    """What a learner may say of the shipped demonstration's 131 rows."""
    covariance = ParameterCovariance(("axis_1", "center_2"), ((4e-4, 0.0), (0.0, 9e-6)))
    hinge = replace(revolute([0, 0, -1], [-0.24, 0, 0], [0.07, 0, 0]), covariance=covariance)
    shut = forward(hinge, 1.2)
    latch = rigid(shut.translation[0], shut.rotation[0].as_quat(), fixed_at=1.2)
    kinds = (("rigid", 0.001), ("prismatic", 0.0), ("revolute", 0.98), ("screw", 0.019))
    start = RowPosterior((98, 99, 100, 102), (0.02, 0.1, 0.8, 0.08))
    segments = (
        Segment(hinge, 0, 0, 99, 0.0, 1.2, (0.0, 1.2), 0.002, 0.01, 0.0, 0.98, SegmentCertainty(None, kinds)),
        Segment(
            latch, 0, 100, 130, 1.2, 1.2, (1.2, 1.2), 0.0, 0.01, 0.0, 1.0, SegmentCertainty(start, (("rigid", 1.0),))
        ),
    )
    certainty = EdgeCertainty(500.0, ((0.0, 0.9, 0.1),), CHANNEL)
    return KinematicGraph((KinematicEdge("base", "door", segments, certainty),))


def unfit_graph() -> KinematicGraph:
    """The same, except for its first segment, which no single joint explains."""
    (edge,) = sure_graph().edges
    first = replace(edge.segments[0], certainty=SegmentCertainty(None, (("revolute", 0.001),), NO_SINGLE_JOINT))
    return KinematicGraph((replace(edge, segments=(first, *edge.segments[1:])),))


@pytest.fixture
def run(monkeypatch, capsys, repository, tmp_path):
    """Runs `learn` in this process with a learner that finds a given graph; returns exit code and what was printed."""

    def run(graph, *arguments, recording=repository / DEMONSTRATION):
        monkeypatch.setattr(learning, "learn_graph", lambda *_, **__: graph)
        command = ["micah-plan", "learn", str(recording), "-o", str(tmp_path / "model.yaml"), *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", command)
        monkeypatch.setenv("COLUMNS", "80")
        monkeypatch.setattr(sys, "excepthook", sys.excepthook)
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return ended.value.code or 0, capsys.readouterr()

    return run


def test_json_has_all_uncertainties(run, tmp_path):
    code, printed = run(sure_graph(), "--json")
    assert (code, printed.err) == (0, "")
    found = json.loads(printed.out)
    turning, shut = found["segments"]
    assert (turning["model"], shut["model"]) == ("revolute", "rigid")
    assert turning["probabilities"] == {"rigid": 0.001, "prismatic": 0.0, "revolute": 0.98, "screw": 0.019}
    assert turning["start_interval"] is None
    assert shut["start_interval"] == [99, 102]
    assert turning["stds"] == pytest.approx({"axis_1": 0.02, "center_2": 0.003})
    assert turning["covariance"] == {"names": ["axis_1", "center_2"], "matrix": [[4e-4, 0.0], [0.0, 9e-6]]}
    assert shut["stds"] is shut["covariance"] is None
    assert found["changepoint_counts"] == [[0.0, 0.9, 0.1]]
    channel = found["action_channel"]
    assert (channel["frame_rotation"], channel["gain"], channel["delay"]) == ([0.0, 0.0, 0.2], 0.94, 0.11)
    assert channel["stds"]["frame_rotation"] == pytest.approx(STDS[:3])
    assert (channel["stds"]["gain"], channel["stds"]["delay"]) == pytest.approx(STDS[3:])
    assert channel["explained"] == 0.87
    assert (found["reason"], found["warnings"]) == ("", [])
    kept = load_model(tmp_path / "model.yaml")
    assert kept.learned[0].certainty == sure_graph().edges[0].certainty
    assert kept.edges[0].threshold_std > 0.01


def test_missing_estimates_are_null(run):
    (edge,) = sure_graph().edges
    bare = replace(edge, segments=tuple(replace(s, certainty=None) for s in edge.segments), certainty=None)
    found = json.loads(run(KinematicGraph((bare,)), "--json")[1].out)
    assert found["action_channel"] is found["changepoint_counts"] is None
    assert [s["probabilities"] for s in found["segments"]] == [None, None]
    assert [s["start_interval"] for s in found["segments"]] == [None, None]


def test_several_parts_have_it_per_edge(repository):
    (edge,) = sure_graph().edges
    other = replace(edge, child="drawer", certainty=None)
    recording = read_recording(repository / DEMONSTRATION)
    result = LearningResult(recording, KinematicGraph((edge, other)), None, 0.1)
    found = result.json()
    assert found["tree_probability"] is None
    assert replace(result, graph=replace(result.graph, probability=0.8)).json()["tree_probability"] == 0.8
    first, second = found["edges"]
    assert first["action_channel"]["gain"] == 0.94
    assert second["action_channel"] is second["changepoint_counts"] is None


def test_the_table_stays_readable(run):
    code, printed = run(sure_graph())
    assert code == 0
    lines = [" ".join(line.split()) for line in printed.out.splitlines()]
    assert lines[lines.index("start row") + 1] == "joint rows configuration axis radius P(kind) (95 %)"
    assert "revolute 0-99 0 → 1.2 rad 0.00 0.00 -1.00 310 mm 98 %" in lines
    assert any(line.startswith("± 1.1° ±") for line in lines)
    assert "rigid 100-130 1.2 >99 % 99-102" in lines
    words = "gain 0.94 ± 0.02, delay 0.11 ± 0.03 s, frame rotation 11.5 ± 2.9°; they explain 87 % of the steps"
    assert f"actions: {words}" in lines
    assert max(map(len, printed.out.splitlines()[:8])) <= 80


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"delay": -0.04}, "delay -0.04 ± 0.03 s"),
        ({"delay": -0.01}, "delay -0.01 ± 0.03 s"),
        ({"frame_rotation": (0.0, 0.0, 0.0)}, "frame rotation 0.0 ± 5.7°"),
        ({"frame_rotation": (0.3, 0.0, 0.0)}, "frame rotation 17.2 ± 5.7°"),
    ],
)
def test_the_line_on_actions(changes, said):
    assert said in action_words(replace(CHANNEL, **changes))


def test_what_a_motion_does_not_determine_has_no_number():
    """A straight line tells no turn about it, and with that no gain."""
    stds = np.array([0.8, 0.8, 0.8, 0.6, 0.03])
    assert action_words(replace(CHANNEL, covariance=tuple(map(tuple, np.diag(stds**2))))) == (
        "delay 0.11 ± 0.03 s; gain and frame rotation not determined by this motion; they explain 87 % of the steps"
    )


def test_rows_that_no_joint_fits_give_exit_code_1_and_no_model(run, tmp_path):
    figure, page = tmp_path / "segments.png", tmp_path / "page.html"
    code, printed = run(unfit_graph(), "--json", "--figure", figure, "--html", page)
    assert (code, printed.err) == (1, "")
    found = json.loads(printed.out)
    first, second = found["segments"]
    assert (first["model"], first["start"], first["end"], second["model"]) == ("none", 0, 99, "rigid")
    assert first["parameters"] == {}
    assert first["best"]["model"] == "revolute"
    assert first["best"]["parameters"]["radius"] == pytest.approx(0.31)
    assert first["misfit"] == {
        "position_m": 0.023,
        "rotation_rad": 0.3,
        "position_noise_m": 0.002,
        "rotation_noise_rad": 0.012,
        "log_odds": 120.0,
    }
    assert found["modes"] == []
    assert found["reason"].startswith(
        "no single-joint model fits rows 0 to 99 of part 'door' (run 0): the best, revolute"
    )
    assert not (tmp_path / "model.yaml").exists()
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "<html" in page.read_text()


def test_an_older_model_is_left_as_it_was_and_the_table_names_the_misfit(run, tmp_path):
    (tmp_path / "model.yaml").write_text("what was here before")
    code, printed = run(unfit_graph())
    assert code == 1
    assert (tmp_path / "model.yaml").read_text() == "what was here before"
    lines = [" ".join(line.split()) for line in printed.out.splitlines()]
    assert "none 0-99 misses by 23 mm" in lines
    assert any(line.startswith("no model: no single-joint model fits rows 0 to 99") for line in lines)
    assert not any(line.startswith("wrote") for line in lines)


def test_what_looks_like_millimetres_is_learned_only_where_the_unit_is_stated(run, repository, tmp_path):
    recording = read_recording(repository / DEMONSTRATION)
    wrong = tmp_path / "millimetres.csv"
    write_recording(replace(recording, position=1000 * recording.position), wrong)
    code, printed = run(sure_graph(), "--json", recording=wrong)
    assert code == 2
    assert "if these are millimetres, add --units mm" in printed.err
    assert not (tmp_path / "model.yaml").exists()
    for unit in ("mm", "m"):
        code, printed = run(sure_graph(), "--json", "--units", unit, recording=wrong)
        assert code == 0
        assert json.loads(printed.out)["warnings"] == []


def test_a_row_far_away_is_warned_of_on_stderr_and_in_json(run, repository, tmp_path):
    recording = read_recording(repository / DEMONSTRATION)
    position = recording.position.copy()
    position[40, 1] += 100.0
    wrong = tmp_path / "lost.csv"
    write_recording(replace(recording, position=position), wrong)
    code, printed = run(sure_graph(), "--json", recording=wrong)
    assert code == 0
    (warning,) = json.loads(printed.out)["warnings"]
    assert "row 40" in warning
    assert printed.err == f"warning: {warning}\n"


def test_wide_numbers_wrap_no_names(run):
    """The widest cells that an ordinary recording makes still fit into 80 columns."""
    (edge,) = sure_graph().edges
    turning, shut = edge.segments
    tilted = replace(turning, joint=revolute([-0.5, -0.5, -np.sqrt(0.5)], [-0.24, 0, 0], [0.07, 0, 0]), end=2399)
    held = replace(shut, start=2400, end=2999)
    _, printed = run(KinematicGraph((replace(edge, segments=(tilted, held)),)))
    lines = [" ".join(line.split()) for line in printed.out.splitlines()]
    assert any(line.startswith("revolute 0-2399 ") for line in lines)
    assert any(line.startswith("rigid 2400-2999 ") for line in lines)
    assert max(map(len, printed.out.splitlines()[:7])) <= 80


@pytest.mark.parametrize(
    ("ends", "reached", "way"),
    [
        ((0.0, 1.2), (0.0, 1.2), "0 → 1.2 rad"),
        ((0.0, 0.001), (-0.01, 1.4), "0 → 1.4 → 0 rad"),
        ((0.5, 0.4), (-0.3, 0.5), "0.5 → -0.3 → 0.4 rad"),
    ],
)
def test_the_table_shows_where_a_part_turned_around(ends, reached, way) -> None:
    moving = sure_graph().edges[0].segments[0]
    there = replace(moving, configuration_start=ends[0], configuration_end=ends[1], configuration_range=reached)
    assert segment_row(there)[2] == way


def test_axis_and_radius_have_their_spread() -> None:
    names = ("axis_1", "axis_2", "center_1", "center_2", "position_1", "position_2", "position_3")
    matrix = np.diag(np.square([0.01, 0.02, 0.003, 0.003, 0.004, 0.004, 0.004]))
    covariance = ParameterCovariance(names, tuple(tuple(row) for row in matrix.tolist()))
    door = replace(revolute((0, 0, 1), (0, 0, 0), (0.3, 0, 0)), covariance=covariance)
    assert axis_std(door) == pytest.approx(0.02)
    assert radius_std(door) == pytest.approx(0.005)
    row = segment_row(replace(sure_graph().edges[0].segments[0], joint=door))
    assert row[3] == "0.00 0.00 1.00\n± 1.1°"
    assert row[4] == "300 mm\n± 5 mm"


def test_a_narrow_terminal_loses_no_number() -> None:
    shown = table("configuration", "axis")
    shown.add_row("0 → 1.21 rad", "0.00 0.00 -1.00 ± 0.18°")
    written = StringIO()
    Console(width=22, file=written).print(shown)
    cells = "".join(written.getvalue().split()).replace("─", "")
    assert sorted(cells) == sorted("configurationaxis0→1.21rad0.000.00-1.00±0.18°")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["resolution"], "--set: expected NAME=VALUE, each once, found 'resolution'"),
        (["resolution=3", "resolution=4"], "--set: expected NAME=VALUE, each once, found 'resolution=4'"),
        (["resolution=2.5"], "--set: expected a whole number for resolution, found '2.5'"),
        (["rest=none"], "--set: expected a number for rest, found 'none'"),
        (["paths=perhaps"], "--set: expected true or false for paths, found 'perhaps'"),
        (["drawz=3"], "learn: unknown setting 'drawz'"),
        (["kinds=rigid,ball"], "LearnSettings.kinds must be among"),
        (["rest=-1"], "LearnSettings.rest must be positive"),
    ],
)
def test_settings_that_are_none(settings: list[str], message: str) -> None:
    with pytest.raises(InputError) as refused:
        report._settings(settings)
    assert message in str(refused.value)


def test_settings_of_learning_by_name() -> None:
    given = [
        "kinds=rigid, screw",
        "paths=False",
        "resolution=7",
        "rest=0.1",
        "likelihood_power=none",
        "mean_length=2e0",
    ]
    expected = LearnSettings(kinds=("rigid", "screw"), paths=False, resolution=7, rest=0.1, mean_length=2.0)
    assert report._settings(given) == expected
    assert report._settings([]) == LearnSettings()
