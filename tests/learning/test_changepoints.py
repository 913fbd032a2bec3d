"""Laws of the parts of the changepoint recursion: length prior, exactness, evidence."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import JOINTS, Noise, moving_then_held, recorded

from micah_plan.automaton.joint import rigid
from micah_plan.changepoints import LengthPrior, most_probable_spans
from micah_plan.errors import InputError
from micah_plan.learning.joints.joint_arrays import arrays_of
from micah_plan.learning.learn import learn_graph
from micah_plan.learning.segmenting.evidence import EvidenceTable, segment_sums, tabulated
from micah_plan.learning.segmenting.noise_fit import initial_noise
from micah_plan.learning.segmenting.pieces import best_segmentation
from micah_plan.learning.segmenting.pool import window_hypotheses
from micah_plan.learning.segmenting.refined_changepoint import refine_changepoint
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import part_track


@pytest.mark.parametrize(("mean", "shape"), [(5.0, 1.0), (40.0, 2.0), (300.0, 3.5)])
def test_the_length_prior_is_normalised_and_survival_is_its_tail(mean: float, shape: float) -> None:
    prior = LengthPrior(mean, shape)
    n = np.arange(1, int(60 * mean))
    probability = np.exp(prior.log_probability(n))
    assert probability.sum() == pytest.approx(1.0, abs=1e-9)
    tail = 1 - np.concatenate([[0.0], np.cumsum(probability)])[:200]
    assert np.allclose(np.exp(prior.log_survival(np.arange(200))), tail, atol=1e-9)
    assert prior.log_survival(0) == 0.0


def test_a_length_prior_without_a_mean_is_refused() -> None:
    with pytest.raises(InputError, match="positive mean"):
        LengthPrior(0.0, 1.0)


@settings(max_examples=40)
@given(st.integers(1, 8), st.integers(0, 10_000))
def test_the_recursion_finds_the_best_of_all_segmentations(rows: int, seed: int) -> None:
    worth = np.random.default_rng(seed).normal(0, 3, (rows, rows))
    worth[np.tril_indices(rows, -1)] = -np.inf
    every = [cuts for k in range(rows) for cuts in itertools.combinations(range(1, rows), k)]
    totals = [sum(worth[a, b - 1] for a, b in itertools.pairwise([0, *cuts, rows])) for cuts in every]
    spans, log_probability = most_probable_spans(worth)
    assert tuple(start for start, _ in spans[1:]) == every[int(np.argmax(totals))]
    assert log_probability == pytest.approx(max(totals))
    assert [end for _, end in spans] == [*(start - 1 for start, _ in spans[1:]), rows - 1]


def planted_table(positions_only: bool = False) -> EvidenceTable:
    recording = recorded(
        [(JOINTS["revolute"], moving_then_held("revolute", 40, 30))],
        np.random.default_rng(2),
        orientation=not positions_only,
    )
    track = part_track(recording, 0, recording.parts[0])
    chosen = LearnSettings()
    noise = initial_noise(track, chosen)
    return tabulated(window_hypotheses(track, chosen.kinds, noise), track, noise, chosen.rest, 0.5)


@pytest.mark.parametrize("positions_only", [False, True])
def test_the_planted_segments_are_the_most_probable(positions_only: bool) -> None:
    table = planted_table(positions_only)
    names = table.pool.hypotheses.joints.kinds
    segmentation = best_segmentation(table, LengthPrior(35.0, 2.0), len(LearnSettings().kinds))
    assert [names[piece.hypothesis] for piece in segmentation.pieces] == ["revolute", "rigid"]
    assert abs(segmentation.pieces[1].start - 40) <= 2
    for piece in segmentation.pieces:
        every = [table.charged_sums(i)[piece.start, piece.end] for i in range(len(names))]
        assert piece.log_evidence == pytest.approx(max(every))
        assert piece.hypothesis == int(np.argmax(every))


def test_the_evidence_of_a_segment_is_the_sum_over_its_rows() -> None:
    rng = np.random.default_rng(3)
    density, ending = rng.normal(0, 2, (2, 4, 11, 3))
    sums = segment_sums(density, ending)
    for start in range(11):
        for end in range(start, 11):
            total = sum(density[min(row - start, 3), row] for row in range(start, end + 1))
            total = total + ending[min(end - start, 3), end]
            assert sums[:, start, end] == pytest.approx(total)


@pytest.mark.parametrize("acted", [False, True])
def test_a_step_may_be_unled_only_where_actions_lead(acted: bool) -> None:
    """Where no action tells how far a part goes, the first and last steps of a segment are as all others."""
    configuration = moving_then_held("prismatic", 40, 40)
    recording = recorded([(JOINTS["prismatic"], configuration)], np.random.default_rng(4))
    push = np.zeros((80, 3))
    push[:, :] = JOINTS["prismatic"].axis * np.append(np.diff(configuration[:41]), np.full(40, 0.01))[:, None]
    track = part_track(replace(recording, action=push if acted else None), 0, recording.parts[0])
    chosen = LearnSettings()
    noise = initial_noise(track, chosen)
    table = tabulated(window_hypotheses(track, chosen.kinds, noise), track, noise, chosen.rest, 0.5)
    led = table.motion.gain.any(axis=1)
    assert led.any() == acted
    assert np.abs(table.ending[:, :, ~led]).max(initial=0.0) < 1e-9
    # Caught in the row 40: there the last step of the motion is more probable than as one that is led.
    assert not acted or table.ending[-1, 40:44, led].max() > 1.0


@pytest.mark.parametrize("counted", [slice(0, 40), slice(40, 80), slice(0, 0), slice(0, 80)])
def test_a_changepoint_is_not_refined_where_no_row_counts_on_one_of_its_sides(counted: slice) -> None:
    recording = recorded([(JOINTS["revolute"], moving_then_held("revolute", 40, 40))], np.random.default_rng(2))
    track = part_track(recording, 0, recording.parts[0])
    inlier = np.zeros(80, dtype=bool)
    inlier[counted] = True
    joints = arrays_of([JOINTS["revolute"], rigid(track.position[-1], track.quaternion[-1])])
    refined = refine_changepoint(joints, 40, 4.0, (0, 80), track, inlier, LearnSettings())
    assert refined.row == 40 if inlier.sum() < 80 else abs(refined.row - 40) <= 2
    assert len(refined.rows) == 1 if inlier.sum() < 80 else len(refined.rows) > 1


@pytest.mark.slow
@pytest.mark.parametrize("grid", [0.0005, 0.004])
def test_the_first_row_of_a_stop_is_as_open_as_readings_on_a_grid_leave_it(grid: float) -> None:
    """A slide of 1 mm per row is read to 4 mm: rows in between say nothing new. Read finer, it is known to a few."""
    configuration, intervals = moving_then_held("prismatic", 400, 200), []
    for seed in range(8):
        recording = recorded(
            [(JOINTS["prismatic"], configuration)], np.random.default_rng(seed), Noise(position=3e-4, rotation=1e-3)
        )
        (edge,) = learn_graph(replace(recording, position=grid * np.round(recording.position / grid))).edges
        intervals.append(edge.segments[1].certainty.start.interval())
    assert sum(low <= 400 and high >= 399 for low, high in intervals) >= 7
    assert max(high - low for low, high in intervals) < 15


def test_a_rest_elsewhere_does_not_explain_a_row_by_the_row_before_it() -> None:
    """A segment goes on from the row before it where both lie on its joint: else any far pose explained a last step."""
    table = planted_table()
    names = table.pool.hypotheses.joints.kinds
    fitted = table.pool.hypotheses.used
    rest = max(
        (i for i, name in enumerate(names) if name == "rigid"),
        key=lambda i: fitted[i, 45:].sum() - fitted[i, :45].sum(),
    )
    motion = max((i for i, name in enumerate(names) if name == "revolute"), key=lambda i: fitted[i, :38].sum())
    in_motion, at_rest = 10, 55
    far, near = (float(table.sums[rest, row, row] - table.sums[motion, row, row]) for row in (in_motion, at_rest))
    assert far < -8.0
    assert near > -2.0
