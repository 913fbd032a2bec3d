"""Learning the extended kinematic graph of a recording: CHAMP and Act-CHAMP for every part.

Sources: MICAH, section IV-A (Act-CHAMP); Niekum et al., "Online Bayesian changepoint detection for articulated motion
models", ICRA 2015 (CHAMP).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.certainty import EdgeCertainty
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import reversed_direction, shifted
from micah_plan.errors import InputError, shown
from micah_plan.learning.acted_run import learn_acted_run
from micah_plan.learning.joints.shared_error import with_shared_error
from micah_plan.learning.online import METHODS, Method, OnlineLearner
from micah_plan.learning.parts.tree import learn_tree
from micah_plan.learning.run import LearnedRun
from micah_plan.learning.segmenting.likelihood_power import likelihood_power_of
from micah_plan.learning.segmenting.noise import MeasurementNoise
from micah_plan.learning.segmenting.noise_fit import initial_noise
from micah_plan.learning.segmenting.steps import MOST_SWEEPS, activity_of, is_long, steps_of
from micah_plan.learning.segments import FittedPiece, segment_configurations, to_segment
from micah_plan.learning.settings import FEWEST_ROWS, LearnSettings
from micah_plan.learning.short_runs import cut_into_runs, one_after_another
from micah_plan.learning.track import PartTrack, find_inliers, part_track
from micah_plan.recording.shared_error import shared_error_of
from micah_plan.recording.symmetry import with_unified_orientations
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress

# Times [s] of the rows that steps are means of, by part and run.
Counted = dict[tuple[str, int], Floats]


def learn_graph(
    recording: Recording,
    method: Method = "act-champ",
    settings: LearnSettings | None = None,
    progress: Progress | None = None,
) -> KinematicGraph:
    """Segment a recording and fit the joints of its segments.

    Every part is attached to the base or to another part, whichever explains the poses best (see `parts.tree`). Every
    run is segmented separately, but short ones together, as a short run alone shows little (see below). The first one
    defines the configuration coordinate, the segments of the others are counted along it and follow in the order of the
    runs. A run in which the only part moves to and fro more than a few times is learned in windows, as by
    `OnlineLearner`.

    Args:
        recording: at least `settings.FEWEST_ROWS` rows per part and run, positions or full poses.
        method: Act-CHAMP predicts motion from the actions; CHAMP is the same without their columns.
        settings: None: the defaults, which are meant for every recording.
        progress: called with a message and the fraction done.

    Raises:
        InputError: unknown method, no rows, fewer than 2 rows of a part, or poses that are not finite.
    """
    if method not in METHODS:
        raise InputError(f"method must be among {METHODS}. Got {shown(method)}")
    if len(recording) == 0:
        raise InputError("recording has no rows", remedy="record the motion of at least one part")
    chosen = settings or LearnSettings()
    recording = with_unified_orientations(recording)
    counted: Counted = {}
    if len(recording.parts) > 1:
        chosen, counted = _common_settings(recording, chosen)
    if method == "champ":
        recording = replace(recording, action=None)
    graph = learn_tree(recording, lambda pair: learn_edge(pair, chosen, counted), progress)
    return _with_shared_errors(graph, recording)


def _with_shared_errors(graph: KinematicGraph, recording: Recording) -> KinematicGraph:
    """The graph with joints' covariances enlarged by shared errors; errors of the base frame affect edges to the base
    only.
    """
    edges = []
    for edge in graph.edges:
        error = shared_error_of(recording, edge.child)
        if error is not None and edge.parent != BASE:
            error = replace(error, frame=np.zeros((6, 6)))
        if error is not None:
            segments = (
                replace(each, joint=with_shared_error(each.joint, each.configuration_range, error))
                for each in edge.segments
            )
            edge = replace(edge, segments=tuple(segments))
        edges.append(edge)
    return replace(graph, edges=tuple(edges))


def _common_settings(recording: Recording, settings: LearnSettings) -> tuple[LearnSettings, Counted]:
    """Common number of steps, likelihood power and rows of a part, for all its pairs.

    A tree compares their evidence.
    """
    counted: Counted = {}
    motions: list[float] = []
    powers: list[float] = []
    tracks: dict[str, tuple[PartTrack, Ints]] = {}
    for part in recording.parts:
        for run in recording.select(part=part).runs:
            track = part_track(recording, run, part)
            activity = activity_of(track, np.flatnonzero(find_inliers(track)))
            counted[part, run] = track.time[activity.rows]
            motions.append(activity.motions_in(len(activity.rows)))
            tracks.setdefault(part, (track, activity.rows))
    settings = replace(settings, sweeps=settings.sweeps or max(motions))
    for track, rows in tracks.values():
        step = steps_of(track, np.isin(np.arange(len(track)), rows), settings)
        powers.append(likelihood_power_of(initial_noise(step.track, settings.of_steps(step.size)), settings))
    return replace(settings, likelihood_power=float(np.mean(powers))), counted


def learn_edge(recording: Recording, settings: LearnSettings, counted: Counted | None = None) -> KinematicEdge:
    """The edge of the only part of a recording in the frame of its poses, with one coordinate for all runs.

    Args:
        counted: times of the rows that steps are means of, by part and run; of others by how the part moves here.
    """
    part = recording.parts[0]
    tracks = [part_track(recording, run, part) for run in recording.runs]
    lengths = [len(track) for track in tracks]
    if len(tracks) > 1 and max(lengths) < settings.resolution / 2 and sum(lengths) <= settings.resolution * MOST_SWEEPS:
        return _edge_of_short_runs(recording, tracks, settings)
    segments: list[Segment] = []
    reference: Joint | None = None
    edges: list[EdgeCertainty | None] = []
    for run, track in zip(recording.runs, tracks, strict=True):
        inlier = find_inliers(track)
        # A tree compares the evidence of pairs: it is that of all rows at once then.
        if settings.sweeps is None and is_long(track, inlier):
            learner = OnlineLearner(settings, part=part, run=run)
            learner.take(track)
            of_run, certainty, noise = list(learner.segments()), learner.edge().certainty, learner.noise
        else:
            times = (counted or {}).get((part, run))
            is_counted = inlier if times is None else inlier & np.isin(track.time, times)
            enough = is_counted.sum() >= FEWEST_ROWS  # of a pair that is seldom seen together
            learned, certainty = _learned(track, settings, inlier, is_counted if enough else inlier)
            of_run, noise = _segments(learned, run), learned.noise
        mover = max((segment for segment in of_run if segment.joint.moves), key=_rows, default=None)
        if reference is not None:
            of_run = _aligned(of_run, mover, reference, track.take(np.flatnonzero(inlier)), noise)
        elif mover is not None:
            reference = mover.joint
        segments += of_run
        edges.append(certainty)
    return KinematicEdge(BASE, part, tuple(segments), _joint_certainty([edge for edge in edges if edge is not None]))


def _learned(
    track: PartTrack,
    settings: LearnSettings,
    inlier: Booleans | None = None,
    counted: Booleans | None = None,
) -> tuple[LearnedRun, EdgeCertainty]:
    """The learned run of a track and its certainty."""
    learned, channel = learn_acted_run(track, settings, inlier, counted)
    counts = tuple(float(p) for p in learned.posterior.counts)
    return learned, EdgeCertainty(learned.posterior.log_evidence, (counts,), channel, learned.trace)


def _edge_of_short_runs(recording: Recording, tracks: list[PartTrack], settings: LearnSettings) -> KinematicEdge:
    """The edge from runs that are too short one by one, learned jointly."""
    together = one_after_another(tracks)
    # Every row is a step, and segments are as long as those of one run.
    run_settings = replace(settings, resolution=max(settings.resolution, len(together)))
    if settings.mean_length is None:
        run_settings = replace(run_settings, mean_length=0.5 * together.duration / len(tracks))
    # Where a run of few rows begins, a motion cannot be separated from an outlier.
    every = np.ones(len(together), dtype=bool)
    learned, certainty = _learned(together, run_settings, every)
    lengths = [len(track) for track in tracks]
    cut = cut_into_runs(learned.pieces, learned.certainties, lengths)

    def segments_of(chain: list[FittedPiece]) -> list[Segment]:
        return [
            to_segment(piece, chain, sure, recording.runs[run], learned.track, learned.inlier, learned.noise)
            for piece, (_, sure, run) in zip(chain, cut, strict=True)
        ]

    chain = [piece for piece, _, _ in cut]
    # The chain is at 0 where a line through the first rows is; few rows of a fast motion are not on it.
    first = segments_of(chain)[0].configuration_start
    segments = segments_of([replace(piece, joint=_counted_along(piece.joint, False, -first)) for piece in chain])
    return KinematicEdge(BASE, recording.parts[0], tuple(segments), replace(certainty, changepoint_counts=()))


def _joint_certainty(runs: Sequence[EdgeCertainty]) -> EdgeCertainty:
    """The certainty of all runs; the number of changepoints only if each run has one."""
    channels = [run.channel for run in runs if run.channel is not None]
    counts = [run.changepoint_counts for run in runs]
    return EdgeCertainty(
        log_evidence=sum(run.log_evidence for run in runs),
        changepoint_counts=sum(counts, ()) if all(counts) else (),
        channel=max(channels, key=lambda channel: channel.explained, default=None),
        trace=runs[0].trace,
    )


def _segments(learned: LearnedRun, run: int) -> list[Segment]:
    """The segments of a run."""
    rows = learned.track, learned.inlier, learned.noise
    return [
        to_segment(piece, learned.pieces, sure, run, *rows)
        for piece, sure in zip(learned.pieces, learned.certainties, strict=True)
    ]


def _aligned(
    segments: list[Segment], longest: Segment | None, reference: Joint, track: PartTrack, noise: MeasurementNoise
) -> list[Segment]:
    """A later run's segments on the first run's coordinate: shifted and, if it ran backward, reversed."""
    backwards, offset = False, 0.0
    if longest is None:
        held = float(np.median(segment_configurations(reference, np.arange(len(track)), track, noise)))
        offset = held - segments[0].joint.fixed_at
    else:
        rows = np.flatnonzero((track.rows >= longest.start) & (track.rows <= longest.end))
        backwards, offset = _alignment(longest.joint, reference, rows, track, noise)
    sign = -1.0 if backwards else 1.0
    aligned = []
    for segment in segments:
        ends = sorted(sign * end + offset for end in segment.configuration_range)
        aligned.append(
            replace(
                segment,
                joint=_counted_along(segment.joint, backwards, offset),
                configuration_start=sign * segment.configuration_start + offset,
                configuration_end=sign * segment.configuration_end + offset,
                configuration_range=(ends[0], ends[1]),
            )
        )
    return aligned


def _alignment(
    joint: Joint, reference: Joint, rows: Ints, track: PartTrack, noise: MeasurementNoise
) -> tuple[bool, float]:
    """(whether a joint's configurations decrease along a reference, offset between the two)."""
    joint_trace, common = (
        segment_configurations(joint, rows, track, noise),
        segment_configurations(reference, rows, track, noise),
    )
    backwards = float((joint_trace - joint_trace.mean()) @ (common - common.mean())) < 0
    return backwards, float(np.median(common - (-joint_trace if backwards else joint_trace)))


def _counted_along(joint: Joint, backwards: bool, offset: float) -> Joint:
    """The joint with its zero and direction moved to those of the first run."""
    return shifted(reversed_direction(joint) if backwards else joint, -offset)


def _rows(segment: Segment) -> int:
    """Number of rows of a segment."""
    return segment.end - segment.start
