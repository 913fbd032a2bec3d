"""Motions of one freedom that no joint follows: paths where they are passed again and agree, else no joint."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from planted import JOINTS, Noise, recorded
from scipy.spatial.transform import Rotation

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import Segment
from micah_plan.automaton.kinematics import forward, inverse
from micah_plan.documents.model import dump_model, load_model
from micah_plan.learning.learn import learn_graph
from micah_plan.learning.paths import length_std, path_evidence, principal_path
from micah_plan.learning.segmenting.free import free_log_probability
from micah_plan.learning.segmenting.noise_fit import initial_noise
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import part_track
from micah_plan.recording.value import Recording

WHITE, TURNED = 0.001, 0.005


def ladder(sweep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A door whose ends run along two walls."""
    angle, flat = 0.1 + 1.3 * sweep, np.zeros(len(sweep))
    return np.stack([0.35 * np.sin(angle), flat, 0.15 * np.cos(angle)], 1), np.stack([flat, -angle, flat], 1)


def slot(sweep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A pin in a wavy slot that does not turn."""
    flat = np.zeros(len(sweep))
    return np.stack([0.5 * sweep, 0.06 * np.sin(2 * np.pi * sweep), flat], 1), np.zeros((len(sweep), 3))


SHAPES = {"ladder": ladder, "slot": slot}


def wander(n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 3) an error of one std that forgets in ten rows."""
    error = rng.standard_normal((n, 3))
    for before, now in pairwise(error):
        now[:] = 0.9 * before + np.sqrt(1 - 0.9**2) * now
    return error


def passed(
    shape: str, times: int, seed: int = 0, orientation: bool = True, wanders: float = 0.0
) -> tuple[Recording, np.ndarray]:
    """A recording of so many passes, and the true positions.

    Args:
        wanders: std of the wander of measured positions [m].
    """
    rng = np.random.default_rng(seed)
    sweep = np.abs((times * np.linspace(0.0, 1.0, 60 * times + 20) + 1.0) % 2.0 - 1.0)
    position, turn = SHAPES[shape](sweep)
    n, base = len(sweep), Rotation.random(rng=rng)
    truth = base.apply(position) + rng.standard_normal(3)
    seen = Rotation.from_rotvec(TURNED * rng.standard_normal((n, 3))) * base * Rotation.from_rotvec(turn)
    found = Recording(
        time=0.1 * np.arange(n),
        position=truth + WHITE * rng.standard_normal((n, 3)) + wanders * wander(n, rng),
        quaternion=seen.as_quat() if orientation else None,
        run=np.zeros(n, dtype=int),
        part=("lid",) * n,
    )
    return found, truth


def only(recording: Recording) -> Segment:
    (segment,) = learn_graph(recording).edges[0].segments
    return segment


@pytest.mark.sweep
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("times", [2, 3])
def test_a_curve_that_is_passed_again_is_a_path(shape: str, times: int) -> None:
    recording, truth = passed(shape, times)
    segment = only(recording)
    assert segment.joint.kind == "path"
    assert segment.probability > 0.9
    assert segment.certainty.no_single_joint is None
    c = inverse(segment.joint, recording.position, recording.poses().rotation)
    left = np.linalg.norm(forward(segment.joint, c).translation - truth, axis=1)
    # Along the curve a row is only as good as its own noise; across it many rows are.
    assert np.sqrt(np.mean(left**2)) < 1.5 * WHITE


@pytest.mark.sweep
@pytest.mark.parametrize("shape", SHAPES)
def test_a_tracker_that_wanders_between_passes_hides_no_path(shape: str) -> None:
    """Passes lie further apart than neighbouring rows, which is no motion across the curve."""
    recording, truth = passed(shape, 3, wanders=2 * WHITE)
    segment = only(recording)
    assert segment.joint.kind == "path"
    c = inverse(segment.joint, recording.position, recording.poses().rotation)
    left, seen = (
        np.linalg.norm(one - truth, axis=1) for one in (forward(segment.joint, c).translation, recording.position)
    )
    assert np.sqrt(np.mean(left**2)) < 0.85 * np.sqrt(np.mean(seen**2))


@pytest.mark.sweep
@pytest.mark.parametrize("wanders", [0.0, 2 * WHITE])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_curve_that_is_passed_once_is_no_joint(shape: str, wanders: float) -> None:
    segment = only(passed(shape, 1, wanders=wanders)[0])
    assert segment.joint.kind != "path"
    assert segment.certainty.no_single_joint is not None


def test_a_path_by_positions_alone_is_likelier_than_free_motion_only_if_it_is_passed_again() -> None:
    for times, again in ((1, False), (3, True)):
        recording, _ = passed("slot", times, orientation=False)
        track = part_track(recording, 0, "lid")
        noise = initial_noise(track, LearnSettings())
        curve = principal_path(track, length_std(noise))
        told = path_evidence(curve, track, noise, 1.0)
        free = free_log_probability(track, noise, 1.0)
        assert (told is not None and told.log_probability > free + 50.0) == again


@pytest.mark.slow
def test_a_curve_that_deforms_is_no_path() -> None:
    """The slot's waves grow from pass to pass, so it does not agree with itself."""
    recording, truth = passed("slot", 3)
    away = truth - truth.mean(axis=0)
    flat = np.linalg.svd(away, full_matrices=False)[2][1]
    waves = (away @ flat)[:, None] * flat
    moved = recording.position + np.linspace(0.0, 1.0, len(truth))[:, None] * waves
    segment = only(replace(recording, position=moved))
    assert segment.joint.kind != "path"


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "screw"])
def test_a_real_joint_that_is_passed_again_is_no_path(kind: str) -> None:
    """It deviates by millimetres, in every pass alike, as real joints do."""
    travel = {"revolute": 1.2, "prismatic": 0.4, "screw": 1.2}[kind]
    sweep = np.abs((3 * np.linspace(0.0, 1.0, 180) + 1.0) % 2.0 - 1.0)
    recording = recorded([(JOINTS[kind], travel * sweep)], np.random.default_rng(1), Noise(position=0.0005))
    bent = recording.position + 0.003 * np.sin(4.0 * sweep)[:, None] * [0.6, 0.0, 0.8]
    segments = learn_graph(replace(recording, position=bent)).edges[0].segments
    assert {segment.joint.kind for segment in segments} == {kind}


def test_a_model_with_a_path_is_saved_and_loaded(tmp_path) -> None:
    automaton = build_automaton(learn_graph(passed("ladder", 3)[0]))
    assert automaton.coordinates[0].unit == "m"
    dump_model(automaton, tmp_path / "lid.yaml")
    assert load_model(tmp_path / "lid.yaml") == automaton
