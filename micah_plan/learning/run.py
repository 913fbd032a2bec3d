"""Learning from one run of one part: its segments, with joints fitted to all rows, and how sure they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from micah_plan.arrays import Booleans
from micah_plan.automaton.certainty import EvidenceTrace, RowPosterior, SegmentCertainty
from micah_plan.automaton.joint import Joint, JointKind
from micah_plan.learning.goodness_of_fit import assess_joints, no_single_joint_of
from micah_plan.learning.joints.final_fit import LackOfFit, fit_joint
from micah_plan.learning.segmenting.noise import MeasurementNoise
from micah_plan.learning.segmenting.pieces import Piece
from micah_plan.learning.segmenting.posterior import (
    ChangepointPosterior,
    with_another_changepoint,
    without_changepoints,
)
from micah_plan.learning.segmenting.refined_changepoint import RefinedChangepoint, refine_changepoint
from micah_plan.learning.segmenting.report import kind_probabilities, other_mechanism, posterior_of
from micah_plan.learning.segmenting.segmentation import segment_track
from micah_plan.learning.segmenting.segmented import Segmented
from micah_plan.learning.segmenting.steps import Steps, steps_of
from micah_plan.learning.segments import FittedPiece, chained
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack, find_inliers

_NEGLIGIBLE = 1e-3  # rows less likely than this are not reported


@dataclass(frozen=True, eq=False)
class LearnedRun:
    """Result of learning one run of one part.

    Attributes:
        track, inlier: its rows, and which are no outliers.
        noise: of single rows.
        pieces: (m,) stretches of rows with their joints, on one coordinate.
        certainties: (m,) how sure they are.
        hypotheses: (m,) equal for pieces that share a joint.
        posterior: over segmentations, in steps.
        trace: evidence over time.
        segmented: the segments in steps, with their evidence.
    """

    track: PartTrack
    inlier: Booleans
    noise: MeasurementNoise
    pieces: tuple[FittedPiece, ...]
    certainties: tuple[SegmentCertainty, ...]
    hypotheses: tuple[int, ...]
    posterior: ChangepointPosterior
    trace: EvidenceTrace
    segmented: Segmented


@dataclass(frozen=True, eq=False)
class SegmentedRun:
    """A run segmented at the resolution of steps, before joints are fitted to rows.

    Attributes:
        track, inlier: its rows, and which are no outliers.
        steps: the rows averaged.
        segmented: the segments in steps, with their evidence.
        posterior: over segmentations, in steps.
    """

    track: PartTrack
    inlier: Booleans
    steps: Steps
    segmented: Segmented
    posterior: ChangepointPosterior


def learn_run(
    track: PartTrack,
    settings: LearnSettings,
    inlier: Booleans | None = None,
) -> LearnedRun:
    """Segment a track and fit the joints of its segments to all of their rows.

    Args:
        inlier: (n,) rows that are no outliers; None: to be found.
    """
    return with_joints(segment_run(track, settings, inlier), settings)


def segment_run(
    track: PartTrack,
    settings: LearnSettings,
    inlier: Booleans | None = None,
    start: SegmentedRun | None = None,
    counted: Booleans | None = None,
) -> SegmentedRun:
    """Cut a track into segments.

    Args:
        inlier: (n,) rows that are no outliers; None: to be found.
        start: result for the same poses with other actions, as the initial guess.
        counted: (n,) rows to average for steps; None: all but outliers.
    """
    inlier = find_inliers(track) if inlier is None else inlier
    steps = (
        steps_of(track, inlier if counted is None else counted, settings) if start is None else start.steps.of(track)
    )
    segmented = segment_track(steps.track, steps.assumed(settings), None if start is None else start.segmented)
    posterior = posterior_of(segmented, settings)
    return SegmentedRun(track, inlier, steps, segmented, posterior)


def with_joints(segmented_run: SegmentedRun, settings: LearnSettings) -> LearnedRun:
    """The run with joints fitted to all rows of its segments, and how sure they are."""
    track, inlier, posterior = segmented_run.track, segmented_run.inlier, segmented_run.posterior
    noise = segmented_run.segmented.noise.of_rows(segmented_run.steps.size)
    segmented, no_single_joint = segmented_run.segmented, None

    def fitted_to(answer: Segmented) -> tuple[list[FittedPiece], list[RowPosterior | None]]:
        pieces = answer.segmentation.pieces
        return fitted_pieces(pieces, answer, segmented_run.steps, track, inlier, settings)

    fitted, places = fitted_to(segmented)
    fit = assess_joints(segmented, fitted, track, inlier, noise, settings)
    if fit is not None and fit.instead is not None:
        segmented = fit.instead
        fitted, places = fitted_to(segmented)
        if fit.log_odds <= 0:
            # Trees compare evidence between parents, so it stays that of one procedure, the first search. Noise fitted
            # anew to the one joint takes what that misses for a tracker's wander, which explains any curve.
            log_evidence = segmented_run.posterior.log_evidence
            posterior = replace(posterior_of(segmented, settings), log_evidence=log_evidence)
        if fit.moves_freely:
            no_single_joint = no_single_joint_of(fitted, track, inlier, noise, settings, fit.log_odds)
    pieces = segmented.segmentation.pieces
    against = -np.inf if fit is None else fit.log_odds
    kinds = [
        kind_probabilities(segmented, p.hypothesis, settings.kinds, against, piece.lack_of_fit)
        for p, piece in zip(pieces, fitted, strict=True)
    ]
    if no_single_joint is None:  # or another axis takes over somewhere
        another = max(other_mechanism(piece.lack_of_fit) for piece in fitted)
        posterior = with_another_changepoint(posterior, another)
    if fit is not None and fit.path is not None:
        fitted = [FittedPiece(0, len(track) - 1, fit.path, np.zeros(3), None, fit.log_evidence)]
        (shares,) = kinds
        rest = 1 - sum(share for _, share in shares)
        kinds = [(*shares, ("path", rest))]
        posterior = without_changepoints(posterior, rest)
    chain = chained(fitted, track, inlier, noise)
    certainties = tuple(
        SegmentCertainty(place, kind, no_single_joint, piece.lack_of_fit.deviation)
        for place, kind, piece in zip(places, kinds, fitted, strict=True)
    )
    trace = _trace(segmented, posterior, settings)
    hypotheses = tuple(piece.hypothesis for piece in pieces)
    return LearnedRun(track, inlier, noise, tuple(chain), certainties, hypotheses, posterior, trace, segmented)


def fitted_pieces(
    pieces: Sequence[Piece],
    segmented: Segmented,
    steps: Steps,
    track: PartTrack,
    inlier: Booleans,
    settings: LearnSettings,
) -> tuple[list[FittedPiece], list[RowPosterior | None]]:
    """Pieces of steps as pieces of rows, with joints fitted to them, and where each may start."""
    refined: list[RefinedChangepoint] = []
    for a, b in pairwise(pieces):
        since = refined[-1].row if refined else 0
        refined.append(_refined(a, b, since, segmented, steps, track, inlier, settings))
    starts = [0, *(refined.row for refined in refined)]
    ends = [*(start - 1 for start in starts[1:]), len(track) - 1]
    spans = list(zip(starts, ends, strict=True))
    joints = _joints(pieces, spans, segmented, track, inlier, settings)
    gain = segmented.table.motion.gain
    fitted = [
        FittedPiece(
            start=a,
            end=b,
            joint=joints[p.hypothesis][0],
            gain=gain[p.hypothesis],
            leader=_leader(p, segmented),
            log_evidence=p.log_evidence,
            lack_of_fit=joints[p.hypothesis][1],
        )
        for p, (a, b) in zip(pieces, spans, strict=True)
    ]
    return fitted, [None, *(_row_posterior(refined, track) for refined in refined)]


def _leader(piece: Piece, segmented: Segmented) -> Joint | None:
    """The joint of a piece that moves, else None."""
    joint = segmented.table.pool.hypotheses.joints.joint(piece.hypothesis)
    return joint if joint.moves else None


def _refined(
    before: Piece,
    after: Piece,
    since: int,
    segmented: Segmented,
    steps: Steps,
    track: PartTrack,
    inlier: Booleans,
    settings: LearnSettings,
) -> RefinedChangepoint:
    """The row of the transition between two pieces, of which the first begins at row `since`."""
    joints = segmented.table.pool.hypotheses.joints.take([before.hypothesis, after.hypothesis])
    limits = since, int(steps.first[after.end + 1])
    row = max(int(steps.first[after.start]), since + 1)
    widest = float(np.diff(steps.first[after.start - 1 : after.start + 2]).max())
    return refine_changepoint(joints, row, widest, limits, track, inlier, settings.of_steps(steps.size))


def _joints(
    pieces: Sequence[Piece],
    spans: Sequence[tuple[int, int]],
    segmented: Segmented,
    track: PartTrack,
    inlier: Booleans,
    settings: LearnSettings,
) -> dict[int, tuple[Joint, LackOfFit]]:
    """Joints by hypothesis, each fitted to all rows of all pieces that share it, from the one that won.

    With the evidence of the rows against them.
    """
    fits: dict[int, tuple[Joint, LackOfFit]] = {}
    for hypothesis in dict.fromkeys(piece.hypothesis for piece in pieces):
        rows = np.concatenate(
            [np.arange(a, b + 1) for p, (a, b) in zip(pieces, spans, strict=True) if p.hypothesis == hypothesis]
        )
        fitted = fit_joint(
            segmented.table.pool.hypotheses.joints.joint(hypothesis),
            track.position[rows],
            None if track.quaternion is None else track.quaternion[rows],
            track.time[rows],
            inlier[rows].astype(float),
            settings,
        )
        fits[hypothesis] = fitted.joint, fitted.lack_of_fit
    return fits


def _row_posterior(refined: RefinedChangepoint, track: PartTrack) -> RowPosterior:
    weights = np.exp(refined.log_probability - refined.log_probability.max())
    weights = weights / weights.sum()
    kept = weights > _NEGLIGIBLE
    share = weights[kept] / weights[kept].sum()
    return RowPosterior(
        tuple(int(row) for row in track.rows[refined.rows[kept]]), tuple(float(value) for value in share)
    )


def _trace(segmented: Segmented, posterior: ChangepointPosterior, settings: LearnSettings) -> EvidenceTrace:
    """Evidence over time of the joints in use, and of the best alternative of every kind."""
    table = segmented.table
    used = list(dict.fromkeys(piece.hypothesis for piece in segmented.segmentation.pieces))
    names = table.pool.hypotheses.joints.kinds
    total = table.log_density[-1].sum(axis=0) - table.occam
    for kind in settings.kinds:
        of_kind = [i for i, name in enumerate(names) if name == kind]
        if of_kind and not any(names[i] == kind for i in used):
            used.append(max(of_kind, key=lambda i: float(total[i])))
    density = table.log_density[
        np.minimum(np.arange(len(segmented.track)), len(table.log_density) - 1), np.arange(len(segmented.track))
    ]
    return EvidenceTrace(
        rows=tuple(int(row) for row in segmented.track.rows),
        models=_numbered([names[i] for i in used]),
        log_density=tuple(tuple(float(v) for v in row) for row in density[:, used]),
        changepoint=tuple(float(v) for v in posterior.changepoint),
    )


def _numbered(kinds: Sequence[JointKind]) -> tuple[str, ...]:
    """Names of models: their kind, numbered from its second occurrence."""
    counts: dict[str, int] = {}
    names = []
    for kind in kinds:
        counts[kind] = counts.get(kind, 0) + 1
        names.append(kind if counts[kind] == 1 else f"{kind}_{counts[kind]}")
    return tuple(names)
