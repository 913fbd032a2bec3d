"""How sure learning says it is, is how often it is right: rows, numbers and kinds; and the laws of its sums."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from planted import JOINTS, TRAVEL, Noise, moving_then_held, recorded
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import binom

from micah_plan.automaton.certainty import RowPosterior
from micah_plan.automaton.graph import KinematicEdge
from micah_plan.automaton.joint import revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.changepoints import LengthPrior
from micah_plan.learning.learn import METHODS, Method, learn_graph
from micah_plan.learning.segmenting.evidence import EvidenceTable, tabulated
from micah_plan.learning.segmenting.noise_fit import initial_noise
from micah_plan.learning.segmenting.pieces import length_priors
from micah_plan.learning.segmenting.pool import refitted_hypotheses, window_hypotheses
from micah_plan.learning.segmenting.posterior import ChangepointPosterior, changepoint_posterior
from micah_plan.learning.segmenting.report import LOG_ODDS_OVERSTATED, OTHER_MECHANISM, kind_probabilities, posterior_of
from micah_plan.learning.segmenting.segmentation import segment_track
from micah_plan.learning.segmenting.segmented import Alternative, Segmented
from micah_plan.learning.segmenting.selections import ANOTHER_JOINT, shared
from micah_plan.learning.segmenting.steps import steps_of
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import part_track
from micah_plan.recording.value import Recording

RECORDINGS = 100
RARELY = 1e-4


def drawn(seed: int) -> tuple[str, int | None, KinematicEdge, KinematicEdge]:
    """A random joint that moves at a random pace and then is held (or not): its kind, the row of the stop, what is
    learned with and without actions."""
    rng = np.random.default_rng([5, seed])
    kind = list(JOINTS)[seed % 3]
    moving, held = int(rng.integers(40, 90)), int(rng.integers(20, 60)) * (seed % 4 > 0)
    pace = np.exp(0.25 * np.convolve(rng.standard_normal(moving + 7), np.full(8, 8**-0.5), mode="valid"))
    c = TRAVEL[kind] * rng.uniform(0.6, 1.3) * np.cumsum(pace) / pace.sum()
    c = np.concatenate([[0.0], c, np.full(held, c[-1])])
    step = np.append(np.diff(c), 0.0)
    step[step == 0] = step.max() / 2
    asked = step * np.exp(0.2 * rng.standard_normal(len(step)))
    recording = recorded([(JOINTS[kind], c)], rng, Noise(0.001, 0.006), commanded=[asked])
    edges = [learn_graph(recording, method=method).edges[0] for method in METHODS]
    return kind, moving if held else None, edges[0], edges[1]


@pytest.fixture(scope="module")
def many() -> list[tuple[str, int | None, KinematicEdge, KinematicEdge]]:
    return [drawn(seed) for seed in range(RECORDINGS)]


@pytest.mark.evidence
@pytest.mark.parametrize("method", METHODS)
def test_intervals_hold_the_row_at_which_a_part_stops(many, method: Method) -> None:
    """The first row at rest. Whether the row that arrives there still moves or already rests, no pose can tell."""
    widths, hits = [], []
    for _, stop, *edges in many:
        segments = edges[METHODS.index(method)].segments
        if stop is not None and len(segments) == 2:
            low, high = segments[1].certainty.start.interval()
            hits.append(low <= stop + 1 and stop <= high)
            widths.append(high - low + 1)
    assert len(hits) > 0.9 * RECORDINGS * 3 / 4
    assert sum(hits) >= binom.ppf(RARELY, len(hits), 0.95)
    # An interval that holds everything says nothing.
    assert np.mean(widths) < 10


@pytest.mark.evidence
@pytest.mark.parametrize("method", METHODS)
def test_the_number_of_changepoints_is_as_certain_as_stated(many, method: Method) -> None:
    given, right = [], []
    for _, stop, *edges in many:
        counts = np.array(edges[METHODS.index(method)].certainty.changepoint_counts[0])
        given.append(counts[int(stop is not None)])
        right.append(int(counts.argmax()) == (stop is not None))
    # Where the claimed certainty is high, it must be earned: no more misses than it leaves room for.
    misses = len(right) - sum(right)
    assert misses <= binom.ppf(1 - RARELY, len(right), max(1 - float(np.mean(given)), 0.03))
    assert np.mean(given) > 0.9


@pytest.mark.evidence
@pytest.mark.parametrize("method", METHODS)
def test_kinds_are_as_certain_as_stated(many, method: Method) -> None:
    given, right = [], []
    for kind, _, *edges in many:
        chances = dict(edges[METHODS.index(method)].segments[0].certainty.kinds)
        given.append(chances[kind])
        right.append(max(chances, key=lambda name, own=chances: own[name]) == kind)
    misses = len(right) - sum(right)
    assert misses <= binom.ppf(1 - RARELY, len(right), max(1 - float(np.mean(given)), 0.03))


@pytest.mark.evidence
@pytest.mark.parametrize("method", METHODS)
def test_kinds_are_stated_with_nine_tenths_on_average(many, method: Method) -> None:
    given = [dict(edges[METHODS.index(method)].segments[0].certainty.kinds)[kind] for kind, _, *edges in many]
    assert np.mean(given) > 0.9


@pytest.mark.sweep
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", list(JOINTS))
def test_probabilities_are_probabilities(kind: str, method: Method) -> None:
    recording = recorded([(JOINTS[kind], moving_then_held(kind))], np.random.default_rng(0))
    edge = learn_graph(recording, method=method).edges[0]
    (counts,) = edge.certainty.changepoint_counts
    assert sum(counts) == pytest.approx(1.0)
    assert int(np.argmax(counts)) == len(edge.segments) - 1
    assert np.isfinite(edge.certainty.log_evidence)
    for segment in edge.segments:
        chances, deviation = dict(segment.certainty.kinds), segment.certainty.deviation
        assert (deviation is None) == (segment.joint.kind == "rigid")
        unusual = 0.0 if deviation is None else deviation.probability
        assert sum(chances.values()) == pytest.approx(1.0 - OTHER_MECHANISM * unusual)
        assert segment.probability == chances[segment.joint.kind] == max(chances.values())
    start = edge.segments[1].certainty.start
    assert sum(start.probabilities) == pytest.approx(1.0)
    assert list(start.rows) == sorted(set(start.rows))
    assert start.rows[int(np.argmax(start.probabilities))] == edge.segments[1].start
    low, high = start.interval()
    inside = sum(p for row, p in zip(start.rows, start.probabilities, strict=True) if low <= row <= high)
    assert inside >= 0.95 - 1e-12
    assert start.interval(0.5)[1] - start.interval(0.5)[0] <= high - low


def test_an_interval_is_the_narrowest_that_holds_enough() -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        rows = np.cumsum(rng.integers(1, 4, 9))
        chances = rng.dirichlet(np.full(9, 0.5))
        low, high = RowPosterior(tuple(rows.tolist()), tuple(chances.tolist())).interval(0.8)
        width = min(rows[j] - rows[i] for i in range(9) for j in range(i, 9) if chances[i : j + 1].sum() >= 0.8 - 1e-12)
        assert high - low == width


def test_a_stop_that_the_answer_has_not_is_counted_all_the_same() -> None:
    """A rest of a few rows may be a pause: one joint is the answer, but how sure it is depends on how long it rests."""
    none = []
    for held in (2, 7, 12):
        recording = recorded([(JOINTS["prismatic"], moving_then_held("prismatic", 70, held))], np.random.default_rng(3))
        none.append(learn_graph(recording, method="champ").edges[0].certainty.changepoint_counts[0][0])
    assert none[0] > 0.9 > none[1] > 0.5 > none[2]


def enumerated(table: EvidenceTable, cost, apart, prior: LengthPrior, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Log weights (c, ...) of all segmentations with up to `most` segments: totals by count, and by count and row."""
    order, n, h = table.log_density.shape[0] - 1, *table.log_density.shape[1:]
    totals: list[list[float]] = [[] for _ in range(most)]
    starts: dict[tuple[int, int, int], list[float]] = {}
    for m in range(1, most + 1):
        for cuts in itertools.combinations(range(1, n), m - 1):
            edges = [0, *cuts, n]
            for used in itertools.product(range(h), repeat=m):
                weight = 0.0
                for j, (start, stop) in enumerate(itertools.pairwise(edges)):
                    length = stop - start
                    weight += float(prior.log_survival(length - 1) if stop == n else prior.log_probability(length))
                    weight += sum(table.log_density[min(t - start, order), t, used[j]] for t in range(start, stop))
                    weight += table.ending[min(length - 1, order), stop - 1, used[j]]
                    weight -= cost[used[j]]
                    weight -= apart[used[j - 1], used[j]] if j else 0.0
                totals[m - 1].append(weight)
                for j, cut in enumerate(cuts):
                    starts.setdefault((m - 1, j, cut), []).append(weight)
    rows = np.full((most, most, n), -np.inf)
    for (count, j, cut), weights in starts.items():
        rows[count, j, cut] = logsumexp(weights)
    return np.array([logsumexp(one) for one in totals]), rows


@pytest.mark.slow
def test_forward_and_backward_sums_are_the_sum_over_all_segmentations() -> None:
    """Every segmentation of a short track, written out one by one."""
    recording = recorded([(JOINTS["prismatic"], moving_then_held("prismatic", 5, 3))], np.random.default_rng(1))
    track = part_track(recording, 0, recording.parts[0])
    settings = LearnSettings()
    noise = initial_noise(track, settings)
    pool = window_hypotheses(track, settings.kinds, noise).take([0, 1, 2])
    table = tabulated(pool, track, noise, settings.rest, 0.5)
    rng = np.random.default_rng(2)
    cost, prior = rng.uniform(0, 3, 3), LengthPrior(4.0, 2.0)
    apart = rng.uniform(0, 2, (3, 3))
    np.fill_diagonal(apart, np.inf)
    worth = table.sums - cost[:, None, None]
    for changepoints in (0, 1, 2):
        found: ChangepointPosterior = changepoint_posterior(worth, apart, prior, changepoints)
        most = len(found.counts)
        totals, rows = enumerated(table, cost, apart, prior, most)
        assert found.log_evidence == pytest.approx(logsumexp(totals))
        np.testing.assert_allclose(found.counts, np.exp(totals - logsumexp(totals)), atol=1e-10)
        expected = np.exp(rows[changepoints, :changepoints] - totals[changepoints])
        np.testing.assert_allclose(found.starts, expected, atol=1e-10)
        any_count = np.exp(logsumexp(rows, axis=(0, 1)) - logsumexp(totals))
        np.testing.assert_allclose(found.changepoint, any_count, atol=1e-10)


def test_a_joint_is_paid_for_by_the_rows_that_it_explains_however_few_it_was_fitted_to() -> None:
    """One joint leaves one segmentation; fitted to a tenth of its rows it was the likelier, by up to eight nats."""
    recording = recorded([(JOINTS["revolute"], np.linspace(0, 1, 60))], np.random.default_rng(1), Noise(0.002, 0.01))
    track = part_track(recording, 0, recording.parts[0])
    settings = LearnSettings(kinds=("revolute",))
    noise = initial_noise(track, settings)
    prior = length_priors(track, settings)[0]
    for rows in (6, 60):
        pool = refitted_hypotheses(["revolute"], np.arange(60)[None] < rows, track, noise)
        table = tabulated(pool, track, noise, settings.rest, 0.5)
        answer = Segmented(track, noise, prior, shared(table, [0], prior, settings), table)
        told = posterior_of(answer, settings).log_evidence
        assert told == pytest.approx(answer.log_probability, abs=1e-6)


@pytest.mark.parametrize("returns", [False, True])
def test_an_answer_is_as_probable_as_its_joints_at_all_places_where_one_may_take_over(returns: bool) -> None:
    """Not only at the likeliest: every place written out, for two joints and for a return to the first.

    The choice of a kind is paid for once per joint, not each time that the part returns to it.
    """
    turn = recorded([(JOINTS["revolute"], np.linspace(0, 1, 9))], np.random.default_rng(1)).position
    slide = recorded([(JOINTS["prismatic"], np.linspace(0, 0.3, 7))], np.random.default_rng(1)).position
    there = np.concatenate([turn, turn[-1] + slide])
    position = np.concatenate([there, there[::-1]]) if returns else there
    recording = recorded([(JOINTS["prismatic"], np.zeros(len(position)))], np.random.default_rng(1))
    recording = replace(recording, position=position)
    track = part_track(recording, 0, recording.parts[0])
    settings = LearnSettings()
    noise, prior, n = initial_noise(track, settings), length_priors(track, settings)[0], len(track)
    joints = ["revolute", "prismatic"]
    turning = (np.arange(n) < 9) | (np.arange(n) >= 23)
    used = np.array([turning, ~turning])
    table = tabulated(refitted_hypotheses(joints, used, track, noise), track, noise, settings.rest, 0.5)
    answer = shared(table, [0, 1], prior, settings)
    order = [piece.hypothesis for piece in answer.pieces]
    assert len(order) == 2 + returns
    weights = []
    for cuts in itertools.combinations(range(1, n), len(order) - 1):
        pieces = list(zip((0, *cuts), (*cuts, n), order, strict=True))
        lengths = [float(prior.log_probability(b - a)) for a, b, _ in pieces[:-1]]
        lengths.append(float(prior.log_survival(n - pieces[-1][0] - 1)))
        rows = [float(table.sums[one, a, b - 1]) for a, b, one in pieces]
        weights.append(sum(lengths) + sum(rows) - 2 * np.log(len(settings.kinds)))
    explained = np.array([float(sum(p.end - p.start + 1 for p in answer.pieces if p.hypothesis == i)) for i in (0, 1)])
    paid = float(table.cost(np.arange(2), explained).sum()) + ANOTHER_JOINT
    assert answer.log_probability == pytest.approx(logsumexp(weights) - paid, abs=1e-9)


@pytest.mark.sweep
@pytest.mark.parametrize("stopped", [None, 40])
@pytest.mark.parametrize("kind", list(JOINTS))
def test_an_answer_is_compared_with_every_kind_of_joint_on_its_rows(kind: str, stopped: int | None) -> None:
    """What had no rival was stated as certain: also where a stop was tried last, each joint has its rivals."""
    c = TRAVEL[kind] * np.linspace(0, 1, 80)
    c = c if stopped is None else np.concatenate([c, np.full(stopped, c[-1])])
    step = np.append(np.diff(c), 0.0)
    step[step == 0] = step.max()
    recording = recorded([(JOINTS[kind], c)], np.random.default_rng(3), Noise(0.003, 0.03), commanded=[step])
    settings = LearnSettings()
    track = part_track(recording, 0, recording.parts[0])
    steps = steps_of(track, np.ones(len(track), dtype=bool), settings)
    found = segment_track(steps.track, settings.of_steps(steps.size))
    pool = found.table.pool.hypotheses
    for used in {piece.hypothesis for piece in found.segmentation.pieces}:
        rows = np.zeros(len(steps.track), dtype=bool)
        for piece in found.segmentation.pieces:
            if piece.hypothesis == used:
                rows[piece.start : piece.end + 1] = True
        rivals = [name for name, own in zip(pool.joints.kinds, pool.used, strict=True) if np.array_equal(own, rows)]
        assert set(rivals) >= {"rigid", "prismatic", "revolute", kind}


def test_an_answer_as_probable_with_its_own_noise_takes_half_of_the_probability() -> None:
    """Under the noise of the answer its rivals fare worse than under their own."""
    recording = recorded([(JOINTS["prismatic"], moving_then_held("prismatic", 70, 30))], np.random.default_rng(3))
    settings = LearnSettings()
    steps = steps_of(part_track(recording, 0, recording.parts[0]), np.ones(len(recording), dtype=bool), settings)
    found = segment_track(steps.track, settings.of_steps(steps.size))
    first, _ = (piece.hypothesis for piece in found.segmentation.pieces)
    n = len(steps.track)
    for below, share in ((0.0, 0.5), (LOG_ODDS_OVERSTATED, 1 / (1 + np.e)), (1e9, 0.0)):
        other = Alternative(("revolute",), np.zeros(n, dtype=np.int64), found.log_probability - below)
        told = replace(found, others=(other,))
        kinds = dict(kind_probabilities(told, first, settings.kinds, -np.inf))
        alone = dict(kind_probabilities(replace(found, others=()), first, settings.kinds, -np.inf))
        assert alone["revolute"] < 0.1 < alone["prismatic"]
        given = alone["revolute"] / (alone["revolute"] + alone["prismatic"])
        ratio = kinds["revolute"] / (kinds["revolute"] + kinds["prismatic"])
        assert ratio == pytest.approx(max(share, given), abs=1e-6)
        counts, without = (posterior_of(one, settings).counts for one in (told, replace(found, others=())))
        # The sums over the joints of the answer know of it, too: what is more counts.
        more = max(np.exp(-below / LOG_ODDS_OVERSTATED) * without[1] - without[0], 0.0)
        assert counts[0] == pytest.approx((without[0] + more) / (1 + more), abs=1e-9)


def test_a_clear_second_joint_has_a_high_probability() -> None:
    """What a further joint costs is weighed against the same evidence where it is chosen and where it is stated."""
    turned = np.concatenate([np.linspace(0.0, 0.8, 60), np.full(60, 0.8)])
    slid = np.concatenate([np.zeros(60), np.linspace(0.0, 0.2, 60)])
    poses = forward(revolute((0.0, 0.0, 1.0), (0.3, 0.0, 0.0), (0.6, 0.0, 0.2)), turned)
    rng = np.random.default_rng(5)
    recording = Recording(
        time=np.arange(120) / 18.0,
        position=poses.translation + np.outer(slid, [0.0, 0.0, 1.0]) + 0.001 * rng.standard_normal((120, 3)),
        quaternion=(Rotation.from_rotvec(0.005 * rng.standard_normal((120, 3))) * poses.rotation).as_quat(),
    )
    hinge, slide = learn_graph(recording).edges[0].segments
    assert (hinge.joint.kind, slide.joint.kind) == ("revolute", "prismatic")
    assert dict(hinge.certainty.kinds)["revolute"] > 0.8
    assert dict(slide.certainty.kinds)["prismatic"] > 0.8


def test_an_answer_with_one_more_segment_takes_its_share_of_their_number() -> None:
    recording = recorded([(JOINTS["prismatic"], np.linspace(0.0, 0.3, 90))], np.random.default_rng(3))
    settings = LearnSettings()
    steps = steps_of(part_track(recording, 0, recording.parts[0]), np.ones(len(recording), dtype=bool), settings)
    found = replace(segment_track(steps.track, settings.of_steps(steps.size)), others=())
    n = len(steps.track)
    other = Alternative(("prismatic", "rigid"), (np.arange(n) >= n - 10).astype(np.int64), found.log_probability)
    alone, told = (posterior_of(one, settings) for one in (found, replace(found, others=(other,))))
    assert alone.counts[0] > 0.8
    assert told.counts[0] == pytest.approx(told.counts[1])
    assert told.changepoint[n - 10] > 0.4
