"""Runs of a held object are predicted by the model that its problem makes: three inputs move four coordinates."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from micah_plan.automaton.hybrid import Noise
from micah_plan.automaton.tracks import tracks
from micah_plan.cli.application import app
from micah_plan.documents.problem import load_problem
from micah_plan.execution.checked_plant import make_plant
from micah_plan.execution.closed_loop import Episode, execute_episode
from micah_plan.recording.csv_file import write_csv
from micah_plan.residual.prediction import predict_recording
from micah_plan.task.plan import Trajectory

PROBLEM = Path(__file__).resolve().parents[2] / "problems" / "stapler_on_books.yaml"
STEPS = np.array([[0.01, 0.0, -0.02]] * 5 + [[0.0, 0.02, -0.01]] * 12)


@pytest.fixture(scope="module")
def problem():
    return load_problem(PROBLEM)


def led(problem):
    """The hand goes down until the stapler folds, without feedback."""
    knots = len(STEPS) + 1
    means = np.tile(problem.start.mean, (knots, 1))
    means[1:, :3] += np.cumsum(STEPS, axis=0)
    still = np.zeros((knots, 4, 4)), STEPS, np.zeros((knots - 1, 3, 4))
    ahead = Trajectory(("free",) * knots, means, *still, np.zeros(knots - 1, dtype=bool))
    result = execute_episode(
        Episode(problem, ahead, max_steps=knots - 1), make_plant(problem, "nominal"), np.random.default_rng(1)
    )
    return result.recording


@pytest.fixture(scope="module")
def recording(problem):
    return led(problem)


def test_inputs_are_read_from_the_actions_of_the_hand(problem):
    tiny = (1e-9,) * 4
    recording = led(replace(problem, automaton=replace(problem.automaton, noise=Noise(tiny, tiny))))
    (track,) = tracks(problem.automaton, recording)
    assert track.u.shape == STEPS.shape
    free = np.array(recording.extra["mode"]).reshape(len(STEPS) + 1, -1)[:-1, 0] == "free"
    assert free.sum() >= 5
    np.testing.assert_allclose(track.u[free], STEPS[free], atol=1e-6)


def test_predictions_are_as_good_as_the_tracker(problem, recording):
    (found,) = predict_recording(problem.automaton, recording)
    std = np.array(problem.automaton.noise.observation_std)
    assert (np.sqrt(np.mean(found.one_step.configuration**2, axis=0)) < 2.5 * std).all()
    assert {"free", "line"} <= set(found.one_step.modes)


def test_the_command_takes_the_problem_instead_of_a_model(recording, tmp_path):
    write_csv(recording, tmp_path / "runs.csv")
    result = CliRunner().invoke(app, ["predict", str(PROBLEM), str(tmp_path / "runs.csv")])
    assert result.exit_code == 0, result.output
    assert "one step" in result.output
