"""Motion that no single joint holds is called so, with the numbers; motion that a joint holds never is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from free_motions import FREE, free_recording, joint_recording
from planted import JOINTS, Noise, moving_then_held, recorded

from micah_plan.automaton.certainty import NoSingleJoint
from micah_plan.automaton.joint import revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.learning.learn import learn_graph
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording
from micah_plan.view.learned_words import deviation_notes


def no_single_joint(recording: Recording) -> NoSingleJoint | None:
    segments = learn_graph(recording).edges[0].segments
    return next((s.certainty.no_single_joint for s in segments if s.certainty.no_single_joint is not None), None)


@pytest.mark.slow
@pytest.mark.parametrize("motion", FREE)
def test_free_motion_fits_no_single_joint(motion: str) -> None:
    recording = free_recording(motion, 0, orientation=True)
    reason = no_single_joint(recording)
    assert reason is not None
    # The numbers say by how much: far more than the noise, and no more than the part moved at all.
    assert reason.log_odds > 0
    moved = np.sqrt(((recording.position - recording.position.mean(axis=0)) ** 2).sum(axis=1).mean())
    off = reason.position > 2 * reason.position_noise or reason.rotation > 2 * reason.rotation_noise
    assert off
    assert reason.position < 1.5 * moved


@pytest.mark.evidence
@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize("motion", FREE)
def test_free_motion_is_hardly_ever_taken_for_a_joint(motion: str, orientation: bool) -> None:
    found = [no_single_joint(free_recording(motion, seed, orientation)) for seed in range(6)]
    # Positions alone: a plane in which a hand moves nearly straight is nearly a drawer. A door that slides as it turns
    # looks like two hinges, one after the other.
    close = (motion == "plane" and not orientation) or motion == "sliding door on a hinge"
    assert sum(one is not None for one in found) >= (3 if close else 5)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", list(JOINTS))
def test_a_joint_under_a_realistic_tracker_is_no_free_motion(kind: str) -> None:
    assert no_single_joint(joint_recording(kind, 0, wander=2.5, memory=15.0)) is None


@pytest.mark.parametrize(
    "memory",
    [
        pytest.param(5.0, marks=pytest.mark.evidence),
        pytest.param(15.0, marks=pytest.mark.slow),
        pytest.param(40.0, marks=pytest.mark.evidence),
    ],
)
@pytest.mark.parametrize("kind", list(JOINTS))
def test_trackers_raise_no_false_alarm(kind: str, memory: float) -> None:
    for seed in range(5):
        for wander in (1.0, 2.5):
            assert no_single_joint(joint_recording(kind, seed, wander, memory)) is None


@pytest.mark.sweep
@pytest.mark.parametrize("kind", list(JOINTS))
def test_a_sound_joint_is_reported_to_fit(kind: str) -> None:
    recording = recorded([(JOINTS[kind], moving_then_held(kind))], np.random.default_rng(0), Noise(0.003, 0.02))
    segments = learn_graph(recording).edges[0].segments
    for segment in segments:
        assert segment.certainty.no_single_joint is None
        assert segment.certainty.deviation is None or segment.certainty.deviation.probability < 0.05
        assert sum(p for _, p in segment.certainty.kinds) == pytest.approx(1.0, abs=0.005)


def test_a_hinge_in_two_stages_is_identified_by_the_deviation_of_rows() -> None:
    c = np.concatenate([np.linspace(0.0, 0.8, 60), np.linspace(0.8, 1.6, 60)])
    first = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.4, 0.0, 0.0))
    met = forward(first, np.array([0.8]))
    second = replace(
        first, center=(0.0, -0.1, 0.0), position=tuple(met.translation[0]), quaternion=tuple(met.rotation.as_quat()[0])
    )
    recording = recorded([(first, c[:60]), (second, c[60:] - 0.8)], np.random.default_rng(0), Noise(0.0005, 0.003))
    (edge,) = learn_graph(recording).edges
    (segment,) = edge.segments
    deviation = segment.certainty.deviation
    assert segment.joint.kind == "revolute"
    assert deviation.probability > 0.9
    # Where another axis may take over, so may the number of changepoints be another.
    assert edge.certainty.changepoint_counts[0][0] < 0.92
    assert sum(edge.certainty.changepoint_counts[0]) == pytest.approx(1.0)
    assert 0.002 < deviation.position < 0.03
    assert deviation.rotation < 0.002
    assert segment.probability < 0.92
    # Said where people read it; of the first stage alone there is nothing to say.
    (note,) = deviation_notes([segment, replace(segment, start=200, end=300)])
    assert note.startswith("rows 0 to 119, 200 to 300 lie off this revolute joint by ")
    (of_first,) = learn_graph(recorded([(first, c[:60])], np.random.default_rng(0), Noise(0.0005, 0.003))).edges
    (alone,) = of_first.segments
    assert alone.probability > 0.98
    assert of_first.certainty.changepoint_counts[0][0] > 0.98
    assert deviation_notes([alone]) == []


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["demonstrations", "tracks"])
def test_shared_recordings_fit_a_joint(shared_data, folder: str) -> None:
    files = sorted((shared_data / folder).rglob("*.csv"))
    assert files
    for file in files:
        assert no_single_joint(read_recording(file)) is None, file.name


@pytest.mark.parametrize(("rows", "scatter"), [(20, Noise(1e-4, 5e-3)), (36, Noise(3e-4, 1e-3))])
def test_few_rows_of_a_part_at_rest_are_rigid(rows: int, scatter: Noise) -> None:
    recording = recorded([(JOINTS["prismatic"], np.zeros(rows))], np.random.default_rng(0), scatter)
    segments = learn_graph(recording).edges[0].segments
    assert [(one.joint.kind, one.certainty.no_single_joint) for one in segments] == [("rigid", None)]


def seen_by_a_wandering_tracker(position: np.ndarray, std: float, rng: np.random.Generator) -> Recording:
    """Positions alone, with an error that keeps nine tenths of itself from row to row."""
    error = rng.standard_normal(position.shape)
    for row in range(1, len(error)):
        error[row] = 0.9 * error[row - 1] + np.sqrt(1 - 0.9**2) * error[row]
    white = 2e-4 * rng.standard_normal(position.shape)
    return Recording(time=np.arange(len(position)) / 18, position=position + white + std * error)


@pytest.mark.sweep
@pytest.mark.parametrize("std", [0.001, 0.002, 0.003, 0.005])
@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_what_a_wandering_tracker_misses_of_a_joint_is_no_free_motion(kind: str, std: float) -> None:
    for seed in range(2):
        rng = np.random.default_rng([seed, 8])
        c = moving_then_held(kind, 120, 0)
        position = forward(JOINTS[kind], c).translation
        assert no_single_joint(seen_by_a_wandering_tracker(position, std, rng)) is None


@pytest.mark.sweep
@pytest.mark.parametrize("std", [0.001, 0.003])
def test_a_path_that_no_joint_has_is_refused_under_a_wandering_tracker_too(std: float) -> None:
    s = np.linspace(0, 0.3, 120)
    position = np.stack([s, 0.03 * np.cos(2 * np.pi * s / 0.15), np.zeros(120)], axis=1)
    assert no_single_joint(seen_by_a_wandering_tracker(position, std, np.random.default_rng(4))) is not None


@pytest.mark.slow
def test_how_sure_a_joint_is_fades_as_its_path_bends_away_from_it() -> None:
    """A joint that is the answer by little is not said with certainty, nor is free motion."""
    s = np.linspace(0, 0.3, 120)
    said = []
    for size in (0.02, 0.024, 0.03):
        position = np.stack([s, size * np.cos(2 * np.pi * s / 0.15), np.zeros(120)], axis=1)
        seen = seen_by_a_wandering_tracker(position, 0.007, np.random.default_rng(4))
        (segment,) = learn_graph(seen).edges[0].segments
        said.append((sum(p for _, p in segment.certainty.kinds), segment.certainty.no_single_joint is None))
    (first, holds), (second, *_), (third, missed) = said
    assert holds
    assert not missed
    assert 0.9 > first > 0.5 > second > third > 0.01
