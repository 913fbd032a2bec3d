"""Learning the extended kinematic graph of a recording: CHAMP and Act-CHAMP for every part.

Sources: MICAH, section IV-A (Act-CHAMP); Niekum et al., "Online Bayesian changepoint detection for articulated motion
models", ICRA 2015 (CHAMP).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import numpy as np

from micah_plan.automaton.certainty import ActionChannel, EdgeCertainty
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import reversed_direction
from micah_plan.errors import InputError, shown
from micah_plan.learn.acted import learn_acted_run
from micah_plan.learn.online import METHODS, Method, OnlineLearner, is_long
from micah_plan.learn.parts.tree import learn_tree
from micah_plan.learn.run import LearnedRun, learn_run
from micah_plan.learn.segments import FittedPiece, configurations, shifted_with_origin, to_segment
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import part_track
from micah_plan.recording.value import Recording

Progress = Callable[[str, float], None]


def learn_graph(
    recording: Recording,
    method: Method = "act-champ",
    settings: LearnSettings | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> KinematicGraph:
    """Segment a recording and fit the joints of its segments.

    Every part hangs on the base or on another part, whichever explains the poses best (see `learn.tree`). Every run is
    segmented on its own; the first one defines the configuration coordinate, the segments of the others are counted
    along it and follow in the order of the runs. A run in which a part moves to and fro more often than is learned at
    once is learned as `OnlineLearner` would.

    Args:
        recording: at least `settings.FEWEST_ROWS` rows per part and run, positions or full poses.
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
    return learn_tree(recording, lambda one: learn_edge(one, method, chosen, seed), progress)


def learn_edge(recording: Recording, method: Method, settings: LearnSettings, seed: int) -> KinematicEdge:
    """How the only part of a recording moves in the frame that its poses are given in, all runs on one coordinate."""
    part = recording.parts[0]
    segments: list[Segment] = []
    reference: Joint | None = None
    learned: list[LearnedRun] = []
    channels: list[ActionChannel | None] = []
    for i, run in enumerate(recording.runs):
        rng = np.random.default_rng([seed, i])
        track = part_track(recording, run, part)
        if method == "act-champ":
            one, channel = learn_acted_run(track, settings, rng)
        else:
            one, channel = learn_run(track, settings, False, rng), None
        learned.append(one)
        channels.append(channel)
        chain = list(one.pieces)
        longest = max((piece for piece in chain if piece.joint.kind != "rigid"), key=_rows, default=None)
        if reference is not None:
            chain = _aligned(chain, longest, reference, one)
        elif longest is not None:
            reference = longest.joint
        segments += [
            to_segment(piece, chain, sure, run, one.track, one.inlier, one.noise)
            for piece, sure in zip(chain, one.certainties, strict=True)
        ]
    certainty = EdgeCertainty(
        log_evidence=sum(one.posterior.log_evidence for one in learned),
        changepoint_counts=tuple(tuple(float(p) for p in one.posterior.counts) for one in learned),
        channel=max((one for one in channels if one is not None), key=lambda one: one.explained, default=None),
        trace=learned[0].trace,
    )
    return KinematicEdge(BASE, part, tuple(segments), certainty)


def _aligned(
    chain: list[FittedPiece], longest: FittedPiece | None, reference: Joint, run: LearnedRun
) -> list[FittedPiece]:
    """A later run's pieces, counted along the first run's coordinate: a shift and, if it ran backwards, a sign."""
    track, noise = run.track, run.noise
    if longest is None:
        held = float(np.median(configurations(reference, np.flatnonzero(run.inlier), track, noise)))
        return [replace(one, joint=replace(one.joint, held=held)) for one in chain]
    rows = longest.index(run.inlier)
    own, common = configurations(longest.joint, rows, track, noise), configurations(reference, rows, track, noise)
    backwards = float((own - own.mean()) @ (common - common.mean())) < 0
    offset = float(np.median(common - (-own if backwards else own)))
    return [
        replace(one, joint=shifted_with_origin(reversed_direction(one.joint) if backwards else one.joint, -offset))
        for one in chain
    ]


def _rows(one: FittedPiece) -> int:
    return one.end - one.start
