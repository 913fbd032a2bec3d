"""Learning the extended kinematic graph of a recording: CHAMP and Act-CHAMP for every part.

Sources: MICAH, section III-B (Act-CHAMP); Niekum et al., "Online Bayesian changepoint detection for articulated motion
models", ICRA 2015 (CHAMP).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import reversed_direction
from micah_plan.errors import InputError, shown
from micah_plan.learn.changepoints import Piece
from micah_plan.learn.noise import NoiseModel, find_inliers
from micah_plan.learn.segmentation import Segmented, segment_track
from micah_plan.learn.segments import (
    FittedPiece,
    chained,
    configurations,
    fit_piece,
    shifted_with_origin,
    to_segment,
)
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack, part_track
from micah_plan.recording.value import Recording

Floats = NDArray[np.float64]
Method = Literal["champ", "act-champ"]
METHODS: tuple[Method, ...] = ("champ", "act-champ")
Progress = Callable[[str, float], None]


def learn_graph(
    recording: Recording,
    method: Method = "act-champ",
    settings: LearnSettings | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> KinematicGraph:
    """Segment a recording and fit the joints of its segments.

    Every part is related to the base by one edge. Every run is segmented on its own; the first run defines the
    configuration coordinate, the segments of the others are counted along it and follow in the order of the runs.

    Args:
        recording: at least 2 rows per part and run, positions or full poses.
        method: Act-CHAMP predicts motion from the actions, CHAMP from the poses alone; without actions they are
            the same.
        settings: None: the defaults, which are meant for every recording.
        seed: of MLESAC and of the resampling; the same seed gives the same result.
        progress: called with a message and the fraction done.

    Raises:
        InputError: unknown method, no rows, fewer than 2 rows of a part, or poses that are not finite.
    """
    if method not in METHODS:
        raise InputError(f"method must be among {METHODS}. Got {shown(method)}")
    if len(recording) == 0:
        raise InputError("recording has no rows", remedy="record the motion of at least one part")
    chosen = settings or LearnSettings()
    edges = []
    for number, part in enumerate(recording.parts):
        runs = tuple(
            dict.fromkeys(int(r) for r, name in zip(recording.run, recording.part, strict=True) if name == part)
        )
        segments: list[Segment] = []
        reference: Joint | None = None
        for i, run in enumerate(runs):
            if progress is not None:
                done = (number + i / len(runs)) / len(recording.parts)
                progress(f"segmenting run {run} of part '{part}'", done)
            rng = np.random.default_rng([seed, number, i])
            found, reference = _learn_run(recording, run, part, chosen, method == "act-champ", rng, reference)
            segments += found
        edges.append(KinematicEdge(BASE, part, tuple(segments)))
    if progress is not None:
        progress("learned", 1.0)
    return KinematicGraph(tuple(edges))


def _learn_run(
    recording: Recording,
    run: int,
    part: str,
    settings: LearnSettings,
    use_actions: bool,
    rng: np.random.Generator,
    reference: Joint | None,
) -> tuple[list[Segment], Joint | None]:
    """Segments of one run, and the joint that the coordinate of all runs is counted along."""
    track = part_track(recording, run, part)
    inlier = find_inliers(track)
    used = np.flatnonzero(inlier)
    used = used[:: -(-len(used) // settings.most_rows)]
    segmented = segment_track(track.summed(used), settings, use_actions, rng)
    noise = segmented.noise
    pieces = _on_all_rows(segmented.segmentation.pieces, used, len(track))
    fitted = [_fitted(piece, pieces, segmented, track, inlier, settings, rng) for piece in pieces]
    chain = chained(fitted, track, inlier, noise)
    longest = max((one for one in chain if one.joint.kind != "rigid"), key=_rows, default=None)
    if reference is not None:
        chain = _aligned(chain, longest, reference, track, inlier, noise)
    elif longest is not None:
        reference = longest.joint
    return [to_segment(one, chain, run, track, inlier, noise) for one in chain], reference


def _on_all_rows(pieces: Sequence[Piece], used: NDArray[np.int64], rows: int) -> list[Piece]:
    """Pieces of the rows used as pieces of all rows: each reaches to where the next one starts."""
    starts = [0, *(int(used[piece.start]) for piece in pieces[1:]), rows]
    return [replace(p, start=a, end=b - 1) for p, a, b in zip(pieces, starts[:-1], starts[1:], strict=True)]


def _fitted(
    piece: Piece,
    pieces: Sequence[Piece],
    segmented: Segmented,
    track: PartTrack,
    inlier: NDArray[np.bool_],
    settings: LearnSettings,
    rng: np.random.Generator,
) -> FittedPiece:
    """The piece with its joint, fitted to all rows of all pieces that share it."""
    joint = segmented.table.pool.hypotheses[piece.hypothesis].joint
    same = [p for p in pieces if p.hypothesis == piece.hypothesis]
    rows = np.concatenate([np.arange(p.start, p.end + 1) for p in same])
    gain = segmented.table.motion.gain[piece.hypothesis]
    return fit_piece(piece, rows, joint, gain, track, inlier, segmented.noise, settings, rng)


def _aligned(
    chain: list[FittedPiece],
    longest: FittedPiece | None,
    reference: Joint,
    track: PartTrack,
    inlier: NDArray[np.bool_],
    noise: NoiseModel,
) -> list[FittedPiece]:
    """A later run's pieces, counted along the first run's coordinate: a shift and, if it ran backwards, a sign."""
    if longest is None:
        rows = np.flatnonzero(inlier)
        held = float(np.median(configurations(reference, rows, track, noise)))
        return [replace(one, joint=replace(one.joint, held=held)) for one in chain]
    rows = np.arange(longest.piece.start, longest.piece.end + 1)
    rows = rows[inlier[rows]]
    own, common = configurations(longest.joint, rows, track, noise), configurations(reference, rows, track, noise)
    backwards = float((own - own.mean()) @ (common - common.mean())) < 0
    offset = float(np.median(common - (-own if backwards else own)))
    return [
        replace(one, joint=shifted_with_origin(reversed_direction(one.joint) if backwards else one.joint, -offset))
        for one in chain
    ]


def _rows(one: FittedPiece) -> int:
    return one.piece.end - one.piece.start
