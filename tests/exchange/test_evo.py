"""Trajectories as TUM text, opened by evo, which people compare trajectories with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from extras import module_requires

from micah_plan.documents.model import load_model
from micah_plan.exchange.convert import convert
from micah_plan.recording.read import read_recording
from micah_plan.residual.prediction import predict_recording, trajectory_errors

pytestmark = module_requires("evo")
from evo.core import metrics
from evo.tools import file_interface

DEMONSTRATIONS = Path(__file__).resolve().parents[2] / "examples" / "demonstrations"


@pytest.mark.parametrize(("name", "part"), [("microwave", "door"), ("cabinet", "drawer")])
def test_evo_reads_what_was_measured(tmp_path: Path, name: str, part: str) -> None:
    convert(DEMONSTRATIONS / f"{name}.csv", tmp_path / "part.tum", part=part, run=0, poses_only=True)
    found = file_interface.read_tum_trajectory_file(tmp_path / "part.tum")
    measured = read_recording(DEMONSTRATIONS / f"{name}.csv").select(run=0, part=part)
    assert found.check()[0]
    np.testing.assert_array_equal(found.timestamps, measured.time)
    np.testing.assert_array_equal(found.positions_xyz, measured.position)
    np.testing.assert_array_equal(np.roll(found.orientations_quat_wxyz, -1, axis=1), measured.quaternion)
    # What people ask evo: how far apart two trajectories are.
    file_interface.write_tum_trajectory_file(tmp_path / "again.tum", found)
    again = read_recording(tmp_path / "again.tum")
    np.testing.assert_allclose(again.position, measured.position, atol=1e-9)
    apart = metrics.APE(metrics.PoseRelation.translation_part)
    apart.process_data((found, file_interface.read_tum_trajectory_file(tmp_path / "again.tum")))
    assert apart.get_statistic(metrics.StatisticsType.max) < 1e-9


def test_the_errors_of_roll_outs_are_those_of_evo(repository: Path) -> None:
    model = load_model(repository / "models" / "microwave.yaml")
    runs = predict_recording(model, read_recording(DEMONSTRATIONS / "microwave.csv"))
    errors = trajectory_errors(runs)
    assert errors is not None
    squares = [np.append(run.rollout.position.ravel() ** 2, 0.0) for run in runs]  # the first row is not predicted
    assert errors[0] == pytest.approx(np.sqrt(np.mean(np.concatenate(squares))), rel=1e-6)
    assert 0.0 < errors[1] < errors[0]
    right = [replace(run, rollout=replace(run.rollout, poses=run.poses[1:])) for run in runs]
    assert trajectory_errors(right) == pytest.approx((0.0, 0.0), abs=1e-9)
