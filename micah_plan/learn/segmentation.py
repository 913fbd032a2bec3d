"""Segmenting one track: alternate between the pool of joints and the most probable changepoints until they agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.learn.changepoints import Segmentation, most_probable
from micah_plan.learn.evidence import EvidenceStream
from micah_plan.learn.hypothesis import Hypothesis, JointView, view
from micah_plan.learn.length_prior import LengthPrior
from micah_plan.learn.merging import merged
from micah_plan.learn.noise import NoiseScales
from micah_plan.learn.pool import moves, robust_fit, window_hypotheses
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

Bools = NDArray[np.bool_]

_MOST_ROUNDS = 4
_FEWEST_ROWS = 4


@dataclass(frozen=True, eq=False)
class Segmented:
    """The most probable segments of a track and what they refer to.

    Attributes:
        track: the rows that were segmented (every k-th of a long run).
        segmentation: pieces, in rows of that track.
        stream: the evidence that decided, with its pool and step models.
    """

    track: PartTrack
    inlier: Bools
    noise: NoiseScales
    segmentation: Segmentation
    stream: EvidenceStream


def segment_track(
    track: PartTrack,
    inlier: Bools,
    noise: NoiseScales,
    settings: LearnSettings,
    use_actions: bool,
    rng: np.random.Generator,
) -> Segmented:
    """The most probable segments of a track.

    The pool starts with joints of windows; then the joints of the segments found, and of what their neighbours would be
    if they were one, are fitted by MLESAC and join it, until the changepoints stay. At last, neighbours on one joint
    are joined (see `merging`).
    """
    views = [view(one, track, noise, inlier) for one in window_hypotheses(track, inlier, noise, settings.kinds)]
    prior = _prior(track, settings)
    known: set[tuple[int, int]] = set()
    for remaining in reversed(range(_MOST_ROUNDS)):
        stream = EvidenceStream(track, inlier, noise, views, settings.kinds, use_actions, settings.rest)
        segmentation = most_probable(stream, len(track), prior, rng, settings.particles)
        added = _refitted(segmentation, known, track, inlier, noise, settings, rng) if remaining else []
        if not added:
            break
        views = views + added

    def evidence(along: bool) -> EvidenceStream:
        return EvidenceStream(track, inlier, noise, views, settings.kinds, use_actions, settings.rest, along)

    return Segmented(track, inlier, noise, merged(segmentation, settings.kinds, evidence), stream)


def _refitted(
    segmentation: Segmentation,
    known: set[tuple[int, int]],
    track: PartTrack,
    inlier: Bools,
    noise: NoiseScales,
    settings: LearnSettings,
    rng: np.random.Generator,
) -> list[JointView]:
    """MLESAC fits of the segments and of unions of neighbours, those not fitted yet."""
    pieces = segmentation.pieces
    stretches = {(p.start, p.end) for p in pieces}
    for apart in (1, 2):
        stretches |= {(a.start, b.end) for a, b in zip(pieces, pieces[apart:], strict=False)}
    added: list[JointView] = []
    for start, end in sorted(stretches - known):
        known.add((start, end))
        if end - start + 1 < _FEWEST_ROWS or not moves(track, start, end, inlier, noise):
            continue
        for kind in settings.kinds:
            if kind == "rigid":
                continue
            fit = robust_fit(kind, track, np.arange(start, end + 1), inlier, noise, settings, rng)
            if fit is not None:
                added.append(view(Hypothesis(fit.joint, start, end), track, noise, inlier))
    return added


def _prior(track: PartTrack, settings: LearnSettings) -> LengthPrior:
    """The length prior in rows."""
    share = 0.5 if settings.mean_length is None else settings.mean_length / max(track.duration, 1e-12)
    return LengthPrior(max(share * len(track), 1.0), settings.length_shape)
