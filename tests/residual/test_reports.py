"""What reports say of errors: each in its own unit, with its floor, and how parameters go together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest
from test_noise_of_places import recorded, slide

from micah_plan.api.prediction import PredictionResult
from micah_plan.documents.model import load_model
from micah_plan.execution.open_loop import carry_out
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.candidates import candidates
from micah_plan.residual.contenders import Option
from micah_plan.residual.examined import examined
from micah_plan.residual.judgement import judge
from micah_plan.residual.prediction import predict_recording, rmse
from micah_plan.task.experiment import Experiment, Motion
from micah_plan.task.start import Start
from micah_plan.view.calibration_page import calibration_page
from micah_plan.view.prediction_page import prediction_page


@pytest.mark.slow
def test_errors_of_an_angle_and_a_displacement_are_reported_in_their_own_units(repository) -> None:
    cupboard = load_model(repository / "models" / "cupboard.yaml")
    motion = Motion(Start((1.5, 0.1), (0.01, 0.003), "open"), ((0.05, 0.02), (-0.05, -0.02)) * 10)
    log, _ = carry_out(Experiment(cupboard, (motion,), 1), seed=4)
    runs = predict_recording(cupboard, log)
    judged = judge(cupboard, log, runs)
    told = PredictionResult(cupboard, log, runs).json()["per_coordinate"]
    assert [(one["name"], one["unit"]) for one in told] == [("door", "rad"), ("jar", "m")]
    for i, one in enumerate(told):
        assert one["one_step_rmse"] == pytest.approx(rmse([run.one_step.configuration[:, i] for run in runs]))
        assert 0 < one["noise_floor"][0] < 2 * one["one_step_rmse"]
    page = prediction_page(cupboard, log, runs, judged, title="cupboard")
    assert "m or rad" not in page
    assert "jar " in page


def test_gain_and_bias_of_one_way_commands_go_together_as_in_a_regression() -> None:
    """Seen almost without noise, a step is one observation of gain u + bias: least squares knows their correlation."""
    rng = np.random.default_rng(0)
    u = rng.uniform(0.005, 0.03, (5, 40))
    c = 0.05 + np.cumsum(u + 0.001 * rng.standard_normal(u.shape), axis=1) - u
    recording = replace(recorded(5), position=_along_x(c), action=_along_x(u))
    (model,) = examined(slide(0.0), recording).models
    parts = {part.name: part for part in candidates(model.data)}
    both = (parts["gain"], parts["bias"])
    (fitted,) = model.competition.fitted([Option(both, np.hstack([part.starts[:1] for part in both]))])
    names, matrix = model.correlations_of(fitted)
    u = model.data.u[model.data.counted_starts]
    assert names == ("gain of gain", "bias of bias")
    assert np.diag(matrix) == pytest.approx([1.0, 1.0])
    assert matrix[0, 1] == pytest.approx(-u.mean() / np.sqrt(np.mean(u**2)), abs=0.05)


def _along_x(values):
    return values.ravel()[:, None] * [1.0, 0.0, 0.0]


@pytest.mark.evidence
def test_the_floor_of_roll_outs_is_what_noise_makes_of_them(door) -> None:
    """Over several recordings of a door that does as the model says."""
    ratios = []
    for seed in range(6):
        found = calibrate(door, plants.door_recording(plants.runs_of(plants.honest, 8, 50, seed)))
        ratios.append(found.before.rollout / found.rollout_floor)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.25)


@pytest.mark.slow
def test_a_page_shows_poses_and_the_correlation_of_parameters(door) -> None:
    recording = plants.door_recording(plants.runs_of(plants.sprung, 8, 50, 3))
    found = calibrate(door, recording)
    (position, *before, after), turn = found.pose_errors[0][:1] + found.pose_errors[0][2:], found.pose_errors[1]
    runs = predict_recording(door, recording)
    assert position == "positions"
    assert before[0].one_step == pytest.approx(rmse([run.one_step.position for run in runs]))
    assert after.rollout < 0.2 * before[0].rollout
    assert turn[:2] == ("orientations", "rad")
    page = calibration_page(found, "door")
    assert "stiffness of spring" in page
    assert "orientations: roll-out" in page
