"""Laws of the parts of the changepoint recursion: length prior, resampling, exactness, evidence."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from exact_evidence import ExactEvidence
from hypothesis import given, settings
from hypothesis import strategies as st
from planted import JOINTS, moving_then_held, recorded

from micah_plan.errors import InputError
from micah_plan.learn.segmenting.changepoints import LengthPrior, best_segmentation, most_probable, resample
from micah_plan.learn.segmenting.evidence import (
    EvidenceColumn,
    EvidenceTable,
    segment_sums,
    tabulated,
)
from micah_plan.learn.segmenting.noise_fit import first_noise
from micah_plan.learn.segmenting.pool import window_hypotheses
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import part_track


class Table:
    """A stream that reads its evidence from a table (starts, ends, kinds)."""

    def __init__(self, values: np.ndarray) -> None:
        self.values, self.starts, self.row = values, np.zeros(0, dtype=np.int64), -1

    def __len__(self) -> int:
        return len(self.values)

    def advance(self) -> EvidenceColumn:
        self.row += 1
        self.starts = np.append(self.starts, self.row)
        chosen = self.values[self.starts, self.row]
        return EvidenceColumn(self.starts.copy(), chosen, lambda _, kind: kind)

    def keep(self, index: np.ndarray) -> None:
        self.starts = self.starts[index]


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


@settings(max_examples=60)
@given(
    st.lists(st.floats(1e-6, 1.0), min_size=2, max_size=40),
    st.integers(1, 12),
    st.integers(0, 1000),
)
def test_resampling_keeps_the_number_the_total_and_the_heavy(weights: list[float], count: int, seed: int) -> None:
    given_weights = np.array(weights)
    kept, new = resample(given_weights, count, np.random.default_rng(seed))
    normalised = given_weights / given_weights.sum()
    assert len(kept) == min(count, len(weights))
    assert len(set(kept.tolist())) == len(kept)
    assert new.sum() == pytest.approx(1.0)
    assert (new >= normalised[kept] * (1 - 1e-9)).all()
    heavy = np.flatnonzero(normalised > 1.0 / count)
    assert set(heavy.tolist()) <= set(kept.tolist())


def test_resampling_preserves_every_expected_weight() -> None:
    weights = np.array([0.4, 0.2, 0.1, 0.1, 0.08, 0.05, 0.04, 0.02, 0.01])
    rng = np.random.default_rng(0)
    total = np.zeros(len(weights))
    draws = 6000
    for _ in range(draws):
        kept, new = resample(weights, 4, rng)
        total[kept] += new
    assert np.allclose(total / draws, weights, atol=4 * 0.2 * np.sqrt(0.25 / draws))


def test_the_recursion_finds_the_best_of_all_segmentations() -> None:
    rng = np.random.default_rng(1)
    rows, kinds = 7, 2
    values = rng.normal(0, 3, (rows, rows, kinds))
    prior = LengthPrior(3.0, 2.0)

    def score(cuts: tuple[int, ...]) -> float:
        edges = [0, *cuts, rows]
        total = 0.0
        for start, stop in itertools.pairwise(edges):
            length = stop - start
            term = prior.log_probability(length) if stop < rows else prior.log_survival(length - 1)
            total += float(term) + float(values[start, stop - 1].max()) - np.log(kinds)
        return total

    candidates = [cuts for k in range(rows) for cuts in itertools.combinations(range(1, rows), k)]
    best = max(candidates, key=score)
    found = most_probable(Table(values), prior, np.random.default_rng(0))
    assert tuple(piece.start for piece in found.pieces[1:]) == best
    assert found.log_probability == pytest.approx(score(best))
    assert [p.hypothesis for p in found.pieces] == [int(values[p.start, p.end].argmax()) for p in found.pieces]


def planted_table(positions_only: bool = False) -> EvidenceTable:
    recording = recorded(
        [(JOINTS["revolute"], moving_then_held("revolute", 40, 30))],
        np.random.default_rng(2),
        orientation=not positions_only,
    )
    track = part_track(recording, 0, recording.parts[0])
    chosen = LearnSettings()
    noise = first_noise(track, chosen)
    return tabulated(window_hypotheses(track, chosen.kinds, noise), track, noise, chosen.rest, 0.5)


def planted_evidence(positions_only: bool = False) -> tuple[ExactEvidence, ExactEvidence, int]:
    table, kinds = planted_table(positions_only), LearnSettings().kinds
    return ExactEvidence(table, kinds), ExactEvidence(table, kinds), table.log_density.shape[1]


def test_particles_agree_with_the_exact_recursion() -> None:
    exact, approximate, rows = planted_evidence()
    prior = LengthPrior(rows / 2, 2.0)
    first = most_probable(exact, prior, np.random.default_rng(0))
    second = most_probable(approximate, prior, np.random.default_rng(0), particles=25)
    assert len(approximate.starts) <= 25
    assert first == second


@pytest.mark.parametrize("positions_only", [False, True])
def test_evidence_does_not_depend_on_when_other_starts_were_forgotten(positions_only: bool) -> None:
    full, pruned, rows = planted_evidence(positions_only)
    for row in range(rows):
        everything, some = full.advance(), pruned.advance()
        at = np.searchsorted(everything.starts, some.starts)
        assert np.allclose(everything.log_evidence[at], some.log_evidence)
        assert np.isfinite(everything.log_evidence).all()
        if row % 10 == 9:
            pruned.keep(np.arange(0, len(some.starts), 2))


def test_evidence_prefers_the_planted_models() -> None:
    stream, _, rows = planted_evidence()
    kinds = LearnSettings().kinds
    for row in range(rows):
        column = stream.advance()
        if row == 39:
            assert kinds[int(column.log_evidence[0].argmax())] == "revolute"
    assert kinds[int(column.log_evidence[40].argmax())] == "rigid"


def test_the_evidence_of_a_segment_is_the_sum_over_its_rows() -> None:
    rng = np.random.default_rng(3)
    density = rng.normal(0, 2, (4, 11, 3))
    sums = segment_sums(density)
    for start in range(11):
        for end in range(start, 11):
            total = sum(density[min(row - start, 3), row] for row in range(start, end + 1))
            assert sums[:, start, end] == pytest.approx(total)


@pytest.mark.parametrize("positions_only", [False, True])
def test_the_recursion_over_all_segments_at_once_is_the_one_over_columns(positions_only: bool) -> None:
    table = planted_table(positions_only)
    prior = LengthPrior(35.0, 2.0)
    kinds = LearnSettings().kinds
    assert best_segmentation(table, prior, len(kinds)) == most_probable(
        ExactEvidence(table, kinds), prior, np.random.default_rng(0)
    )
